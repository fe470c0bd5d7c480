"""Ridges on the coat of a thin sheet: line contact and full contact in closed form, and between."""

import numpy as np
import pytest

from twin.config.models import Elastomer
from twin.mechanics import PressError, ridge_height_mm, ridge_transfer
from twin.mechanics.contact_transfer import Ridges
from twin.mechanics.transfer import solve_transfer
from twin.specimens.kinds.fingerprint import Fingerprint
from twin.specimens.kinds.grating import Grating
from twin.specimens.kinds.nut import Nut

PITCH_MM = 0.45


def sheet(thickness_mm: float, **changes: object) -> Elastomer:
    values: dict[str, object] = {
        "thickness_mm": thickness_mm,
        "length_x_mm": 20.0,
        "length_y_mm": 20.0,
        "young_modulus_kpa": 300.0,
        "poisson_ratio": 0.4999,
    }
    return Elastomer.model_validate(values | changes)


def shown_um(thickness_mm: float, pressure_kpa: float, ridge_mm: float = 0.07) -> float:
    return 1e3 * ridge_mm * Ridges(sheet(thickness_mm), pressure_kpa, ridge_mm).shown(PITCH_MM)


def on_crests_um(thickness_mm: float, pressure_kpa: float) -> float:
    """Sheet that touches the crests in lines: the layer's response to a comb of forces."""
    wave = 2 * np.pi / PITCH_MM * np.arange(1, 200, 2)
    compliance = solve_transfer(wave * thickness_mm, 0.4999, "free").normal_b
    return float(1e3 * 4 * (2 * (1 - 0.4999**2) * compliance / wave).sum() * pressure_kpa / 300.0)


@pytest.mark.parametrize("thickness_mm", [0.1, 0.2, 0.3])
def test_faint_pressure_lets_it_stand_on_the_crests(thickness_mm: float) -> None:
    """Lines of contact: 1.3, 0.23, 0.07 um of 70 at 0.3 kPa."""
    result = shown_um(thickness_mm, 0.3)
    assert result == pytest.approx(on_crests_um(thickness_mm, 0.3), rel=0.01)
    assert result < on_crests_um(thickness_mm, 0.3)


def test_a_thin_sheet_bends_as_a_plate_over_a_long_pitch() -> None:
    """Sag p P^4 / (384 D), D = E h^3 / 9, which shear through the thickness adds 1 % to."""
    pressure_kpa, h, pitch = 1e-3, 0.05, 2.0
    result = Ridges(sheet(h), pressure_kpa, 0.3).shown(pitch)
    stiffness = 300.0 * h**3 / (12 * (1 - 0.4999**2))
    plate = pressure_kpa * pitch**4 / (384 * stiffness)
    assert 0.3 * result == pytest.approx(plate, rel=0.02)


@pytest.mark.parametrize(
    ("thickness_mm", "three_kpa", "ten_kpa", "thirty_kpa"),
    [(0.1, 13.0, 43.0, 63.0), (0.2, 2.3, 7.6, 23.0), (0.3, 0.7, 2.3, 6.9)],
)
def test_a_fingerprint_needs_a_thin_sheet_and_pressure(
    thickness_mm: float, three_kpa: float, ten_kpa: float, thirty_kpa: float
) -> None:
    """Estimates with lines of contact up to T of the ridge: contact of some width shows less."""
    for pressure_kpa, estimate_um in ((3.0, three_kpa), (10.0, ten_kpa), (30.0, thirty_kpa)):
        result = shown_um(thickness_mm, pressure_kpa)
        assert 0.8 * estimate_um < result < 1.01 * estimate_um


def test_full_contact_keeps_what_the_slab_keeps() -> None:
    result = ridge_transfer(sheet(0.2), 1e4)
    filled = result.pitch_mm > 0.4
    np.testing.assert_allclose(result.computed[filled], result.closed_form[filled], atol=1e-4)
    assert result.half_pitch_mm / 0.2 == pytest.approx(2.40, abs=0.01)


def test_softer_means_as_much_as_more_pressure() -> None:
    soft = Ridges(sheet(0.2, young_modulus_kpa=100.0), 3.0, 0.07)
    pressed = Ridges(sheet(0.2), 9.0, 0.07)
    assert soft.shown(0.8) == pytest.approx(pressed.shown(0.8), rel=1e-9)


def test_the_height_of_ridges_is_the_specimens() -> None:
    assert ridge_height_mm(Grating(groove_mm=0.2)) == 0.2
    assert ridge_height_mm(Fingerprint(depth_mm=0.05)) == 0.05
    assert ridge_height_mm(Nut()) == 0.07


def test_without_pressure_nothing_is_pressed_into_grooves() -> None:
    with pytest.raises(PressError, match=r"press\.back_pressure_kpa: found 0, allowed more"):
        ridge_transfer(sheet(0.2), 0.0)
