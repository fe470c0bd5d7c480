"""Sliding with friction: Cattaneo-Mindlin, memory, energy, symmetry, and the press with a slide."""

from pathlib import Path

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from tests.oracles.partial_slip import paraboloid, solve_partial_slip
from twin.config.models import Elastomer, Mechanics, Press
from twin.config.relaxation import Relaxation
from twin.mechanics import (
    PressedElastomer,
    PressError,
    in_plane_displacement,
    press_with,
    read_press,
    write_press,
)
from twin.mechanics.contact import Contact, solve_on_layer
from twin.mechanics.control import DepthControl, inner
from twin.mechanics.layer import BondedLayer
from twin.mechanics.shear import ShearedLayer
from twin.mechanics.sliding import SlidEquilibrium, slide
from twin.specimens.kinds.ball import Ball

MU = 0.5
SPECTRAL = Mechanics(model="spectral")
COARSE = {"solver_pitch_mm": 0.25, "relief_pitch_mm": 0.05}


def force_mm2(layer: BondedLayer, field: FloatArray) -> float:
    return float(field.sum()) * layer.cell_area_mm2


@pytest.mark.parametrize("share", [0.4, 0.8])
def test_partial_slip_of_a_ball_on_a_thick_layer(share: float) -> None:
    """Cattaneo, Mindlin: T and stick radius by travel, 3 %."""
    solved = solve_partial_slip(share, MU)
    assert solved.force_ratio == pytest.approx(1.0, rel=0.03)
    assert solved.radius_ratio == pytest.approx(1.0, rel=0.03)
    traction, slip, bound = solved.traction, solved.slip_mm, solved.bound
    assert np.hypot(*slip)[solved.sticking].max() < 1e-3 * solved.travel_mm
    slipping = (bound > 0) & ~solved.sticking
    # Friction opposes the slip of the face: the traction on the face has the slip's direction.
    power = (traction.x * slip.x + traction.y * slip.y)[slipping]
    np.testing.assert_allclose(power, (bound * np.hypot(*slip))[slipping], rtol=1e-3, atol=1e-9)


LAYER = BondedLayer(96, 96, 24.0, 24.0, 3.0, 0.49)


@pytest.fixture(scope="module")
def rest() -> tuple[Contact, DepthControl]:
    control = DepthControl(0.5)
    return solve_on_layer(LAYER, paraboloid(LAYER), control), control


def along_x(
    rest: tuple[Contact, DepthControl], travels_mm: list[float], mu: float = MU
) -> list[SlidEquilibrium]:
    path = [(travel, 0.0) for travel in travels_mm]
    return list(slide(LAYER, paraboloid(LAYER), rest, mu, path))


def test_a_reversed_slide_follows_masings_rule(rest: tuple[Contact, DepthControl]) -> None:
    """T* - T = 2 f((d* - d) / 2), with the first loading f: the contact remembers its path."""
    loading, back = along_x(rest, [0.04, 0.08, 0.16]), along_x(rest, [0.16, 0.08, 0.0])
    small, half, whole = (state.force_mm2(LAYER.cell_area_mm2)[0] for state in loading)
    after = [state.force_mm2(LAYER.cell_area_mm2)[0] for state in back]
    assert after[0] == pytest.approx(whole, rel=1e-3)
    assert after[1] == pytest.approx(whole - 2 * small, abs=0.01 * whole)
    assert after[2] == pytest.approx(whole - 2 * half, abs=0.01 * whole)
    assert after[2] < 0  # back at the start the friction pulls the other way


def test_full_slip_energy_and_dissipation(rest: tuple[Contact, DepthControl]) -> None:
    """T grows to mu N; the work of the travel is stored or dissipated; friction dissipates."""
    states = along_x(rest, [0.05 * number for number in range(1, 17)])
    forces = [state.force_mm2(LAYER.cell_area_mm2)[0] for state in states]
    loads = [force_mm2(LAYER, state.contact.pressure) for state in states]
    ratios = [force / (MU * load) for force, load in zip(forces, loads, strict=True)]
    assert ratios == sorted(ratios)
    assert 0.999 < ratios[-1] <= 1 + 1e-6
    assert not states[-1].sticking.any()
    dissipated = [state.dissipated_mm3 for state in states]
    assert dissipated == sorted(dissipated)
    assert dissipated[0] >= 0
    end, start = states[-1], rest[0]
    stored = (
        inner(end.contact.pressure, end.contact.deflection_mm)
        + sum(inner(end.traction[axis], end.displacement_mm[axis]) for axis in (0, 1))
        - inner(start.pressure, start.deflection_mm)
    )
    balance = stored / 2 * LAYER.cell_area_mm2 + end.dissipated_mm3
    assert end.work_mm3 == pytest.approx(balance, rel=0.02)


