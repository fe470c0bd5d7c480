"""Choose the widths of the cells of a press: fine in the contact, wider where that is sufficient.

Cells are fine in a box round the contact. Within this box they are wider along a direction in which
the sheet does not bend, for example along the edge of a bar. A quadratic spline is accurate if the
direction of the surface changes little over each cell.
"""

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.errors import PressError
from twin.mechanics.sheet.case import Box, Cells, SheetCase
from twin.mechanics.sheet.energy import Sheet, SheetState
from twin.mechanics.sheet.splines import SplineLine, Widths

COARSE_CELL_MM = 0.4
# Width of the cells at the rim over that of the finest.
_RIM = 1 / 3
# Change of the width of coarse cells over distance, from the finest width at a clamped rim: without
# such cells the whole sheet is 0.1 mm too high. Twice as many are no more accurate.
_GROWTH_AT_RIM = 0.5
# Gap of points in the contact's box, and margin round them.
_NEAR_MM, _MARGIN_MM = COARSE_CELL_MM / 2, 1.5
# Most cells in the box of contact, some 90,000 unknowns: more take long. And most control points
# of the sheet, some 230,000 unknowns: more need more than 2 GiB.
_MOST_CELLS, _MOST_CONTROLS = 24_000, 78_000
_WIDENED = 1.02
# Most coarse cells of the load steps: more take minutes for each step. Most cells if specified.
_MOST_COARSE, _MOST_NAMED = 40_000, 4 * _MOST_CONTROLS
# Largest turn of the surface over a wider cell, radians, but at most that over a cell of the pitch
# where it bends most. If that is below the second number, cells do not resolve so light a touch.
_TURN, _LIGHTEST_TURN = 0.1, 0.01
_STRAIGHT = 1e-9


def coarse_cells(case: SheetCase) -> Cells:
    """Return the widths of the cells for the load steps: about `COARSE_CELL_MM`.

    Raises
    ------
    PressError
        The sheet is so large that each load step would take minutes.
    """
    cells = _coarse(case)
    count = _count(case, cells)
    if count > _MOST_COARSE:
        frame = case.frame
        raise PressError(
            f"elastomer.length_x_mm, length_y_mm: found {frame.length_x_mm:g} and "
            f"{frame.length_y_mm:g}, of which a thin sheet takes {count} control points, allowed "
            f"up to {_MOST_COARSE}: each step of the load would take minutes; shorten them to the "
            "camera's field of view"
        )
    return cells


def _coarse(case: SheetCase) -> Cells:
    box = case.shape.bounds_mm()
    if case.sticks or case.laws.tack:  # its equilibrium depends on the cells of the load steps
        return Cells(COARSE_CELL_MM, COARSE_CELL_MM, box)
    rim_mm = min(_RIM * case.cell_mm, COARSE_CELL_MM)
    return Cells(COARSE_CELL_MM, rim_mm, box, growth=_GROWTH_AT_RIM)


def _count(case: SheetCase, cells: Cells) -> int:
    x, y = case.lines(cells)
    return x.size * y.size


def cells_between(case: SheetCase, coarse: Sheet, state: SheetState) -> Cells:
    """Return cells of intermediate width: the geometric mean of the coarse and the finest width.

    `state` is that of the coarse sheet; it gives the contact and the bending.
    """
    box = _contact_box(case, coarse, state)
    pitch_mm = float(np.sqrt(_affordable_mm(case, box) * COARSE_CELL_MM))
    return Cells(pitch_mm, _RIM * pitch_mm, box, _allowed(coarse, state, box, pitch_mm))


def finest_cells(case: SheetCase, coarser: Sheet, state: SheetState, pitch_mm: float) -> Cells:
    """Return cells of width `pitch_mm`, or wider ones if the sheet would have too many in total.

    Cells are not widened if the experiment specifies press.cell_mm.

    Parameters
    ----------
    coarser, state : a sheet on wider cells and its state, which give the contact and the bending

    Raises
    ------
    PressError
        Cells of the specified press.cell_mm take too much memory.
    """
    box = _contact_box(case, coarser, state)
    allowed = _allowed(coarser, state, box, pitch_mm)
    while True:
        cells = Cells(pitch_mm, _RIM * pitch_mm, box, allowed)
        count = _count(case, cells)
        if case.is_cell_specified and count > _MOST_NAMED:
            raise PressError(
                f"press.cell_mm: found {pitch_mm:g}, of which this contact takes {count} control "
                f"points, allowed up to {_MOST_NAMED} (some 8 GB); use wider cells"
            )
        if case.is_cell_specified or count <= _MOST_CONTROLS:
            return cells
        pitch_mm *= _WIDENED


