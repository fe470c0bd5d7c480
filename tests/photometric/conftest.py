"""SYNTHETIC shading, no ray tracing, no real image: closed-form surfaces under three lamps.

A surface of known slopes is shaded by three directional lamps (red from the top edge, green from
the right, blue from the bottom; azimuths of a measured unit), Lambert's law with soft shadows, some
colour crosstalk, a mild saturation, vignetting, display gamma, noise and 8 bits.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from reconstruction.colour_maps import COLOUR_MAPS
from reconstruction.photometric.calibration_ball import BallPress
from reconstruction.photometric.sensor import calibrate_sensor

PITCH_MM = 0.0634
SHAPE = (240, 320)
AZIMUTHS_DEG = (95.0, -7.0, -83.0)  # as displayed: 0 right, 90 top; least squares on real presses
ELEVATION_DEG = 25.0
AMBIENT = 0.08
GAMMA = 1.5
NOISE_LEVELS = 1.0
SHADOW = 0.1  # softness of the attached shadow: lamps are strips, not points
EXPOSURE = 0.45
CROSSTALK = np.array([[0.90, 0.07, 0.03], [0.06, 0.88, 0.06], [0.03, 0.07, 0.90]])


@dataclass(frozen=True)
class Press:
    """A ball's cap in the gel; centre and contact radius in px."""

    ball_diameter_mm: float
    row_px: float
    col_px: float
    contact_px: float


def grid_mm(row_px, col_px, shape=SHAPE):
    row, col = np.indices(shape, dtype=float)
    return (row - row_px) * PITCH_MM, (col - col_px) * PITCH_MM


def ball_surface(press: Press):
    """Return height mm and slopes: a spherical cap, and around it a skirt that dies off.

    The skirt continues the slope at the edge of contact and decays exponentially: it replaces
    the gel's own shape and is no contact solution.
    """
    y, x = grid_mm(press.row_px, press.col_px)
    r, a, R = np.hypot(y, x), press.contact_px * PITCH_MM, press.ball_diameter_mm / 2.0
    edge_slope = a / np.sqrt(R**2 - a**2)
    length_mm = 0.3 * a
    skirt = edge_slope * np.exp(-np.maximum(r - a, 0.0) / length_mm)
    inside = np.sqrt(R**2 - np.minimum(r, a) ** 2)
    cap = inside - np.sqrt(R**2 - a**2) + edge_slope * length_mm
    height = np.where(r <= a, cap, skirt * length_mm)
    fall = np.where(r <= a, r / inside, skirt) / np.maximum(r, 1e-9)
    return height, np.stack([-y * fall, -x * fall])


def shade(slopes, seed):
    """Return the (row, col, 3) uint8 image of a surface, (2, row, col) mm/mm."""
    row_slope, col_slope = slopes
    nz = 1.0 / np.sqrt(1.0 + row_slope**2 + col_slope**2)
    # Camera-facing normal in image axes: x right, y down.
    normal = np.stack([-col_slope * nz, -row_slope * nz, nz], axis=-1)
    azimuth, elevation = np.deg2rad(AZIMUTHS_DEG), np.deg2rad(ELEVATION_DEG)
    lamps = np.column_stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            -np.sin(azimuth) * np.cos(elevation),
            np.full(3, np.sin(elevation)),
        ]
    )
    lit = SHADOW * np.logaddexp(0.0, normal @ lamps.T / SHADOW)
    light = (lit * falloff(slopes.shape[1:]) + AMBIENT) @ CROSSTALK.T
    light = EXPOSURE * light / (1.0 + 0.1 * light)
    noise = np.random.default_rng(seed).normal(0.0, NOISE_LEVELS, light.shape)
    return np.clip(np.rint(255.0 * light ** (1.0 / GAMMA) + noise), 0, 255).astype(np.uint8)


def falloff(shape):
    """Return each lamp's relative strength, brighter on the far side, as real units show."""
    y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in shape), indexing="ij")
    along = [np.cos(a) * x - np.sin(a) * y for a in np.deg2rad(AZIMUTHS_DEG)]
    return np.stack([(1.0 - 0.15 * s) * (1.0 - 0.15 * (x**2 + y**2)) for s in along], axis=-1)


def calibration_presses(count: int, seed: int) -> list[Press]:
    """Return presses of balls of 4 to 9 mm, spread over the field."""
    random = np.random.default_rng(seed)
    rows, cols = SHAPE
    presses = []
    for _ in range(count):
        diameter_mm = random.uniform(4.0, 9.0)
        contact_px = random.uniform(0.35, 0.62) * diameter_mm / 2.0 / PITCH_MM
        margin = contact_px + 4.0
        place = random.uniform((margin, margin), (rows - margin, cols - margin))
        presses.append(Press(diameter_mm, *place, contact_px))
    return presses


@pytest.fixture(scope="session")
def make_surface():
    return ball_surface


@pytest.fixture(scope="session")
def render():
    return shade


@pytest.fixture(scope="session")
def background_frames():
    flat = np.zeros((2, *SHAPE))
    return np.stack([shade(flat, seed) for seed in range(10)])


@pytest.fixture(scope="session")
def presses():
    return calibration_presses(50, 7)


@pytest.fixture(scope="session")
def ball_presses(presses):
    return [
        BallPress(shade(ball_surface(press)[1], 1000 + i), press.ball_diameter_mm)
        for i, press in enumerate(presses)
    ]


@pytest.fixture(scope="session")
def calibrations(ball_presses, background_frames):
    return {
        kind: calibrate_sensor(ball_presses, background_frames, PITCH_MM, kind)
        for kind in COLOUR_MAPS.names()
    }
