"""Sheets under pressure by nested iteration: the same equilibrium as by load steps."""

from typing import Any

import numpy as np
import pytest

from tests.mechanics.sheets import EXACT, FINE, ball, build_sheet, laws, pressed, round_sheet
from twin.config.models import Mechanics, Press
from twin.mechanics.errors import SolverError
from twin.mechanics.sheet import press
from twin.mechanics.sheet.damping import Damping
from twin.mechanics.sheet.energy import Bodies, Sheet, SheetState
from twin.mechanics.sheet.equilibrium import _Descent
from twin.mechanics.sheet.linear_solver import Banded, _Refined
from twin.mechanics.sheet.nested import descended, taut_mm
from twin.mechanics.sheet.path import Loads, follow, mounted
from twin.mechanics.sheet.splines import SplineLine
from twin.specimens.kinds.ball import Ball


def grids(bodies: Bodies, half_mm: float = 6.0) -> list[Sheet]:
    """Return a round sheet of 0.3 mm on 10, 20 and 40 cells across."""
    lines = [SplineLine(np.linspace(-half_mm, half_mm, cells + 1)) for cells in (10, 20, 40)]
    sheets = [round_sheet(laws(0.3), bodies, line) for line in lines]
    for sheet in sheets:
        sheet.cell_mm = 2 * half_mm / sheet.grid.x.cells
    return sheets


def test_nested_iteration_reaches_the_equilibrium_of_the_load_path() -> None:
    goal = Loads(0.8, 2.0)
    sheets = grids(ball(3.0))
    nested = descended(sheets, goal, EXACT).control_mm
    by_path = follow(sheets[-1], goal, EXACT).control_mm
    assert 1e3 * np.abs(nested - by_path).max() < 1e-3


def test_a_sheet_starts_above_the_bodies_and_from_its_rim() -> None:
    """Over a ball the hull is a cone with a straight line from the rim to the ball."""
    sheet = grids(ball(2.0))[-1]
    place = taut_mm(sheet, 1.5)
    assert (place[~sheet.grid.free[..., 2], 2] == 0).all()
    distance = sheet.touch(place[:, :, None], 1.5).distance_mm.min()
    assert distance > 0.15 - 0.02  # half the thickness, less the chord between control points
    along = place[21, :, 2]
    assert along.max() == pytest.approx(1.5, abs=0.02)
    assert (np.diff(along, 2)[2:-2] < 0.02).all()  # no valley


def test_a_mounted_sheet_starts_flat() -> None:
    sheet = grids(ball(2.0))[0]
    np.testing.assert_array_equal(taut_mm(sheet, 0.0), mounted(sheet.grid).control_mm)


def test_a_deep_travel_leaves_no_body_above_the_sheet() -> None:
    """At this travel the ball is above the plane of the mounted sheet as a whole."""
    goal = Loads(3.0, 1.0)
    sheets = grids(ball(1.2), half_mm=10.0)
    state = descended(sheets, goal, FINE)
    middle = state.control_mm[20:22, 20:22, 2]
    assert (middle > 2.85).all()


def test_a_smooth_press_factorises_at_most_twice_on_its_finest_cells(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The finest cells start near their equilibrium, and later tangents use the first factors."""
    factorised: list[int] = []
    factorise = Sheet.factorise

    def counted(sheet: Sheet, viscosity: float) -> bool:
        factorised.append(int(sheet.grid.free.sum()))
        return factorise(sheet, viscosity)

    monkeypatch.setattr(Sheet, "factorise", counted)
    sheet = build_sheet(thickness_mm=0.3)
    loads = {"depth_mm": 0.6, "back_pressure_kpa": 2.0, "cell_mm": 0.2}
    press.forget_paths()
    result = pressed(Ball(), sheet, **loads)
    finest = max(factorised)
    assert finest > 10_000
    assert factorised.count(finest) <= 2
    # Newton's method with new factors for every tangent: the same equilibrium.
    monkeypatch.setattr(_Refined, "keeps_factors", False)
    press.forget_paths()
    before = len(factorised)
    exact = pressed(Ball(), sheet, **loads)
    assert factorised[before:].count(finest) > 2
    assert 1e3 * np.abs(result.face_z_mm - exact.face_z_mm).max() < 0.01
    assert result.force_n == pytest.approx(exact.force_n, rel=1e-5)


def test_kept_factors_do_not_keep_a_tangent_convex(monkeypatch: pytest.MonkeyPatch) -> None:
    """Convex tangents, with which Newton's method is linear, are for a stated number of steps."""
    monkeypatch.setattr(Banded, "keeps_factors", True)
    sheet = grids(ball(3.0))[1]
    descent = _Descent(sheet, descended([sheet], Loads(0.8, 2.0), FINE), FINE)
    descent.damping = Damping(convex_steps=3, last_convex_steps=3)
    descent.move(descent.control_mm + 1e-3 * np.where(sheet.grid.free, descent.control_mm, 0.0))
    steps = []
    for _ in range(5):
        convex = descent.damping.convex
        descent.descend()
        steps.append((convex, descent.kept))
    assert steps == [(True, False), (True, True), (True, True), (False, True), (False, True)]


def test_coarse_cells_place_the_sheet_as_the_finest_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under pressure a clamped sheet bends within half its thickness of the rim.

    Without narrow cells at the rim the coarse sheet is 0.1 mm higher than the finest one.
    """
    starts: list[np.ndarray] = []
    begun = press._begun

    def recorded(*data: Any) -> tuple[Sheet, SheetState]:
        fine, state = begun(*data)
        starts.append(fine.surface(state.control_mm)[..., 0, 2])
        return fine, state

    monkeypatch.setattr(press, "_begun", recorded)
    sheet = build_sheet(thickness_mm=0.2)
    press.forget_paths()
    load = Press.model_validate(
        {"control": "depth", "depth_mm": 0.8, "back_pressure_kpa": 2.0, "cell_mm": 0.25}
    )
    settled = press.settled_sheet(Ball(), sheet, load, Mechanics(model="sheet"))
    end = settled.sheet.surface(settled.state.control_mm)[..., 0, 2]
    assert np.abs(end - starts[-1]).max() < 0.03


def test_a_sheet_without_nested_equilibrium_follows_the_load_path(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def failed(*_: object) -> None:
        raise SolverError("sheet: no direction lowers its energy")

    sheet = build_sheet(thickness_mm=0.3, length_x_mm=8.0, length_y_mm=8.0)
    loads = {"depth_mm": 0.4, "back_pressure_kpa": 1.0, "cell_mm": 0.3}
    press.forget_paths()
    usual = pressed(Ball(diameter_mm=4.0), sheet, **loads)
    monkeypatch.setattr(press, "descended", failed)
    by_path = pressed(Ball(diameter_mm=4.0), sheet, **loads)
    assert 1e3 * np.abs(by_path.face_z_mm - usual.face_z_mm).max() < 0.5
    assert by_path.force_n == pytest.approx(usual.force_n, rel=1e-3)
