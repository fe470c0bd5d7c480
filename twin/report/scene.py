"""Scene of a measurement for 3-D views: relief, deviation, specimen, rays of the rig, views."""

from dataclasses import replace

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize

from reconstruction.arrays import FloatArray, IntArray, at_pixels
from reconstruction.cells import CellMeans
from reconstruction.rig.layers import PlaneLayers
from reconstruction.rig.pinhole import Pinhole
from twin.config import Experiment
from twin.mechanics import PressedElastomer, fields_at
from twin.optics.rig import true_calibration
from twin.optics.view import SceneDescription, SceneLines, SceneSurface, SceneView
from twin.report.canvas import near_truth, symmetric_limit
from twin.report.relief import average_on_grid, enlargement, height_surface
from twin.results.record import Measurement
from twin.specimens import height_above_lowest

HEIGHTS, DEVIATION, SPECIMEN = "measured heights", "deviation", "specimen"
CAMERA, PROJECTOR, ELASTOMER = "camera's rays", "projector's rays", "elastomer"
CAMERA_RGB, PROJECTOR_RGB, SPECIMEN_RGB = (31, 119, 180), (214, 110, 14), (190, 182, 168)
_ELASTOMER_RGB = (90, 100, 112)
_MOST_CELLS, _SPECIMEN_CELLS = 110, 140
_RELIEF_SHARE = 0.25
_BISECTIONS = 60


def measured_scene(measured: Measurement) -> SceneDescription:
    """Return the scene of a measurement with at least one point.

    Its views are "relief", "deviation" and "rig".
    """
    relief, deviation_um = _cells(measured)
    low, high = np.percentile(relief.mean[relief.valid], (0.5, 99.5))
    limit_um = symmetric_limit(deviation_um.mean[deviation_um.valid])
    surfaces = (
        height_surface(HEIGHTS, relief, _scale("viridis", low, high)),
        height_surface(DEVIATION, relief, _scale("RdBu_r", -limit_um, limit_um), deviation_um.mean),
        *_specimen(measured, relief),
    )
    lines = rig_lines(measured.experiment, elastomer=measured.pressed is not None)
    near = _near_view(relief, float(low), float(high))
    shown = tuple(name for name in SceneDescription(surfaces, lines).names if name != DEVIATION)
    views = {
        "relief": replace(near, shows=(HEIGHTS,)),
        "deviation": replace(near, shows=(DEVIATION,)),
        "rig": _rig_view(measured.experiment, shown),
    }
    return SceneDescription(surfaces, lines, views)


def _scale(name: str, low: float, high: float) -> ScalarMappable:
    return ScalarMappable(Normalize(low, max(high, low + 1e-9), clip=True), colormaps[name])


def _cells(measured: Measurement) -> tuple[CellMeans, CellMeans]:
    """Return the measured heights (mm) and their z errors (um), averaged on the same cells.

    Points far from the true surface are omitted.
    """
    points, true_mm = measured.points, measured.truth.points_world_mm
    on = points.valid & measured.truth.measured
    on = on if on.any() else points.valid
    true_on_mm = at_pixels(true_mm, on).astype(np.float64)
    world_mm = at_pixels(points.world_mm, on).astype(np.float64)
    near = near_truth(world_mm, true_on_mm)
    if near.any():
        world_mm, true_on_mm = world_mm[near], true_on_mm[near]
    error_um = 1e3 * (world_mm[:, 2] - true_on_mm[:, 2])
    grid = measured.pixel_mm, _MOST_CELLS
    return (
        average_on_grid(world_mm, world_mm[:, 2], *grid),
        average_on_grid(world_mm, error_um, *grid),
    )


def _specimen(measured: Measurement, relief: CellMeans) -> list[SceneSurface]:
    """Return the surface of the specimen that faces the elastomer, in its final pressed position.

    The list is empty for a measurement without press.
    """
    if measured.pressed is None:
        return []
    experiment = measured.experiment
    left, right, low, high = relief.extent_mm
    pitch_mm = max(right - left, high - low) / _SPECIMEN_CELLS
    x_mm = np.arange(left + pitch_mm / 2, right, pitch_mm)
    y_mm = np.arange(low + pitch_mm / 2, high, pitch_mm)
    behind_mm = height_above_lowest(experiment.specimen, x_mm, y_mm)[::-1]
    front_mm = measured.pressed.depth_mm + experiment.elastomer.touched_plane_mm
    there = np.isfinite(behind_mm)
    z_mm = front_mm - np.where(there, behind_mm, 0.0)
    cells = CellMeans(x_mm, y_mm[::-1], z_mm, there, pitch_mm)
    grey = ScalarMappable(Normalize(), ListedColormap([np.divide(SPECIMEN_RGB, 255.0)]))
    return [height_surface(SPECIMEN, cells, grey)]


def _near_view(relief: CellMeans, low_mm: float, high_mm: float) -> SceneView:
    """Return the oblique view of the relief, from -y and slightly from -x, with z enlarged."""
    left, right, bottom, top = relief.extent_mm
    middle = ((left + right) / 2, (bottom + top) / 2, (low_mm + high_mm) / 2)
    width_mm = 0.84 * float(np.hypot(right - left, top - bottom))
    enlarged = max(1.0, enlargement(right - left, high_mm - low_mm, _RELIEF_SHARE) / 2)
    return SceneView.around(middle, width_mm, -0.5, 0.6, enlarged=enlarged)


