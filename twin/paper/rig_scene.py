"""Surfaces of the rendered set-up: sheet, specimen, stage and frame, camera and projector.

Poses, sheet, relief and specimen are those of the experiment. Housings, frame and stage are
schematic: the paper shows them in a photograph without dimensions. Coordinates are in the world
frame, mm.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from twin.config import Experiment
from twin.mechanics import PressedElastomer, face_mesh, slab_mesh
from twin.optics.creases import split_at_creases
from twin.optics.rig import true_calibration
from twin.optics.view import SceneSurface
from twin.report.scene import on_nodes
from twin.specimens import bodies

ALUMINIUM, DARK, CREAM = (0.42, 0.44, 0.48), (0.05, 0.05, 0.06), (0.75, 0.75, 0.72)
CAMERA_BLUE, PROJECTOR_ORANGE = (0.10, 0.30, 0.55), (0.75, 0.30, 0.08)
# Matte, as in a cut-away drawing: clear silicone under its coat would be a dark slit.
SILICONE = (0.50, 0.72, 0.88)
# Gap between specimen and silicone, and between silicone and coat: coincident faces would flicker.
_APART_MM = 0.02
_RENDER_PITCH_MM = 0.1
_FRINGE_DARK, _FRINGE_BRIGHT = 0.08, 0.62


def sheet_things(
    experiment: Experiment, pressed: PressedElastomer, cut_y_mm: float | None = None
) -> list[SceneSurface]:
    """Return the surfaces of the silicone, and of the coat with a fringe pattern.

    If `cut_y_mm` is given, only the part with world y >= `cut_y_mm` is returned.
    """
    coarse = _thinned(pressed, cut_y_mm)
    face = face_mesh(coarse)
    shade = fringe_shade(experiment, np.asarray(face.vertices))
    rgb = np.repeat(shade[:, np.newaxis], 3, axis=1)
    coat = SceneSurface.of_mesh("coat", face, rgb, smooth=True)
    return [
        SceneSurface.of_mesh("silicone", slab_mesh(coarse, experiment.elastomer), SILICONE),
        replace(coat, vertices_mm=np.add(coat.vertices_mm, (0.0, 0.0, 2 * _APART_MM))),
    ]


def fringe_shade(
    experiment: Experiment, points_world_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the albedo (n,) at points (n, xyz), world mm, of painted vertical fringes.

    The fringes are where the experiment's projector would project them.
    """
    rig = true_calibration(experiment)
    pose = rig.T_world_from_proj
    pixels = rig.projector.project((points_world_mm - pose[:3, 3]) @ pose[:3, :3])
    phase = 2 * np.pi * pixels[:, 0] / experiment.patterns.period_px
    middle, swing = (_FRINGE_BRIGHT + _FRINGE_DARK) / 2, (_FRINGE_BRIGHT - _FRINGE_DARK) / 2
    return np.asarray(middle + swing * np.cos(phase))


def specimen_things(experiment: Experiment, pressed: PressedElastomer) -> list[SceneSurface]:
    """Return the specimen at its position under load, and the plate of the stage below it."""
    top_mm = experiment.elastomer.touched_plane_mm + pressed.depth_mm - _APART_MM
    parts = bodies(experiment.specimen, top_mm)
    things = [
        SceneSurface.of_mesh(
            f"part_{k}",
            split_at_creases(part.mesh),
            CREAM,
            bsdf=None if part.material is None else part.material.bsdf(),
            smooth=True,
        )
        for k, part in enumerate(parts)
    ]
    lowest = min(float(part.mesh.bounds[0, 2]) for part in parts) - _APART_MM
    stage = _box((-14, -11, lowest - 3), (14, 11, lowest))
    return [*things, SceneSurface.of_mesh("stage_plate", stage, CREAM)]


def holder_things(experiment: Experiment, cut_y_mm: float | None = None) -> list[SceneSurface]:
    """Return the bars of the frame that holds the rim of the sheet.

    If `cut_y_mm` is given, the frame has no front bar and no part with a smaller world y.
    """
    slab, rim = experiment.elastomer, 8.0
    x, y, low, high = slab.length_x_mm / 2, slab.length_y_mm / 2, -slab.thickness_mm - 2.0, 0.3
    front = -y if cut_y_mm is None else cut_y_mm
    bars = {
        "left": ((-x - rim, front, low), (-x, y, high)),
        "right": ((x, front, low), (x + rim, y, high)),
        "back": ((-x - rim, y, low), (x + rim, y + rim, high)),
    }
    if cut_y_mm is None:
        bars["front"] = ((-x - rim, -y - rim, low), (x + rim, -y, high))
    return [
        SceneSurface.of_mesh(f"holder_{name}", _box(*corners), ALUMINIUM)
        for name, corners in bars.items()
    ]


