"""Equilibrium of a sheet under pressure without load steps: by nested iteration on finer cells.

Without anchors and tack the equilibrium under pressure does not depend on the load path. The first
state is a taut sheet over the bodies. From there, 10 to 20 steps on cells four times as wide as
those of the load steps take less time than a single step on the finest cells. Each finer grid then
corrects the state of the grid before.
"""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.spatial import ConvexHull

from reconstruction.arrays import FloatArray
from twin.mechanics.errors import SolverError
from twin.mechanics.sheet.case import Cells, SheetCase
from twin.mechanics.sheet.cells import COARSE_CELL_MM
from twin.mechanics.sheet.energy import Sheet, SheetState
from twin.mechanics.sheet.equilibrium import Accuracy, settle
from twin.mechanics.sheet.faces import height_map
from twin.mechanics.sheet.path import Loads, check_thickness, mounted, refined

# Widths of the first cells over those of the load steps.
_WIDER = (4.0, 2.0)
# On cells wider than the sheet's details an equilibrium takes many steps and does not help.
NEAR = Accuracy(step_mm=5e-3, residual_kpa=1.0, most_steps=20, strict=False)
"""Accuracy of a state from which finer cells start."""
_CLEAR_MM, _MOST_LOWERINGS = 1e-3, 200
# Of the hull's unit normals: a smaller z belongs to its lower side or to a side.
_UPWARD = 1e-3
# Of a cell: on wide cells the sheet penetrates edges and ridges.
_SUNK, _NODES_MM = 0.25, 0.25


def wider_cells(case: SheetCase) -> list[Cells]:
    """Return the widths of the cells of the first grids, the widest first."""
    widths = [ratio * COARSE_CELL_MM for ratio in _WIDER]
    return [Cells(width, width, case.shape.bounds_mm()) for width in widths]


def descended(grids: list[Sheet], goal: Loads, accuracy: Accuracy) -> SheetState:
    """Return the state of the last of some sheets at the loads `goal`, to the given accuracy.

    Parameters
    ----------
    grids : one sheet under pressure on finer and finer cells, without anchors and tack
    accuracy : tolerances on the last grid; on the others they are `NEAR`

    Raises
    ------
    SolverError
        There is no equilibrium within the accuracy's number of steps, the sheet becomes too thin,
        or a body is above it.
    """
    bodies = _bodies_seen_from_above(grids[-1], goal.travel_mm)
    last: tuple[Sheet, SheetState] | None = None
    for sheet in grids[:-1]:
        with suppress(SolverError):  # the next grid starts without this one
            state = settle(sheet, _start(sheet, goal, last), NEAR)
            last = (sheet, state) if bodies.are_below(sheet, state) else None
    sheet = grids[-1]
    state = settle(sheet, _start(sheet, goal, last), accuracy)
    check_thickness(sheet, state)
    if not bodies.are_below(sheet, state):
        raise SolverError("sheet: a body has passed between its cells")
    return state


def _start(sheet: Sheet, goal: Loads, last: tuple[Sheet, SheetState] | None) -> SheetState:
    """Return the first state on a grid: that of the last wider grid, or a taut sheet."""
    if last is not None:
        return refined(last[0], sheet, last[1])
    return replace(
        mounted(sheet.grid),
        control_mm=taut_mm(sheet, goal.travel_mm),
        travel_mm=goal.travel_mm,
        pressure_kpa=goal.pressure_kpa,
    )


def taut_mm(sheet: Sheet, travel_mm: float) -> FloatArray:
    """Return control points (row + 2, col + 2, xyz) of a sheet stretched tightly over the bodies.

    It is the upper convex hull of the bodies and the rim.
    """
    place = sheet.grid.mounted_mm.copy()
    place[..., 2] = _obstacle_mm(sheet, place[..., :2], travel_mm)
    if not place[..., 2].any():
        return place
    planes = ConvexHull(place.reshape(-1, 3)).equations
    planes = planes[planes[:, 2] > _UPWARD]
    height = -(place[..., :2] @ planes[:, :2].T + planes[:, 3]) / planes[:, 2]
    place[..., 2] = np.where(sheet.grid.free[..., 2], height.min(axis=-1), 0.0)
    return place


@dataclass(frozen=True, eq=False)
class _SeenFromAbove:
    """Heights of the bodies on a grid in plan, for a check that the sheet is above them.

    On cells wider than a body, the body may pass between the Gauss points of the sheet.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    #: (y, x) lowest height of the sheet's middle surface that is clear of the bodies; 0 where that
    #: of the mounted sheet is: there the pressure may bend it down
    clear_mm: FloatArray

    def are_below(self, sheet: Sheet, state: SheetState) -> bool:
        """Return True if the sheet is nowhere lower than the bodies by more than 1/4 of a cell."""
        grid = sheet.grid
        surface = grid.evaluate(state.control_mm, grid.x.edges, grid.y.edges)[:, :, 0]
        no_values = np.zeros((*surface.shape[:2], 0))
        height, _ = height_map(surface, no_values, self.x_mm, self.y_mm, np.zeros(1))
        above = height > self.clear_mm - _SUNK * sheet.cell_mm
        return bool((above | (self.clear_mm == 0)).all())


def _bodies_seen_from_above(sheet: Sheet, travel_mm: float) -> _SeenFromAbove:
    half_x, half_y = sheet.grid.frame.half_mm
    x, y = (
        np.linspace(-half, half, int(np.ceil(2 * half / _NODES_MM)) + 1)
        for half in (half_x, half_y)
    )
    clear_mm = _obstacle_mm(sheet, np.stack(np.meshgrid(x, y), axis=-1), travel_mm)
    # Next to a wall a small shift in plan is a large one in height.
    return _SeenFromAbove(x, y, minimum_filter(clear_mm, size=3))


def _obstacle_mm(sheet: Sheet, plan_mm: FloatArray, travel_mm: float) -> FloatArray:
    """Return the lowest heights (row, col), mm, at which a sheet from above is clear of the bodies.

    They are 0 where the mounted sheet is clear. Each point is lowered from above the bodies by its
    distance to the nearest body.

    Parameters
    ----------
    plan_mm : (row, col, xy) points
    """
    place = np.concatenate((plan_mm, np.full((*plan_mm.shape[:2], 1), travel_mm)), axis=-1)
    half_mm = sheet.laws.thickness_mm / 2
    row, col = np.nonzero(place[..., 2] > 0)
    for _ in range(_MOST_LOWERINGS):
        if not row.size:
            break
        points = place[row, col]
        distance = sheet.touch(points[:, None, None], travel_mm).distance_mm.min(axis=0)[:, 0, 0]
        gap = np.minimum(distance, sheet.reach_mm) - half_mm
        lowered = np.maximum(points[:, 2] - np.where(gap > _CLEAR_MM, gap, 0.0), 0.0)
        place[row, col, 2] = lowered
        moves = (gap > _CLEAR_MM) & (lowered > 0)
        row, col = row[moves], col[moves]
    return np.asarray(place[..., 2])
