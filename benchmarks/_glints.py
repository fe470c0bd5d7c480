"""References of the glints: energy, contrast of compound Poisson sums, and every facet as geometry.

None of them uses the kernels of `twin.optics.glints`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, signal

from twin.config import Experiment, load_experiment
from twin.config.coatings import DiscreteFacets, Glints
from twin.mechanics.relief import FaceGrid
from twin.optics.flakes import FlakeProcess
from twin.optics.glints import PixelMaps, glint_maps
from twin.optics.pupil_cone import Cone

Floats = NDArray[np.floating[Any]]
NO_BSDF: dict[str, Any] = {}


@dataclass(frozen=True)
class FlatCoat:
    """A flat coat under parallel light: the camera looks along the normal.

    Attributes
    ----------
    facets : flakes of the coat
    camera, projector : radii of the pupils over their distance
    tilt_rad : angle between the directions to camera and projector
    """

    facets: DiscreteFacets
    camera: float = 0.0146
    projector: float = 0.01
    tilt_rad: float = 0.4

    @property
    def scatter(self) -> float:
        """Standard deviation of the reflected directions, rad."""
        return 2.0 * self.facets.glints.facet_roughness

    def ratio(self, seed: int, pitch_mm: float, pixels: int) -> Floats:
        """Return the glints of square pixels, (row, col)."""
        process, cone = (
            FlakeProcess.of(self.facets, seed),
            Cone.of(self.camera, self.projector, self.scatter),
        )
        return glint_maps(process, self.facets.share, cone, self.maps(pitch_mm, pixels)).ratio

    def maps(self, pitch_mm: float, pixels: int) -> PixelMaps:
        """Return the geometry of square pixels; the material is the world's x and y."""
        y_mm, x_mm = np.mgrid[:pixels, :pixels] * pitch_mm
        fields = np.zeros((pixels, pixels, 10), np.float32)
        for first in (0, 2, 7):
            fields[..., first], fields[..., first + 1] = x_mm, y_mm
        fields[..., 6] = 1.0
        to_eye, to_light = np.zeros((2, pixels, pixels, 3), np.float32)
        to_eye[..., 2] = 1.0
        to_light[..., 0], to_light[..., 2] = np.sin(self.tilt_rad), np.cos(self.tilt_rad)
        one = np.ones((pixels, pixels, 2), np.float32)
        return PixelMaps(np.ones((pixels, pixels), bool), fields, to_eye, to_light, one)

    def contrast(self, pitch_mm: float) -> float:
        """Return the standard deviation of the ratio by Campbell's theorem.

        The variance of a sum over Poisson points is the density times the integral of the squared
        contribution: that of place and size times that of the tilt.
        """
        process = FlakeProcess.of(self.facets, 0)
        radii_mm, weights = radii_of(process)
        area_mm2 = np.sum(weights * np.pi * radii_mm**2)
        squares = [square_overlap_mm6(radius, pitch_mm) for radius in radii_mm]
        first, second = self._tilt_moments(process.alpha)
        footprint_mm2 = pitch_mm**2
        variance = np.sum(weights * squares) / (
            process.density_per_mm2 * (area_mm2 * footprint_mm2) ** 2
        )
        return float(np.sqrt(variance * second / first**2))

    def _tilt_moments(self, alpha: float) -> tuple[float, float]:
        """Return mean and mean square of the light of a facet over the distribution of tilts."""
        chords, density = cone_by_convolution(self.camera, self.projector, self.scatter)
        half = 0.5 * self.tilt_rad
        reach = 0.6 * chords[-1] / np.cos(half) ** 2
        along = np.linspace(-reach, reach, 801)
        slope_x, slope_y = np.meshgrid(along - np.tan(half), along)
        square = slope_x**2 + slope_y**2
        steep = np.sqrt(1.0 + square)
        facet = np.stack([-slope_x, -slope_y, np.ones_like(square)], axis=-1) / steep[..., None]
        to_light = np.array([np.sin(self.tilt_rad), 0.0, np.cos(self.tilt_rad)])
        cosine = facet @ to_light
        mirrored = 2.0 * cosine[..., None] * facet - to_light
        chord = np.sqrt(np.maximum(2.0 - 2.0 * mirrored[..., 2], 0.0))
        light = 4.0 * cosine * steep * np.interp(chord, chords, density, right=0.0)
        tilts = (1.0 + square / alpha**2) ** -2 / (np.pi * alpha**2) * (along[1] - along[0]) ** 2
        return float(np.sum(tilts * light)), float(np.sum(tilts * light**2))


