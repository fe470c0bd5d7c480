"""A gel on a window: pressure, contact and ball from the coat of a large-strain solid."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation import (
    CompensatedGel,
    GelLayer,
    SheetOpening,
    compensate_gel,
    parts_of,
    relief_on_frame,
)
from reconstruction.errors import FitError
from twin.mechanics.contact import solve_on_layer
from twin.mechanics.control import DepthControl
from twin.mechanics.layer import BondedLayer

SOLIDS = Path(__file__).parents[1] / "mechanics/reference/neo_hookean.json"
CELLS, PITCH_MM = 140, 0.08


def compensated(
    heights_mm: FloatArray, thickness_mm: float, noise_mm: float, measured: BoolArray | None = None
) -> CompensatedGel:
    """Compensate heights on CELLS x CELLS with white noise; E = 1 MPa."""
    side = CELLS * PITCH_MM
    places = (np.arange(CELLS) + 0.5) * PITCH_MM - side / 2
    x, y = np.meshgrid(places, places)
    valid = np.ones(x.shape, bool) if measured is None else measured
    z = heights_mm + np.random.default_rng(2).normal(scale=noise_mm, size=x.shape)
    points = np.stack((x[valid], y[valid], z[valid]), axis=-1)
    sigma = np.full(len(points), max(noise_mm, 1e-6))
    relief = relief_on_frame(points, sigma, SheetOpening(side, side), (CELLS, CELLS))
    margin = int(np.ceil(2.5 * thickness_mm / PITCH_MM))
    return compensate_gel(relief, GelLayer(layer(thickness_mm, margin).deflect, (margin,) * 2, 1e3))


def layer(thickness_mm: float, margin: int) -> BondedLayer:
    count = CELLS + 2 * margin
    return BondedLayer(count, count, count * PITCH_MM, count * PITCH_MM, thickness_mm, 0.49)


def test_ball_in_a_large_strain_solid() -> None:
    """Neo-Hookean, R 4, h 4, travel 1 mm, 10 um of noise: R to 0.3 %, force to 10 %.

    Stored axisymmetric solid elements, with no code in common with the linear layer.
    """
    case = json.loads(SOLIDS.read_text())["bonded_r4_h4_d1"]
    places = (np.arange(CELLS) + 0.5) * PITCH_MM - CELLS * PITCH_MM / 2
    radius = np.minimum(np.hypot(places, places[:, None]), 10.0)
    heights = CubicSpline(case["r_mm"], case["touched_face_mm"])(radius)
    fitted = compensated(heights, 4.0, 0.01)
    (ball,) = parts_of(fitted)
    assert ball.form == "ball"
    assert ball.radius_mm == pytest.approx(4.0, rel=3e-3)
    assert abs(ball.radius_mm - 4.0) < 3 * ball.sigma_mm
    assert fitted.force_n == pytest.approx(1e3 * 1e-3 * case["force_over_modulus_mm2"], rel=0.1)
    assert fitted.misfit_mm == pytest.approx(0.01, rel=0.15)


def test_two_balls_and_a_gap_in_the_map() -> None:
    """Linear layer: two unequal balls are two parts; unmeasured cells have no pressure."""
    gel = layer(2.0, 62)
    x, y = np.meshgrid(gel.x_mm, gel.y_mm)
    balls = ((-2.5, 0.0, 3.0, 0.0), (2.5, 0.5, 2.0, 0.1))
    height = np.min(
        [low + r - np.sqrt(np.maximum(r**2 - (x - a) ** 2 - (y - b) ** 2, 0.0))
         for a, b, r, low in balls], axis=0,
    )  # fmt: skip
    pressed = solve_on_layer(gel, height, DepthControl(0.5))
    inner = slice(62, 62 + CELLS)
    valid = np.ones((CELLS, CELLS), bool)
    valid[:, 36:39] = False
    fitted = compensated(pressed.deflection_mm[inner, inner], 2.0, 1e-3, valid)
    assert not fitted.contact[~valid].any()
    parts = sorted(parts_of(fitted), key=lambda part: -int(part.core.sum()))
    right = next(part for part in parts if part.middle_mm[0] > 1.5)
    assert right.radius_mm == pytest.approx(2.0, rel=0.01)
    true_n = float(pressed.pressure.sum()) * PITCH_MM**2
    assert fitted.force_n == pytest.approx(true_n, rel=0.05)
    # Unmeasured cells can have no pressure.
    assert fitted.pressure_kpa[np.broadcast_to(~valid, fitted.contact.shape)].max() == 0.0


def test_a_flat_coat_is_rejected() -> None:
    with pytest.raises(FitError, match="no object presses"):
        compensated(np.full((CELLS, CELLS), -0.1), 4.0, 0.0)