def test_a_slide_is_symmetric(rest: tuple[Contact, DepthControl]) -> None:
    """A slide to the other side gives mirrored fields, one along y transposed fields."""
    height = paraboloid(LAYER)
    right, left, up = (
        next(slide(LAYER, height, rest, MU, [travel]))
        for travel in ((0.1, 0.0), (-0.1, 0.0), (0.0, 0.1))
    )
    size = np.abs(right.traction.x).max()
    np.testing.assert_allclose(left.traction.x, -right.traction.x[:, ::-1], atol=1e-3 * size)
    np.testing.assert_allclose(up.traction.y, right.traction.x.T, atol=1e-3 * size)
    np.testing.assert_allclose(right.traction.x, right.traction.x[::-1], atol=1e-3 * size)
    # The traction pushes the face against the press in front of the ball, and along it behind.
    deflection = ShearedLayer(LAYER).deflect(right.traction)
    assert deflection[48, 60] < -1e-3 < 1e-3 < deflection[48, 35]


def gel(**changes: object) -> Elastomer:
    """A 24 x 24 x 4 mm gel of 400 kPa on a window, with friction."""
    values = {
        "thickness_mm": 4.0,
        "length_x_mm": 24.0,
        "length_y_mm": 24.0,
        "young_modulus_kpa": 400.0,
        "poisson_ratio": 0.49,
        "layout": "contact_face",
        "friction_coefficient": MU,
    }
    return Elastomer.model_validate(values | changes)


def slid(elastomer: Elastomer | None = None, **values: object) -> PressedElastomer:
    load = Press.model_validate({"control": "depth", "depth_mm": 0.5} | COARSE | values)
    return press_with(SPECTRAL, Ball(), gel() if elastomer is None else elastomer, load)


@pytest.fixture(scope="module")
def slid_far() -> PressedElastomer:
    return slid(slide_x_mm=0.12, slide_y_mm=-0.05)


def test_the_coat_moves_with_the_specimen_where_it_sticks(slid_far: PressedElastomer) -> None:
    load = Press(control="depth", depth_mm=0.5, slide_x_mm=0.12, slide_y_mm=-0.05, **COARSE)
    at_rest = slid(gel(friction_coefficient=None))
    moved, before = (in_plane_displacement(some, gel(), load) for some in (slid_far, at_rest))
    row, col = slid_far.face_y_mm.size // 2, slid_far.face_x_mm.size // 2
    assert moved[0][row, col] - before[0][row, col] == pytest.approx(0.12, rel=0.02)
    assert moved[1][row, col] - before[1][row, col] == pytest.approx(-0.05, rel=0.02)
    assert abs(moved[0][0, 0]) < 0.01
    assert 0 < slid_far.stick_area_share < 1 == at_rest.stick_area_share


def test_the_force_has_the_direction_of_the_slide(slid_far: PressedElastomer) -> None:
    shear = slid_far.shear
    assert shear is not None
    assert shear.force_y_n / shear.force_x_n == pytest.approx(-0.05 / 0.12, rel=0.01)
    assert 0.3 < shear.force_n / (MU * slid_far.force_n) < 1
    assert (
        np.hypot(shear.traction_x_kpa, shear.traction_y_kpa)
        <= MU * slid_far.pressure_kpa * (1 + 1e-9)
    ).all()
    assert not shear.slip_x_mm[~slid_far.contact].any()
    assert not np.hypot(shear.slip_x_mm, shear.slip_y_mm)[shear.sticking].any()


