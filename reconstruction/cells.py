"""Average scattered points in the square cells of a grid over world x and y, both in mm."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, IntArray
from reconstruction.errors import InputError

_MOST_CELLS = 10**8


@dataclass(frozen=True, eq=False)
class CellMeans:
    """Mean of one quantity in each square cell of a grid over world x and y.

    Attributes
    ----------
    x_mm : (col,) world x of the cells' centres, ascending
    y_mm : (row,) world y of the cells' centres, descending: row 0 is the top of a picture
    mean : (row, col) mean of the quantity, in its unit; 0 in cells without a point
    valid : (row, col) bool, whether the cell contains a point
    pitch_mm : edge length of a cell
    """

    x_mm: FloatArray
    y_mm: FloatArray
    mean: FloatArray
    valid: BoolImage
    pitch_mm: float

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Least and largest world x, then least and largest world y, of the grid's borders."""
        half = 0.5 * self.pitch_mm
        ends = self.x_mm[0] - half, self.x_mm[-1] + half, self.y_mm[-1] - half, self.y_mm[0] + half
        return (float(ends[0]), float(ends[1]), float(ends[2]), float(ends[3]))


def box_of(points: NDArray[np.floating[Any]]) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest coordinates, each (axis,), of points (point, axis)."""
    # Axis by axis: over short rows Numpy takes ten times as long.
    axes = points.T
    return np.array([axis.min() for axis in axes]), np.array([axis.max() for axis in axes])


@dataclass(frozen=True, eq=False)
class SquareCells:
    """Assignment of points to the square cells of a grid over world x and y.

    Attributes
    ----------
    number : (point,) row * columns + column of the cell that contains the point; row 0 at the top
    x_mm, y_mm, pitch_mm : centres and edge length of the cells, as in `CellMeans`
    """

    number: IntArray
    x_mm: FloatArray
    y_mm: FloatArray
    pitch_mm: float

    @classmethod
    def of(
        cls,
        points_mm: NDArray[np.floating[Any]],
        pitch_mm: float,
        corner_mm: tuple[float, float] = (0.0, 0.0),
    ) -> "SquareCells":
        """Assign points to cells; the grid covers all points.

        Parameters
        ----------
        points_mm : (point, xyz) or (point, xy), world frame, at least one point
        pitch_mm : edge length of a cell
        corner_mm : world x and y of a corner of any cell, which fixes the position of the grid

        Raises
        ------
        InputError : the pitch is not positive, or makes more than 10^8 cells
        """
        if pitch_mm <= 0.0:
            raise InputError(f"height map: pitch: found {pitch_mm:g} mm, allowed more than 0")
        shifted_mm = (axis_mm - at for axis_mm, at in zip(points_mm.T[:2], corner_mm, strict=True))
        across, along = (np.floor(axis_mm / pitch_mm) for axis_mm in shifted_mm)
        left, low = float(across.min()), float(along.min())
        cols, rows = int(across.max() - left) + 1, int(along.max() - low) + 1
        if rows * cols > _MOST_CELLS:
            made = f"pitch {pitch_mm:g} mm makes {rows} x {cols} cells"
            raise InputError(f"height map: {made}; give more")
        row, col = (along - low).astype(np.int64), (across - left).astype(np.int64)
        x_mm = np.asarray(corner_mm[0] + (left + np.arange(cols) + 0.5) * pitch_mm)
        y_mm = np.asarray(corner_mm[1] + (low + np.arange(rows)[::-1] + 0.5) * pitch_mm)
        return cls((rows - 1 - row) * cols + col, x_mm, y_mm, float(pitch_mm))

    def means(self, values: NDArray[Any]) -> CellMeans:
        """Return the mean of values (point,) over the points in each cell."""
        shape = len(self.y_mm), len(self.x_mm)
        size = shape[0] * shape[1]
        count = np.bincount(self.number, minlength=size).reshape(shape)
        total = np.bincount(self.number, values, size).reshape(shape)
        mean, valid = total / np.maximum(count, 1), count > 0
        return CellMeans(self.x_mm, self.y_mm, mean, valid, self.pitch_mm)
