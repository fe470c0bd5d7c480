"""Relaxing elastomers: creep and relaxation are inverse, a held press against time steps."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import quad

from reconstruction.arrays import FloatArray
from tests.oracles.creeping_layer import press_by_steps
from twin.config.models import Elastomer, Mechanics, Press
from twin.config.relaxation import Relaxation
from twin.mechanics import PressedElastomer, PressError, press_with, read_press, write_press
from twin.mechanics.control import Control, DepthControl, ForceControl
from twin.mechanics.layer import BondedLayer
from twin.mechanics.models import MODELS, PressInput
from twin.mechanics.relaxation import (
    creep_function,
    relaxation_function,
    relaxed_share,
    waiting_time_s,
)
from twin.specimens import height_above_lowest
from twin.specimens.kinds.ball import Ball

SPECTRAL = Mechanics(model="spectral")
TERMS = Relaxation(shares=(0.15, 0.1, 0.05), times_s=(0.5, 5.0, 60.0))
COARSE = {"solver_pitch_mm": 0.25, "relief_pitch_mm": 0.05}
BALL = Ball(diameter_mm=8.0)


def gel(**changes: object) -> Elastomer:
    """A 24 x 24 x 4 mm gel of 500 kPa on a window, which relaxes by 30 %."""
    values = {
        "thickness_mm": 4.0,
        "length_x_mm": 24.0,
        "length_y_mm": 24.0,
        "young_modulus_kpa": 500.0,
        "poisson_ratio": 0.49,
        "layout": "contact_face",
        "relaxation": TERMS,
    }
    return Elastomer.model_validate(values | changes)


def to_depth(**values: float) -> Press:
    return Press.model_validate({"control": "depth", "depth_mm": 0.5} | COARSE | values)


def with_force(**values: float) -> Press:
    return Press.model_validate({"control": "force", "force_n": 0.8} | COARSE | values)


def pressed(load: Press, **changes: object) -> PressedElastomer:
    return press_with(SPECTRAL, BALL, gel(**changes), load)


@pytest.mark.parametrize("t_s", [1e-4, 0.3, 2.0, 40.0, 500.0])
@pytest.mark.parametrize(
    "terms", [TERMS, Relaxation(shares=(0.2, 0.3), times_s=(2.0, 2.0))], ids=["three", "equal"]
)
def test_relaxation_times_creep_is_one(terms: Relaxation, t_s: float) -> None:
    """The stress of a creeping strain stays 1: integral of r(t - s) dc(s), with c(0) = 1."""
    r, c = relaxation_function(terms), creep_function(terms)

    def rate(s: float) -> float:
        return float(c.amplitudes @ (c.rates_per_s * np.exp(-c.rates_per_s * s)))

    stress, _ = quad(lambda s: r(t_s - s) * rate(s), 0, t_s, epsabs=1e-13, epsrel=1e-12, limit=400)
    assert r(t_s) + stress == pytest.approx(1.0, abs=1e-9)


def test_limits_at_once_and_after_a_long_time() -> None:
    r, c = relaxation_function(TERMS), creep_function(TERMS)
    assert (r(0.0), c(0.0)) == (1.0, 1.0)
    assert r(1e6) == pytest.approx(0.7, rel=1e-12)
    assert c(1e6) == pytest.approx(1 / 0.7, rel=1e-12)
    assert (r.final, c.final) == pytest.approx((0.7, 1 / 0.7), rel=1e-12)
    # Creep is slower than relaxation: each retardation time is longer than its relaxation time.
    assert (np.sort(1 / c.rates_per_s) > np.sort(np.array(TERMS.times_s))).all()


def test_the_mean_of_a_series_is_its_integral() -> None:
    c = creep_function(TERMS)
    area, _ = quad(c, 2.0, 9.0)
    assert c.mean(2.0, 9.0) == pytest.approx(area / 7.0, rel=1e-9)
    assert c.mean(2.0, 2.0) == c(2.0)
    assert c.mean(2.0, 2.0 + 1e-9) == pytest.approx(c(2.0), rel=1e-8)


def by_steps(times_s: FloatArray, controls: list[Control]) -> tuple[FloatArray, FloatArray]:
    """Return force over modulus and travel of the ball by time steps of a 24 x 24 x 4 mm gel."""
    layer = BondedLayer(96, 96, 24.0, 24.0, 4.0, 0.49)
    height = height_above_lowest(BALL, layer.x_mm, layer.y_mm)
    return press_by_steps(layer, height, TERMS, times_s, controls)


def test_a_press_at_constant_speed_and_its_hold_against_time_steps() -> None:
    """Force of a ramp of 2 s, at once and 3 s later; expected by the layer's time steps: 1 %."""
    times = np.concatenate((np.linspace(0, 2.0, 9), [2.5, 3.5, 5.0]))
    travels = np.minimum(times / 2.0, 1.0)[1:] * 0.5
    forces, _ = by_steps(times, [DepthControl(float(depth)) for depth in travels])
    for hold_s, number in ((0.0, 8), (3.0, 11)):
        result = pressed(to_depth(ramp_s=2.0, hold_s=hold_s))
        assert result.force_n == pytest.approx(0.5 * forces[number], rel=0.01)
    elastic = pressed(to_depth(), relaxation=None)
    assert result.force_n < 0.85 * elastic.force_n
    np.testing.assert_array_equal(result.face_z_mm, elastic.face_z_mm)


