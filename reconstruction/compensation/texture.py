"""Texture of a coat as a random field, estimated from the relief minus its smooth part.

The texture has the autocovariance v exp(-r^2 / L^2) at the lag r. The filter `Relief.smoothed` with
Gaussians of standard deviation s passes a part of it. The rest has the power transfer (1 - g)^4, in
which g is that of one Gaussian. Its autocovariance is a closed form, because powers of g are
Gaussians: with X_j = L^2 + 2 j s^2,

    C(r) = v sum_j (-1)^j binomial(4, j) L^2 / X_j exp(-r^2 / X_j),  j = 0 to 4

For means over cells of width c, X_j increases by c^2 / 3: the variance of a uniform distribution
over the cell, for both ends of a lag. L follows from the decrease of C with the lag, and v from its
size. Only lags of at least one cell are used, because the noise of different cells is independent.
"""

from math import comb

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.relief import Relief
from reconstruction.evaluate.fit import spread

# Lags of the fit, in cells, and range of L over the standard deviation of the filter: longer
# textures are almost removed with the smooth part.
_LAGS = 3
_LENGTHS = np.geomspace(0.3, 2.0, 40)
_LEAST_PAIRS = 200
# Residuals beyond this multiple of their spread are edges of the object.
_OUTLIER = 4.0


def smoothed_variance(relief: Relief, used: BoolArray, sigma_mm: float) -> float:
    """Return the variance, mm^2, of the part of the texture that `Relief.smoothed` passes.

    0 if the relief shows no texture with a correlation over neighbouring cells.

    Parameters
    ----------
    used : (row, col) bool, cells from which the texture is estimated
    sigma_mm : standard deviation of the filter
    """
    rest = relief.heights_mm - relief.smoothed(sigma_mm)
    used = used & (np.abs(rest) <= _OUTLIER * spread(rest[used])) if used.any() else used
    covariance = _covariance(rest, used)
    if covariance is None or covariance[0] <= 0:
        return 0.0
    lags_mm = np.asarray((1 + np.arange(_LAGS)) * np.mean(relief.pitch_mm), np.float64)
    lengths = np.asarray(_LENGTHS * sigma_mm, np.float64)
    shapes = np.stack([_shape(lags_mm, length, sigma_mm, relief) for length in lengths])
    variances = np.maximum(shapes @ covariance / np.sum(shapes**2, axis=1), 0.0)
    misfit = np.sum((covariance - variances[:, None] * shapes) ** 2, axis=1)
    best = int(np.argmin(misfit))
    left = _shape(np.zeros(1), lengths[best], sigma_mm)[0]
    return float(variances[best] * (1 - left))


def _shape(
    lags_mm: FloatArray, length_mm: float, sigma_mm: float, relief: Relief | None = None
) -> FloatArray:
    """Return C / v at some lags (n,), of points, or of the cells of a relief."""
    of_cell = 0.0 if relief is None else relief.cell_area_mm2 / 3
    total = np.zeros(len(lags_mm))
    for power in range(5):
        square = length_mm**2 + of_cell + 2 * power * sigma_mm**2
        of_power = length_mm**2 / square * np.exp(-(lags_mm**2) / square)
        total += (-1) ** power * comb(4, power) * of_power
    return total


def _covariance(rest: FloatArray, used: BoolArray) -> FloatArray | None:
    """Return the mean autocovariance (lag,) along rows and columns from a lag of one cell on.

    None if too few pairs of cells are used.
    """
    values, covariance = np.where(used, rest, 0.0), np.zeros(_LAGS)
    for lag in range(1, _LAGS + 1):
        total, count = 0.0, 0
        for along, both in ((values, used), (values.T, used.T)):
            total += float(np.sum(along[lag:] * along[:-lag]))
            count += int(np.sum(both[lag:] & both[:-lag]))
        if count < _LEAST_PAIRS:
            return None
        covariance[lag - 1] = total / count
    return covariance
