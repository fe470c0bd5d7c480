"""The measured coat on a grid over its frame: heights, filled gaps, slopes and curvature; mm.

Cells are square except for rounding, (row, col), x and y growing; world frame. In gaps (shadows,
outside the image) the sheet is assumed to have no curvature between measured cells and the rim,
where the coat is z = 0. Only the stretch, an integral, uses these heights.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import spread

_LEAST_SHARE = 0.2
_CORRELATED_CELLS = 8
# Passes of the shift to the cells' middles: the slope used is that of heights off the middles.
_TURNS_TO_MIDDLES = 2


@dataclass(frozen=True)
class SheetOpening:
    """Opening in which the sheet is held, centred on the world's origin."""

    length_x_mm: float
    length_y_mm: float
    is_round: bool = False


@dataclass(frozen=True, eq=False)
class Relief:
    """Heights of the coat on a grid of cells.

    Attributes
    ----------
    x_mm, y_mm : (col,), (row,) middles of the cells
    points_mm : (row, col, xyz) mean of the points in each cell; in a cell without points its
        middle at an interpolated height
    heights_mm : (row, col) z at the cells' middles: the mean, moved there along the slope
    sigma_mm : (row, col) standard uncertainty of the mean along z; 0 in a cell without points
    measured : (row, col) bool
    inside : (row, col) bool, within the frame
    """

    x_mm: FloatArray
    y_mm: FloatArray
    points_mm: FloatArray
    heights_mm: FloatArray
    sigma_mm: FloatArray
    measured: BoolArray
    inside: BoolArray

    @property
    def pitch_mm(self) -> tuple[float, float]:
        """Edges of a cell along x and y."""
        return float(self.x_mm[1] - self.x_mm[0]), float(self.y_mm[1] - self.y_mm[0])

    @property
    def cell_area_mm2(self) -> float:
        """Area of a cell."""
        pitch = self.pitch_mm
        return pitch[0] * pitch[1]

    def smoothed(self, sigma_mm: float) -> FloatArray:
        """Return heights, mm, after a Gaussian filter of fourth order, (row, col).

        The filter 2 G(s) - G(sqrt(2) s), with s = `sigma_mm`, preserves curvature. A plain Gaussian
        of 0.3 mm would reduce the curvature of a free span by 3 %. Heights are mirrored at the rim,
        because the clamp keeps the coat horizontal there.
        """
        return 2 * self.blurred(sigma_mm) - self.blurred(np.sqrt(2.0) * sigma_mm)

    def blurred(self, sigma_mm: float) -> FloatArray:
        """Return heights after a plain Gaussian filter, (row, col), without dips next to peaks."""
        sigmas = [sigma_mm / pitch for pitch in self.pitch_mm[::-1]]
        return np.asarray(ndimage.gaussian_filter(self.heights_mm, sigmas, mode="reflect"))

    def noise_area_mm2(self, sigma_mm: float) -> tuple[float, float]:
        """Return (variance, correlation area) of the heights' part that a filter removes.

        Noise and texture of the coat: their variance, mm^2, and the area over which neighbours
        share one error, mm^2.
        """
        rest = np.where(self.measured, self.heights_mm - self.smoothed(sigma_mm), 0.0)
        limit = 4 * spread(rest[self.measured])
        used = self.measured & (np.abs(rest) <= max(limit, 1e-12))
        return variance_and_area(rest, used, self.cell_area_mm2)


def variance_and_area(
    rest_mm: FloatArray, used: BoolArray, cell_area_mm2: float
) -> tuple[float, float]:
    """Return (variance, correlation area) of residuals (row, col) over the `kept` cells.

    The area is the sum of the autocorrelation as far as it is positive along both axes, at least
    one cell.
    """
    count = int(used.sum())
    if count < 2:
        raise FitError("residuals: fewer than two cells were measured; give another region")
    values = np.where(used, rest_mm, 0.0)
    variance = float(np.sum(values**2)) / count
    if variance == 0.0:
        return 0.0, cell_area_mm2
    width = 1.0
    for axis in range(2):
        width *= _correlated_cells(values, used, variance, axis)
    return variance, width * cell_area_mm2


def _correlated_cells(values: FloatArray, used: BoolArray, variance: float, axis: int) -> float:
    """Return 1 + 2 sum of the autocorrelation along an axis, up to its first value below 0."""
    total = 1.0
    for lag in range(1, min(_CORRELATED_CELLS, values.shape[axis] - 1) + 1):
        first = np.take(values, range(values.shape[axis] - lag), axis=axis)
        second = np.take(values, range(lag, values.shape[axis]), axis=axis)
        both = np.take(used, range(values.shape[axis] - lag), axis=axis) & np.take(
            used, range(lag, values.shape[axis]), axis=axis
        )
        if not both.any():
            break
        share = float(np.sum(first * second)) / int(both.sum()) / variance
        if share <= 0:
            break
        total += 2 * share
    return total


