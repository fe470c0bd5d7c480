"""What a measurement will know, from the trace alone: levels, contrast, sigma of every pixel.

No frame is rendered, no noise drawn, nothing decoded. Of each pixel the trace gives the irradiance
E of a white field and the projector coordinate; then

| step | formula |
|---|---|
| level, contrast | A = E a + dark, B = E b T(period), see `twin.optics.contrast` |
| noise of one value | EMVA 1288: (K sigma_d)^2 + K (A - black) + 1/12 DN^2, see `SensorNoise` |
| phase | sigma_phi = sqrt(2 / N) sigma_I / B (Surrel 1997), as the decoder states it |
| coordinate | sigma_x = period sigma_phi / 2 pi; of several periods 1 / sqrt(sum 1 / sigma^2) |
| height | sigma_x |dz/dx|, of the triangulation, at the surface's own slope |

What the filter makes of it: `reconstruction.decoding.filter_noise`.

The estimate of N >= 4 steps takes all frames to have the noise of their mean. It is not the last
word of the frames: with fringes of full contrast shot noise is small in the dark frames, and a fit
that knew it would find phases up to sqrt(2) better. No decoder in use does so, this one neither, so
bounds here are on decoded coordinates.

Left out: fixed pattern noise (it scales level and contrast alike), light between surfaces, wrong
fringe orders, and that clipping of a frame near the limit is a matter of chance.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Reason, ReasonImage
from reconstruction.decoding import AxisDecode, Decoded, DecodeOptions
from reconstruction.decoding.filter_noise import FilterNoise, filter_noise, without_edges
from reconstruction.patterns import AXES, Axis
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.pinhole import distortion_jacobian
from reconstruction.triangulation import PointMap, triangulate
from twin.camera import choose_exposure_ms, noise_model
from twin.config.models import Experiment
from twin.optics.contrast import FringeLight
from twin.optics.rig import true_calibration
from twin.optics.stack import TraceMaps, Truth, rows_of
from twin.results.fringe_levels import (
    FringeNumbers,
    axis_levels,
    clipping,
    steps_of,
    white_radiance,
)

# Of a band of rows that stays in the cache with all that is made of it.
_BAND_PIXELS = 1 << 16


@dataclass(frozen=True, eq=False)
class AxisPrediction:
    """One projector axis that the depth is taken from.

    Attributes
    ----------
    sigma_px : (row, col) of the single pixel's coordinate
    height_by_px : (row, col) mm by which the surface's height errs per px of the coordinate
    filtered : what the filter makes of the noise
    """

    sigma_px: FloatArray
    height_by_px: FloatArray
    filtered: FilterNoise


@dataclass(frozen=True, eq=False)
class PredictedMaps:
    """What a measurement is expected to know.

    Attributes
    ----------
    points : without noise and filter, with the sigma of single pixels
    reason : (row, col) as the decoder is expected to mask
    axes : those that the depth is taken from
    exposure_ms : as set, or as the automatic exposure finds it
    """

    points: PointMap
    reason: ReasonImage
    axes: tuple[AxisPrediction, ...]
    exposure_ms: float

    @property
    def valid(self) -> BoolImage:
        """Pixels with a point, (row, col)."""
        return np.asarray(self.reason == Reason.VALID)

    @property
    def single_mm(self) -> FloatArray:
        """Standard deviation of each height before the filter, (row, col) mm; 0 without one."""
        parts = [(one.height_by_px * one.sigma_px) ** 2 for one in self.axes]
        return np.asarray(np.sqrt(sum(parts)))

    @property
    def filtered_mm(self) -> FloatArray:
        """Standard deviation of each height by noise, as measured, (row, col) mm."""
        shares = [one.height_by_px**2 * one.filtered.variance_px2 for one in self.axes]
        return np.asarray(np.sqrt(sum(shares)))

    def noise_mm(self, slope: FloatArray) -> float:
        """Return the standard deviation of sum(slope * height), slope (row, col).

        Neighbours share their errors through the filter; both axes' noises are independent.
        """
        return float(
            np.sqrt(sum(one.filtered.noise(slope * one.height_by_px) ** 2 for one in self.axes))
        )


def predict(experiment: Experiment, maps: TraceMaps, truth: Truth) -> PredictedMaps:
    """Return what a measurement will know of every pixel.

    Parameters
    ----------
    truth : of the same view; its normals say how a depth counts as height

    Raises
    ------
    InputError : automatic exposure without any light
    """
    shape = maps.weight.shape
    (white,) = _by_bands(shape, lambda band: (white_radiance(rows_of(maps, band), experiment),))
    light = FringeLight.of(experiment.projector, experiment.patterns)
    exposure_ms = choose_exposure_ms(experiment, white * np.float32(light.white))
    numbers = FringeNumbers.of(experiment, exposure_ms)
    column, row, reason = _by_bands(
        shape, lambda band: _single_pixels(experiment, rows_of(maps, band), white[band], numbers)
    )
    if experiment.decode.filter_taps:
        reason = without_edges(reason)
    places: dict[Axis, FloatArray] = {"column": maps.column_px, "row": maps.row_px}
    single = _Single(places, {"column": column, "row": row}, reason)
    return _placed(experiment, single, truth, exposure_ms)


def _by_bands(
    shape: tuple[int, ...], found: Callable[[slice], tuple[NDArray[Any], ...]]
) -> tuple[NDArray[Any], ...]:
    """Join what is found of one band of rows after the other.

    Arrays of a whole image leave the cache between two operations, and each new one is memory that
    the system must clear first: a third of the speed.
    """
    rows = max(1, _BAND_PIXELS // shape[1])
    parts = [found(slice(first, first + rows)) for first in range(0, shape[0], rows)]
    return tuple(np.concatenate(one) for one in zip(*parts, strict=True))


def _single_pixels(
    experiment: Experiment, maps: TraceMaps, white: FloatImage, numbers: FringeNumbers
) -> tuple[FloatArray, FloatArray, ReasonImage]:
    """Return sigma of single pixels' coordinates along columns and rows, px, and the mask."""
    places: dict[Axis, FloatArray] = {"column": maps.column_px, "row": maps.row_px}
    light, reason, sigma = white.astype(np.float64), _dark(experiment, white, numbers), []
    for axis in AXES:
        levels = axis_levels(maps, numbers, steps_of(experiment, axis), axis, light)
        growth = clipping(experiment, levels, places[axis], axis, reason)
        too_much = levels.phase_sigma_rad > DecodeOptions.max_phase_sigma_rad
        reason[(reason == 0) & too_much] = Reason.LOW_MODULATION
        sigma.append(np.asarray(levels.sigma_px * growth, np.float64))
    return sigma[0], sigma[1], reason