def test_four_increments_are_enough(
    slid_far: PressedElastomer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("twin.mechanics.sliding.straight.__defaults__", (16,))
    fine = slid(slide_x_mm=0.12, slide_y_mm=-0.05)
    assert fine.shear is not None
    assert slid_far.shear is not None
    assert slid_far.shear.force_n == pytest.approx(fine.shear.force_n, rel=0.01)
    assert slid_far.stick_area_share == pytest.approx(fine.stick_area_share, abs=0.02)


def test_the_modulus_scales_the_stresses(slid_far: PressedElastomer) -> None:
    harder = slid(gel(young_modulus_kpa=800.0), slide_x_mm=0.12, slide_y_mm=-0.05)
    assert harder.shear is not None
    assert slid_far.shear is not None
    assert harder.shear.force_x_n == pytest.approx(2 * slid_far.shear.force_x_n, rel=1e-9)
    np.testing.assert_allclose(harder.face_z_mm, slid_far.face_z_mm, atol=1e-9)


def test_friction_relaxes_with_the_pressure(slid_far: PressedElastomer) -> None:
    relaxing = gel(relaxation=Relaxation(shares=(0.2,), times_s=(1.0,)))
    held = slid(relaxing, slide_x_mm=0.12, slide_y_mm=-0.05, hold_s=50.0)
    assert held.shear is not None
    assert slid_far.shear is not None
    assert held.shear.force_n == pytest.approx(0.8 * slid_far.shear.force_n, rel=1e-9)
    assert held.stick_area_share == slid_far.stick_area_share
    for kept in ({"control": "force", "force_n": 0.5, "depth_mm": None}, {"ramp_s": 1.0}):
        with pytest.raises(PressError, match="and a slide, allowed with control = 'depth'"):
            slid(relaxing, slide_x_mm=0.1, hold_s=1.0, **kept)


def test_a_press_with_a_given_force_slides_with_that_force() -> None:
    values = {"control": "force", "force_n": 0.6, "depth_mm": None}
    result = slid(slide_x_mm=1.5, **values)
    assert result.shear is not None
    assert result.force_n == pytest.approx(0.6, rel=1e-9)
    assert result.shear.force_n == pytest.approx(MU * 0.6, rel=0.01)
    assert result.shear.slip_x_mm.max() > 1.0


def test_large_shear_is_a_warning(slid_far: PressedElastomer) -> None:
    assert not any("shears the gel" in warning for warning in slid_far.validity.warnings)
    rough = slid(gel(friction_coefficient=2.0), slide_x_mm=0.6)
    assert any("shears the gel by up to" in warning for warning in rough.validity.warnings)


def test_the_shear_fields_are_stored(slid_far: PressedElastomer, tmp_path: Path) -> None:
    write_press(tmp_path / "press.nc", slid_far)
    stored = read_press(tmp_path / "press.nc").shear
    assert stored is not None
    assert slid_far.shear is not None
    for name, values in vars(slid_far.shear).items():
        np.testing.assert_array_equal(getattr(stored, name), values)
    assert stored.sticking.dtype == bool


@pytest.mark.parametrize(
    ("changes", "load", "model", "message"),
    [
        ({"layout": "opposite_face"}, {}, "spectral", "allowed with 'contact_face' only: a gel"),
        ({"friction_coefficient": None}, {}, "spectral", "give elastomer.friction_coefficient"),
        ({"film": {"thickness_mm": 0.1, "young_modulus_kpa": 900.0}}, {}, "spectral", "film"),
        ({}, {"slide_x_mm": 9.0}, "spectral", "the slide starts beyond the pad"),
        ({"friction_coefficient": None}, {}, "fem", "which the fem model lacks; use mechanics.mod"),
    ],
)
def test_unsupported_slides_are_one_line(
    changes: dict[str, object], load: dict[str, float], model: str, message: str
) -> None:
    values = {"control": "depth", "depth_mm": 0.5, "slide_x_mm": 0.1} | COARSE | load
    with pytest.raises(PressError, match=message) as caught:
        press_with(Mechanics(model=model), Ball(), gel(**changes), Press.model_validate(values))
    assert "\n" not in str(caught.value)
    assert "press.slide_x_mm: found" in str(caught.value)


def test_without_a_slide_friction_remains_a_key_of_the_sheet() -> None:
    with pytest.raises(PressError, match="friction_coefficient: found"):
        slid(slide_x_mm=0.0)