def relief_on_frame(
    points_mm: FloatArray,
    sigma_z_mm: FloatArray,
    frame: SheetOpening,
    cells: tuple[int, int],
    least_share: float = _LEAST_SHARE,
) -> Relief:
    """Average measured points on a grid over the frame, and interpolate its gaps.

    Parameters
    ----------
    points_mm : (n, xyz) world
    sigma_z_mm : (n,) standard uncertainty of z; `Relief.noise_area_mm2` gives the correlated part
    cells : columns and rows over the frame
    least_share : least share of the frame with measured points

    Raises
    ------
    FitError : a smaller share of the frame was measured
    """
    cols, rows = cells
    pitch = frame.length_x_mm / cols, frame.length_y_mm / rows
    x = np.asarray((np.arange(cols) + 0.5) * pitch[0] - frame.length_x_mm / 2, np.float64)
    y = np.asarray((np.arange(rows) + 0.5) * pitch[1] - frame.length_y_mm / 2, np.float64)
    inside = _inside(frame, x, y)
    col = np.floor((points_mm[:, 0] + frame.length_x_mm / 2) / pitch[0]).astype(np.intp)
    row = np.floor((points_mm[:, 1] + frame.length_y_mm / 2) / pitch[1]).astype(np.intp)
    on = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
    index = row[on] * cols + col[on]
    count = np.bincount(index, minlength=rows * cols).reshape(rows, cols)
    measured = (count > 0) & inside
    share = float(measured.sum()) / int(inside.sum())
    if share < least_share:
        raise FitError(
            f"relief: {share:.0%} of the sheet's opening was measured, {least_share:.0%} needed; "
            "check length_x_mm and length_y_mm of the layer"
        )
    means = [_means(index, points_mm[on, axis], count) for axis in range(3)]
    variance = _means(index, sigma_z_mm[on] ** 2, count) / np.maximum(count, 1)
    points = np.stack(
        (
            np.where(measured, means[0], x[None, :]),
            np.where(measured, means[1], y[:, None]),
            filled(means[2], measured, inside),
        ),
        axis=-1,
    )
    sigma = np.where(measured, np.sqrt(variance), 0.0)
    heights = _mirrored(_at_middles(points, x, y), x, y, frame)
    return Relief(x, y, points, heights, sigma, measured, inside)


def filled(z_mm: FloatArray, known: BoolArray, inside: BoolArray) -> FloatArray:
    """Return heights (row, col) with gaps that solve Laplace's equation; 0 outside."""
    gaps = inside & ~known
    z = np.where(known, z_mm, 0.0)
    if not gaps.any():
        return z
    number = np.pad(np.where(gaps, np.cumsum(gaps).reshape(gaps.shape) - 1, -1), 1,
                    constant_values=-1)  # fmt: skip
    wide, row, col = np.pad(z, 1), *np.nonzero(gaps)
    load, rows, cols = np.zeros(len(row)), [], []
    for down, right in ((0, 1), (2, 1), (1, 0), (1, 2)):
        neighbour = number[row + down, col + right]
        is_gap = neighbour >= 0
        rows.append(np.flatnonzero(is_gap))
        cols.append(neighbour[is_gap])
        load += np.where(is_gap, 0.0, wide[row + down, col + right])
    places = np.concatenate(rows), np.concatenate(cols)
    near = sparse.csc_matrix((np.ones(len(places[0])), places), shape=(len(row),) * 2)
    laplace = sparse.csc_matrix(4.0 * sparse.identity(len(row)) - near)
    z[gaps] = spsolve(laplace, load)
    return z


def _at_middles(points_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return z moved along the slope from the mean positions to the cells' middles, (row, col)."""
    z = points_mm[..., 2]
    for _ in range(_TURNS_TO_MIDDLES):
        slope_y, slope_x = np.gradient(ndimage.gaussian_filter(z, 1.0), y_mm, x_mm)
        away_x, away_y = points_mm[..., 0] - x_mm, points_mm[..., 1] - y_mm[:, None]
        z = points_mm[..., 2] - slope_x * away_x - slope_y * away_y
    return np.asarray(z)


def _mirrored(
    z_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray, frame: SheetOpening
) -> FloatArray:
    """Return heights mirrored at a round rim, where the clamp keeps the coat level."""
    if not frame.is_round:
        return z_mm
    radius, rim = np.hypot(x_mm, y_mm[:, None]), frame.length_x_mm / 2
    back = np.where(radius > rim, np.maximum(2 * rim / np.maximum(radius, 1e-9) - 1, 0.0), 1.0)
    at = [
        (back * axis - first) / step
        for axis, first, step in (
            (y_mm[:, None], y_mm[0], y_mm[1] - y_mm[0]),
            (x_mm, x_mm[0], x_mm[1] - x_mm[0]),
        )
    ]
    return np.asarray(ndimage.map_coordinates(z_mm, at, order=1, mode="nearest"))


def _means(index: NDArray[np.intp], values: FloatArray, count: NDArray[np.intp]) -> FloatArray:
    total = np.bincount(index, values, count.size).reshape(count.shape)
    return np.asarray(total / np.maximum(count, 1))


def _inside(frame: SheetOpening, x_mm: FloatArray, y_mm: FloatArray) -> BoolArray:
    if not frame.is_round:
        return np.ones((len(y_mm), len(x_mm)), bool)
    return np.asarray(np.hypot(x_mm, y_mm[:, None]) < frame.length_x_mm / 2)
