"""Means in square cells of world x and y: how scattered points become a map in mm."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError

_MOST_CELLS = 10**8


@dataclass(frozen=True, eq=False)
class CellMeans:
    """Means of one quantity per cell.

    Attributes
    ----------
    x_mm : (col,) world x of the cells' centres, growing
    y_mm : (row,) world y of the cells' centres, falling: row 0 is the top of a picture
    mean : (row, col) 0 where no point lies
    valid : (row, col) bool
    pitch_mm : edge of a cell
    """

    x_mm: FloatArray
    y_mm: FloatArray
    mean: FloatArray
    valid: BoolImage
    pitch_mm: float

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Left, right, lower and upper end of all cells."""
        half = 0.5 * self.pitch_mm
        ends = self.x_mm[0] - half, self.x_mm[-1] + half, self.y_mm[-1] - half, self.y_mm[0] + half
        return (float(ends[0]), float(ends[1]), float(ends[2]), float(ends[3]))


def box_of(points: NDArray[np.floating[Any]]) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest coordinates of points (point, axis), at least one."""
    # Axis by axis: over short rows Numpy takes ten times as long.
    axes = points.T
    return np.array([axis.min() for axis in axes]), np.array([axis.max() for axis in axes])


def cell_means(
    points_mm: NDArray[np.floating[Any]], values: NDArray[Any], pitch_mm: float
) -> CellMeans:
    """Average `values` over square cells.

    Parameters
    ----------
    points_mm : (point, xyz) or (point, xy) float, world; at least one
    values : (point,)

    Raises
    ------
    InputError : the pitch makes more than 10^8 cells
    """
    places = np.floor(points_mm[:, :2] / pitch_mm)
    low, high = box_of(places)
    cols, rows = (high - low).astype(int) + 1
    if pitch_mm <= 0.0 or rows * cols > _MOST_CELLS:
        made = f"pitch {pitch_mm:g} mm makes {rows} x {cols} cells"
        raise InputError(f"height map: {made}; give more")
    col, row = (places - low).astype(int).T
    index = (rows - 1 - row) * cols + col
    count = np.bincount(index, minlength=rows * cols).reshape(rows, cols)
    total = np.bincount(index, values, rows * cols).reshape(rows, cols)
    return CellMeans(
        x_mm=(low[0] + np.arange(cols) + 0.5) * pitch_mm,
        y_mm=(low[1] + np.arange(rows)[::-1] + 0.5) * pitch_mm,
        mean=total / np.maximum(count, 1),
        valid=count > 0,
        pitch_mm=float(pitch_mm),
    )
