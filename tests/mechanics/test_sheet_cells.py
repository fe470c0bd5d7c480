"""Where a sheet's cells may be wider than the pitch, and the effect on the result."""

import numpy as np
import pytest

from tests.mechanics.sheets import build_sheet, pressed
from twin.config.models import Elastomer, Mechanics, Press, Specimen
from twin.mechanics import PressedElastomer
from twin.mechanics.sheet import cells, press
from twin.mechanics.sheet.case import SheetCase, sheet_case
from twin.mechanics.sheet.energy import Sheet
from twin.mechanics.sheet.path import mounted
from twin.mechanics.sheet.splines import Widths, graded_line
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.bar import Bar
from twin.specimens.kinds.grating import Grating
from twin.specimens.kinds.nut import Nut

SMALL = {"length_x_mm": 12.0, "length_y_mm": 12.0}


def test_widths_are_rungs_of_a_ladder_and_grow_by_a_fifth_of_the_distance():
    """1, sqrt 2, 2, 2 sqrt 2 and 4 pitches; away from a place of one pitch 0.2 mm more per mm."""
    allowed = Widths(np.array([0.0, 1.0, 5.0, 9.0]), np.array([0.01, 7.0, 0.29, 7.0]))
    result = allowed.at(np.array([0.0, 0.5, 1.0, 5.0, 9.0]), 0.1)
    np.testing.assert_allclose(result, [0.1, 0.2, 0.3, 0.2 * 2**0.5, 0.4])


def test_a_last_digit_moves_no_cell():
    ends, fine, widths = (-5.0, 5.0), (-4.0, 4.0), np.array([0.1, 0.3, 0.5])
    lines = [
        graded_line(ends, fine, 0.1, 0.1, 1.0, allowed=Widths(np.array([-3.0, 0.0, 3.0]), changed))
        for changed in (widths, widths * (1 + 1e-12), widths * (1 - 1e-12))
    ]
    for line in lines[1:]:
        np.testing.assert_array_equal(line.edges, lines[0].edges)


def test_cells_within_the_box_are_wider_where_they_may():
    """From 0.1 mm at both ends of 8 mm to 0.4 mm: 5 ln 4 = 6.93 cells over 1.5 mm, twice, and 5 mm
    of 0.4 mm, 12.5: 26.36 in all, so 27. An allowance that is nowhere wider has no effect."""
    places = np.linspace(-4.0, 4.0, 801)
    ends = Widths(places, np.where(np.abs(places) > 3.999, 0.1, 9.0))
    line = graded_line((-4.0, 4.0), (-4.0, 4.0), 0.1, 0.1, 1.0, allowed=ends)
    assert line.cells == 27
    assert (line.edges[0], line.edges[-1]) == (-4.0, 4.0)
    np.testing.assert_allclose(line.edges, -line.edges[::-1], atol=1e-9)
    alike = Widths(np.linspace(-4.0, 4.0, 9), np.full(9, 0.12))
    result = graded_line((-5.0, 5.0), (-4.0, 4.0), 0.1, 0.1, 1.0, allowed=alike)
    plain = graded_line((-5.0, 5.0), (-4.0, 4.0), 0.1, 0.1, 1.0)
    np.testing.assert_array_equal(result.edges, plain.edges)


def finest(
    monkeypatch: pytest.MonkeyPatch, specimen: Specimen, elastomer: Elastomer, **load: object
) -> tuple[PressedElastomer, Sheet]:
    """Return the result of a press, and its sheet."""
    made: list[Sheet] = []
    make = SheetCase.sheet

    def recorded(case: SheetCase, requested: cells.Cells) -> Sheet:
        made.append(make(case, requested))
        return made[-1]

    press.forget_paths()
    with monkeypatch.context() as patch:
        patch.setattr(SheetCase, "sheet", recorded)
        result = pressed(specimen, elastomer, **load)
    return result, made[-1]