def test_creep_under_a_constant_force_against_time_steps() -> None:
    """Travel of a ball under a step of force; expected by the layer's time steps: 1 %."""
    times = np.array([0.0, 1e-6, 0.2, 0.6, 1.4, 3.0, 6.0])
    area = (24.0 / 96) ** 2
    _, depths = by_steps(times, [ForceControl(0.8 / 0.5, area)] * 6)
    first, result = pressed(with_force()), pressed(with_force(hold_s=6.0))
    assert first.depth_mm == pytest.approx(depths[1], rel=1e-3)
    assert result.depth_mm == pytest.approx(depths[-1], rel=0.01)
    assert result.depth_mm > 1.08 * first.depth_mm
    assert result.initial_force_n == pytest.approx(0.8, rel=1e-9)
    assert result.relief_change_um == pytest.approx(
        1e3 * np.abs(result.face_z_mm - first.face_z_mm).max(), rel=1e-9
    )


def test_a_step_of_travel_has_the_force_of_the_prony_series() -> None:
    elastic = pressed(to_depth(), relaxation=None)
    for t_s in (1e-3, 1.0, 20.0, 1e4):
        share = 1 - sum(
            g * (1 - np.exp(-t_s / tau)) for g, tau in zip(TERMS.shares, TERMS.times_s, strict=True)
        )
        result = pressed(to_depth(hold_s=t_s))
        assert result.force_n == pytest.approx(share * elastic.force_n, rel=1e-12)
        assert (result.initial_force_n, result.relief_change_um) == (elastic.force_n, 0.0)


def test_a_slab_on_a_rim_creeps_as_a_softer_slab() -> None:
    """Opposite-face layout: a held force is that on an elastic slab of modulus E / c(t)."""
    rim = {"layout": "opposite_face", "young_modulus_kpa": 800.0}
    held = pressed(with_force(hold_s=10.0), **rim)
    softer = 800.0 / creep_function(TERMS)(10.0)
    expected = pressed(with_force(), **rim | {"young_modulus_kpa": softer, "relaxation": None})
    np.testing.assert_allclose(held.face_z_mm, expected.face_z_mm, atol=1e-9)
    assert held.relief_change_um is not None
    assert held.relief_change_um > 50
    at_depth = pressed(to_depth(hold_s=10.0), **rim)
    elastic = pressed(to_depth(), **rim | {"relaxation": None})
    assert at_depth.force_n == pytest.approx(relaxation_function(TERMS)(10.0) * elastic.force_n)
    np.testing.assert_array_equal(at_depth.face_z_mm, elastic.face_z_mm)


