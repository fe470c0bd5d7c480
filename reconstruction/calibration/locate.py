"""Where a calibrated rig sees the features of a board: an independent check of lengths."""

import cv2
import numpy as np

from reconstruction.arrays import Doubles
from reconstruction.calibration.conics import centre_bias_px
from reconstruction.calibration.observation import Observation
from reconstruction.rig.calibration import Calibration

STEPS = 4


def locate_features(calibration: Calibration, seen: Observation) -> Doubles:
    """Triangulate every feature from camera and projector pixels, (n, 3) mm, world frame.

    The board's dimensions enter only the bias of the dots' centres (below a micrometre), through a
    rough pose: distances between the points are measurements.
    """
    camera = calibration.camera
    T = _rough_pose(calibration, seen)
    inside = seen.points_mm @ T[:3, :3].T + T[:3, 3]
    bias = centre_bias_px(camera, inside, seen.radii_mm, T[:3, :3])
    projector_px = seen.projector_px - np.einsum("nij,nj->ni", seen.slopes, bias)
    rays = np.column_stack([camera.unproject(seen.camera_px - bias), np.ones(len(bias))])
    points = rays * _depths(calibration, rays, projector_px, inside[:, 2])[:, np.newaxis]
    world = calibration.T_world_from_cam
    return np.asarray(points @ world[:3, :3].T + world[:3, 3])


def _rough_pose(calibration: Calibration, seen: Observation) -> Doubles:
    flat = np.ascontiguousarray(calibration.camera.unproject(seen.camera_px))
    rotation, shift = cv2.solvePnP(
        seen.points_mm, flat, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )[1:3]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(rotation)[0], shift.reshape(3)
    return T


def _depths(
    calibration: Calibration, rays: Doubles, projector_px: Doubles, start_mm: Doubles
) -> Doubles:
    """Depths along the camera rays that fit both projector coordinates best (Gauss-Newton)."""
    T, depth, step_mm = calibration.T_proj_from_cam, start_mm.copy(), 1e-3
    for _ in range(STEPS):
        places = [
            calibration.projector.project((rays * d[:, np.newaxis]) @ T[:3, :3].T + T[:3, 3])
            for d in (depth - step_mm, depth + step_mm)
        ]
        slope = (places[1] - places[0]) / (2.0 * step_mm)
        miss = projector_px - (places[0] + places[1]) / 2.0
        depth = depth + np.sum(slope * miss, axis=1) / np.sum(slope * slope, axis=1)
    return depth


def length_errors_mm(points_world_mm: Doubles, seen: Observation, length_mm: float) -> Doubles:
    """Return measured minus nominal distance of all pairs of features `length_mm` apart, (m,)."""
    nominal = np.linalg.norm(seen.points_mm[:, np.newaxis] - seen.points_mm, axis=-1)
    first, second = np.nonzero(np.triu(np.abs(nominal - length_mm) < 1e-6))
    measured = np.linalg.norm(points_world_mm[first] - points_world_mm[second], axis=1)
    return np.asarray(measured - nominal[first, second])