def test_the_box_of_the_contact_does_not_depend_on_the_reach_of_the_bodies():
    """Beyond the reach a distance is only a lower limit: no point is near because of it.

    The reach is 0.15 mm for a sheet of 0.2 mm, plus the range of the tack, which depends on the
    width of the cells.
    """
    load = Press.model_validate({"control": "depth", "depth_mm": 0.5})
    sheet = build_sheet(thickness_mm=0.2)
    case = sheet_case(Nut(), sheet, load, Mechanics(model="sheet"))
    boxes = []
    for range_mm in (0.0, 1.0):
        grid = case.sheet(cells.Cells(0.5, 0.5, case.shape.bounds_mm()))
        grid.laws = grid.laws._replace(tack_range_mm=range_mm)
        boxes.append(cells._contact_box(case, grid, mounted(grid.grid)))
    assert boxes[0] == boxes[1]
    assert max(boxes[0]) < 8.0


@pytest.mark.parametrize("yaw_deg", [0.0, 2.0])
def test_along_a_bar_cells_are_wider_and_the_face_is_the_same(
    monkeypatch: pytest.MonkeyPatch, yaw_deg: float
):
    """As with even cells, within the effect of even cells of 0.11 mm: 0.5 to 0.6 um (SD)."""
    bar = Bar(width_mm=2.0, height_mm=1.5, length_mm=8.0, yaw_deg=yaw_deg)
    load = {"depth_mm": 0.5, "back_pressure_kpa": 1.0, "cell_mm": 0.15}
    graded, fewer = finest(monkeypatch, bar, build_sheet(**SMALL), **load)
    monkeypatch.setattr(cells, "_TURN", 0.0)
    even, more = finest(monkeypatch, bar, build_sheet(**SMALL), **load)
    assert fewer.grid.y.cells < 0.75 * more.grid.y.cells
    middle = np.abs(fewer.grid.y.points).min(axis=1) < 1.5
    assert np.diff(fewer.grid.y.edges)[middle].min() > 0.4
    section = np.abs(even.face_y_mm) < 1.0
    apart_mm = (graded.face_z_mm - even.face_z_mm)[section]
    assert apart_mm.std() < 2e-3
    assert np.abs(apart_mm).max() < 0.01
    assert graded.force_n == pytest.approx(even.force_n, rel=2e-3)


def test_ridges_that_coarse_cells_do_not_follow_keep_cells_narrow(monkeypatch: pytest.MonkeyPatch):
    """Ridges of 0.03 mm at a pitch of 0.5 mm: cells of 0.4 mm hardly resolve them.

    Where a flank turns from hollow to round it is straight, and a cell may be a little wider.
    """
    ridges = Grating(pitch_mm=0.5, groove_mm=0.03, length_x_mm=1.5, length_y_mm=1.5)
    _, sheet = finest(
        monkeypatch,
        ridges,
        build_sheet(thickness_mm=0.1, length_x_mm=5.0, length_y_mm=5.0),
        depth_mm=0.1,
        back_pressure_kpa=0.5,
        cell_mm=0.1,
    )
    across = np.abs(sheet.grid.x.points).max(axis=1) < 0.65
    assert np.diff(sheet.grid.x.edges)[across].max() < 0.12


def test_a_sheet_that_sticks_has_even_cells(monkeypatch: pytest.MonkeyPatch):
    _, sheet = finest(
        monkeypatch, Ball(), build_sheet(friction="stick", **SMALL), depth_mm=0.2, cell_mm=0.2
    )
    middle = np.abs(sheet.grid.x.points).max(axis=1) < 1.0
    widths_mm = np.diff(sheet.grid.x.edges)[middle]
    assert np.ptp(widths_mm) < 1e-9


def test_a_touch_between_two_samples_is_pressed(monkeypatch: pytest.MonkeyPatch):
    """A contact smaller than the cells, and between the sampled cell centres: no failure."""
    result, sheet = finest(
        monkeypatch, Ball(), build_sheet(**SMALL), depth_mm=0.01, cell_mm=0.2, solver_pitch_mm=0.2
    )
    assert result.force_n > 0.0
    assert not result.contact.any()
    assert np.diff(sheet.grid.x.edges)[np.abs(sheet.grid.x.points).max(axis=1) < 1.0].max() < 0.21
