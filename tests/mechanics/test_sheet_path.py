"""Load stepping of a press: Newton steps per load step, its cells, and its end."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.mechanics.sheets import (
    EXACT,
    FINE,
    ball,
    bar,
    build_sheet,
    laws,
    pressed,
    round_sheet,
    strip,
)
from twin.mechanics.errors import PressError, SolverError
from twin.mechanics.sheet import cells, press
from twin.mechanics.sheet.case import Box, Cells, SheetCase
from twin.mechanics.sheet.energy import Evaluation, Sheet, SheetState
from twin.mechanics.sheet.equilibrium import (
    Accuracy,
    _Descent,
    _searched,
    settle,
)
from twin.mechanics.sheet.laws import Grip
from twin.mechanics.sheet.path import Loads, follow
from twin.mechanics.sheet.splines import SplineLine
from twin.specimens.kinds.ball import Ball

MOST_STEPS_ON_THE_WAY = 20


def slack_strip() -> Sheet:
    """A strip of 0.06 mm over sharp edges: hardly stretched, it slips from point to point."""
    return strip(laws(0.06), bar(4.0, 0.05), SplineLine(np.linspace(-10.0, 10.0, 81)))


def test_load_steps_take_few_steps_and_the_end_is_an_equilibrium() -> None:
    sheet, stops = slack_strip(), list[SheetState]()
    end = follow(sheet, Loads(1.0), EXACT, stops)
    taken = np.diff([0, *(stop.steps for stop in stops)])
    assert len(stops) == 5
    assert taken.max() <= MOST_STEPS_ON_THE_WAY
    sheet.evaluate(end.control_mm, end, tangent=False)
    assert np.abs(sheet.forces()).max() < 1e-3


def test_an_unfinished_descent_is_rejected_or_accepted() -> None:
    sheet = slack_strip()
    start = follow(sheet, Loads(0.2), Accuracy())
    moved = SheetState(start.control_mm, start.grip, travel_mm=0.6)
    before = sheet.evaluate(moved.control_mm, moved, tangent=False).energy
    with pytest.raises(SolverError, match=r"no equilibrium at 0.6 mm of travel"):
        settle(sheet, moved, Accuracy(most_steps=2))
    taken = settle(sheet, moved, Accuracy(most_steps=2, strict=False))
    assert taken.steps == moved.steps + 2
    assert sheet.evaluate(taken.control_mm, taken, tangent=False).energy < before


def test_a_step_that_is_far_too_short_is_made_longer() -> None:
    sheet = slack_strip()
    state = follow(sheet, Loads(0.2), Accuracy())
    state = SheetState(state.control_mm, state.grip, travel_mm=0.4)
    descent = _Descent(sheet, state, Accuracy())
    forces = sheet.forces()
    step = np.zeros_like(state.control_mm)
    step[sheet.grid.free] = -1e-6 * forces / np.abs(forces).max()
    slope = float(forces @ step[sheet.grid.free])
    share, new = _searched(descent, step, slope)
    assert share >= 4
    assert new.energy < descent.now.energy + 3 * slope


class ToAndFro:
    """A sheet of one point, for which the whole step leads to as much force on the other side."""

    def __init__(self, force: Callable[[float], float]) -> None:
        self.grid = SimpleNamespace(free=np.ones((1, 1, 3), bool))
        self.force, self.place, self.laws, self.sticks = force, 0.0, laws(0.2), False

    def evaluate(self, control_mm: np.ndarray, _state: object, **_: bool) -> Evaluation:
        self.place = float(control_mm[0, 0, 2])
        return Evaluation(-1905.0, control_mm, np.zeros(0), tangent=True)

    def residuals_kpa(self) -> np.ndarray:
        return np.array([[abs(self.force(self.place))]])


@pytest.mark.parametrize(
    ("force", "share"),
    [
        (lambda z: 1.0 - z, 1.0),  # the step of a smooth law
        (lambda z: 1.0 if z < 0.4 else -1.0 + (z < 0.6), 0.5),
        (lambda z: 1.0 if z < 0.2 else -1.0 + (z < 0.3), 0.25),
        (lambda z: 1.0, 0.25),
    ],
)
def test_a_step_between_two_sides_is_cut(force: Callable[[float], float], share: float) -> None:
    sheet = ToAndFro(force)
    state = SheetState(np.zeros((1, 1, 3)), Grip(*(np.zeros(0) for _ in range(4))))
    descent = _Descent(sheet, state, Accuracy())  # type: ignore[arg-type]
    step = np.array([[[0.0, 0.0, 1.0]]])
    result, new = _searched(descent, step, slope=-1e-9)
    assert result == share
    assert new.control_mm[0, 0, 2] == share


def test_anchors_updated_early_move_a_stuck_sheet_by_little() -> None:
    """Compared with the path itself, which differs by more with half its steps."""
    faces = []
    for anchors_from_mm in (0.0, 0.03):
        sheet = round_sheet(laws(0.2), ball(2.0), SplineLine(np.linspace(-6.0, 6.0, 41)), True)
        early = replace(FINE, anchors_from_mm=anchors_from_mm)
        state = follow(sheet, Loads(0.6, 2.0), FINE)
        moved = replace(state, pressure_kpa=2.4)
        faces.append(settle(sheet, moved, early).control_mm)
    assert 1e3 * np.abs(faces[0] - faces[1]).max() < 0.5


@pytest.mark.parametrize(
    ("thickness_mm", "cell_mm", "most_cells", "pitches_mm"),
    [
        (0.2, None, 36_000, [0.4, 0.15]),
        # More than three times finer than the coarse cells: some of intermediate width.
        (0.1, None, 36_000, [0.4, (0.4 * 0.075) ** 0.5, 0.075]),
        # A large contact has wider cells, unless they are specified.
        (0.2, None, 400, [0.4, None]),
        (0.2, 0.3, 400, [0.4, 0.3]),
        (0.1, 0.2, 36_000, [0.4, 0.28284, 0.2]),
    ],
)
def test_cells_follow_from_thickness_and_contact(
    monkeypatch: pytest.MonkeyPatch,
    thickness_mm: float,
    cell_mm: float | None,
    most_cells: int,
    pitches_mm: list[float | None],
) -> None:
    result: list[float] = []
    boxes: list[Box] = []
    made: list[Sheet] = []
    make = SheetCase.sheet

    def recorded(case: SheetCase, requested: Cells) -> Sheet:
        result.append(requested.pitch_mm)
        boxes.append(requested.box_mm)
        made.append(make(case, requested))
        return made[-1]

    monkeypatch.setattr(SheetCase, "sheet", recorded)
    monkeypatch.setattr(cells, "_MOST_CELLS", most_cells)
    press.forget_paths()
    sheet = build_sheet(thickness_mm=thickness_mm, length_x_mm=8.0, length_y_mm=8.0)
    pressed(Ball(diameter_mm=4.0), sheet, depth_mm=0.2, cell_mm=cell_mm)
    west, east, south, north = boxes[-1]
    widest = np.sqrt((east - west) * (north - south) / most_cells)
    assert result == pytest.approx(
        [widest if value is None else value for value in pitches_mm], rel=1e-4
    )
    stiffness = 300.0 / 0.75 / (0.25 * thickness_mm)
    assert made[-1].laws.contact_stiffness == pytest.approx(stiffness)
    on_the_way = [300.0 / 0.75 / (0.5 * pitch) for pitch in result[:-1]]
    assert [value.laws.contact_stiffness for value in made[:-1]] == pytest.approx(on_the_way)


def test_cells_are_wider_where_the_rim_adds_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a limit on control points the finest cells are the narrowest, in steps, that keep it."""
    sizes: list[int] = []
    widths: list[float] = []
    make = SheetCase.sheet

    def recorded(case: SheetCase, requested: Cells) -> Sheet:
        sheet = make(case, requested)
        sizes.append(sheet.grid.x.size * sheet.grid.y.size)
        widths.append(requested.pitch_mm)
        return sheet

    monkeypatch.setattr(SheetCase, "sheet", recorded)
    ball, sheet = Ball(diameter_mm=4.0), build_sheet(length_x_mm=8.0, length_y_mm=8.0)
    finest = []
    for most, cell_mm in ((10_000, None), (2_000, None), (2_000, 0.15)):
        monkeypatch.setattr(cells, "_MOST_CONTROLS", most)
        press.forget_paths()
        pressed(ball, sheet, depth_mm=0.2, cell_mm=cell_mm)
        finest.append((sizes[-1], widths[-1]))
    (free, pitch), (limited, wider), (given, _) = finest
    assert free > 2_000, "the limit bites"
    assert 0.8 * 2_000 < limited <= 2_000
    assert wider > pitch == pytest.approx(0.15)
    assert given == free, "specified cells are used"


