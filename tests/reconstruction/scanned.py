"""Patches of analytic surfaces for tests of scans: a sensor in known poses over one part."""

import numpy as np

from reconstruction.arrays import Reason
from reconstruction.scan.registration import StagePrior, moved
from reconstruction.triangulation import PointMap

STAGE = StagePrior((0.05, 0.05, 0.02), (1e-3, 1e-3, 1e-3))
SIGMA_MM, PITCH_MM = 0.003, 0.15
CAMERA = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 200], [0, 0, 0, 1]], float)


def hills(x, y):
    """Heights of a part with relief in both directions, and their derivatives along x and y."""
    z = 0.4 * np.sin(0.9 * x) + 0.3 * np.cos(0.7 * y + 0.3 * x)
    by_x = 0.36 * np.cos(0.9 * x) - 0.09 * np.sin(0.7 * y + 0.3 * x)
    return z, by_x, -0.21 * np.sin(0.7 * y + 0.3 * x)


def nominal_grid(columns, rows, step_x_mm, step_y_mm):
    T = np.tile(np.eye(4), (columns * rows, 1, 1))
    x = step_x_mm * (np.arange(columns) - (columns - 1) / 2)
    y = step_y_mm * (np.arange(rows) - (rows - 1) / 2)
    T[:, :2, 3] = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return T


def true_poses(nominal, stage, seed):
    """Draw true motions of the stage; return them, (patch, 6), and the true poses."""
    X = stage.factor(len(nominal))
    v = np.random.default_rng(seed).standard_normal(X.shape[1])
    motion = (X @ v).reshape(-1, 6)
    return motion, moved(nominal, motion)


def patch_of(T_part_from_sensor, surface, seed, shape=(63, 84), *, sigma_mm=SIGMA_MM, blur=None):
    """Return the point map of a surface in the frame of a sensor of pose T, with noise in z."""
    rows, cols = shape
    rotation, origin, along = (
        T_part_from_sensor[:3, :3],
        T_part_from_sensor[:3, 3],
        T_part_from_sensor[:3, 2],
    )
    x, y = np.meshgrid(np.arange(cols) - (cols - 1) / 2, (rows - 1) / 2 - np.arange(rows))
    x, y, z = x * PITCH_MM, y * PITCH_MM, np.zeros(shape)
    for _ in range(8):  # intersect the vertical line of each pixel with the surface, by Newton
        p = np.stack([x, y, z], -1) @ rotation.T + origin
        height, by_x, by_y = surface(p[..., 0], p[..., 1])
        z = z + (height - p[..., 2]) / (along[2] - by_x * along[0] - by_y * along[1])
    noise = np.random.default_rng(seed).standard_normal(shape)
    if blur is not None:
        noise = blur(noise)
    z = z + sigma_mm * noise
    sigma = np.zeros((*shape, 3), np.float32)
    sigma[..., 2] = sigma_mm
    reason = np.full(shape, Reason.VALID, np.uint8)
    return PointMap(np.stack([x, y, z], -1).astype(np.float32), sigma, reason, CAMERA)
