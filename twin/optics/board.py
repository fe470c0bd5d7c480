"""Render a printed flat board under the rig: a plane mesh in a pose, with an image of its albedo.

The albedo image is finer than a camera pixel, and its edges are one texel wide. The fixed grid of
sub-pixel rays therefore resolves the position of every edge. A hard edge would be sampled in steps
of 0.25 px, with errors of 0.01 px in the centroids of dots.
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
    """Return T_world_from_board, (4, 4), translation in mm.

    The board is first rotated by the spin in its plane, then tilted towards the azimuth.
    """
    azimuth, tilt, spin = np.deg2rad([pose.azimuth_deg, pose.tilt_deg, pose.spin_deg])
    T = np.eye(4)
    T[:3, :3] = about_z(azimuth) @ _about_y(tilt) @ about_z(spin - azimuth)
    T[:3, 3] = pose.x_mm, pose.y_mm, pose.z_mm
    return T


def albedo_image(board: Board, plate: BoardPlate, texel_mm: float) -> FloatImage:
    """Return the albedo of the board's plate, (row, col) float32; row 0 has the largest board y.

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
    """Return `albedo_image`, cached for all poses: its computation takes as long as a render."""
    return albedo_image(board, plate, texel_mm)


def camera_texel_mm(experiment: Experiment) -> float:
    """Return the texel size, mm: half a camera pixel, projected onto the reference plane."""
    camera = experiment.camera
    image_mm = camera.focal_length_mm / (camera.pose.standoff_mm - camera.focal_length_mm)
    return camera.pixel_pitch_um * 1e-3 * camera.binning / image_mm / TEXELS_PER_PIXEL


@renderer_session()
def render_board(experiment: Experiment, file: BoardFile, pose: BoardPose) -> Frames:
    """Return the radiance, mW / (mm^2 sr), of all projected frames on the board in one pose.

    The one-trace renderer computes direct light only, with `render.samples` rays per pixel. The
    board is in air, without the experiment's clear layers. Defocus follows the experiment
    (`camera.depth_of_field`, `projector.aperture_mm`); by default all distances are in focus.

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
    """Return the four corners of the plate in the world, (corner, xyz) float32, mm.

    The order is counter-clockwise as seen from the printed side, from the lower left corner.
    """
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