def frame_things(experiment: Experiment, pressed: PressedElastomer) -> list[SceneSurface]:
    """Return schematic aluminium profiles behind the rig, base plate and z stage."""
    rig = true_calibration(experiment)
    top = float(max(rig.T_world_from_cam[2, 3], rig.T_world_from_proj[2, 3])) + 90.0
    parts = bodies(experiment.specimen, experiment.elastomer.touched_plane_mm + pressed.depth_mm)
    under = min(float(part.mesh.bounds[0, 2]) for part in parts) - 3.1
    base = -95.0
    camera, projector = rig.T_world_from_cam[:3, 3], rig.T_world_from_proj[:3, 3]
    mount = camera[2] + 55.0
    boxes = {
        "cross": ((-75, 70, mount), (155, 90, mount + 16)),
        "camera_arm": ((camera[0] - 8, 15, mount), (camera[0] + 8, 70, mount + 16)),
        "projector_arm": ((projector[0] + 14, 10, mount), (projector[0] + 30, 70, mount + 16)),
        "post_left": ((-95, 70, base), (-75, 90, top)),
        "post_right": ((155, 70, base), (175, 90, top)),
        "beam": ((-95, 70, top), (175, 90, top + 20)),
        "arm_left": ((-92, 18, -7), (-78, 70, 0)),
        "rail": ((-92, 18, -7), (-12, 26, 0)),
        "base": ((-120, -80, base - 10), (200, 110, base)),
    }
    column = trimesh.creation.cylinder(12.0, segment=((0, 0, base + 30), (0, 0, under)))
    foot = _box((-30, -30, base), (30, 30, base + 30))
    return [
        *(SceneSurface.of_mesh(name, _box(*corners), ALUMINIUM) for name, corners in boxes.items()),
        SceneSurface.of_mesh("stage_column", column, CREAM),
        SceneSurface.of_mesh("stage_foot", foot, DARK),
    ]


def device_things(experiment: Experiment) -> list[SceneSurface]:
    """Return housings and lenses of camera and projector, at the true pinholes."""
    rig = true_calibration(experiment)
    camera, projector = rig.T_world_from_cam, _level_pose(rig.T_world_from_proj)
    return [
        SceneSurface.of_mesh("camera_lens", _lens(camera, 20.0, -45.0, 12.0), DARK),
        SceneSurface.of_mesh(
            "camera_body", _posed_box(camera, (-20, -20, -80), (20, 20, -45)), CAMERA_BLUE
        ),
        SceneSurface.of_mesh("projector_lens", _lens(projector, 11.0, -14.0, 4.0), DARK),
        SceneSurface.of_mesh(
            "projector_body",
            _posed_box(projector, (-38, -14, -72), (38, 26, -14)),
            PROJECTOR_ORANGE,
        ),
    ]


def _level_pose(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a device pose (4, 4), rotated so that its optical axis is through the world origin.

    The drawn housing then ignores the lens offset of the projector.
    """
    forward = -pose[:3, 3] / np.linalg.norm(pose[:3, 3])
    down = pose[:3, 1] - (pose[:3, 1] @ forward) * forward
    down /= np.linalg.norm(down)
    turned = pose.copy()
    turned[:3, :3] = np.stack([np.cross(down, forward), down, forward], axis=1)
    return turned


def _thinned(pressed: PressedElastomer, cut_y_mm: float | None) -> PressedElastomer:
    """Return the press on fewer nodes of the coat, without those in front of `cut_y_mm`."""
    pitch = float(pressed.face_x_mm[1] - pressed.face_x_mm[0])
    step = max(1, round(_RENDER_PITCH_MM / pitch))
    rows, cols = (_every(nodes, step) for nodes in (pressed.face_y_mm, pressed.face_x_mm))
    if cut_y_mm is not None:
        rows = rows[pressed.face_y_mm[rows] >= cut_y_mm]
    return on_nodes(replace(pressed, texture_mm=None), rows, cols)


def _every(nodes: NDArray[Any], step: int) -> NDArray[np.intp]:
    """Return every `step`-th index of the nodes, and the last index."""
    return np.union1d(np.arange(0, nodes.size, step), [nodes.size - 1])


def _box(low: tuple[float, ...], high: tuple[float, ...]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=np.array([low, high], np.float64))


def _posed_box(
    pose: NDArray[np.float64], low: tuple[float, ...], high: tuple[float, ...]
) -> trimesh.Trimesh:
    body = _box(low, high)
    body.apply_transform(pose)
    return body


def _lens(
    pose: NDArray[np.float64], radius_mm: float, behind_mm: float, before_mm: float
) -> trimesh.Trimesh:
    barrel = trimesh.creation.cylinder(radius_mm, segment=((0, 0, behind_mm), (0, 0, before_mm)))
    barrel.apply_transform(pose)
    return barrel