def test_a_ramp_converges_with_its_steps() -> None:
    """The force of 8 steps differs from that of 64 by less than 0.1 %, for forces of a ball."""
    load = to_depth(ramp_s=2.0, hold_s=0.0)
    shares = []
    for count in (8, 64):
        travel = np.arange(1, count + 1) / count
        shares.append(relaxed_share(TERMS, load, travel**1.5))
    assert shares[0] == pytest.approx(shares[1], rel=1e-3)
    assert relaxed_share(TERMS, load) == pytest.approx(shares[1], rel=0.05)


def test_waiting_time() -> None:
    """After it the relief changes by the given amount; with a given travel it does not change."""
    coarse = {"solver_pitch_mm": 0.4}
    case = PressInput(SPECTRAL, BALL, gel(), with_force(**coarse))
    wait_s = waiting_time_s(MODELS["spectral"], case, 5.0)
    held, final = (pressed(with_force(hold_s=t_s, **coarse)).face_z_mm for t_s in (wait_s, 1e5))
    assert 1e3 * np.abs(final - held).max() == pytest.approx(5.0, rel=0.05)
    assert waiting_time_s(MODELS["spectral"], case, 1e3) == 0.0
    at_depth = PressInput(SPECTRAL, BALL, gel(), to_depth())
    assert waiting_time_s(MODELS["spectral"], at_depth, 1e-3) == 0.0


def test_the_figures_are_stored(tmp_path: Path) -> None:
    result = pressed(to_depth(hold_s=2.0))
    write_press(tmp_path / "press.nc", result)
    stored = read_press(tmp_path / "press.nc")
    assert stored.initial_force_n == result.initial_force_n
    assert stored.relief_change_um == 0.0
    write_press(tmp_path / "elastic.nc", pressed(to_depth(), relaxation=None))
    assert read_press(tmp_path / "elastic.nc").initial_force_n is None


@pytest.mark.parametrize(
    ("changes", "load", "model", "message"),
    [
        ({"layout": "opposite_face"}, {"back_pressure_kpa": 1.0}, "spectral", "air pressure or we"),
        (
            {"film": {"thickness_mm": 0.1, "young_modulus_kpa": 900.0}},
            {},
            "spectral",
            "and a film, whose relaxation is not known",
        ),
        ({"layout": "opposite_face"}, {}, "neo_hookean", "which the neo_hookean model lacks; use"),
        ({"layout": "opposite_face", "thickness_mm": 0.2}, {}, "sheet", "the sheet model lacks"),
    ],
)
def test_unsupported_presses_are_one_line(
    changes: dict[str, object], load: dict[str, float], model: str, message: str
) -> None:
    with pytest.raises(PressError, match=message) as caught:
        press_with(Mechanics(model=model), BALL, gel(**changes), to_depth(hold_s=3.0, **load))
    assert "\n" not in str(caught.value)
    assert "press.hold_s: found 3 s" in str(caught.value)


@pytest.mark.parametrize(
    ("shares", "times_s", "message"),
    [
        ((0.5, 0.5), (1.0, 2.0), "found a sum of 1, allowed less than 1"),
        ((0.5,), (1.0, 2.0), "found 1 numbers and 2 times_s"),
        ((0.5,), (0.0,), "greater than or equal to 0.000001"),
        ((), (), "at least 1 item"),
    ],
)
def test_invalid_terms_are_refused(
    shares: tuple[float, ...], times_s: tuple[float, ...], message: str
) -> None:
    with pytest.raises(ValidationError, match=message):
        Relaxation(shares=shares, times_s=times_s)


def test_an_elastic_elastomer_has_no_new_key() -> None:
    """Experiments without relaxation and slide keep their digests."""
    assert "relaxation" not in gel(relaxation=None).model_dump()
    new = {"ramp_s", "hold_s", "slide_x_mm", "slide_y_mm"}
    assert not new & set(to_depth().model_dump())
    assert new <= set(to_depth(ramp_s=1.0, hold_s=1.0, slide_x_mm=1, slide_y_mm=1).model_dump())