@dataclass(frozen=True, eq=False)
class _Single:
    """Coordinates as pixels decode by themselves, (row, col) px by axis, and the mask."""

    places: dict[Axis, FloatArray]
    sigma: dict[Axis, FloatArray]
    reason: ReasonImage

    def as_decoded(self) -> Decoded:
        """Return what a decoder without noise and filter would hand on."""
        nothing = np.zeros(self.reason.shape, np.float32)

        def axis(name: Axis) -> AxisDecode:
            return AxisDecode(
                coordinate_px=self.places[name].astype(np.float32),
                phase_rad=nothing,
                order=nothing.astype(np.int16),
                mean_dn=nothing,
                modulation_dn=nothing,
                sigma_px=np.where(self.reason == 0, self.sigma[name], 0.0).astype(np.float32),
                residual_dn=nothing,
                order_error=nothing,
                bias_share=nothing,
            )

        return Decoded(axis("column"), axis("row"), self.reason)


def _dark(experiment: Experiment, white: FloatImage, numbers: FringeNumbers) -> ReasonImage:
    """Mark pixels on which white and black frame will not differ."""
    sensor = noise_model(experiment.camera)
    gain, black_dn = numbers.gain_dn_per_e, sensor.black_level_dn
    light = FringeLight.of(experiment.projector, experiment.patterns)
    electrons = light.white * white.astype(np.float64) * numbers.electrons_per_radiance
    bright = gain * (electrons + numbers.dark_e)
    dim = bright / (light.white / light.black)
    variance = sensor.variance_dn2(bright + black_dn) + sensor.variance_dn2(dim + black_dn)
    dark = bright - dim < DecodeOptions.dark_sigmas * np.sqrt(variance)
    return np.where(dark, Reason.DARK, Reason.VALID).astype(np.uint8)