def radii_of(process: FlakeProcess) -> tuple[Floats, Floats]:
    """Return radii, mm, and weights of a quadrature over the log-normal distribution, cut at 3."""
    deviation = np.linspace(-3.0, 3.0, 61)
    weights = np.exp(-0.5 * deviation**2)
    weights[[0, -1]] *= 0.5
    return process.median_mm * np.exp(process.spread * deviation), weights / weights.sum()


def square_overlap_mm6(radius_mm: float, side_mm: float) -> float:
    """Return the integral of (area of disc within square)^2 over all places of the disc.

    It is the integral of the product of the two set covariances (Matheron 1975).
    """
    reach_mm = min(2.0 * radius_mm, np.sqrt(2.0) * side_mm)
    lag = (np.arange(400) + 0.5) / 400 * reach_mm
    x, y = np.meshgrid(lag, lag)
    square = np.maximum(side_mm - x, 0.0) * np.maximum(side_mm - y, 0.0)
    share = np.minimum(np.hypot(x, y) / (2.0 * radius_mm), 1.0)
    disc = 2.0 * radius_mm**2 * (np.arccos(share) - share * np.sqrt(1.0 - share**2))
    return float(4.0 * np.sum(square * disc) * (lag[1] - lag[0]) ** 2)


def cone_by_convolution(camera: float, projector: float, scatter: float) -> tuple[Floats, Floats]:
    """Return chords and density, 1/sr, of two discs and a normal distribution, by convolution."""
    reach = camera + projector + 5.0 * scatter
    along = np.linspace(-reach, reach, 801)
    x, y = np.meshgrid(along, along)
    density = np.exp(-0.5 * (x**2 + y**2) / scatter**2)
    for radius in (camera, projector):
        if radius > 0.0:
            edge = np.clip((radius - np.hypot(x, y)) / (along[1] - along[0]) + 0.5, 0.0, 1.0)
            density = signal.fftconvolve(density, edge, mode="same")
    density /= density.sum() * (along[1] - along[0]) ** 2
    return along[400:], density[400, 400:]


def flat_face(half_mm: float = 12.0) -> FaceGrid:
    """Return a flat coated face."""
    along = np.linspace(-half_mm, half_mm, 25)
    x_mm, y_mm = np.meshgrid(along, along)
    vertices = np.stack([x_mm, y_mm, 0.0 * x_mm], axis=-1).reshape(-1, 3).astype(np.float32)
    normals = np.zeros_like(vertices)
    normals[:, 2] = 1.0
    return FaceGrid(x_mm.shape, vertices, normals)


def glinting(
    f_number: float,
    aperture_mm: float,
    pixels: int = 400,
    field_mm: float = 20.0,
    polar_deg: float = 25.0,
    **glints: float,
) -> Experiment:
    """Return an experiment that images a square field of a coat with glints."""
    settings = {"diameter_um": 15.0, "diameter_spread": 0.4, "facet_roughness": 0.03} | glints
    return load_experiment(
        "examples/slab_ball",
        {
            "camera.width_px": pixels,
            "camera.height_px": pixels,
            # A pixel of 4.5 um images 14.76 um.
            "camera.pixel_pitch_um": 4.5 / 0.01476 * field_mm / pixels,
            "camera.f_number": f_number,
            "projector.aperture_mm": aperture_mm,
            "projector.pose.polar_deg": polar_deg,
            **{f"coating.glints.{name}": value for name, value in settings.items()},
        },
    )


