"""Coats of a ball under a round sheet from the one-dimensional oracle, as measured points."""

from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline

from reconstruction.arrays import FloatArray
from reconstruction.compensation import SheetLayer, SheetOpening
from tests.oracles.round_sheet import Profile, round_sheet_profile

YOUNG_KPA = 300.0
RIM_MM = 6.0


@cache
def pressed_ball(
    thickness_mm: float, pressure_kpa: float, rim_mm: float = RIM_MM, travel_mm: float = 0.6,
    stick: bool = False,
) -> Profile:  # fmt: skip
    """Press a ball of 4 mm from below; see `round_sheet_profile`."""
    return round_sheet_profile(
        4.0, thickness_mm, YOUNG_KPA, rim_mm, travel_mm, pressure_kpa=pressure_kpa, stick=stick
    )


def layer_of(
    thickness_mm: float, pressure_kpa: float, rim_mm: float = RIM_MM, **known: float | bool
) -> SheetLayer:
    """Return the known values of that sheet."""
    return SheetLayer(
        SheetOpening(2 * rim_mm, 2 * rim_mm, is_round=True), thickness_mm, YOUNG_KPA,
        back_pressure_kpa=pressure_kpa, **known,
    )  # fmt: skip


def coat_points(
    profile: Profile, noise_mm: float = 0.0, seed: int = 0, pitch_mm: float = 0.05
) -> tuple[FloatArray, FloatArray]:
    """Return points (n, xyz) of the coat with white noise along z, and its standard deviation."""
    rim = profile.radius_mm[-1]
    places = np.arange(-rim + pitch_mm / 2, rim, pitch_mm)
    x, y = np.meshgrid(places, places)
    radius = np.hypot(x, y)
    on = radius < rim
    z = CubicSpline(profile.radius_mm, profile.upper_z_mm)(radius[on])
    z += np.random.default_rng(seed).normal(scale=noise_mm, size=z.shape) if noise_mm else 0.0
    return np.stack((x[on], y[on], z), axis=-1), np.full(int(on.sum()), max(noise_mm, 1e-6))
