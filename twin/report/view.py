"""A view of a measurement that is turned by dragging: relief, deviation, specimen, rig and rays.

The page carries the data (height maps on some hundred cells a side, lines) and a short script that
draws them with the browser's own WebGL; nothing is loaded.
"""

import base64
import json
from typing import Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, at_pixels
from reconstruction.cells import CellMeans, SquareCells, box_of
from reconstruction.rig.layers import PlaneLayers
from reconstruction.rig.pinhole import Pinhole
from twin.optics.rig import true_calibration
from twin.report.canvas import near_truth, round_up, symmetric_limit
from twin.report.page import Section, TurnableView
from twin.results.record import Measurement
from twin.specimens import height_above_lowest

HEIGHTS, DEVIATION, SPECIMEN = "measured heights", "deviation", "specimen"
CAMERA, PROJECTOR, ELASTOMER = "camera's rays", "projector's rays", "elastomer"
_MOST_CELLS = 110
_SPECIMEN_CELLS = 140
# The relief fills about this share of its width.
_RELIEF_SHARE = 0.25
_SPECIMEN_GREY = (190, 182, 168)
_LINE_COLOURS = {CAMERA: (31, 119, 180), PROJECTOR: (214, 110, 14), ELASTOMER: (90, 100, 112)}
_BISECTIONS = 60


def view_section(measured: Measurement) -> list[Section]:
    """Return the section with the view; none where nothing was measured."""
    if not measured.points.valid.any():
        return []
    data = view_data(measured)
    enlarged, limit_um = data["homes"]["relief"]["enlarged"], data["limit_um"]
    heights = f"enlarged {enlarged:g} times in relief and deviation, and true in the rig"
    told = (
        "Drag to turn, scroll to come nearer; arrow keys turn, too. Heights are "
        f"{heights if enlarged != 1 else 'true'}. "
        f"Deviation: blue −{limit_um:g} µm, white 0, red {limit_um:g} µm."
    )
    names = [one["name"] for one in (*data["grids"], *data["lines"])]
    view = TurnableView(
        "view3d", told, _as_json(data), tuple(data["homes"]), tuple(dict.fromkeys(names))
    )
    return [Section("in-space", "In three dimensions", (view,))]


def view_data(measured: Measurement) -> dict[str, Any]:
    """Return what the script draws: height maps, lines, and where each view begins."""
    relief, deviation, limit_um = _surfaces(measured)
    low, high = _ends(relief)
    heights = colormaps["viridis"]((relief.mean - low) / max(high - low, 1e-9))
    signed = colormaps["RdBu_r"](0.5 + 0.5 * deviation.mean / limit_um)
    grids = [
        _grid(HEIGHTS, relief, relief.mean, heights),
        _grid(DEVIATION, relief, relief.mean, signed),
        *_specimen(measured, relief),
    ]
    lines = _rig_lines(measured)
    return {
        "grids": grids,
        "lines": lines,
        "homes": _homes(measured, relief, [one["name"] for one in (*grids, *lines)]),
        "limit_um": limit_um,
    }


def _surfaces(measured: Measurement) -> tuple[CellMeans, CellMeans, float]:
    """Return the measured heights and their deviation in um on the same cells, and its scale."""
    points, true_mm = measured.points, measured.truth.points_world_mm
    on = points.valid & measured.truth.measured
    on = on if on.any() else points.valid
    true_on_mm = at_pixels(true_mm, on).astype(np.float64)
    world_mm = at_pixels(points.world_mm, on).astype(np.float64)
    near = near_truth(world_mm, true_on_mm)
    if near.any():
        world_mm, true_on_mm = world_mm[near], true_on_mm[near]
    low_mm, high_mm = box_of(world_mm[:, :2])
    span_mm = high_mm - low_mm
    typical_mm = 1.5 * np.sqrt(np.prod(span_mm) / len(world_mm))
    pitch_mm = max(float(span_mm.max()) / _MOST_CELLS, float(typical_mm), 1e-6)
    error_um = 1e3 * (world_mm[:, 2] - true_on_mm[:, 2])
    cells = SquareCells.of(world_mm, pitch_mm)
    relief, deviation = cells.means(world_mm[:, 2]), cells.means(error_um)
    return relief, deviation, symmetric_limit(deviation.mean[deviation.valid])


def _ends(relief: CellMeans) -> tuple[float, float]:
    found = relief.mean[relief.valid]
    return float(np.percentile(found, 0.5)), float(np.percentile(found, 99.5))


def _grid(
    name: str, cells: CellMeans, z_mm: FloatArray, rgba: NDArray[np.floating[Any]]
) -> dict[str, Any]:
    """Return one height map: NaN where there is none, which has no place in any other file."""
    rows, cols = z_mm.shape
    z = np.where(cells.valid, z_mm, np.nan).astype("<f4")
    return {
        "name": name,
        "nx": cols,
        "ny": rows,
        "x": [float(cells.x_mm[0]), cells.pitch_mm],
        "y": [float(cells.y_mm[0]), -cells.pitch_mm],
        "z": _as_text(z),
        "rgb": _as_text(np.rint(255 * rgba[..., :3]).astype(np.uint8)),
    }