@pytest.mark.parametrize(
    ("friction", "pressure_kpa", "converges"),
    [("stick", 0.0, True), ("stick", 1.0, False), ("none", 0.0, False)],
)
def test_what_folds_on_cells_between_goes_on_from_the_coarse_ones(
    monkeypatch: pytest.MonkeyPatch, friction: str, pressure_kpa: float, converges: bool
) -> None:
    """Only if it sticks, and the failure reports no limit pressure."""

    def folded(case: SheetCase, coarse: Sheet, state: SheetState) -> tuple[Sheet, SheetState]:
        raise SolverError("sheet: no direction lowers its energy")

    ball = Ball(diameter_mm=4.0)
    sheet = build_sheet(thickness_mm=0.2, length_x_mm=8.0, length_y_mm=8.0, friction=friction)
    loads = {"depth_mm": 0.2, "cell_mm": 0.12, "back_pressure_kpa": pressure_kpa}
    press.forget_paths()
    usual = pressed(ball, sheet, **loads)
    monkeypatch.setattr(press, "_between", folded)
    if not converges:
        with pytest.raises((SolverError, PressError)):
            pressed(ball, sheet, **loads)
        return
    direct = pressed(ball, sheet, **loads)
    assert np.abs(direct.face_z_mm - usual.face_z_mm).max() < 2e-3
