"""Sheets under pressure by nested iteration: the same equilibrium as by load steps."""

import numpy as np
import pytest

from tests.mechanics.sheets import EXACT, FINE, ball, build_sheet, laws, pressed, round_sheet
from twin.mechanics.errors import SolverError
from twin.mechanics.sheet import press
from twin.mechanics.sheet.energy import Bodies, Sheet
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
