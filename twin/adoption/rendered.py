"""Render a captured scene: its measured surface in the view of the adopted rig.

The surface is the slightly smoothed reconstruction, because noise would change the shading. A pixel
of the rendered image is black if the capture has no point at this pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.ndimage import gaussian_filter, map_coordinates

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.capture.folder import Capture
from reconstruction.characterise import UncertainValue
from reconstruction.errors import InputError
from reconstruction.pipeline import Reconstruction, ReconstructOptions, reconstruct
from reconstruction.triangulation import PointMap
from twin.config.models import Coating, Experiment, Patterns
from twin.optics.coatings.matte import Matte
from twin.pipeline.fringes import expose_capture, render
from twin.pipeline.progress import Stopwatch
from twin.specimens.solids import grid_facets

_SMOOTH_PX = 2.0
# Approximate limit of the number of nodes of a face, fine enough for any image.
_MOST_NODES = 250_000
# Pixels per node, no integer: with nodes on the rays of pixels some rays pass between facets.
_UNALIGNED = 1.618
_RIM_PX = 8
_BLOCKS = 8
_LEAST_PIXELS = 1000
# Relative error of the shading, from the noise of the smoothed surface and from the rendering.
_SHADING_RELATIVE = 0.005
# Only the uniform frames are used.
_UNIFORM = Patterns(period_px=64.0, steps=3, code="gray")


def face_of(points: PointMap, origin_mm: tuple[float, float, float]) -> trimesh.Trimesh:
    """Return the smoothed measured surface as a mesh in the rig's frame, mm, with normals up.

    `origin_mm` (xyz) is the rig's origin in the world frame of the points.
    """
    valid = points.valid
    weight = gaussian_filter(valid.astype(np.float64), _SMOOTH_PX)
    smooth = (
        np.stack(
            [
                gaussian_filter(np.where(valid, points.points_world_mm[..., k], 0.0), _SMOOTH_PX)
                for k in range(3)
            ],
            axis=-1,
        )
        / np.maximum(weight, 1e-9)[..., None]
    )
    step = _UNALIGNED * max(1.0, float(np.sqrt(valid.size / _MOST_NODES)))
    places = np.meshgrid(*(np.arange(0.2, n - 1.0, step) for n in valid.shape), indexing="ij")
    nodes = np.stack([_between(smooth[..., k], places) for k in range(3)], axis=-1)
    nodes -= np.array(origin_mm)
    is_inside = _between(valid.astype(np.float64), places).ravel() > 0.999
    facets = grid_facets(*nodes.shape[:2])
    facets = facets[is_inside[facets].all(axis=1)]
    # If image rows ascend towards -y, which is usual, the grid's facets face down.
    corner = nodes.reshape(-1, 3)[facets]
    up = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2]
    facets = facets[:, ::-1] if float(up.mean()) < 0.0 else facets
    mesh = trimesh.Trimesh(nodes.reshape(-1, 3), facets, process=False, validate=False)
    mesh.metadata["name"] = "coated_face"
    return mesh


def _between(image: FloatArray, places: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(map_coordinates(image, places, order=1, mode="nearest"))


@dataclass(frozen=True, eq=False)
class Scene:
    """A capture, its reconstruction, and the rig's origin (xyz) in the capture's world frame."""

    capture: Capture
    points: Reconstruction
    origin_mm: tuple[float, float, float]

    @property
    def face(self) -> trimesh.Trimesh:
        """The measured surface in the rig's frame."""
        return face_of(self.points.point_map, self.origin_mm)


@dataclass(frozen=True, eq=False)
class Rendered:
    """Simulated capture of a scene that was captured before, and its reconstruction."""

    capture: Capture
    points: Reconstruction


def patterns_of(capture: Capture) -> Patterns:
    """Return the pattern sequence of a capture in the form of a rig file."""
    return Patterns.of(capture.patterns)


def render_again(experiment: Experiment, scene: Scene) -> Rendered:
    """Render the measured surface with the adopted rig, record the frames and reconstruct them."""
    captured = experiment.model_copy(update={"patterns": patterns_of(scene.capture)})
    radiance = render(captured, scene.face)
    recorded = expose_capture(captured, radiance, Stopwatch(), 0).capture
    recorded = replace(recorded, response=scene.capture.response)
    return Rendered(recorded, reconstruct(recorded, ReconstructOptions()))