def mean_over_smooth(seeds: range) -> float:
    """Return the mean radiance of white on glinting flat coats over that on the smooth coat.

    The standard deviation of one coat is 0.001: 20 x 20 mm have 3 million flakes.
    """
    from twin.pipeline import trace

    case = glinting(8.0, 4.0, 200, diameter_um=6.0, facet_roughness=0.06)
    geometry = trace.load_face(case, flat_face())
    view = trace.view_of(case, geometry)
    coating = case.coating.model_copy(update={"glints": None})
    smooth = case.model_copy(update={"coating": coating})
    weights = [
        np.sum(np.asarray(trace.patches_of(each, geometry, view).weight, np.float64))
        for each in (smooth, *(case.model_copy(update={"seed": seed}) for seed in seeds))
    ]
    return float(np.mean(weights[1:]) / weights[0])


class BruteForce:
    """Every facet of a flat coat as geometry: random points on pupils, flake and its own slopes."""

    def __init__(self, case: Experiment, samples: int, seed: int = 1) -> None:
        from twin.optics.glinting import cone_of, pixel_maps
        from twin.pipeline import trace

        self.rng, self.samples = np.random.default_rng(seed), samples
        face = flat_face()
        geometry = trace.load_face(case, face)
        view = trace.view_of(case, geometry)
        self.rig, self.facets = view.rig, case.coating.facets()
        self.process = FlakeProcess.of(self.facets, case.seed)
        self.maps = pixel_maps(case, self.facets, face, self.rig, view.truth)
        self.cone = cone_of(case, self.facets, self.rig)
        self.radii_mm = (
            case.camera.focal_length_mm / case.camera.f_number / 2,
            case.projector.aperture_mm / 2,
        )

    def expected(self) -> Floats:
        """Return the glints as the renderer computes them, (row, col)."""
        return glint_maps(self.process, self.facets.share, self.cone, self.maps).ratio

    def rms_over_noise(self) -> float:
        """Return the RMS deviation of the renderer's glints over the random error of this class.

        The error is that of the mean of two independent estimates, from their difference.
        """
        smooth = self._smooth()
        first, second = (self._sums() / smooth for _ in range(2))
        deviation = self.expected() - 0.5 * (first + second)
        return float(2.0 * np.sqrt(np.mean(deviation**2) / np.mean((first - second) ** 2)))

    def _sums(self) -> Floats:
        """Return the distribution of normals at the half vectors, over all flakes of each pixel."""
        flakes, facet, place = self._glinting_flakes()
        shape = self.maps.valid.shape
        sums = np.zeros(shape[0] * shape[1])
        area_mm2 = np.pi * flakes[:, 2] ** 2 / facet[:, 2]  # of the facet: its plan over its cosine
        for half in self._half_vectors(place, self.samples):
            cosine = np.sum(half * facet, axis=1)
            density = normal_slopes(cosine, self.facets.glints.facet_roughness)
            spot = place + flakes[:, 2, None] * disc(self.rng, len(place), np.eye(3)[:2])
            column, row = np.rint(self._image_px(spot)).astype(int)
            inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
            index = row[inside] * shape[1] + column[inside]
            light = area_mm2[inside] * density[inside] / self.samples
            sums += np.bincount(index, light, sums.size)
        return sums.reshape(shape) / self._footprint_mm2()

    def _glinting_flakes(self) -> tuple[Floats, Floats, Floats]:
        """Return the flakes that can reflect the pupils, their normals and their places."""
        half_mm = 0.51 * self.maps.valid.shape[0] * np.sqrt(self._footprint_mm2())
        flakes = self.process.within((-half_mm, half_mm, -half_mm, half_mm)).flakes
        facet = np.stack([-flakes[:, 3], -flakes[:, 4], np.ones(len(flakes))], axis=1)
        facet /= np.linalg.norm(facet, axis=1, keepdims=True)
        place = np.stack([flakes[:, 0], flakes[:, 1], 0 * flakes[:, 0]], axis=1)
        half = unit(unit(self._position(0) - place) + unit(self._position(1) - place))
        near = 2.0 * np.linalg.norm(half - facet, axis=1) < 1.1 * self.cone.reach
        return flakes[near], facet[near], place[near]

    def _position(self, number: int) -> Floats:
        device = (self.rig.camera, self.rig.projector)[number]
        return device.T_world_from_device[:3, 3]

    def _half_vectors(self, place: Floats, count: int) -> Iterator[Floats]:
        """Yield half vectors of random points on both pupils, which face the world origin."""
        for _ in range(count):
            rays = []
            for number, radius_mm in enumerate(self.radii_mm):
                position = self._position(number)
                across = unit(np.cross(position, [0.0, 1.0, 0.0]))
                axes = np.stack([across, unit(np.cross(position, across))])
                rays.append(unit(position + radius_mm * disc(self.rng, len(place), axes) - place))
            yield unit(rays[0] + rays[1])

    def _image_px(self, points_mm: Floats) -> Floats:
        camera = self.rig.camera
        pose = camera.T_world_from_device
        return camera.pinhole.project((points_mm - pose[:3, 3]) @ pose[:3, :3]).T

    def _footprint_mm2(self) -> float:
        camera = self.rig.camera
        return float((np.linalg.norm(self._position(0)) / camera.pinhole.fx_px) ** 2)

    def _smooth(self) -> Floats:
        """Return the mean over all coats, (row, col): GGX smeared by the flakes' own slopes."""
        rows, cols = self.maps.valid.shape
        step = (rows - 1) // 19
        places = self.maps.fields[::step, ::step, 7:10].reshape(-1, 3).astype(np.float64)
        sums, count = np.zeros(len(places)), 1000
        for half in self._half_vectors(places, count):
            own = self.facets.glints.facet_roughness * self.rng.normal(size=(len(half), 2))
            facet = unit(half + across(half, own))
            # The area of a flake is seen from the half vector: its density has 1 / cosine.
            sums += ggx(facet[:, 2], self.facets.alpha) / np.sum(half * facet, axis=1)
        grid = (sums / count).reshape(len(range(0, rows, step)), -1)
        at = np.mgrid[:rows, :cols] / step
        return self.facets.share * ndimage.map_coordinates(grid, at, order=1, mode="nearest")


