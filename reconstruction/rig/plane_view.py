"""Points of a horizontal plane at all camera pixels, and images of world points in both devices."""

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.pinhole import Pinhole


def points_at_height(calibration: Calibration, z_mm: float) -> FloatArray:
    """Return the point of each camera ray on the plane z, (row, col, xyz) mm, world."""
    camera, T = calibration.camera, calibration.T_world_from_cam
    pixels = np.stack(np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)), -1)
    flat = camera.unproject(pixels.reshape(-1, 2).astype(np.float64))
    rays = np.column_stack([flat, np.ones(len(flat))]) @ T[:3, :3].T
    points = rays * ((z_mm - T[2, 3]) / rays[:, 2:]) + T[:3, 3]
    return np.asarray(points.reshape(camera.height_px, camera.width_px, 3))


def projector_px(calibration: Calibration, points_mm: FloatArray) -> FloatArray:
    """Return the projector pixels of world points, (row, col, column and row) px."""
    return _image(calibration.projector, calibration.T_world_from_proj, points_mm)


def camera_px(calibration: Calibration, points_mm: FloatArray) -> FloatArray:
    """Return the camera pixels of world points, (row, col, column and row) px."""
    return _image(calibration.camera, calibration.T_world_from_cam, points_mm)


def _image(device: Pinhole, T_world_from_dev: FloatArray, points_mm: FloatArray) -> FloatArray:
    T = np.linalg.inv(T_world_from_dev)
    inside = points_mm.reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
    return np.asarray(device.project(inside).reshape(*points_mm.shape[:2], 2))
