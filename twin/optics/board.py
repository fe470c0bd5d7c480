"""A printed flat board under the rig: its albedo as an image, its plate as a mesh in a pose.

The albedo image is finer than a camera pixel and its edges are one texel wide, so that the fixed
grid of sub-pixel rays resolves the position of every edge. A hard edge would be sampled in steps of
0.25 px, with errors of 0.01 px in the centroids of dots.
"""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage
from reconstruction.calibration.boards import Board
from twin.config.board import BoardFile, BoardPlate, BoardPose
from twin.config.models import Experiment
from twin.optics.materials import bitmap, mitsuba_mesh
from twin.optics.rig import about_z
from twin.optics.session import renderer_session
from twin.optics.stack import Frames

TEXELS_PER_PIXEL = 2.0
# 8192 x 8192 float32 texels: 256 MB.
MAX_TEXELS = 8192


def board_pose(pose: BoardPose) -> FloatArray:
    """Return T_world_from_board (4, 4), mm: spin in the plane, then tilt towards the azimuth."""
    azimuth, tilt, spin = np.deg2rad([pose.azimuth_deg, pose.tilt_deg, pose.spin_deg])
    T = np.eye(4)
    T[:3, :3] = about_z(azimuth) @ _about_y(tilt) @ about_z(spin - azimuth)
    T[:3, 3] = pose.x_mm, pose.y_mm, pose.z_mm
    return T


def albedo_image(board: Board, plate: BoardPlate, texel_mm: float) -> FloatImage:
    """Return the plate's albedo, (row, col) float32, row 0 at the top (board y up).

    Parameters
    ----------
    texel_mm : nominal texel size; rounded so that the plate has whole texels
    """
    x_mm, y_mm = (_texel_centres(size, texel_mm) for size in (plate.width_mm, plate.height_mm))
    ink = board.ink(x_mm, -y_mm, texel_mm)
    albedo = plate.white_albedo + (plate.ink_albedo - plate.white_albedo) * ink
    return np.asarray(albedo, dtype=np.float32)


@lru_cache(maxsize=1)
def _albedo_of(board: Board, plate: BoardPlate, texel_mm: float) -> FloatImage:
    """Return the albedo image, cached for all poses: it takes as long as one render."""
    return albedo_image(board, plate, texel_mm)


def camera_texel_mm(experiment: Experiment) -> float:
    """Size of a texel: half a camera pixel on the reference plane."""
    camera = experiment.camera
    image_mm = camera.focal_length_mm / (camera.pose.standoff_mm - camera.focal_length_mm)
    return camera.pixel_pitch_um * 1e-3 * camera.binning / image_mm / TEXELS_PER_PIXEL


@renderer_session()
def render_board(experiment: Experiment, file: BoardFile, pose: BoardPose) -> Frames:
    """Render the whole sequence on the board in one pose.

    The engine is the one-trace renderer with direct light and the experiment's rays per pixel. The
    board is in air, without the experiment's clear layers. Defocus follows the experiment
    (`camera.depth_of_field`, `projector.aperture_mm`); by default all distances are sharp.

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    """
    # Mitsuba is imported here because importing it selects the backend's library.
    from twin.optics import one_trace
    from twin.optics.connection import axial_range_mm
    from twin.optics.light import light_tables, pattern_set
    from twin.optics.scene import rig_of

    albedo = _albedo_of(file.board(), file.plate, camera_texel_mm(experiment))
    scene = _board_scene(file.plate, albedo, board_pose(pose))
    # A single plane casts no shadow on itself: no shadow rays.
    rig = replace(rig_of(experiment), layers=None, shadows=False)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns, axial_range_mm(scene, rig))
    return one_trace.trace_stack(scene, rig, tables, experiment.render.samples)


def _board_scene(plate: BoardPlate, albedo: FloatImage, T_world_from_board: FloatArray) -> Any:
    import mitsuba as mi

    mesh = mitsuba_mesh(
        "board",
        _corners_world_mm(plate, T_world_from_board),
        [(0, 1, 2), (0, 2, 3)],
        {"type": "diffuse", "reflectance": bitmap(albedo)},
        # Row 0 of a bitmap is at v = 0 of a mesh.
        texture=[(0, 1), (1, 1), (1, 0), (0, 0)],
    )
    return mi.load_dict({"type": "scene", "board": mesh}, optimize=False)


def _corners_world_mm(plate: BoardPlate, T_world_from_board: FloatArray) -> FloatImage:
    """Return the plate's corners from the lower left, counter-clockwise from the front, (4, 3)."""
    half_x, half_y = plate.width_mm / 2.0, plate.height_mm / 2.0
    corners = np.array(
        [[-half_x, -half_y, 0], [half_x, -half_y, 0], [half_x, half_y, 0], [-half_x, half_y, 0]]
    )
    world_mm = corners @ T_world_from_board[:3, :3].T + T_world_from_board[:3, 3]
    return np.asarray(world_mm, dtype=np.float32)


def _texel_centres(size_mm: float, texel_mm: float) -> FloatArray:
    count = int(min(np.ceil(size_mm / texel_mm), MAX_TEXELS))
    return np.asarray(((np.arange(count) + 0.5) / count - 0.5) * size_mm)


def _about_y(angle_rad: float) -> FloatArray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
