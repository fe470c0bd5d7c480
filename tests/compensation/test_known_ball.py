"""One press of a known ball determines thickness and modulus for other presses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from reconstruction.compensation import calibrate_sheet, compensate_sheet, known_ball, parts_of
from reconstruction.compensation.known_ball import require_determined
from reconstruction.errors import FitError, InputError
from tests.compensation.sheets import YOUNG_KPA, coat_points, layer_of, pressed_ball


def test_ball_calibrates_thickness_and_modulus_for_another_press() -> None:
    """Start 10 % too thick and 20 % too soft; then R of a press with more air to 2 um."""
    prior = replace(
        layer_of(0.22, 2.0, sigma_back_pressure_kpa=0.02), young_modulus_kpa=0.8 * YOUNG_KPA
    )
    calibrated = calibrate_sheet(*coat_points(pressed_ball(0.2, 2.0), 5e-4), prior, 4.0)
    assert calibrated.balls == 1
    assert calibrated.radius_before_mm < 3.99
    assert abs(calibrated.layer.thickness_mm - 0.2) < 3 * calibrated.layer.sigma_thickness_mm < 5e-3
    modulus, sigma = calibrated.layer.young_modulus_kpa, calibrated.layer.sigma_young_modulus_kpa
    assert abs(modulus - YOUNG_KPA) < 2 * sigma < 0.1 * YOUNG_KPA
    second = pressed_ball(0.2, 3.0, travel_mm=0.7)
    points, updated = (
        coat_points(second, 5e-4, seed=1),
        replace(calibrated.layer, back_pressure_kpa=3.0),
    )
    (before,), (after,) = (
        parts_of(compensate_sheet(*points, layer))
        for layer in (replace(prior, back_pressure_kpa=3.0), updated)
    )
    assert abs(before.radius_mm - 4.0) > 0.015
    assert abs(after.radius_mm - 4.0) < 2e-3


def test_a_ball_that_fits_no_sheet_is_rejected() -> None:
    points = coat_points(pressed_ball(0.2, 2.0))
    with pytest.raises(FitError, match="check the ball"):
        calibrate_sheet(*points, layer_of(0.2, 2.0), 3.0)
    with pytest.raises(InputError, match="ball radius"):
        calibrate_sheet(*points, layer_of(0.2, 2.0), -1.0)


MISTAKES = {
    "pressure in mbar": (layer_of(0.2, 20.0), 4.0, r"back_pressure_kpa = 20 of the layer"),
    "10 % of the pressure": (
        layer_of(0.2, 0.2),
        4.0,
        r"modulus of 28\.6 kPa, allowed 100 to 900; check .*back_pressure_kpa = 0\.2",
    ),
    "another ball": (layer_of(0.2, 2.0), 3.75, r"sheet of .* mm, allowed 0\.1 to 0\.4; check"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_the_layer_is_no_calibration(name: str) -> None:
    """A ball of 4 mm under 0.2 mm, 300 kPa and 2 kPa of air; 1 mbar is 0.1 kPa."""
    layer, radius_mm, message = MISTAKES[name]
    with pytest.raises(FitError, match=message) as caught:
        calibrate_sheet(*coat_points(pressed_ball(0.2, 2.0), 5e-4, pitch_mm=0.08), layer, radius_mm)
    assert "\n" not in str(caught.value)


def test_a_thickness_that_the_press_hardly_determines_is_no_calibration() -> None:
    """A ball known to 0.5 mm: the thickness would be known to 0.4 mm of 0.2 mm."""
    points = coat_points(pressed_ball(0.2, 2.0), 5e-4, pitch_mm=0.08)
    with pytest.raises(FitError, match=r"thickness_mm is 0\.199 \+- .*up to 25%; press"):
        calibrate_sheet(*points, layer_of(0.2, 2.0), 4.0, sigma_radius_mm=0.5)
    require_determined("young_modulus_kpa", 400.0, 100.0)
    for sigma in (101.0, float("nan"), float("inf")):
        with pytest.raises(FitError, match="young_modulus_kpa is 400"):
            require_determined("young_modulus_kpa", 400.0, sigma)


def test_balls_of_different_radii_are_no_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    """All balls in contact have one diameter: of 4 and 2 mm the mean would be a thickness."""
    parts = [SimpleNamespace(form="ball", radius_mm=radius) for radius in (3.9, 2.0)]
    monkeypatch.setattr(known_ball, "parts_of", lambda _: parts)
    points = coat_points(pressed_ball(0.2, 2.0), pitch_mm=0.08)
    with pytest.raises(FitError, match=r"radii of 2 to 3\.9 mm, allowed one diameter"):
        calibrate_sheet(*points, layer_of(0.2, 2.0), 4.0)


def test_an_iteration_that_does_not_end_is_no_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    """One step only, from 10 % too thick: the remaining error exceeds the uncertainty."""
    monkeypatch.setattr(known_ball, "_MOST_TURNS", 1)
    points = coat_points(pressed_ball(0.2, 2.0), pitch_mm=0.08)
    with pytest.raises(FitError, match=r"after 1 steps the thickness still changes by 0\.0"):
        calibrate_sheet(*points, layer_of(0.22, 2.0), 4.0)


def test_a_flat_press_has_no_ball() -> None:
    """A flat sheet without air has no contact."""
    x, y = np.meshgrid(np.linspace(-5.9, 5.9, 100), np.linspace(-5.9, 5.9, 100))
    points = np.stack((x, y, 0 * x), axis=-1).reshape(-1, 3)
    with pytest.raises(FitError, match="no part"):
        calibrate_sheet(points, np.full(len(points), 1e-3), layer_of(0.2, 0.0), 4.0)