def _specimen(measured: Measurement, relief: CellMeans) -> list[dict[str, Any]]:
    """Return the side of the specimen that faces the elastomer, where it was pressed to."""
    if measured.pressed is None:
        return []
    experiment = measured.experiment
    left, right, low, high = relief.extent_mm
    pitch_mm = max(right - left, high - low) / _SPECIMEN_CELLS
    x_mm = np.arange(left + pitch_mm / 2, right, pitch_mm)
    y_mm = np.arange(low + pitch_mm / 2, high, pitch_mm)
    behind_mm = height_above_lowest(experiment.specimen, x_mm, y_mm)[::-1]
    front_mm = measured.pressed.depth_mm + experiment.elastomer.touched_plane_mm
    z_mm = np.where(np.isfinite(behind_mm), front_mm - behind_mm, 0.0)
    cells = CellMeans(x_mm, y_mm[::-1], z_mm, np.isfinite(behind_mm), pitch_mm)
    grey = np.broadcast_to(np.array(_SPECIMEN_GREY) / 255.0, (*z_mm.shape, 3))
    return [_grid(SPECIMEN, cells, z_mm, grey)]


def _homes(measured: Measurement, relief: CellMeans, parts: list[str]) -> dict[str, dict[str, Any]]:
    """Return for each view its middle, size, enlargement of z, and what it shows."""
    left, right, bottom, top = relief.extent_mm
    low, high = _ends(relief)
    radius_mm = 0.42 * float(np.hypot(right - left, top - bottom))
    enlarged = max(1.0, round_up(_RELIEF_SHARE * (right - left) / max(high - low, 1e-9)) / 2)
    near = {
        "middle": [(left + right) / 2, (bottom + top) / 2, (low + high) / 2],
        "radius": radius_mm,
        "enlarged": enlarged,
    }
    rig = true_calibration(measured.experiment)
    ends_mm = np.stack((rig.T_world_from_cam[:3, 3], rig.T_world_from_proj[:3, 3], np.zeros(3)))
    middle = (ends_mm.max(axis=0) + ends_mm.min(axis=0)) / 2
    far = {
        "middle": middle.tolist(),
        "radius": 1.2 * float(np.linalg.norm(ends_mm - middle, axis=1).max()),
        "enlarged": 1.0,
        "lift": 0.15,
        "turn": 0.3,
    }
    return {
        "relief": near | {"shows": [HEIGHTS]},
        "deviation": near | {"shows": [DEVIATION]},
        "rig": far | {"shows": [part for part in parts if part != DEVIATION]},
    }


def _rig_lines(measured: Measurement) -> list[dict[str, Any]]:
    """Return rays to the corners of both fields, bent at the layers, and the elastomer's edges."""
    experiment, rig = measured.experiment, true_calibration(measured.experiment)
    drawn = {
        CAMERA: field_rays(rig.camera, rig.T_world_from_cam, rig.layers),
        PROJECTOR: field_rays(rig.projector, rig.T_world_from_proj, rig.layers),
        ELASTOMER: _edges(
            experiment.elastomer.length_x_mm / 2,
            experiment.elastomer.length_y_mm / 2,
            (experiment.elastomer.touched_plane_mm, 0.0),
        )
        if measured.pressed is not None
        else [],
    }
    return [
        {"name": name, "rgb": _LINE_COLOURS[name], "points": _as_text(segments(paths))}
        for name, paths in drawn.items()
        if paths
    ]


def field_rays(device: Pinhole, pose: FloatArray, layers: PlaneLayers | None) -> list[FloatArray]:
    """Return the paths from a pinhole to the corners of its field on z = 0, and its outline."""
    rays = np.column_stack([device.seen_corners(), np.ones(4)]) @ pose[:3, :3].T
    centre = pose[:3, 3]
    # A grazing ray would meet the plane far away; the drawing ends at twice the standoff.
    most = 2 * float(np.linalg.norm(centre)) / np.linalg.norm(rays, axis=1)
    reach = np.where(rays[:, 2] < 0, -centre[2] / np.minimum(rays[:, 2], -1e-9), most)
    ends = centre + np.minimum(reach, most)[:, np.newaxis] * rays
    frame = centre + 0.12 * (ends - centre)
    paths = [ray_path(centre, end, layers) for end in (*ends, ends.mean(axis=0))]
    return [*paths, np.vstack([ends, ends[:1]]), np.vstack([frame, frame[:1]])]


def ray_path(start_mm: FloatArray, end_mm: FloatArray, layers: PlaneLayers | None) -> FloatArray:
    """Return the corners of the way that light takes between two points, (corner, xyz), mm.

    Notes
    -----
    Snell: with w_i the vertical way in medium i of index n_i and s the sine of the angle to the
    vertical in air, the horizontal way is sum_i w_i s / sqrt(n_i^2 - s^2), which grows with s.
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


def _edges(half_x: float, half_y: float, levels: tuple[float, ...]) -> list[FloatArray]:
    """Return the outlines of a rectangle at some heights, and the lines between them."""
    turn = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * (half_x, half_y)
    outlines = [np.column_stack((turn, np.full(5, z))) for z in levels]
    return [*outlines, *(np.stack([one[at] for one in outlines]) for at in range(4))]


def segments(paths: list[FloatArray]) -> NDArray[np.float32]:
    """Return paths as pairs of ends, (end, xyz)."""
    pairs = [np.stack((path[:-1], path[1:]), axis=1).reshape(-1, 3) for path in paths]
    return np.concatenate(pairs).astype("<f4")


def _as_text(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _as_json(data: dict[str, Any]) -> str:
    # Inside a script element nothing but its own end may look like one.
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
