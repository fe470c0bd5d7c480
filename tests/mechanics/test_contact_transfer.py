"""Share of a groove on the coat: closed form, the solver's operators, and a pressed grating."""

import numpy as np
import pytest

from twin.config.models import Elastomer, Press
from twin.mechanics import PressError, contact_transfer, press
from twin.specimens.kinds.grating import Grating


def slab(**changes: object) -> Elastomer:
    values: dict[str, object] = {
        "thickness_mm": 2.0,
        "length_x_mm": 24.0,
        "length_y_mm": 24.0,
        "young_modulus_kpa": 300.0,
        "poisson_ratio": 0.49,
    }
    return Elastomer.model_validate(values | changes)


def test_half_is_kept_at_2_40_thicknesses_and_a_tenth_at_1_32() -> None:
    result = contact_transfer(slab())
    assert result.half_pitch_mm / 2 == pytest.approx(2.40, abs=0.005)
    assert result.tenth_pitch_mm / 2 == pytest.approx(1.32, abs=0.006)
    assert np.interp(result.half_pitch_mm, result.pitch_mm, result.closed_form) == pytest.approx(
        0.5, abs=0.005
    )


@pytest.mark.parametrize("nu", [0.3, 0.4999])
def test_the_solver_computes_the_closed_form(nu: float) -> None:
    result = contact_transfer(slab(poisson_ratio=nu))
    np.testing.assert_allclose(result.computed, result.closed_form, rtol=1e-6)
    assert result.rows()[3] == (
        result.pitch_mm[3],
        result.closed_form[3],
        result.computed[3],
    )


@pytest.mark.parametrize("pitch_mm", [3.0, 4.0])
def test_a_pressed_grating_shows_what_the_closed_form_says(pitch_mm: float) -> None:
    """Gauge pressure fills the grooves: the touched face is the grating, the coat shows T of it.

    The slab also bends as a whole, over a smooth plate likewise: the grooves are the difference.
    """
    specimen = Grating(pitch_mm=pitch_mm, groove_mm=0.004, length_x_mm=18, length_y_mm=18)
    load = Press(
        control="depth",
        depth_mm=0.5,
        back_pressure_kpa=40.0,
        solver_pitch_mm=0.1,
        relief_pitch_mm=0.05,
    )
    thick = slab(layout="opposite_face")
    flat = press(specimen.model_copy(update={"groove_mm": 1e-9}), thick, load)
    pressed = press(specimen, thick, load)
    row, col = pressed.y_mm.size // 2, np.abs(pressed.x_mm) < pitch_mm
    assert pressed.contact[row, col].all()
    change = (pressed.face_z_mm - flat.face_z_mm)[pressed.face_y_mm.size // 2]
    near = np.abs(pressed.face_x_mm) <= pitch_mm / 2
    x = pressed.face_x_mm[near]
    basis = np.stack((np.cos(2 * np.pi * x / pitch_mm), np.ones_like(x), x, x**2), axis=-1)
    amplitude = np.linalg.lstsq(basis, change[near], rcond=None)[0][0]
    transferred = contact_transfer(thick, np.array([pitch_mm])).closed_form[0]
    assert 2 * amplitude / 0.004 == pytest.approx(transferred, rel=0.02)


def test_a_coat_on_the_touched_face_loses_nothing() -> None:
    result = contact_transfer(slab(layout="contact_face"), np.array([0.5, 5.0]))
    assert result.computed.tolist() == result.closed_form.tolist() == [1.0, 1.0]
    assert result.half_pitch_mm == 0


def test_a_pitch_of_zero_is_rejected() -> None:
    with pytest.raises(PressError, match="allowed: more than 0"):
        contact_transfer(slab(), np.array([1.0, 0.0]))
