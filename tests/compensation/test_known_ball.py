"""One press of a known ball tells thickness and modulus, which other presses then use."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.compensation import calibrate_sheet, compensate_sheet, parts_of
from reconstruction.errors import FitError, InputError
from tests.compensation.sheets import YOUNG_KPA, coat_points, layer_of, pressed_ball


def test_ball_tells_thickness_and_modulus_for_another_press() -> None:
    """Believed 10 % too thick and 20 % too soft; afterwards R of a press with more air to 2 um."""
    believed = replace(
        layer_of(0.22, 2.0, sigma_back_pressure_kpa=0.02), young_modulus_kpa=0.8 * YOUNG_KPA
    )
    found = calibrate_sheet(*coat_points(pressed_ball(0.2, 2.0), 5e-4), believed, 4.0)
    assert found.balls == 1
    assert found.radius_before_mm < 3.99
    assert abs(found.layer.thickness_mm - 0.2) < 3 * found.layer.sigma_thickness_mm < 5e-3
    modulus, sigma = found.layer.young_modulus_kpa, found.layer.sigma_young_modulus_kpa
    assert abs(modulus - YOUNG_KPA) < 2 * sigma < 0.1 * YOUNG_KPA
    other = pressed_ball(0.2, 3.0, travel_mm=0.7)
    points, kept = coat_points(other, 5e-4, seed=1), replace(found.layer, back_pressure_kpa=3.0)
    (before,), (after,) = (
        parts_of(compensate_sheet(*points, layer))
        for layer in (replace(believed, back_pressure_kpa=3.0), kept)
    )
    assert abs(before.radius_mm - 4.0) > 0.015
    assert abs(after.radius_mm - 4.0) < 2e-3


def test_a_ball_that_no_sheet_explains_is_refused() -> None:
    points = coat_points(pressed_ball(0.2, 2.0))
    with pytest.raises(FitError, match="check the ball"):
        calibrate_sheet(*points, layer_of(0.2, 2.0), 3.0)
    with pytest.raises(InputError, match="ball radius"):
        calibrate_sheet(*points, layer_of(0.2, 2.0), -1.0)


def test_a_flat_press_has_no_ball() -> None:
    """Nothing touches a sheet that lies flat without air."""
    x, y = np.meshgrid(np.linspace(-5.9, 5.9, 100), np.linspace(-5.9, 5.9, 100))
    points = np.stack((x, y, 0 * x), axis=-1).reshape(-1, 3)
    with pytest.raises(FitError, match="no part"):
        calibrate_sheet(points, np.full(len(points), 1e-3), layer_of(0.2, 0.0), 4.0)
