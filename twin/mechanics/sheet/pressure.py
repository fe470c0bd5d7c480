"""Compute the pressure of specimen and plate on a sheet in equilibrium, on a grid of cells in plan.

The forces on the sheet act at its Gauss points. Each force is distributed over the quarter of a
spline cell that belongs to the Gauss point, and from there to the cells in plan that it covers.
No force is lost, even on an edge narrower than a cell: the sum over the cells is the contact force.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from twin.mechanics.sheet.energy import Sheet, SheetState
from twin.mechanics.sheet.laws import Laws, kernel
from twin.mechanics.sheet.splines import SplineLine
from twin.mechanics.sheet.surface import (
    Points,
    PointWork,
    along_row,
    normal_times_area,
    point_in_row,
    points_on,
    turn,
    work_for,
)

# Parts of the sheet per solver cell, at the stretch of the second number.
_PARTS_PER_CELL, _STRETCHED = 4.0, 1.5


def pressure_on_cells(
    sheet: Sheet, state: SheetState, x_mm: FloatArray, y_mm: FloatArray
) -> FloatArray:
    """Return the upward force of specimen and plate on the sheet per area in plan, (row, col), kPa.

    Without friction and tack it is the contact pressure p, because p n_z dA = p dx dy. The pull of
    tack is included with negative sign, and the vertical part of friction is included.

    Parameters
    ----------
    x_mm, y_mm : (col,) and (row,) middles of cells of equal width, ascending
    """
    steps = x_mm[1] - x_mm[0], y_mm[1] - y_mm[0]
    lifted_mn = lift_kpa(sheet, state) * sheet.grid.rest.area_mm2
    loaded = lifted_mn != 0
    if not loaded.any():
        return np.zeros((y_mm.size, x_mm.size))
    cut_x, cut_y = (
        _cut(line, loaded.any(axis=(axis, 2)), step)
        for line, axis, step in ((sheet.grid.x, 0, steps[0]), (sheet.grid.y, 1, steps[1]))
    )
    share = lifted_mn[
        cut_y.cell[:, None], cut_x.cell, 2 * cut_y.half[:, None] + cut_x.half
    ] / (cut_y.parts[:, None] * cut_x.parts)  # fmt: skip
    x, y = (
        points_on(*of) for of in ((sheet.grid.x, cut_x.places_mm), (sheet.grid.y, cut_y.places_mm))
    )
    control, total = np.ascontiguousarray(state.control_mm), np.zeros((y_mm.size, x_mm.size))
    _distribute(
        control,
        x,
        y,
        sheet.grid.cut(cut_x.places_mm, cut_y.places_mm),
        share,
        sheet.laws.thickness_mm / 2,
        np.array([x_mm[0], y_mm[0], *steps]),
        work_for(control),
        total,
    )
    # kPa mm^2 = mN
    return np.asarray(total / (steps[0] * steps[1]))


def lift_kpa(sheet: Sheet, state: SheetState) -> FloatArray:
    """Return the upward force of specimen and plate per undeformed area, (row, col, 4), kPa."""
    surface = sheet.surface(state.control_mm)
    touch = sheet.touch(surface[..., 0, :], state.travel_mm)
    ratio = sheet.thickness_ratio
    slope = _contact_slope(sheet.gap_mm(surface, touch), sheet.laws, ratio)
    lifted = -(slope * touch.gradient[..., 2]).sum(axis=0)
    if not sheet.sticks:
        return np.asarray(lifted)
    return np.asarray(lifted + sheet.friction(surface, state).traction_kpa[..., 2])


def _contact_slope(gap_mm: FloatArray, laws: Laws, ratio: FloatArray) -> FloatArray:
    """Return the derivative, kPa, of the contact's potential by the gap, see `laws.contact_law`.

    `ratio` is the local over the mean undeformed thickness.
    """
    repelled = laws.contact_stiffness / ratio * np.minimum(gap_mm, 0.0)
    share = np.clip(gap_mm / laws.tack_range_mm, 0.0, 1.0)
    return np.asarray(repelled + 6 * laws.tack / laws.tack_range_mm * share * (1 - share))


class _Cut:
    """Equally spaced points in the halves of some cells of a line.

    Attributes
    ----------
    places_mm : (n,) positions along the line, ascending
    cell : (n,) index of the cell that contains the point
    half : (n,) 0 or 1, the half of the cell, and index of the Gauss point in this half
    parts : (n,) number of points in that half
    """

    def __init__(self, line: SplineLine, cells: IntArray, halves: IntArray) -> None:
        self.cell, self.parts = np.repeat(cells, 2 * halves), np.repeat(halves, 2 * halves)
        number = np.concatenate([np.arange(2 * count) for count in halves])
        self.half = number // self.parts
        width = np.diff(line.edges)[self.cell]
        self.places_mm = line.edges[self.cell] + width * (number + 0.5) / (2 * self.parts)


def _cut(line: SplineLine, loaded: BoolArray, step_mm: float) -> _Cut:
    """Return points in the cells marked in `loaded`, at intervals far below `step_mm`."""
    cells = np.flatnonzero(loaded)
    widths = np.diff(line.edges)[cells]
    halves = np.ceil(widths / 2 * _STRETCHED * _PARTS_PER_CELL / step_mm).astype(np.intp)
    return _Cut(line, cells, halves)


@kernel
def _distribute(
    c: FloatArray,
    x: Points,
    y: Points,
    cut: FloatArray,
    forces: FloatArray,
    half_mm: float,
    cells: FloatArray,
    work: PointWork,
    total: FloatArray,
) -> None:
    """Add forces (y, x) at points of the lower face to the four nearest cells, bilinearly.

    Parameters
    ----------
    c, x, y, cut : as `surface_at`
    half_mm : half of the undeformed thickness
    cells : (4,) x0, y0, dx, dy: middle of the first cell in plan, and widths
    total : (row, col) sums
    """
    v, across = work.point, work.across
    rows, cols = total.shape
    for j in range(y.cell.size):
        along_row(c, y, j, work.row)
        for i in range(x.cell.size):
            if forces[j, i] == 0.0:
                continue
            point_in_row(work.row, x, i, v)
            if cut.shape[1] > 0:
                turn(cut, j, i, v)
            over_area2 = half_mm / normal_times_area(v, across)
            col = min(max((v[0, 0] - across[0] * over_area2 - cells[0]) / cells[2], 0.0), cols - 1)
            row = min(max((v[0, 1] - across[1] * over_area2 - cells[1]) / cells[3], 0.0), rows - 1)
            a, b = min(int(row), rows - 2), min(int(col), cols - 2)
            down, right = row - a, col - b
            total[a, b] += (1 - down) * (1 - right) * forces[j, i]
            total[a, b + 1] += (1 - down) * right * forces[j, i]
            total[a + 1, b] += down * (1 - right) * forces[j, i]
            total[a + 1, b + 1] += down * right * forces[j, i]
