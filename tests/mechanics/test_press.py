"""The whole press: invariants, orientation, grids, back pressure and refusals."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from twin.config.models import Ball, Elastomer, Press, Specimen, TwoBalls
from twin.mechanics import PressedElastomer, PressError, press
from twin.specimens import height_above_lowest

SlabBuilder = Callable[..., Elastomer]

# Coarse: the invariants hold on any grid.
COARSE = {"solver_pitch_mm": 0.25, "relief_pitch_mm": 0.05}


def to_depth(depth_mm: float, **pitches: float) -> Press:
    return Press.model_validate({"control": "depth", "depth_mm": depth_mm} | pitches)


def with_force(force_n: float, **pitches: float) -> Press:
    return Press.model_validate({"control": "force", "force_n": force_n} | pitches)


def gap_mm(pressed: PressedElastomer, specimen: Specimen, slab: Elastomer) -> NDArray[np.float64]:
    height = height_above_lowest(specimen, pressed.x_mm, pressed.y_mm)
    return pressed.touched_face_mm + slab.thickness_mm + height - pressed.depth_mm


def cell_area_mm2(pressed: PressedElastomer) -> float:
    return float((pressed.x_mm[1] - pressed.x_mm[0]) * (pressed.y_mm[1] - pressed.y_mm[0]))


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    specimen=st.builds(
        TwoBalls,
        x_mm=st.floats(-2, 2),
        yaw_deg=st.floats(-180, 180),
        tilt_deg=st.floats(-4, 4),
    ),
    depth_mm=st.floats(0.3, 1.2),
    thickness_mm=st.floats(1.5, 4),
    nu=st.floats(0.3, 0.4999),
)
def test_contact_conditions_hold_for_any_press(
    specimen: TwoBalls, depth_mm: float, thickness_mm: float, nu: float
) -> None:
    slab = Elastomer(
        thickness_mm=thickness_mm, length_x_mm=22, length_y_mm=21, shore_a=10, poisson_ratio=nu
    )
    pressed = press(specimen, slab, to_depth(depth_mm, **COARSE))
    gap = gap_mm(pressed, specimen, slab)
    assert pressed.converged
    assert pressed.pressure_kpa.min() >= 0
    assert gap.min() >= -1e-4 * depth_mm
    assert np.abs(gap[pressed.contact]).max() <= 1e-4 * depth_mm
    force_n = pressed.pressure_kpa.sum() * cell_area_mm2(pressed) * 1e-3
    assert pressed.force_n == pytest.approx(force_n, rel=1e-6)
    np.testing.assert_array_equal(pressed.contact, pressed.pressure_kpa > 0)


@settings(max_examples=8, deadline=None, derandomize=True)
@given(depth_mm=st.floats(0.3, 1.2), y_mm=st.floats(-3, 3))
def test_force_control_inverts_depth_control(depth_mm: float, y_mm: float) -> None:
    slab = Elastomer(thickness_mm=3, length_x_mm=18, length_y_mm=18, shore_a=10, poisson_ratio=0.49)
    there = press(Ball(y_mm=y_mm), slab, to_depth(depth_mm, **COARSE))
    back = press(Ball(y_mm=y_mm), slab, with_force(there.force_n, **COARSE))
    assert back.force_n == pytest.approx(there.force_n, rel=1e-6)
    assert back.depth_mm == pytest.approx(depth_mm, rel=1e-3)
    np.testing.assert_allclose(back.face_z_mm, there.face_z_mm, atol=1e-3 * depth_mm)


def test_two_balls_press_symmetrically(slab: SlabBuilder) -> None:
    pressed = press(TwoBalls(), slab(length_x_mm=24), to_depth(0.8))
    for field in (pressed.pressure_kpa, pressed.face_z_mm):
        np.testing.assert_allclose(field, field[:, ::-1], atol=1e-5 * field.max())
        np.testing.assert_allclose(field, field[::-1], atol=1e-5 * field.max())


@pytest.mark.parametrize(("x_mm", "y_mm"), [(4.0, 0.0), (0.0, 4.0), (-4.0, 3.0)])
def test_the_bulge_lies_where_the_ball_is(slab: SlabBuilder, x_mm: float, y_mm: float) -> None:
    elastomer = slab(length_x_mm=24, thickness_mm=2)
    pressed = press(Ball(x_mm=x_mm, y_mm=y_mm), elastomer, to_depth(0.8, **COARSE))
    weight = pressed.pressure_kpa / pressed.pressure_kpa.sum()
    centre = (weight.sum(axis=0) @ pressed.x_mm, weight.sum(axis=1) @ pressed.y_mm)
    # The bent slab leans away from the middle and touches the ball on its outer side.
    assert centre == pytest.approx((x_mm, y_mm), abs=0.3)
    row, col = np.unravel_index(pressed.face_z_mm.argmax(), pressed.face_z_mm.shape)
    # The bent slab leans its summit towards the middle of the span.
    assert pressed.face_x_mm[col] == pytest.approx(x_mm, abs=1.0)
    assert pressed.face_y_mm[row] == pytest.approx(y_mm, abs=1.0)
    assert pressed.face_z_mm.max() > 0


def test_mirrored_specimens_give_mirrored_faces(slab: SlabBuilder) -> None:
    one, other = (
        press(TwoBalls(yaw_deg=yaw, tilt_deg=tilt), slab(), to_depth(0.8, **COARSE))
        for yaw, tilt in ((30.0, 3.0), (150.0, 3.0))
    )
    np.testing.assert_allclose(one.face_z_mm, other.face_z_mm[:, ::-1], atol=1e-5)


def test_the_lifted_ball_presses_harder(slab: SlabBuilder) -> None:
    pressed = press(TwoBalls(tilt_deg=2.0), slab(), to_depth(0.8, **COARSE))
    right = pressed.pressure_kpa[:, pressed.x_mm > 0].sum()
    assert right > 1.5 * pressed.pressure_kpa[:, pressed.x_mm < 0].sum()


def test_shape_does_not_depend_on_the_modulus_and_force_is_proportional(
    slab: SlabBuilder,
) -> None:
    soft, hard = (
        press(Ball(), slab(young_modulus_kpa=kpa), to_depth(0.6, **COARSE)) for kpa in (100, 250)
    )
    np.testing.assert_array_equal(soft.face_z_mm, hard.face_z_mm)
    assert hard.force_n == pytest.approx(2.5 * soft.force_n, rel=1e-12)


def test_force_grows_with_depth_and_softness_deepens_a_press_by_force(slab: SlabBuilder) -> None:
    forces = [press(Ball(), slab(), to_depth(d, **COARSE)).force_n for d in (0.3, 0.6, 0.9)]
    assert forces == sorted(forces)
    depths = [
        press(Ball(), slab(young_modulus_kpa=kpa), with_force(0.3, **COARSE)).depth_mm
        for kpa in (1000, 600)
    ]
    assert depths[0] < depths[1]


def test_hardness_sets_the_modulus_when_none_is_measured(slab: SlabBuilder) -> None:
    pressed = press(Ball(), slab(young_modulus_kpa=None), to_depth(0.5, **COARSE))
    assert pressed.young_modulus_kpa == pytest.approx(413, abs=1)  # Shore 10 A by Gent


def test_halving_the_solver_pitch_moves_the_face_by_less_than_a_micrometre(
    slab: SlabBuilder, reference_press: PressedElastomer
) -> None:
    fine = press(Ball(), slab(), to_depth(1.0, solver_pitch_mm=0.04))
    assert np.abs(fine.face_z_mm - reference_press.face_z_mm).max() < 1e-3
    assert fine.force_n == pytest.approx(reference_press.force_n, rel=1e-3)


def test_relief_grid_covers_the_slab_to_its_rim(reference_press: PressedElastomer) -> None:
    pressed = reference_press
    assert pressed.face_z_mm.shape == (pressed.face_y_mm.size, pressed.face_x_mm.size)
    assert (pressed.face_x_mm[0], pressed.face_x_mm[-1]) == (-10, 10)
    assert np.diff(pressed.face_x_mm).max() <= 0.04 + 1e-12
    for rim in (pressed.face_z_mm[0], pressed.face_z_mm[:, -1]):
        assert not rim.any()
    assert pressed.pressure_kpa.shape == (pressed.y_mm.size, pressed.x_mm.size)
    assert np.diff(pressed.x_mm).max() <= 0.08 + 1e-12


def test_back_pressure_drapes_the_sheet_between_two_balls(slab: SlabBuilder) -> None:
    elastomer = slab(thickness_mm=2, length_x_mm=24)
    plain, draped = (
        press(TwoBalls(), elastomer, to_depth(0.8, back_pressure_kpa=kpa, **COARSE))
        for kpa in (0.0, 30.0)
    )
    middle, apex = (
        [np.interp(x, p.face_x_mm, p.face_z_mm[p.face_y_mm.size // 2]) for p in (plain, draped)]
        for x in (0.0, 4.0)
    )
    assert middle[0] > apex[0]  # without it the slab bends into one hump
    assert middle[1] < apex[1] - 0.2
    gap = gap_mm(draped, TwoBalls(), elastomer)
    assert gap.min() >= -1e-4
    assert draped.force_n > plain.force_n


def test_validity_of_the_reference_press_has_no_warning(
    reference_press: PressedElastomer,
) -> None:
    validity = reference_press.validity
    assert validity.warnings == ()
    assert validity.depth_over_thickness == validity.depth_over_radius == 0.25
    # Neo-Hookean reference: the face's peak errs by 17 to 20 um.
    assert validity.height_error_mm == pytest.approx(0.02, abs=0.005)
    assert 8 < validity.margin_mm < 9.5


def test_a_harsh_press_is_flagged(slab: SlabBuilder) -> None:
    elastomer = slab(thickness_mm=2.0)
    pressed = press(Ball(x_mm=7, diameter_mm=4), elastomer, to_depth(1.2, **COARSE))
    said = " ".join(pressed.validity.warnings)
    for part in ("of the thickness", "of the ball's radius", "rim", "cells wide"):
        assert part in said
    assert pressed.validity.height_error_mm > 0.04


@pytest.mark.parametrize(
    ("specimen", "changes", "load", "message"),
    [
        (TwoBalls(), {"length_x_mm": 14.0}, to_depth(0.5), "length_x_mm"),
        (Ball(y_mm=7.0), {}, to_depth(0.5), "length_y_mm"),
        (Ball(y_mm=70.0), {}, to_depth(0.5), "move the specimen"),
        (Ball(), {"thickness_mm": 1.0}, to_depth(1.0), "thickness of 1 mm"),
        (Ball(), {}, with_force(50.0, **COARSE), "50 N needs a depth of"),
        (Ball(), {}, to_depth(1e-5), "solver_pitch_mm"),
        (Ball(), {"thickness_mm": 0.02}, to_depth(0.01), "300 times the thickness"),
        (
            Ball(diameter_mm=2),
            {"thickness_mm": 8},
            to_depth(3.0, **COARSE),
            "widest outline",
        ),
    ],
)
def test_impossible_presses_are_refused_in_one_line(
    slab: SlabBuilder, specimen: Specimen, changes: dict[str, float], load: Press, message: str
) -> None:
    with pytest.raises(PressError, match=message) as caught:
        press(specimen, slab(**changes), load)
    assert "\n" not in str(caught.value)