def across(normal: Floats, slopes: Floats) -> Floats:
    """Return vectors perpendicular to unit vectors, of the given two components."""
    first = unit(np.cross(normal, [0.0, 1.0, 0.0]))
    return slopes[:, :1] * first + slopes[:, 1:] * np.cross(normal, first)


def unit(vectors: Floats) -> Floats:
    """Return the vectors (..., xyz) with length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def disc(rng: np.random.Generator, count: int, axes: Floats) -> Floats:
    """Return uniform random points of the unit disc with the given axes, (point, xyz)."""
    radius, angle = np.sqrt(rng.random(count)), 2.0 * np.pi * rng.random(count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1) @ axes


def normal_slopes(cosine: Floats, deviation: float) -> Floats:
    """Return the Beckmann distribution of normals, 1/sr, of a flake's own slopes."""
    tangent = 1.0 / cosine**2 - 1.0
    density = np.exp(-0.5 * tangent / deviation**2) / (2.0 * np.pi * deviation**2 * cosine**4)
    return np.where(cosine > 0.0, density, 0.0)


def ggx(cosine: Floats, alpha: float) -> Floats:
    """Return the GGX distribution of normals, 1/sr."""
    return alpha**2 / (np.pi * (cosine**2 * (alpha**2 - 1.0) + 1.0) ** 2)


def glint_facets(
    diameter_um: float = 15.0, diameter_spread: float = 0.4, facet_roughness: float = 0.05
) -> DiscreteFacets:
    """Return facets with 15 % of the area and GGX alpha of 0.4."""
    glints = Glints(
        diameter_um=diameter_um,
        diameter_spread=diameter_spread,
        facet_roughness=facet_roughness,
    )
    return DiscreteFacets(glints, 0.15, 0.4, NO_BSDF)
