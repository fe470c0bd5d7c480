"""Synthetic captures with known truth: fringes sampled at exact projector coordinates."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from reconstruction.patterns import PatternSet
from reconstruction.rig.calibration import Calibration, Pinhole
from reconstruction.rig.sensor import SensorNoise

# Fine samples per projector pixel when a pattern is blurred.
FINE = 32
LIST_HEAD = """format = "fringe-frames"
version = 1
bit_depth = 8
{top}
[projector]
width_px = 160
height_px = 96

[sensor]
gain_dn_per_e = 0.1
read_noise_e = 5.0
black_level_dn = 4.0
saturation_dn = 255.0
"""
"""Start of a capture.toml with a list of frames, without any [[frames]]; `top`: further keys."""


def frames_at(
    patterns: PatternSet,
    column_px: np.ndarray,
    row_px: np.ndarray,
    *,
    mean_dn: float = 120.0,
    amplitude_dn: float = 100.0,
    blur_px: float = 0.0,
) -> np.ndarray:
    """Return float64 frames of camera pixels that see the given projector coordinates.

    Phase frames are ideal sinusoids, the other frames are pixel boxes, both blurred.
    """
    frames = [
        mean_dn + amplitude_dn * _signal(patterns, frame, column_px, row_px, blur_px)
        for frame in patterns.frames
    ]
    return np.stack(frames)


def _signal(patterns, frame, column_px, row_px, blur_px):
    x_px = row_px if frame.axis == "row" else column_px
    if frame.kind == "phase":
        period_px, shift = patterns.phase_of(frame)
        contrast = np.exp(-0.5 * (2.0 * np.pi * blur_px / period_px) ** 2)
        return contrast * np.cos(2.0 * np.pi * (x_px / period_px + shift))
    span = patterns.high_level - patterns.low_level
    levels = 2.0 * (patterns.profile(frame) - float(patterns.low_level)) / span - 1.0
    if blur_px == 0.0:
        return levels[np.clip(np.rint(x_px).astype(int), 0, levels.size - 1)]
    fine = gaussian_filter1d(np.repeat(levels, FINE), blur_px * FINE, mode="nearest")
    centres_px = (np.arange(fine.size) + 0.5) / FINE - 0.5
    return np.interp(x_px, centres_px, fine)


def ramps(rows: int, cols: int, patterns: PatternSet) -> tuple[np.ndarray, np.ndarray]:
    """Return slanted column and row coordinates that cover nearly the whole projector."""
    row, col = np.mgrid[0:rows, 0:cols].astype(float)
    column_px = 3.0 + (patterns.width_px - 8.0) * (col + 0.3 * row / rows) / cols
    row_px = 3.0 + (patterns.height_px - 8.0) * (row + 0.3 * col / cols) / rows
    return column_px, row_px


def looking_at(position_mm, target_mm) -> np.ndarray:
    """Return T_world_from_dev of a device that looks from position to target, y down."""
    position, target = np.asarray(position_mm, float), np.asarray(target_mm, float)
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross([0.0, -1.0, 0.0], z)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = position
    return T


@pytest.fixture(scope="session")
def patterns() -> PatternSet:
    return PatternSet(width_px=1280, height_px=720)


@pytest.fixture(scope="session")
def quiet_sensor() -> SensorNoise:
    """Only quantisation noise; 8 bit."""
    return SensorNoise(0.0, 0.0, 0.0, 255.0)


@pytest.fixture(scope="session")
def synthesise() -> Callable[..., np.ndarray]:
    return frames_at


@pytest.fixture(scope="session")
def cover() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    return ramps


@pytest.fixture(scope="session")
def aim() -> Callable[..., np.ndarray]:
    return looking_at


@pytest.fixture(scope="session")
def calibration() -> Calibration:
    """A small camera above the coat, a projector at 30 degrees with its axis off the image."""
    camera = Pinhole(120, 90, 900.0, 905.0, 59.0, 44.0, (-0.05, 0.1, 1e-4, -2e-4, 0.02))
    projector = Pinhole(1280, 720, 1536.0, 1530.0, 640.0, 1096.0, (-0.02, 0.01, 1e-4, 2e-4, 0.0))
    return Calibration(
        camera,
        projector,
        looking_at([0.0, 0.0, 214.0], [0.0, 0.0, 0.0]),
        looking_at([125.0, -110.0, 216.0], [0.0, -110.0, 0.0]),
    )


def surface_points(calibration: Calibration, relief_mm: float = 1.0) -> np.ndarray:
    """Return the point on a bump at every camera pixel, (row, col, xyz) mm, world."""
    camera = calibration.camera
    pixels = np.stack(np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)), -1)
    ray = np.concatenate([camera.unproject(pixels), np.ones((*pixels.shape[:2], 1))], axis=-1)
    depth_mm = 214.0 - relief_mm * np.exp(-np.sum((ray[..., :2] * 214.0 / 5.0) ** 2, axis=-1))
    T = calibration.T_world_from_cam
    return (ray * depth_mm[..., np.newaxis]) @ T[:3, :3].T + T[:3, 3]


def seen_by_projector(calibration: Calibration, points_world_mm: np.ndarray) -> np.ndarray:
    """Return the projector pixels of world points."""
    T = np.linalg.inv(calibration.T_world_from_proj)
    return calibration.projector.project(points_world_mm @ T[:3, :3].T + T[:3, 3])


@pytest.fixture(scope="session")
def surface() -> Callable[..., np.ndarray]:
    return surface_points


@pytest.fixture(scope="session")
def project() -> Callable[..., np.ndarray]:
    return seen_by_projector