def finest_pitch_mm(case: SheetCase, coarse: Sheet, state: SheetState) -> float:
    """Return the width, mm, of the finest cells in the contact of a coarse sheet.

    It is `case.cell_mm`, or a larger width if the contact would have too many of those cells.
    """
    return _affordable_mm(case, _contact_box(case, coarse, state))


def _affordable_mm(case: SheetCase, box: Box) -> float:
    """Return the width of the finest cells, mm, as `finest_pitch_mm`, for the contact's box."""
    if case.is_cell_specified:
        return case.cell_mm
    west, east, south, north = box
    return max(case.cell_mm, float(np.sqrt((east - west) * (north - south) / _MOST_CELLS)))


def _contact_box(case: SheetCase, sheet: Sheet, state: SheetState) -> Box:
    """Return the box of the mounted sheet, world, mm, that contains the contact and a margin.

    Without contact it is the specimen's bounding box.
    """
    surface = sheet.surface(state.control_mm)
    # With the reach of the sheet alone, which is shorter on narrower cells, the lower limits of
    # distant points would be near.
    touch = sheet.touch(surface[..., 0, :], state.travel_mm, sheet.reach_mm + _NEAR_MM)
    gap = sheet.gap_mm(surface, touch)[: case.parts].min(axis=0)
    near = gap < _NEAR_MM
    if not near.any():
        return case.shape.bounds_mm()
    x, y = sheet.grid.x.points.ravel(), sheet.grid.y.points.ravel()
    rows, cols = near.shape[:2]
    table = near.reshape(rows, cols, 2, 2).transpose(0, 2, 1, 3).reshape(2 * rows, 2 * cols)
    along_x, along_y = x[table.any(axis=0)], y[table.any(axis=1)]
    stretch = case.frame.pre_stretch
    return (
        float(along_x.min() * stretch - _MARGIN_MM),
        float(along_x.max() * stretch + _MARGIN_MM),
        float(along_y.min() * stretch - _MARGIN_MM),
        float(along_y.max() * stretch + _MARGIN_MM),
    )


# ---- wider cells -----------------------------------------------------------------------------


def _allowed(
    sheet: Sheet, state: SheetState, box: Box, pitch_mm: float
) -> tuple[Widths, Widths] | None:
    """Return the largest widths of cells along x and y, from the bending of a coarser sheet.

    The curvature of the coarser sheet's gap to the bodies is used, too, because it includes ridges
    finer than the coarser cells. None for a sheet that sticks or has tack, because the edge of its
    contact moves from point to point. None also for a sheet that hardly bends.
    """
    if sheet.sticks or sheet.laws.tack > 0:
        return None
    stretch = sheet.grid.frame.pre_stretch
    west, east, south, north = (end / stretch for end in box)
    x = _samples(sheet.grid.x, west, east, pitch_mm)
    y = _samples(sheet.grid.y, south, north, pitch_mm)
    sampled = _sampled(sheet, state, x, y)
    along_x, along_y = _bends(sampled, x, y)
    most = pitch_mm * max(bend.max() for bend in _bends(sampled[..., :3], x, y))
    if most < _LIGHTEST_TURN:
        return None
    turn = min(_TURN, most)
    return (
        Widths(x[1:-1], turn / np.maximum(along_x, _STRAIGHT)),
        Widths(y[1:-1], turn / np.maximum(along_y, _STRAIGHT)),
    )


def _samples(line: SplineLine, low_mm: float, high_mm: float, pitch_mm: float) -> FloatArray:
    """Return at least 4 points between `low_mm` and `high_mm` on a line, at most a pitch apart."""
    low, high = max(low_mm, line.edges[0]), min(high_mm, line.edges[-1])
    return np.linspace(low, high, max(4, int(np.ceil((high - low) / pitch_mm)) + 1))


def _sampled(sheet: Sheet, state: SheetState, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return position and gaps of the sheet at points along it, (row, col, 3 + bodies), mm.

    The gap to each body is limited smoothly to `Sheet.reach_mm`.
    """
    surface = sheet.grid.evaluate(state.control_mm, x, y)[:, :, None]
    touch = sheet.touch(surface[..., 0, :], state.travel_mm)
    # Waves of the thickness, some um in some mm, do not change the widths of the cells.
    gaps = np.moveaxis(sheet.gap_mm(surface, touch, 1.0)[..., 0], 0, -1)
    near = sheet.reach_mm * np.tanh(gaps / sheet.reach_mm)
    return np.concatenate((surface[:, :, 0, 0], near), axis=-1)


def _bends(sampled: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the largest second derivative along x at each inner x, and that along y, 1/mm."""
    along_x = np.abs(np.diff(sampled, 2, axis=1)).max(axis=(0, 2)) / (x[1] - x[0]) ** 2
    along_y = np.abs(np.diff(sampled, 2, axis=0)).max(axis=(1, 2)) / (y[1] - y[0]) ** 2
    return along_x, along_y
