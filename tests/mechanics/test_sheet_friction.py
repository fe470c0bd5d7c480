"""Coulomb friction of the thin sheet: closed forms, its two limits, and its energy balance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pydantic import ValidationError

from tests.mechanics.sheets import (
    FINE,
    ball,
    build_sheet,
    laws,
    line,
    pressed,
    rod,
    round_sheet,
    strip,
)
from twin.config.models import Mechanics, Press
from twin.mechanics import PressError
from twin.mechanics.sheet.energy import Bodies, Sheet, SheetState
from twin.mechanics.sheet.equilibrium import Accuracy, settle
from twin.mechanics.sheet.grid import Frame, sheet_grid
from twin.mechanics.sheet.neighbour import Neighbourhood
from twin.mechanics.sheet.path import Loads, follow, mounted
from twin.mechanics.sheet.press import settled_sheet
from twin.specimens.distance import plate
from twin.specimens.kinds.ball import Ball

CLOSE = Accuracy(step_mm=1e-5, residual_kpa=1e-4)


def dragged(sheet: Sheet, state: SheetState, by_mm: float) -> SheetState:
    """Return the equilibrium after the rim has moved along x over the specimen."""
    moved = state.control_mm + np.array([by_mm, 0.0, 0.0])
    return settle(sheet, replace(state, control_mm=moved), CLOSE)


def rim_forces(sheet: Sheet, state: SheetState) -> np.ndarray:
    """Return the forces (row + 2, col + 2, xyz) of the rim on the sheet, mN."""
    sheet.evaluate(state.control_mm, state, tangent=False)
    return np.where(sheet.grid.free, 0.0, sheet._forces)


def on_a_plate(coefficient: float, pressure_kpa: float) -> tuple[Sheet, SheetState]:
    """Return a sheet of 6 x 4 mm under pressure on a plate that it touches everywhere."""
    grid = sheet_grid(Frame(6.0, 4.0), line(3.0, 3.0, 0.5), line(2.0, 2.0, 0.5))
    sheet = Sheet(grid, laws(0.3), Bodies((plate(0.0),)), -0.15, True)
    sheet.friction_coefficient = coefficient
    return sheet, settle(sheet, replace(mounted(grid), pressure_kpa=pressure_kpa), CLOSE)


def normal_force(sheet: Sheet, state: SheetState) -> float:
    """Return the force of air on the plate, mN: what the rim does not carry."""
    area = float(sheet.grid.rest.area_mm2.sum())
    return state.pressure_kpa * area - float(rim_forces(sheet, state)[..., 2].sum())


def test_a_dragged_sheet_slips_at_the_coefficient_times_its_load() -> None:
    sheet, state = on_a_plate(0.4, 2.0)
    stuck = dragged(sheet, state, 1e-4)
    assert 0 < rim_forces(sheet, stuck)[..., 0].sum() < 0.02 * normal_force(sheet, stuck)
    for by_mm, sign in ((0.05, 1.0), (-0.15, -1.0)):
        state = dragged(sheet, state, by_mm)
        drag = float(rim_forces(sheet, state)[..., 0].sum())
        assert drag == pytest.approx(sign * 0.4 * normal_force(sheet, state), rel=1e-3)


@pytest.mark.parametrize("coefficient", [0.1, 0.3])
def test_a_strip_dragged_over_a_rod_has_the_tensions_of_a_belt(coefficient: float) -> None:
    """Euler and Eytelwein: ratio of tensions exp(coefficient times wrapped angle)."""
    sheet = strip(laws(0.1), rod(3.0), line(6.0, 3.5, 0.2), True)
    sheet.friction_coefficient = coefficient
    state = follow(sheet, Loads(1.5), CLOSE)
    for by_mm in (0.05, 0.05, 0.05, 0.01):
        state = dragged(sheet, state, by_mm)
    of_rim = rim_forces(sheet, state)
    left, right = of_rim[:, :2].sum(axis=(0, 1)), of_rim[:, -2:].sum(axis=(0, 1))
    angle = np.arctan2(-left[2], -left[0]) + np.arctan2(-right[2], right[0])
    ratio = np.hypot(right[0], right[2]) / np.hypot(left[0], left[2])
    assert angle > 0.5
    assert np.log(ratio) == pytest.approx(coefficient * angle, rel=0.01)


def test_the_work_of_dragging_is_stored_or_dissipated() -> None:
    """Friction never does work on the sheet, at any point and in any step."""
    sheet, state = on_a_plate(0.4, 2.0)
    area = sheet.grid.rest.area_mm2
    work = dissipated = 0.0
    first = sheet.evaluate(state.control_mm, state, tangent=False).energy
    pull = 0.0
    for _ in range(12):
        before, state, by_mm = state, dragged(sheet, state, 2e-3), 2e-3
        last, pull = pull, float(rim_forces(sheet, state)[..., 0].sum())
        work += by_mm * (last + pull) / 2
        slip = state.grip.anchor_mm - before.grip.anchor_mm
        slip = np.where((state.grip.held * before.grip.held)[..., None] > 0, slip, 0.0)
        traction = sheet.friction(sheet.surface(state.control_mm), state).traction_kpa
        lost = -(traction * slip).sum(axis=-1)
        assert lost.min() >= -1e-12
        dissipated += float((lost * area).sum())
    stored = sheet.evaluate(state.control_mm, state, tangent=False).energy - first
    assert dissipated > 0.5 * work
    assert stored + dissipated == pytest.approx(work, rel=0.02)


@cache
def wrapped(coefficient: float, *, sticks: bool = True) -> tuple[Sheet, SheetState]:
    """Return a round sheet pressed over a ball, then by air on it."""
    sheet = round_sheet(laws(0.2), ball(3.0), line(4.0, 2.0, 0.5), sticks)
    sheet.friction_coefficient = coefficient
    return sheet, follow(sheet, Loads(1.0, 2.0), FINE)


def test_little_friction_is_none_and_much_is_stick() -> None:
    free, stuck = wrapped(np.inf, sticks=False)[1], wrapped(np.inf)[1]

    def moved_mm(coefficient: float) -> float:
        return float(np.abs(wrapped(coefficient)[1].control_mm - free.control_mm).max())

    assert moved_mm(0.0) < 1e-6
    assert 0.01 < moved_mm(0.3) < 0.03 < moved_mm(1e3)
    # Sheets that stick have their anchors where an iteration first touches.
    np.testing.assert_allclose(wrapped(1e3)[1].control_mm, stuck.control_mm, atol=2e-3)


def test_friction_is_at_most_the_coefficient_times_the_pressure() -> None:
    sheet, state = wrapped(0.3)
    surface = sheet.surface(state.control_mm)
    gap = sheet.gap_mm(surface, sheet.touch(surface[..., 0, :], state.travel_mm)).min(axis=0)
    pressure = sheet.laws.contact_stiffness * np.maximum(-gap, 0.0)
    traction = np.linalg.norm(sheet.friction(surface, state).traction_kpa, axis=-1)
    assert (traction <= 0.3 * pressure + FINE.residual_kpa).all()
    touching = pressure > 0.1
    at_limit = traction[touching] > 0.297 * pressure[touching]
    assert 0.3 < at_limit.mean() < 1.0


# ---- the product -----------------------------------------------------------------------------


def test_a_press_with_friction_is_between_free_and_stuck() -> None:
    """On coarse and fine cells; without friction it has the bytes of friction = "none"."""
    load = {"depth_mm": 0.6, "back_pressure_kpa": 2.0}

    def tip_mm(**friction: object) -> float:
        sheet = build_sheet(thickness_mm=0.2, length_x_mm=8.0, length_y_mm=8.0, **friction)
        return float(pressed(Ball(diameter_mm=4.0), sheet, **load).face_z_mm.max())

    free, stuck = tip_mm(friction="none"), tip_mm(friction="stick")
    assert tip_mm(friction_coefficient=0.0) == free
    assert free + 0.002 < tip_mm(friction_coefficient=0.1) < stuck - 0.002
    # 7 um: stated uncertainty of a sheet that sticks.
    assert tip_mm(friction_coefficient=10.0) == pytest.approx(stuck, abs=0.007)


def test_a_specimen_without_a_derivative_names_the_key() -> None:
    elastomer = build_sheet(
        thickness_mm=0.2, length_x_mm=8.0, length_y_mm=8.0, friction_coefficient=0.1
    )
    load = Press(control="depth", depth_mm=0.2, back_pressure_kpa=1.0, cell_mm=0.3)
    settled = settled_sheet(Ball(diameter_mm=4.0), elastomer, load, Mechanics(model="sheet"))
    with pytest.raises(PressError, match=r"elastomer\.friction_coefficient: found 0\.1"):
        Neighbourhood(settled)


@pytest.mark.parametrize(
    ("values", "sticks", "largest"),
    [
        ({}, False, 0.0),
        ({"friction": "stick"}, True, np.inf),
        ({"tack_j_m2": 0.1}, True, np.inf),
        ({"tack_j_m2": 0.1, "friction_coefficient": 0.5}, True, 0.5),
        ({"friction_coefficient": 0.0}, False, 0.0),
    ],
)
def test_a_coefficient_replaces_the_choice(
    values: dict[str, object], sticks: bool, largest: float
) -> None:
    elastomer = build_sheet(**values)
    assert (elastomer.sticks, elastomer.largest_friction) == (sticks, largest)
    assert ("friction_coefficient" in elastomer.model_dump()) is ("friction_coefficient" in values)


@pytest.mark.parametrize("choice", ["none", "stick"])
def test_a_coefficient_and_a_choice_exclude_each_other(choice: str) -> None:
    with pytest.raises(ValidationError, match=f"found '{choice}': remove one"):
        build_sheet(friction=choice, friction_coefficient=0.3)
