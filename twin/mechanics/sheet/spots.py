"""Where few points hold a whole sheet back: each such spot settles by itself, the rest held.

Round an edge the sheet slips over points one by one. As long as one of them is on its way, a step
of the whole sheet is short everywhere. A spot is a window of the same sheet, with the same energy:
what it gains the sheet gains.
"""

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.errors import SolverError
from twin.mechanics.sheet.laws import Grip

if TYPE_CHECKING:
    from twin.mechanics.sheet.equilibrium import Accuracy, Sheet, SheetState

_HALF_CELLS, _MOST_SPOTS, _MOST_STEPS = 10, 12, 25
# Of the largest residual: what is below is no spot.
_LEAST_SHARE = 0.05


def settled_spots(
    sheet: "Sheet", state: "SheetState", residual_kpa: FloatArray, accuracy: "Accuracy"
) -> FloatArray:
    """Return the control points (row, col, xyz) after each spot has settled by itself.

    Parameters
    ----------
    sheet : without anchors: it does not stick
    state : on its way
    residual_kpa : (row, col) of the control points
    accuracy : of the whole sheet
    """
    control, left = state.control_mm.copy(), residual_kpa.copy()
    least = max(_LEAST_SHARE * float(left.max()), accuracy.residual_kpa)
    rough = replace(accuracy, most_steps=_MOST_STEPS, strict=False)
    for _ in range(_MOST_SPOTS):
        row, col = np.unravel_index(int(left.argmax()), left.shape)
        if left[row, col] <= least:
            break
        rows, cols = (
            _round(int(at), count)
            for at, count in ((row, sheet.grid.y.cells), (col, sheet.grid.x.cells))
        )
        inside = slice(rows.start, rows.stop + 2), slice(cols.start, cols.stop + 2)
        grip = Grip(*(part[rows, cols] for part in state.grip))
        start = replace(state, control_mm=control[inside], grip=grip)
        with suppress(SolverError):  # else the whole sheet has to go on first
            control[inside] = sheet.window(rows, cols).settle(start, rough).control_mm
        left[inside] = 0.0
    return control


def _round(control: int, cells: int) -> slice:
    """Return the cells round a control point."""
    middle = control - 1
    return slice(max(0, middle - _HALF_CELLS), min(cells, middle + _HALF_CELLS + 1))
