"""Fit the image of a dark ellipse to each printed dot: centre and its standard uncertainty.

Model of the light about a dot: a plane, times 1 - contrast S, where S is an ellipse with a blurred
edge (the integral of a Gaussian). The plane is the illumination, so that uneven light does not
displace the centre. The fit is by least squares; the covariance of the centre is
s^2 (J^T J)^-1, the Cramer-Rao bound for white noise, with the variance s^2 of the residuals. Errors
of neighbouring pixels are correlated, by demosaicing or because the model is not exact. The
covariance is therefore multiplied by the sum of the residuals' autocorrelation (median over the
dots of an image). `MODEL_SIGMA_PX` is added in quadrature.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from reconstruction.arrays import BoolImage, FloatArray

MODEL_SIGMA_PX = 0.007
"""Standard uncertainty of a centre without noise: 0.005 to 0.008 px RMS on rendered dots with sharp
rims (`tests/optics/test_printed_dots.py`)."""
# Half width of the window about a dot: so many radii, but at most this share of the spacing beyond
# the dot's own rim, so that no other dot is in it.
_WINDOW_RADII, _FREE_SHARE = 2.0, 0.85
# A centre that moves by more radii than this from the start belongs to another object.
_FARTHEST = 0.8
# Least ratio of the axes of a dot's ellipse.
_LEAST_AXES = 0.45
_EVALUATIONS = 60
# Sizes of the parameters' changes.
_SCALES = np.array([1.0, 1.0, 0.1, 0.1, 0.1, 0.3, 0.1, 1.0, 0.01, 0.01])
_MOST_CONTRAST, _LARGEST_CONDITION = 1.2, 1e14
# Gel that must be visible around a dot, px.
_RIM_PX = 2
# Largest lag, px, of the autocorrelation of the residuals.
_LAG = 3
# Largest correlation of neighbouring residuals: that of a blur over half of a dot's window.
_MOST_CORRELATION = 0.95
_PARAMETERS = 10


@dataclass(frozen=True, eq=False)
class FittedDots:
    """Dots of one image.

    Attributes
    ----------
    centres_px : (n, 2) row and column; whole numbers are pixel centres
    sigma_px : (n, 2) standard uncertainties of row and column
    radius_px : (n,) geometric mean of the two half axes
    contrast : (n,) 1 - light of the dot over that around it
    """

    centres_px: FloatArray
    sigma_px: FloatArray
    radius_px: FloatArray
    contrast: FloatArray

    def where(self, keep: BoolImage) -> "FittedDots":
        """Return the dots with a True element in `keep` (n,)."""
        return FittedDots(*(values[keep] for values in vars(self).values()))


@dataclass(frozen=True, eq=False)
class _DotFit:
    """Fit of one dot: parameters, covariance for white noise, and residuals in their window."""

    parameters: FloatArray
    variance_px2: FloatArray
    residuals: FloatArray


def fit_dots(
    light: FloatArray, places_px: FloatArray, radius_px: float, spacing_px: float
) -> FittedDots:
    """Return the fitted dots; places without a dot, and dots cut by the border, are left out.

    Parameters
    ----------
    light : (row, col) float, linear image; any unit
    places_px : (n, 2), row and column, approximate centres
    radius_px, spacing_px : approximate radius, and distance of neighbouring dots
    """
    half = min(_WINDOW_RADII * radius_px, _FREE_SHARE * (spacing_px - radius_px))
    half = int(np.ceil(max(half, radius_px + 2.0)))
    tried = [_fitted(light, place, radius_px, half) for place in places_px]
    fits = [fit for fit in tried if fit is not None]
    if not fits:
        return FittedDots(*(np.zeros((0, *shape)) for shape in ((2,), (2,), (), ())))
    correlation = _correlation_sum([fit.residuals for fit in fits])
    values = np.array([fit.parameters for fit in fits])
    return FittedDots(
        centres_px=values[:, :2],
        sigma_px=np.sqrt(
            correlation * np.array([fit.variance_px2 for fit in fits]) + MODEL_SIGMA_PX**2
        ),
        radius_px=np.exp(values[:, 2]),
        contrast=values[:, 6],
    )


def _fitted(light: FloatArray, place_px: FloatArray, radius_px: float, half: int) -> _DotFit | None:
    """Return the fit of the dot at a place; None if there is none, or the border cuts it."""
    middle = np.round(place_px).astype(int)
    whole = int(np.ceil(radius_px)) + _RIM_PX
    if (middle < whole).any() or (middle + whole >= light.shape).any():
        return None
    low, high = np.maximum(middle - half, 0), np.minimum(middle + half + 1, light.shape)
    window = light[low[0] : high[0], low[1] : high[1]]
    around = float(np.percentile(window, 80.0))
    if around <= 0.0:
        return None
    axes = [np.arange(a, b) - at for a, b, at in zip(low, high, place_px, strict=True)]
    y, x = (places.ravel() for places in np.meshgrid(*axes, indexing="ij"))
    start = _start(window, radius_px)

    def residual(p: FloatArray) -> FloatArray:
        return _Dot(p, y, x).light - window.ravel() / around

    done = least_squares(residual, start, lambda p: _Dot(p, y, x).derivatives(), method="lm",
                         max_nfev=_EVALUATIONS, x_scale=_SCALES, ftol=1e-7, xtol=1e-7)  # fmt: skip
    residuals = np.zeros((2 * half + 1, 2 * half + 1))
    first = low - middle + half
    rows, cols = (slice(a, a + n) for a, n in zip(first, window.shape, strict=True))
    residuals[rows, cols] = done.fun.reshape(window.shape)
    return _checked(done.x, done.jac, residuals, start, place_px)


def _start(window: FloatArray, radius_px: float) -> FloatArray:
    start = np.zeros(_PARAMETERS)
    start[2], start[7] = np.log(radius_px), 1.0
    start[6] = float(
        np.clip(1.0 - np.percentile(window, 5.0) / np.percentile(window, 80.0), 0.1, 0.9)
    )
    return start


def _checked(
    p: FloatArray, jacobian: FloatArray, residuals: FloatArray, start: FloatArray, place: FloatArray
) -> _DotFit | None:
    """Return the fit, or None if its dot is not an ellipse of about the expected size and place."""
    sized = abs(p[2] - start[2]) < np.log(2.0) and 0.0 < p[6] < _MOST_CONTRAST
    near = np.hypot(p[0], p[1]) < _FARTHEST * np.exp(start[2])
    round_enough = np.exp(-2.0 * np.hypot(p[3], p[4])) > _LEAST_AXES
    if not (np.isfinite(p).all() and sized and near and round_enough):
        return None
    normal = jacobian.T @ jacobian
    if np.linalg.cond(normal) > _LARGEST_CONDITION:
        return None
    variance = float(np.sum(residuals**2)) / (len(jacobian) - _PARAMETERS)
    centred = np.concatenate([p[:2] + place, p[2:]])
    return _DotFit(centred, variance * np.diag(np.linalg.inv(normal))[:2], residuals)


def _stretch(one: float, other: float) -> FloatArray:
    """Return exp of the matrix [[one, other], [other, -one]], (2, 2); its determinant is 1."""
    length = float(np.hypot(one, other))
    ratio = np.sinh(length) / length if length > 1e-9 else 1.0
    matrix = np.array([[one, other], [other, -one]])
    return np.asarray(np.cosh(length) * np.eye(2) + ratio * matrix)


class _Dot:
    """Light of a dot at pixels, relative to the light around it.

    Parameters
    ----------
    p : row and column of the centre, logarithm of the radius, two components of the stretch,
        logarithm of the blur, contrast, light at the centre and its slopes along row and column
    row, col : (pixel,) places, px
    """

    def __init__(self, p: FloatArray, row: FloatArray, col: FloatArray) -> None:
        self._p, self._y, self._x = p, row - p[0], col - p[1]
        self._radius, self._edge = np.exp(p[2]), np.exp(p[5])
        self._matrix = _stretch(p[3], p[4])
        self._v, self._h = self._mapped(self._matrix)
        self._length = np.maximum(np.hypot(self._v, self._h), 1e-9)
        self._depth = (self._radius - self._length) / self._edge
        self._ink = ndtr(self._depth)
        self._plane = p[7] + p[8] * self._y + p[9] * self._x

    def _mapped(self, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        (a, b), (c, d) = matrix
        return a * self._y + b * self._x, c * self._y + d * self._x

    @property
    def light(self) -> FloatArray:
        """Light at the pixels, (pixel,)."""
        return np.asarray(self._plane * (1.0 - self._p[6] * self._ink))

    def derivatives(self) -> FloatArray:
        """Return the derivatives of the light, (pixel, parameter)."""
        p, kept = self._p, 1.0 - self._p[6] * self._ink
        rim = np.exp(-0.5 * self._depth**2) / np.sqrt(2.0 * np.pi)
        by_depth = -self._plane * p[6] * rim / self._edge
        columns = [-by_depth * self._along(-self._matrix[:, k]) - p[8 + k] * kept for k in (0, 1)]
        columns.append(by_depth * self._radius)
        columns += [-by_depth * self._along(self._mapped(self._turned(k))) for k in (3, 4)]
        columns.append(-by_depth * self._depth * self._edge)
        columns.append(-self._plane * self._ink)
        columns += [kept, kept * self._y, kept * self._x]
        return np.stack(columns, axis=-1)

    def _along(self, change: Any) -> FloatArray:
        """Return the derivative of the length for a change of the mapped offset."""
        return np.asarray((self._v * change[0] + self._h * change[1]) / self._length)

    def _turned(self, k: int) -> FloatArray:
        """Return the derivative of the stretch's matrix by its component: a central difference."""
        step = np.array([1e-5, 0.0]) if k == 3 else np.array([0.0, 1e-5])
        here = self._p[3:5]
        return (_stretch(*(here + step)) - _stretch(*(here - step))) / 2e-5


