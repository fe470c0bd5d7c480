"""Surface elements of one patch: polynomials of x and y fitted to each small window of pixels.

Over a window of 7 x 7 pixels round (x0, y0) two polynomials of dx = x - x0 and dy = y - y0 are
fitted to z in the frame of the sensor, by least squares with the weights 1 / sigma_z^2:

- a cubic one for the height. The slope of a quadratic one is wrong by 7 px^2 / 6 d^3z/dx^3. Between
  two pixels this is an error of height that looks like a displacement; it would be alike in all
  overlaps of a regular path and add up to a drift;
- a quadratic one for the slopes, with a third of the noise of the cubic one. The slopes are needed
  only for the derivatives of a distance: an error of a few per cent does not displace the optimum.

(A plane through neighbouring points is wrong by the curvature, and its slope has ten times the
noise.) There is an element at every pixel, so that it is evaluated near its centre only. Elements
whose windows do not overlap are marked `is_apart`: errors of neighbouring pixels, which the filter
of the decoder correlates, do not link them.

Windows with a pixel without a point are left out, and those that the quadratic surface does not
fit: edges, steps and points with a wrong fringe order.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError
from reconstruction.triangulation import PointMap

WINDOW_PX = 7
MOST_PIXELS = 20_000
"""Pixels of one patch; of larger images every second, third, ... row and column is used."""
MOST_MISFIT = 5.0
"""Largest mean square of the residuals of a window, over the median of all windows."""
_CUBIC, _QUADRATIC = 3, 2


@dataclass(frozen=True, eq=False)
class FittedPolynomials:
    """Polynomials of dx and dy in mm, one for each element; the terms are those of `_basis`.

    Parameters
    ----------
    coefficients : (element, term), the term dx^p dy^q in mm^(1 - p - q)
    covariance : (element, term, term) covariance for independent errors of the points
    """

    coefficients: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class SurfaceElements:
    """Quadratic surface elements of one patch, in the frame of the sensor.

    Parameters
    ----------
    centres_mm : (element, 2) x0 and y0
    cubic, quadratic : fitted polynomials, the first for heights and the second for slopes
    is_apart : (element,) bool, elements whose windows do not overlap
    reach_mm : largest distance from the centre at which an element is evaluated
    """

    centres_mm: FloatArray
    cubic: FittedPolynomials
    quadratic: FittedPolynomials
    is_apart: BoolImage
    reach_mm: float

    @property
    def points_mm(self) -> FloatArray:
        """Points of the surface at the centres, (element, xyz)."""
        return np.column_stack([self.centres_mm, self.cubic.coefficients[:, 0]])

    @property
    def variance_mm2(self) -> FloatArray:
        """Variances of the heights at the centres, (element,)."""
        return self.cubic.covariance[:, 0, 0]


@dataclass(frozen=True, eq=False)
class SurfaceValues:
    """Heights and slopes of elements at given places.

    Parameters
    ----------
    z_mm : (n,) height
    variance_mm2 : (n,) variance of the height
    slopes : (n, 2) dz/dx and dz/dy
    slope_covariance : (n, 2, 2) covariance of the slopes
    """

    z_mm: FloatArray
    variance_mm2: FloatArray
    slopes: FloatArray
    slope_covariance: FloatArray


def surface_elements(points: PointMap) -> SurfaceElements:
    """Fit the surface elements of a patch.

    Raises
    ------
    InputError : no window of 7 x 7 pixels has a point and a standard deviation at every pixel
    """
    step = max(1, int(np.ceil(np.sqrt(points.valid.size / MOST_PIXELS))))
    world, sigma = points.points_world_mm[::step, ::step], points.sigma_z_mm[::step, ::step]
    whole = _windows(points.valid[::step, ::step] & (sigma > 0.0)).all(axis=-1)
    if not whole.any():
        raise InputError(
            f"scan: a patch has no {WINDOW_PX} x {WINDOW_PX} neighbouring pixels with points; "
            "look at its mask's reasons"
        )
    x, y, z = (_windows(axis)[whole] for axis in np.moveaxis(world, -1, 0))
    apart = np.zeros_like(whole)
    apart[::WINDOW_PX, ::WINDOW_PX] = True
    return _fitted(x, y, z, _windows(sigma)[whole], apart[whole])


def values_at(elements: SurfaceElements, which: FloatArray, xy_mm: FloatArray) -> SurfaceValues:
    """Evaluate elements (n,), one at each place (n, 2)."""
    dx, dy = (xy_mm - elements.centres_mm[which]).T
    height, slope = elements.cubic, elements.quadratic
    powers = _basis(dx, dy, _CUBIC)
    along = np.stack(_derivatives(dx, dy), axis=-2)
    return SurfaceValues(
        np.einsum("nk,nk->n", powers, height.coefficients[which]),
        np.einsum("nk,nkl,nl->n", powers, height.covariance[which], powers),
        np.einsum("nsk,nk->ns", along, slope.coefficients[which]),
        np.einsum("nsk,nkl,ntl->nst", along, slope.covariance[which], along),
    )


def _windows(image: NDArray[Any]) -> NDArray[Any]:
    """Return the pixels of every window, (row, col, 49)."""
    size = (WINDOW_PX, WINDOW_PX)
    if min(image.shape) < WINDOW_PX:
        return np.zeros((0, 0, WINDOW_PX**2), image.dtype)
    seen = sliding_window_view(image, size)
    return seen.reshape(*seen.shape[:2], -1)


def _exponents(degree: int) -> list[tuple[int, int]]:
    """Return the exponents of dx and dy of all terms up to a degree, by increasing degree."""
    return [(total - q, q) for total in range(degree + 1) for q in range(total + 1)]


def _basis(dx: FloatArray, dy: FloatArray, degree: int) -> FloatArray:
    """Return the terms dx^p dy^q of a polynomial, (..., term)."""
    return np.stack([dx**p * dy**q for p, q in _exponents(degree)], axis=-1)


def _derivatives(dx: FloatArray, dy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the terms of a quadratic polynomial by dx and dy."""
    one, none = np.ones_like(dx), np.zeros_like(dx)
    return (
        np.stack([none, one, none, 2.0 * dx, dy, none], axis=-1),
        np.stack([none, none, one, none, dx, 2.0 * dy], axis=-1),
    )