def _placed(
    experiment: Experiment, single: _Single, truth: Truth, exposure_ms: float
) -> PredictedMaps:
    """Triangulate what is expected, and see what the filter makes of the noise."""
    places, sigma, reason = single.places, single.sigma, single.reason
    decode = experiment.decode
    used: tuple[Axis, ...] = AXES if decode.use == "both" else (decode.use,)
    rig = true_calibration(experiment)
    decoded = single.as_decoded()
    alone = {axis: triangulate(decoded, rig, axis) for axis in used}
    usable = np.logical_and.reduce([found.valid for found in alone.values()]) & truth.lit
    by_px = {
        axis: _height_by_px(rig, truth, axis, usable)
        if rig.layers is None
        else _height_mm(found, truth, usable) / sigma[axis]
        for axis, found in alone.items()
    }
    information = sum(np.where(usable, (by_px[a] * sigma[a]) ** -2.0, 0.0) for a in used)
    axes = []
    for axis in used:
        own = np.where(usable, (by_px[axis] * sigma[axis]) ** -2.0, 0.0)
        share = np.divide(own, information, out=np.zeros(usable.shape), where=usable)
        filtered = filter_noise(
            places[axis],
            sigma[axis] ** 2,
            reason == 0,
            taps=decode.filter_taps,
            sigma_px=decode.filter_sigma_px,
            limit_px=0.5 * experiment.patterns.period_px,
        )
        axes.append(AxisPrediction(sigma[axis], share * by_px[axis], filtered))
    points = alone[used[0]]
    masked = np.where(usable, 0, np.maximum(points.mask_reason, Reason.DARK)).astype(np.uint8)
    return PredictedMaps(points, masked, tuple(axes), exposure_ms)


def coordinate_slope(
    pose: Any, focal_px: tuple[Any, Any], rig: Calibration, truth: Truth, axis: Axis
) -> Any:
    """Return the change of the projector coordinate along each camera ray, (row, col) px.

    Per length of the ray from the camera to the surface, in air; analytic in the first two.

    Parameters
    ----------
    pose : (3, 4) of T_proj_from_world
    focal_px : of the projector, along columns and rows
    """
    shape = truth.lit.shape
    # Axis by axis: a product with a matrix of three columns takes several times as long.
    point = np.moveaxis(truth.points_world_mm, -1, 0).reshape(3, -1).astype(np.float64)
    turned = (pose[:, :3] @ point).reshape(3, *shape)
    x, y, z = turned + pose[:, 3, None, None]
    dx, dy, dz = turned - (pose[:, :3] @ rig.T_world_from_cam[:3, 3])[:, None, None]
    z = np.where(truth.lit, z, 1.0)
    u, v = x / z, y / z
    u_slope, v_slope = (dx - u * dz) / z, (dy - v * dz) / z
    xx, xy, yy = distortion_jacobian(u, v, rig.projector.distortion)
    if axis == "row":
        return focal_px[1] * (xy * u_slope + yy * v_slope)
    return focal_px[0] * (xx * u_slope + xy * v_slope)


def _height_by_px(rig: Calibration, truth: Truth, axis: Axis, usable: BoolImage) -> FloatArray:
    """Return by how much the surface's height errs per px of the coordinate, in air; mm."""
    lens = rig.projector
    pose = np.linalg.inv(rig.T_world_from_proj)[:3]

    def of_band(band: slice) -> tuple[FloatArray]:
        seen = rows_of(truth, band)
        slope = np.abs(coordinate_slope(pose, (lens.fx_px, lens.fy_px), rig, seen, axis))
        ray = seen.points_world_mm.astype(np.float64) - rig.T_world_from_cam[:3, 3]
        normals = seen.normals_world.astype(np.float64)
        across = np.abs(np.einsum("rcx,rcx->rc", ray, normals))
        found: FloatArray = np.ones(slope.shape)
        told = usable[band] & (slope > 0.0)
        np.divide(across, np.abs(normals[..., 2]) * slope, out=found, where=told)
        return (found,)

    return _by_bands(usable.shape, of_band)[0]


def _height_mm(found: PointMap, truth: Truth, usable: BoolImage) -> FloatArray:
    """Return the sigma of the surface's height, (row, col) mm; 1 where there is no point.

    A point that errs along its ray by e on a surface with the normal n looks like a height that
    errs by e . n / n_z.
    """
    along = found.points_world_mm - found.T_world_from_cam[:3, 3].astype(np.float32)
    error = np.copysign(found.sigma_xyz_mm, along).astype(np.float64)
    across = np.abs(np.einsum("rcx,rcx->rc", error, truth.normals_world))
    upward = np.abs(truth.normals_world[..., 2].astype(np.float64))
    height: FloatArray = np.ones(usable.shape)
    np.divide(across, upward, out=height, where=usable & (across > 0.0))
    return height
