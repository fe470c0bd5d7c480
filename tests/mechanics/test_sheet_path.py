"""The way to a press: what its stops may cost, which cells it goes through, where it ends."""

import numpy as np
import pytest

from tests.mechanics.sheets import EXACT, bar, build_sheet, laws, pressed, strip
from twin.config.models import Ball
from twin.mechanics.errors import SolverError
from twin.mechanics.sheet import press
from twin.mechanics.sheet.case import SheetCase
from twin.mechanics.sheet.equilibrium import Accuracy, Sheet, SheetState
from twin.mechanics.sheet.path import Loads, follow
from twin.mechanics.sheet.splines import SplineLine

MOST_STEPS_ON_THE_WAY = 20


def slack_strip() -> Sheet:
    """A strip of 0.06 mm over sharp edges: hardly stretched, it slips from point to point."""
    return strip(laws(0.06), bar(4.0, 0.05), SplineLine(np.linspace(-10.0, 10.0, 81)))


def test_stops_on_the_way_take_few_steps_and_the_end_is_an_equilibrium() -> None:
    sheet, stops = slack_strip(), list[SheetState]()
    end = follow(sheet, Loads(1.0), EXACT, stops)
    taken = np.diff([0, *(stop.steps for stop in stops)])
    assert len(stops) == 5
    assert taken.max() <= MOST_STEPS_ON_THE_WAY
    sheet.evaluate(end.control_mm, end, tangent=False)
    assert np.abs(sheet.forces()).max() < 1e-3


def test_what_is_still_going_down_is_refused_or_taken() -> None:
    sheet = slack_strip()
    start = follow(sheet, Loads(0.2), Accuracy())
    moved = SheetState(start.control_mm, start.grip, travel_mm=0.6)
    before = sheet.evaluate(moved.control_mm, moved, tangent=False).energy
    with pytest.raises(SolverError, match=r"no equilibrium at 0.6 mm of travel"):
        sheet.settle(moved, Accuracy(most_steps=2))
    taken = sheet.settle(moved, Accuracy(most_steps=2, strict=False))
    assert taken.steps == moved.steps + 2
    assert sheet.evaluate(taken.control_mm, taken, tangent=False).energy < before


def test_a_step_that_is_far_too_short_is_made_longer() -> None:
    sheet = slack_strip()
    state = follow(sheet, Loads(0.2), Accuracy())
    state = SheetState(state.control_mm, state.grip, travel_mm=0.4)
    now = sheet.evaluate(state.control_mm, state, tangent=True)
    forces = sheet.forces()
    step = -1e-6 * sheet._spread(forces) / np.abs(forces).max()
    slope = float(forces @ step[sheet.grid.free])
    share, new = sheet._search(step, slope, now, state, convex=False)
    assert share >= 4
    assert new.energy < now.energy + 3 * slope


@pytest.mark.parametrize(
    ("thickness_mm", "asked_mm", "most_cells", "pitches_mm"),
    [
        (0.2, None, 36_000, [0.4, 0.15]),
        # More than three times finer than the coarse ones: some between them.
        (0.1, None, 36_000, [0.4, (0.4 * 0.075) ** 0.5, 0.075]),
        # A large contact has wider cells, unless they are asked for.
        (0.2, None, 400, [0.4, None]),
        (0.2, 0.3, 400, [0.4, 0.3]),
    ],
)
def test_cells_follow_from_thickness_and_contact(
    monkeypatch: pytest.MonkeyPatch,
    thickness_mm: float,
    asked_mm: float | None,
    most_cells: int,
    pitches_mm: list[float | None],
) -> None:
    found: list[float] = []
    boxes: list[tuple[float, float, float, float]] = []
    made: list[Sheet] = []
    make = SheetCase.sheet

    def seen(
        case: SheetCase, pitch: float, rim: float, box: tuple[float, float, float, float]
    ) -> Sheet:
        found.append(pitch)
        boxes.append(box)
        made.append(make(case, pitch, rim, box))
        return made[-1]

    monkeypatch.setattr(SheetCase, "sheet", seen)
    monkeypatch.setattr(press, "_MOST_CELLS", most_cells)
    press.forget_paths()
    sheet = build_sheet(thickness_mm=thickness_mm, length_x_mm=8.0, length_y_mm=8.0)
    pressed(Ball(diameter_mm=4.0), sheet, depth_mm=0.2, cell_mm=asked_mm)
    west, east, south, north = boxes[-1]
    widest = np.sqrt((east - west) * (north - south) / most_cells)
    assert found == pytest.approx([widest if one is None else one for one in pitches_mm])
    stiffness = 300.0 / 0.75 / (0.25 * thickness_mm)
    assert made[-1].laws.contact_stiffness == pytest.approx(stiffness)
    on_the_way = [300.0 / 0.75 / (0.5 * pitch) for pitch in found[:-1]]
    assert [one.laws.contact_stiffness for one in made[:-1]] == pytest.approx(on_the_way)
