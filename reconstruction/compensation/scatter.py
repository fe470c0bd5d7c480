"""Noise and texture of a coat as a random field: its autocovariance, estimated from residuals.

Camera noise after the phase filter, and the grain of the coat, are correlated between neighbouring
cells. The autocovariance is modelled as the variance times a function of the row lag times a
function of the column lag. The uncertainty of a fitted value v with the derivatives dv/dz_i is then
u^2 = sum_ij dv/dz_i dv/dz_j C_ij (JCGM 100, 5.2.2), with all pairs of cells, also at the border of
the fitted region, where cells have fewer neighbours.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import FittedDimension

_CORRELATED_CELLS = 8
# Sample autocorrelations below this value are noise: over a contact of 5 mm^2 with a grain of
# 0.15 mm their standard error is 0.05 to 0.1.
_INSIGNIFICANT = 0.05
# Least share of the patches that a fit leaves free; with fewer the residuals show no scatter.
_LEAST_FREE = 0.25
# Residuals that are by at most this share below the outliers' limit determine the density there.
_NEAR_LIMIT, _LEAST_EFFICIENCY = 0.2, 0.5
# Patches in excess of the parameters from which the residuals determine sigma within some 20 %.
_FREE_PATCHES = 10


@dataclass(frozen=True, eq=False)
class Scatter:
    """Variance and separable autocorrelation of residuals on cells.

    Attributes
    ----------
    variance : variance of the residuals, in the square of their unit
    along_rows, along_cols : (lag,) autocorrelation at lags of 0, 1, 2, ... cells along each axis;
        the first value is 1
    """

    variance: float
    along_rows: FloatArray
    along_cols: FloatArray

    @property
    def correlated_cells(self) -> float:
        """Number of neighbouring cells with a common error: sum of the autocorrelation."""
        return float(np.prod([2 * line.sum() - 1 for line in (self.along_rows, self.along_cols)]))

    def patches(self, used: int) -> float:
        """Return the number of independent patches in a number of used cells."""
        return used / self.correlated_cells

    def of_fit(self, used: int, parameters: int) -> "Scatter":
        """Return the scatter before a fit of some parameters, which took part of the variance.

        Parameters
        ----------
        used : number of fitted cells
        """
        free = 1.0 - parameters / self.patches(used)
        return Scatter(self.variance / max(free, _LEAST_FREE), self.along_rows, self.along_cols)

    def uncertainty(self, slope: FloatArray) -> float:
        """Return the standard uncertainty of a value, in its unit.

        Parameters
        ----------
        slope : (row, col) derivative of the value by the residual of each cell; 0 for unused cells
        """
        spread = slope
        for axis, line in enumerate((self.along_rows, self.along_cols)):
            kernel = np.concatenate((line[:0:-1], line))
            spread = ndimage.convolve1d(spread, kernel, axis=axis, mode="constant")
        return float(np.sqrt(max(self.variance * np.sum(slope * spread), 0.0)))


def scatter_of(rest: FloatArray, used: BoolArray) -> Scatter:
    """Return variance and autocorrelation of residuals over the `used` cells.

    Each autocorrelation ends before the first lag, of at most 8 cells, at which it is below 0.05.

    Parameters
    ----------
    rest, used : (row, col) residuals, and bool
    """
    count = int(used.sum())
    if count < 2:
        raise FitError("residuals: fewer than two cells were measured; give another region")
    values = np.where(used, rest, 0.0)
    variance = float(np.sum(values**2)) / count
    along = [_autocorrelation(values, used, variance, axis) for axis in range(2)]
    return Scatter(variance, *along)


@dataclass(frozen=True)
class FitNoise:
    """Standard uncertainty of a fitted value by noise and texture of the coat.

    Attributes
    ----------
    sigma_mm : standard uncertainty of the value, mm
    patches : number of independent patches of the coat among the fitted cells
    parameters : number of fitted parameters
    """

    sigma_mm: float
    patches: float
    parameters: int

    @property
    def is_known(self) -> bool:
        """Whether the residuals of the fit determine the scatter of the coat."""
        return self.patches >= self.least_patches

    @property
    def least_patches(self) -> int:
        """Least number of patches from which the residuals determine the scatter."""
        return self.parameters + _FREE_PATCHES


def noise_of_fit(estimate: FittedDimension, cells: IntArray, shape: tuple[int, ...]) -> FitNoise:
    """Return the uncertainty of a fit by noise and texture, estimated from its residuals.

    Parameters
    ----------
    cells : (n,) flat index of the cell of each fitted point
    shape : number of rows and columns of the cells
    """
    rest, slope, used = np.zeros(shape), np.zeros(shape), np.zeros(shape, bool)
    own = estimate.slope_of_residual
    slope.flat[cells] = estimate.slope if own is None else own
    rest.flat[cells], used.flat[cells] = estimate.residuals_mm, estimate.used
    count = int(used.sum())
    parameters = 1 if estimate.design is None else estimate.design.shape[1]
    scatter = scatter_of(rest, used)
    sigma_mm = scatter.of_fit(count, parameters).uncertainty(slope) / _efficiency(estimate)
    return FitNoise(sigma_mm, scatter.patches(count), parameters)


def _efficiency(estimate: FittedDimension) -> float:
    """Return the share by which a change of the residuals changes a fit without outliers.

    A change c moves some points across the limit L of the outliers, which reduces the share from 1
    to 1 - 2 L f(L), with the density f of the residuals at L (Huber, Robust Statistics, 1981, eq.
    3.2.13). The value's uncertainty is that of a fit to the inliers over this share.
    """
    if estimate.used.all():
        return 1.0
    size = np.abs(estimate.residuals_mm[estimate.used])
    near = float(np.mean(size > (1 - _NEAR_LIMIT) * size.max())) / _NEAR_LIMIT
    return max(1.0 - near, _LEAST_EFFICIENCY)


def variance_and_area(
    rest_mm: FloatArray, used: BoolArray, cell_area_mm2: float
) -> tuple[float, float]:
    """Return the variance and the correlation area, mm^2, of residuals over the `used` cells.

    The variance is mm^2, or without unit if the residuals are without unit. The area is at least
    one cell.

    Parameters
    ----------
    rest_mm, used : (row, col) residuals, and bool
    """
    scatter = scatter_of(rest_mm, used)
    return scatter.variance, scatter.correlated_cells * cell_area_mm2


def _autocorrelation(values: FloatArray, used: BoolArray, variance: float, axis: int) -> FloatArray:
    """Return the autocorrelation (lag,) along an axis, up to the last significant lag."""
    line = [1.0]
    for lag in range(1, min(_CORRELATED_CELLS, values.shape[axis] - 1) + 1 if variance else 1):
        first = np.take(values, range(values.shape[axis] - lag), axis=axis)
        second = np.take(values, range(lag, values.shape[axis]), axis=axis)
        both = np.take(used, range(values.shape[axis] - lag), axis=axis) & np.take(
            used, range(lag, values.shape[axis]), axis=axis
        )
        share = float(np.sum(first * second)) / max(int(both.sum()), 1) / variance
        if share < _INSIGNIFICANT:
            break
        line.append(share)
    return np.array(line)
