"""Large strain in space: its small-strain limit, and the stretching that a linear slab neglects."""

import numpy as np
import pytest

from twin.config.models import Elastomer, Press
from twin.mechanics import PressError, press
from twin.mechanics.reference.grid import ElementGrid
from twin.mechanics.reference.neo_hookean import Bricks, HeightContact, press_neo_hookean
from twin.mechanics.reference.result import sample
from twin.specimens import shape_of
from twin.specimens.kinds.ball import Ball

SHEET = Elastomer(
    thickness_mm=1.0,
    length_x_mm=20.0,
    length_y_mm=20.0,
    shore_a=10.0,
    young_modulus_kpa=1000.0,
    poisson_ratio=0.49,
)
COARSE = Bricks(half=5, contact=2.0, steps=3)
PITCHES = {"solver_pitch_mm": 0.08, "relief_pitch_mm": 0.05}


def load(**prescribed: object) -> Press:
    return Press.model_validate(prescribed | PITCHES)


@pytest.mark.parametrize("linear", [False, True])
def test_contact_stiffness_is_the_forces_derivative(linear: bool) -> None:
    edge = np.linspace(-1, 1, 4)
    grid = ElementGrid((edge, edge, np.array([0.0, 1.0])))
    surface = grid.surface(3)
    field = sample(shape_of(Ball()), 6.0, 6.0)
    carried = np.ones_like(surface.weight_mm2)
    contact = HeightContact(surface, grid.nodes_mm, field, 50.0, linear, carried)
    moved, along = np.random.default_rng(1).normal(size=(2, *grid.nodes_mm.shape)) * 1e-2
    pushed = contact.evaluate(moved, 0.3, None)
    ahead, behind = (
        contact.evaluate(moved + sign * 1e-5 * along, 0.3, pushed.active).force for sign in (1, -1)
    )
    expected = -(ahead - behind) / 2e-5
    assert pushed.active.sum() > 0
    result = pushed.stiffness @ along.ravel()
    np.testing.assert_allclose(result, expected, atol=1e-5 * abs(expected).max())


def test_small_strain_mode_is_the_spectral_slab() -> None:
    """Off the middle: only y = 0 is a plane of symmetry."""
    slab = SHEET.model_copy(update={"thickness_mm": 3.0})
    specimen, to_depth = Ball(x_mm=1.5), load(control="depth", depth_mm=0.6)
    bricks = Bricks(half=4, through=2, contact=2.0, steps=1)
    result = press_neo_hookean(specimen, slab, to_depth, bricks=bricks, linear=True)
    spectral = press(specimen, slab, to_depth)
    assert result.force_n == pytest.approx(spectral.force_n, rel=0.04)
    np.testing.assert_allclose(result.face_z_mm, spectral.face_z_mm, atol=0.01)
    assert np.sqrt(np.mean((result.face_z_mm - spectral.face_z_mm) ** 2)) < 5e-3
    cell_mm2 = float(result.x_mm[1] - result.x_mm[0]) * float(result.y_mm[1] - result.y_mm[0])
    force_n = result.pressure_kpa.sum() * cell_mm2 * 1e-3
    assert result.force_n == pytest.approx(force_n, rel=1e-6)


def test_a_sheet_that_deflects_by_its_thickness_stretches() -> None:
    """Span 20, h 1, R 4, d 1: full size F / E = 0.0296, the linear slab's force is 23 % lower."""
    to_depth = load(control="depth", depth_mm=0.999)
    result, spectral = (
        press_neo_hookean(Ball(), SHEET, to_depth, bricks=COARSE),
        press(Ball(), SHEET, to_depth),
    )
    assert result.force_n == pytest.approx(0.0296, rel=0.05)
    assert 0.70 < spectral.force_n / result.force_n < 0.80
    # The face's shape errs by far less than the force: the depth is given.
    error_mm = result.face_z_mm - spectral.face_z_mm
    assert 5e-3 < np.sqrt(np.mean(error_mm**2)) < 20e-3
    np.testing.assert_allclose(result.face_z_mm, result.face_z_mm[:, ::-1], atol=1e-6)
    # The rim's coated edge turns outwards: the span's end shows a point slightly inside of it.
    assert np.abs(result.face_z_mm[[0, -1]]).max() < 5e-3
    assert spectral.validity.warnings != result.validity.warnings == ()


def test_force_control_meets_the_force() -> None:
    with_force = load(control="force", force_n=0.01)
    bricks = Bricks(half=4, contact=1.5, steps=2)
    result = press_neo_hookean(Ball(), SHEET, with_force, bricks=bricks)
    assert result.force_n == pytest.approx(0.01, rel=1e-3)
    linear_depth_mm = press(Ball(), SHEET, with_force).depth_mm
    assert 0.7 < result.depth_mm / linear_depth_mm < 1


def test_preloads_are_refused_in_one_line() -> None:
    with pytest.raises(PressError, match="neither film, back pressure nor weight") as caught:
        press_neo_hookean(Ball(), SHEET, load(control="depth", depth_mm=0.3, back_pressure_kpa=1.0))
    assert "\n" not in str(caught.value)


def test_a_sheet_may_travel_farther_than_it_is_thick() -> None:
    """Solid elements have no such limit; a pad on its window has it."""
    deep = load(control="depth", depth_mm=1.4)
    bricks = Bricks(half=4, contact=1.5, steps=2)
    result = press_neo_hookean(Ball(), SHEET, deep, bricks=bricks)
    linear = press(Ball(), SHEET, deep, any_depth=True)
    # The tension of the bent sheet, which the linear slab neglects, is about 50 % of it.
    assert 0.5 < linear.force_n / result.force_n < 0.7
    assert result.face_z_mm.max() == pytest.approx(1.4, abs=0.05)
    pad = SHEET.model_copy(update={"layout": "contact_face"})
    with pytest.raises(PressError, match="not less than the slab's thickness"):
        press_neo_hookean(Ball(), pad, deep, bricks=bricks)