def albedo_of(
    experiment: Experiment, scene: Scene, reference: Capture, reference_albedo: UncertainValue
) -> UncertainValue:
    """Return the coat's albedo, from captures of the coat and of a matte reference.

    The ratio of the light of both captures is compared with that of renderings of both surfaces.
    The radiance of the coat is a constant (its flakes) plus a term in proportion to its albedo; two
    renderings with different albedos give both terms at every pixel. Both captures must have the
    same exposure and gain.

    Raises
    ------
    InputError : the coat has no albedo, too few pixels have a point in both captures, or the
        resulting albedo is outside 0 to 1
    """
    coat = experiment.coating
    if not coat.albedo_field:
        raise InputError(
            f"--reference: found coating.kind = '{coat.kind}', which has no albedo to be "
            "determined; leave the reference away, or give a rig with another coating"
        )
    matte = Matte(base_albedo=reference_albedo.value)
    reference_scene = Scene(
        reference, reconstruct(reference, ReconstructOptions()), scene.origin_mm
    )
    rendered_reference = _light(experiment, matte, reference_scene)
    dark, bright = (
        _light(experiment, coat.model_copy(update={coat.albedo_field: albedo}), scene)
        for albedo in (0.2, 0.7)
    )
    measured, reference_light = _white_less_black(scene.capture), _white_less_black(reference)
    inside = _inside(scene.points.point_map) & _inside(reference_scene.points.point_map)
    inside &= (reference_light > 0.0) & (bright > dark)
    if int(inside.sum()) < _LEAST_PIXELS:
        raise InputError(
            f"coat and reference share {int(inside.sum())} pixels with points and light; the "
            f"albedo needs {_LEAST_PIXELS}: put the reference in the coat's place"
        )
    ratio = measured[inside] / reference_light[inside] * rendered_reference[inside]
    albedo = 0.2 + 0.5 * (ratio - dark[inside]) / (bright - dark)[inside]
    value = float(np.median(albedo))
    _require_albedo(value, reference_albedo.value)
    spread = _spread_of_blocks(albedo, inside)
    relative = np.hypot(reference_albedo.uncertainty / reference_albedo.value, _SHADING_RELATIVE)
    return UncertainValue(value, float(np.hypot(spread, value * relative)))


def _require_albedo(albedo: float, reference: float) -> None:
    if not 0.0 < albedo < 1.0:
        raise InputError(
            f"the coat's albedo is {albedo:.3g}, allowed 0 to 1, with a reference of "
            f"{reference:g}; record both at the same exposure and gain, and check "
            "--reference-albedo"
        )


def _light(experiment: Experiment, coat: Coating, scene: Scene) -> FloatArray:
    """Return the rendered radiance (row, col) of a measured surface: white minus black frame."""
    varied = experiment.model_copy(update={"coating": coat, "patterns": _UNIFORM})
    frames = render(varied, scene.face).frames
    return np.asarray(frames[-2].astype(np.float64) - frames[-1])


def _white_less_black(capture: Capture) -> FloatArray:
    white, black = (
        capture.stack[capture.patterns.index(kind).start].astype(np.float64)
        for kind in ("white", "black")
    )
    return np.asarray(white - black)


def _inside(points: PointMap) -> BoolImage:
    """Return whether each pixel (row, col) has points all around.

    Near the rims of the surface, smoothing displaces it.
    """
    weight: FloatImage = gaussian_filter(points.valid.astype(np.float32), _SMOOTH_PX)
    # The weight at a straight rim is 0.5; single missing pixels are filled by their neighbours.
    inside = points.valid & (weight > 0.9)
    inside[:_RIM_PX], inside[-_RIM_PX:] = False, False
    inside[:, :_RIM_PX], inside[:, -_RIM_PX:] = False, False
    return inside


def _spread_of_blocks(values: FloatArray, inside: BoolImage) -> float:
    """Return the standard error of the median of `values` (n,), from medians of 8 x 8 blocks.

    `inside` (row, col) are the pixels of the image to which the values belong.
    """
    rows, cols = inside.shape
    row, col = np.nonzero(inside)
    block = row * _BLOCKS // rows * _BLOCKS + col * _BLOCKS // cols
    medians = [np.median(values[block == k]) for k in np.unique(block)]
    return float(np.std(medians) / np.sqrt(len(medians)))