def _correlation_sum(residuals: list[FloatArray]) -> float:
    """Return the sum of the residuals' autocorrelation over all lags, at least 1.

    It is the larger of two estimates, both medians over the dots, because at the edge of a contact
    the light is far from a plane. The first one is the sum over lags up to 3 px. It contains errors
    of the model, but it is too low for correlated noise, because the fit has removed slow errors
    from the small windows. The second one is for such noise: the autocorrelation is taken as the
    Gaussian function exp(-lag^2 / (4 s^2)) with the measured value at 1 px; its sum is 4 pi s^2.

    Parameters
    ----------
    residuals : windows of one size; 0 at pixels outside the image
    """
    stack = np.stack(residuals)
    inside = (stack != 0.0).astype(np.float64)
    variance = np.sum(stack**2, axis=(1, 2)) / np.sum(inside, axis=(1, 2))
    lags = [(down, right) for down in range(-_LAG, _LAG + 1) for right in range(-_LAG, _LAG + 1)]
    at = {lag: _products(stack, lag) / _products(inside, lag) / variance for lag in lags}
    summed = float(np.median(sum(at.values())))
    next_to = float(np.median((at[0, 1] + at[1, 0]) / 2.0)) + _PARAMETERS / stack[0].size
    gaussian = -np.pi / np.log(np.clip(next_to, 1e-9, _MOST_CORRELATION))
    return max(summed, float(gaussian), 1.0)


def _products(stack: FloatArray, lag: tuple[int, int]) -> FloatArray:
    """Return the sum of the products of each image's pixels with those at a lag, (image,)."""
    padded = np.pad(stack, ((0, 0), (_LAG, _LAG), (_LAG, _LAG)))
    return np.asarray(np.sum(padded * np.roll(padded, lag, axis=(1, 2)), axis=(1, 2)))
