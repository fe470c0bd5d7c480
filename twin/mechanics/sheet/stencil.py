"""Sparsity pattern of the tangent of a spline grid, and the areas of its control points."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from reconstruction.arrays import FloatArray
from twin.mechanics.sheet.grid import SheetGrid
from twin.mechanics.sheet.kernel import SLOTS


@dataclass(frozen=True, eq=False)
class Stencil:
    """Sparsity of the tangent: CSR pattern of its upper triangle, and source of each element."""

    start: npt.NDArray[np.int32]
    columns: npt.NDArray[np.int32]
    #: elements of the stencil array, in the order of the upper triangle
    taken: npt.NDArray[np.int64]


def control_areas(grid: SheetGrid) -> FloatArray:
    """Return the undeformed area of each control point, (row + 2, col + 2), mm^2.

    It is the integral of the control point's spline function over the sheet.
    """
    rest = grid.rest
    rows, cols = rest.area_mm2.shape[:2]
    weights = rest.area_mm2.reshape(rows, cols, 2, 2)
    along_x = np.einsum("jiqp,ipa->jiqa", weights, rest.along_x[:, :, 0])
    share = np.einsum("jiqa,jqb->jiba", along_x, rest.along_y[:, :, 0])
    area = np.zeros(grid.free.shape[:2])
    for b, a in np.ndindex(3, 3):
        area[b : b + rows, a : a + cols] += share[..., b, a]
    return area


def stencil(free: npt.NDArray[np.bool_]) -> Stencil:
    """Return the sparsity of the tangent; `free` (row + 2, col + 2, xyz) marks what may move."""
    rows, cols, _ = free.shape
    number = np.full((rows + 4, cols + 4, 3), -1, np.int64)
    number[2:-2, 2:-2][free] = np.arange(free.sum())
    own = number[2:-2, 2:-2]
    coupled = np.stack(
        [number[2 + b : 2 + b + rows, 2 + a : 2 + a + cols] for b, a in SLOTS], axis=2
    )
    # Row by row, with the columns of each row in ascending order: as the slots are.
    shape = (rows, cols, 3, len(SLOTS), 3)
    first = np.broadcast_to(own[..., None, None], shape)
    second = np.broadcast_to(coupled[:, :, None], shape)
    element = np.arange(first.size).reshape(rows, cols, len(SLOTS), 3, 3).swapaxes(2, 3)
    inside = (first >= 0) & (second >= first)
    count = np.bincount(first[inside], minlength=int(free.sum()))
    start = np.concatenate(([0], np.cumsum(count))).astype(np.int32)
    return Stencil(start, second[inside].astype(np.int32), element[inside])
