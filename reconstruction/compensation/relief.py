"""Average the measured coat on a grid over its frame, and fill the gaps; lengths in mm.

Arrays are (row, col); row and column increase with world y and x. Cells are square except for
rounding. In gaps (shadows, parts outside the image) the heights solve Laplace's equation between
the measured cells and the rim, where the coat is at z = 0. Only the computation of the stretch,
an integral over the surface, uses these filled heights.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.scatter import variance_and_area
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import spread

_LEAST_SHARE = 0.2
# Passes of the shift to the cells' middles: the first pass uses the slope of unshifted heights.
_TURNS_TO_MIDDLES = 2


@dataclass(frozen=True)
class SheetOpening:
    """Opening in which the sheet is held, centred on the world's origin.

    Attributes
    ----------
    length_x_mm, length_y_mm : edge lengths of a rectangular opening; for a round opening both are
        equal to its diameter
    is_round : True for a round opening, False for a rectangular one
    """

    length_x_mm: float
    length_y_mm: float
    is_round: bool = False


@dataclass(frozen=True, eq=False)
class Relief:
    """Heights of the coat on a grid of cells over the frame, world.

    Attributes
    ----------
    x_mm, y_mm : (col,), (row,) coordinates of the middles of the cells
    points_mm : (row, col, xyz) mean of the measured points in each cell; in a cell without points
        the middle of the cell at an interpolated height
    heights_mm : (row, col) z at the middles of the cells, extrapolated from `points_mm` along the
        slope of the coat
    sigma_mm : (row, col) standard uncertainty of the mean z; 0 in a cell without points
    measured : (row, col) bool, True for a cell within the frame with measured points
    inside : (row, col) bool, True for a cell within the frame
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
        """Edge lengths of a cell along x and y, mm."""
        return float(self.x_mm[1] - self.x_mm[0]), float(self.y_mm[1] - self.y_mm[0])

    @property
    def cell_area_mm2(self) -> float:
        """Area of a cell, mm^2."""
        pitch = self.pitch_mm
        return pitch[0] * pitch[1]

    def smoothed(self, sigma_mm: float) -> FloatArray:
        """Return heights, mm, after a Gaussian filter of fourth order, (row, col).

        The filter 2 G(s) - G(sqrt(2) s), with Gaussians of standard deviation s = `sigma_mm` and
        sqrt(2) s, preserves curvature. A simple Gaussian filter of 0.3 mm would reduce the
        curvature of a free span by 3 %. Heights are mirrored at the rim, because the clamp keeps
        the coat horizontal there.
        """
        return 2 * self.blurred(sigma_mm) - self.blurred(np.sqrt(2.0) * sigma_mm)

    def blurred(self, sigma_mm: float) -> FloatArray:
        """Return heights, mm, after a simple Gaussian filter, (row, col).

        Unlike `smoothed`, this filter makes no dips next to peaks.

        Parameters
        ----------
        sigma_mm : standard deviation of the Gaussian
        """
        sigmas = [sigma_mm / pitch for pitch in self.pitch_mm[::-1]]
        return np.asarray(ndimage.gaussian_filter(self.heights_mm, sigmas, mode="reflect"))

    def noise_area_mm2(self, sigma_mm: float) -> tuple[float, float]:
        """Return the variance and correlation area, both mm^2, of the coat's noise and texture.

        Noise and texture are the part of the heights that the filter `smoothed` removes. The
        correlation area is the area over which neighbouring cells have a common error.
        """
        rest = np.where(self.measured, self.heights_mm - self.smoothed(sigma_mm), 0.0)
        limit = 4 * spread(rest[self.measured])
        used = self.measured & (np.abs(rest) <= max(limit, 1e-12))
        return variance_and_area(rest, used, self.cell_area_mm2)


def relief_on_frame(
    points_mm: FloatArray,
    sigma_z_mm: FloatArray,
    frame: SheetOpening,
    cells: tuple[int, int],
    least_share: float = _LEAST_SHARE,
) -> Relief:
    """Average measured points of the coat on a grid over the frame, and fill its gaps.

    Parameters
    ----------
    points_mm : (n, xyz) world
    sigma_z_mm : (n,) standard uncertainty of z. For `Relief.sigma_mm` the errors of the points are
        assumed independent; see `Relief.noise_area_mm2` for their actual correlation
    cells : numbers of columns and rows over the frame
    least_share : smallest admissible share of the cells in the frame that contain measured points

    Raises
    ------
    FitError : the share of the cells in the frame with measured points is below `least_share`
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
    """Return heights (row, col), mm, in which the gaps inside the frame are filled.

    In gaps the heights solve Laplace's equation; outside the frame they are 0.

    Parameters
    ----------
    known, inside : (row, col) bool, cells with a measured height, and cells inside the frame
    """
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
    """Return the heights at the cells' middles, (row, col), mm.

    They are extrapolated along the coat's slope from the mean point (row, col, xyz) of each cell.
    """
    z = points_mm[..., 2]
    for _ in range(_TURNS_TO_MIDDLES):
        slope_y, slope_x = np.gradient(ndimage.gaussian_filter(z, 1.0), y_mm, x_mm)
        away_x, away_y = points_mm[..., 0] - x_mm, points_mm[..., 1] - y_mm[:, None]
        z = points_mm[..., 2] - slope_x * away_x - slope_y * away_y
    return np.asarray(z)


def _mirrored(
    z_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray, frame: SheetOpening
) -> FloatArray:
    """Return heights (row, col), mm, with the values beyond a round rim mirrored at the rim.

    The clamp keeps the coat horizontal at the rim. Heights in a rectangular frame are unchanged.
    """
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