def _rig_view(experiment: Experiment, shows: tuple[str, ...]) -> SceneView:
    """Return the view that contains camera, projector and the world origin."""
    rig = true_calibration(experiment)
    ends_mm = np.stack((rig.T_world_from_cam[:3, 3], rig.T_world_from_proj[:3, 3], np.zeros(3)))
    middle = (ends_mm.max(axis=0) + ends_mm.min(axis=0)) / 2
    width_mm = 2.4 * float(np.linalg.norm(ends_mm - middle, axis=1).max())
    return SceneView.around(middle, width_mm, 0.3, 0.15, shows=shows)


def rig_lines(experiment: Experiment, *, elastomer: bool) -> tuple[SceneLines, ...]:
    """Return the rays of camera and projector to the corners of their fields, world mm.

    The rays are refracted at the layers. If `elastomer` is True, the edges of the elastomer are
    added.
    """
    rig, slab = true_calibration(experiment), experiment.elastomer
    camera = field_rays(rig.camera, rig.T_world_from_cam, rig.layers)
    projector = field_rays(rig.projector, rig.T_world_from_proj, rig.layers)
    lines = (
        SceneLines.along(CAMERA, camera, CAMERA_RGB),
        SceneLines.along(PROJECTOR, projector, PROJECTOR_RGB),
    )
    if not elastomer:
        return lines
    half_mm = np.array([slab.length_x_mm, slab.length_y_mm]) / 2
    edges = _edges(half_mm, (slab.touched_plane_mm, 0.0))
    return (*lines, SceneLines.along(ELASTOMER, edges, _ELASTOMER_RGB))


def field_corners(device: Pinhole, pose: FloatArray) -> FloatArray:
    """Return the intersections of a pinhole's four corner rays with z = 0, (4, xyz), world mm.

    A ray that would meet the plane farther away than twice the standoff ends at this distance.
    """
    rays = np.column_stack([device.seen_corners(), np.ones(4)]) @ pose[:3, :3].T
    centre = pose[:3, 3]
    most = 2 * float(np.linalg.norm(centre)) / np.linalg.norm(rays, axis=1)
    reach = np.where(rays[:, 2] < 0, -centre[2] / np.minimum(rays[:, 2], -1e-9), most)
    return np.asarray(centre + np.minimum(reach, most)[:, np.newaxis] * rays)


def field_rays(device: Pinhole, pose: FloatArray, layers: PlaneLayers | None) -> list[FloatArray]:
    """Return the polylines (corner, xyz), world mm, that show the field of a pinhole.

    The first five are the light paths from the pinhole to the corners and the middle of the field
    on z = 0. The others are the outline of the field and a smaller outline near the pinhole.
    """
    centre, ends = pose[:3, 3], field_corners(device, pose)
    frame = centre + 0.12 * (ends - centre)
    paths = [ray_path(centre, end, layers) for end in (*ends, ends.mean(axis=0))]
    return [*paths, np.vstack([ends, ends[:1]]), np.vstack([frame, frame[:1]])]


def ray_path(start_mm: FloatArray, end_mm: FloatArray, layers: PlaneLayers | None) -> FloatArray:
    """Return the corners of the light path between two points, (corner, xyz), mm.

    Notes
    -----
    w_i is the vertical path in medium i of index n_i, and s the sine of the angle to the vertical
    in air. By Snell's law, the horizontal path is sum_i w_i s / sqrt(n_i^2 - s^2). It increases
    with s, so that s is found by bisection.
    """
    if layers is None or end_mm[2] >= layers.tops_mm[0]:
        return np.stack((start_mm, end_mm))
    tops = [top for top in layers.tops_mm if top > end_mm[2]]
    z_mm = np.array([start_mm[2], *tops, end_mm[2]])
    iors, ways = np.array([1.0, *layers.iors[: len(tops)]]), -np.diff(z_mm)
    across = end_mm[:2] - start_mm[:2]
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        sine = 0.5 * (low + high)
        too_far = (ways * sine / np.sqrt(iors**2 - sine**2)).sum() > np.hypot(*across)
        low, high = (low, sine) if too_far else (sine, high)
    steps = ways * low / np.sqrt(iors**2 - low**2)
    share = np.concatenate(([0.0], np.cumsum(steps))) / max(steps.sum(), 1e-12)
    return np.column_stack((start_mm[:2] + share[:, np.newaxis] * across, z_mm))


def _edges(half_mm: FloatArray, levels: tuple[float, ...]) -> list[FloatArray]:
    """Return the edges of a box as polylines: outlines at all `levels` (z, mm), vertical edges.

    `half_mm` is half the length of the box along x and y.
    """
    turn = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * half_mm
    outlines = [np.column_stack((turn, np.full(5, z))) for z in levels]
    return [*outlines, *(np.stack([corner[at] for corner in outlines]) for at in range(4))]


def on_nodes(pressed: PressedElastomer, rows: IntArray, cols: IntArray) -> PressedElastomer:
    """Return a press reduced to the given rows and columns of its coated face, for pictures."""
    grid = np.ix_(rows, cols)
    return replace(
        pressed,
        face_x_mm=pressed.face_x_mm[cols],
        face_y_mm=pressed.face_y_mm[rows],
        face_z_mm=pressed.face_z_mm[grid],
        texture_mm=None if pressed.texture_mm is None else pressed.texture_mm[grid],
        sheet=None if pressed.sheet is None else fields_at(pressed.sheet, grid),
    )
