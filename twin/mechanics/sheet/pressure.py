"""Compute the pressure of specimen and plate on a sheet in equilibrium, on a grid of cells in plan.

The forces on the sheet act at its Gauss points. Each force is distributed over the quarter of a
spline cell that belongs to the Gauss point, and from there to the cells in plan that it covers.
No force is lost, even on an edge narrower than a cell: the sum over the cells is the contact force.
"""

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from twin.mechanics.sheet.energy import Sheet, SheetState
from twin.mechanics.sheet.laws import Laws
from twin.mechanics.sheet.splines import SplineLine

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
    place = _lower_mm(sheet, state, cut_x.places_mm, cut_y.places_mm)
    at = [
        np.clip((place[..., axis] - along[0]) / step, 0, along.size - 1)
        for axis, along, step in ((0, x_mm, steps[0]), (1, y_mm, steps[1]))
    ]
    # kPa mm^2 = mN
    on_cells = _spread(share, at[1], at[0], (y_mm.size, x_mm.size))
    return np.asarray(on_cells / (steps[0] * steps[1]))


def lift_kpa(sheet: Sheet, state: SheetState) -> FloatArray:
    """Return the upward force of specimen and plate per undeformed area, (row, col, 4), kPa."""
    surface = sheet.surface(state.control_mm)
    touch = sheet.touch(surface[..., 0, :], state.travel_mm)
    slope = _contact_slope(sheet.gap_mm(surface, touch), sheet.laws)
    lifted = -(slope * touch.gradient[..., 2]).sum(axis=0)
    if not sheet.sticks:
        return np.asarray(lifted)
    grip = state.grip
    away = surface[..., 0, :] - grip.anchor_mm - np.array([0.0, 0.0, state.travel_mm])
    along = (away * grip.normal).sum(axis=-1)
    pulled = sheet.laws.stick_stiffness * (away[..., 2] - along * grip.normal[..., 2])
    return np.asarray(lifted - np.where(grip.held > 0, pulled, 0.0))


def _contact_slope(gap_mm: FloatArray, laws: Laws) -> FloatArray:
    """Return the derivative, kPa, of the contact's potential by the gap, see `laws.contact_law`."""
    repelled = laws.contact_stiffness * np.minimum(gap_mm, 0.0)
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


def _lower_mm(sheet: Sheet, state: SheetState, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return positions on the touched face, (y, x, xyz), mm, at parameters x and y of the sheet."""
    middle, along_x, along_y = sheet.grid.evaluate(state.control_mm, x, y)
    across = np.cross(along_x, along_y)
    area2 = (across**2).sum(axis=-1, keepdims=True)
    return np.asarray(middle - sheet.laws.thickness_mm / 2 * across / area2)


def _spread(
    values: FloatArray, row: FloatArray, col: FloatArray, shape: tuple[int, int]
) -> FloatArray:
    """Distribute values to the four cells around each point, bilinearly; return the sums per cell.

    `row` and `col` are positions in cells, `shape` is (rows, cols) of the result.
    """
    total = np.zeros(shape[0] * shape[1])
    low = [
        np.minimum(at.astype(np.intp), count - 2)
        for at, count in zip((row, col), shape, strict=True)
    ]
    beyond = row - low[0], col - low[1]
    for down in (0, 1):
        for right in (0, 1):
            weight = (beyond[0] if down else 1 - beyond[0]) * (
                beyond[1] if right else 1 - beyond[1]
            )
            cell = (low[0] + down) * shape[1] + low[1] + right
            total += np.bincount(cell.ravel(), (values * weight).ravel(), total.size)
    return total.reshape(shape)