def _fitted(
    x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], sigma: NDArray[Any], apart: BoolImage
) -> SurfaceElements:
    """Fit the elements of windows (window, 49) of coordinates and standard deviations, mm."""
    x, y, z, sigma = (values.astype(np.float64) for values in (x, y, z, sigma))
    centres = np.column_stack([x.mean(axis=1), y.mean(axis=1)])
    dx, dy = x - centres[:, :1], y - centres[:, 1:]
    half_mm = float(np.median(np.maximum(np.abs(dx).max(axis=1), np.abs(dy).max(axis=1))))
    # In units of half a window, so that the normal equations are well-conditioned.
    at = (dx / half_mm, dy / half_mm, z, 1.0 / sigma**2)
    quadratic, misfit = _least_squares(*at, _QUADRATIC)
    cubic, _ = _least_squares(*at, _CUBIC)
    fits = misfit <= MOST_MISFIT * np.median(misfit)
    # Half a window is three pixels: beyond half of it the nearest element is at an edge or a gap.
    reach_mm = 0.5 * half_mm
    return SurfaceElements(
        centres[fits],
        _in_mm(cubic, half_mm, _CUBIC, fits),
        _in_mm(quadratic, half_mm, _QUADRATIC, fits),
        apart[fits],
        reach_mm,
    )


def _least_squares(
    dx: FloatArray, dy: FloatArray, z: FloatArray, weight: FloatArray, degree: int
) -> tuple[FittedPolynomials, FloatArray]:
    """Fit windows (window, 49); return also the weighted mean square of each window's residuals."""
    basis = _basis(dx, dy, degree)
    weighted = np.swapaxes(basis * weight[..., np.newaxis], 1, 2)
    covariance: FloatArray = np.asarray(np.linalg.inv(weighted @ basis), np.float64)
    c = covariance @ (weighted @ z[..., np.newaxis])
    misfit = (weight * (z - (basis @ c)[..., 0]) ** 2).mean(axis=1)
    return FittedPolynomials(c[..., 0], covariance), misfit


def _in_mm(
    fitted: FittedPolynomials, unit_mm: float, degree: int, kept: BoolImage
) -> FittedPolynomials:
    """Return kept polynomials of dx and dy in mm, from those in another unit."""
    unit = np.array([unit_mm ** -(p + q) for p, q in _exponents(degree)])
    return FittedPolynomials(
        fitted.coefficients[kept] * unit,
        fitted.covariance[kept] * (unit[:, np.newaxis] * unit),
    )
