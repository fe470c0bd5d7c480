"""Surface elements of one patch: a quadratic surface fitted to each small window of pixels.

Over a window of 7 x 7 pixels round (x0, y0) the height in the frame of the sensor is

    z = c0 + c1 dx + c2 dy + c3 dx^2 / 2 + c4 dx dy + c5 dy^2 / 2,   dx = x - x0, dy = y - y0,

by least squares with the weights 1 / sigma_z^2. Value and slope are exact for a quadratic surface,
so an element can be compared with a point between the pixels. (A plane through neighbouring points
is wrong by the curvature, and its slope has ten times the noise.) There is an element
at every pixel, so that it is evaluated near its centre only. Elements whose windows do not overlap
are marked `is_apart`: errors of neighbouring pixels, which the filter of the decoder correlates, do
not link them.

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
_TERMS = 6


@dataclass(frozen=True, eq=False)
class SurfaceElements:
    """Quadratic surface elements of one patch, in the frame of the sensor.

    Parameters
    ----------
    centres_mm : (element, 2) x0 and y0
    coefficients : (element, 6) c0 to c5: mm, 1, 1, 1/mm, 1/mm, 1/mm
    covariance : (element, 6, 6) covariance of the coefficients for independent errors of the points
    is_apart : (element,) bool, elements whose windows do not overlap
    reach_mm : largest distance from the centre at which an element is evaluated
    """

    centres_mm: FloatArray
    coefficients: FloatArray
    covariance: FloatArray
    is_apart: BoolImage
    reach_mm: float

    @property
    def points_mm(self) -> FloatArray:
        """Points of the surface at the centres, (element, xyz)."""
        return np.column_stack([self.centres_mm, self.coefficients[:, 0]])


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
    value, along_x, along_y = _bases(dx, dy)
    c, covariance = elements.coefficients[which], elements.covariance[which]
    slopes = np.stack([along_x, along_y], axis=-2)
    return SurfaceValues(
        np.einsum("nk,nk->n", value, c),
        np.einsum("nk,nkl,nl->n", value, covariance, value),
        np.einsum("nsk,nk->ns", slopes, c),
        np.einsum("nsk,nkl,ntl->nst", slopes, covariance, slopes),
    )


def _windows(image: NDArray[Any]) -> NDArray[Any]:
    """Return the pixels of every window, (row, col, 49)."""
    size = (WINDOW_PX, WINDOW_PX)
    if min(image.shape) < WINDOW_PX:
        return np.zeros((0, 0, WINDOW_PX**2), image.dtype)
    seen = sliding_window_view(image, size)
    return seen.reshape(*seen.shape[:2], -1)


def _bases(dx: FloatArray, dy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of height and of both slopes by the coefficients, each (..., 6)."""
    one, none = np.ones_like(dx), np.zeros_like(dx)
    return (
        np.stack([one, dx, dy, 0.5 * dx**2, dx * dy, 0.5 * dy**2], axis=-1),
        np.stack([none, one, none, dx, dy, none], axis=-1),
        np.stack([none, none, one, none, dx, dy], axis=-1),
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
    basis, _, _ = _bases(dx / half_mm, dy / half_mm)
    weight = 1.0 / sigma**2
    weighted = np.swapaxes(basis * weight[..., np.newaxis], 1, 2)
    covariance = np.linalg.inv(weighted @ basis)
    c = (covariance @ (weighted @ z[..., np.newaxis]))[..., 0]
    misfit = (weight * (z - (basis @ c[..., np.newaxis])[..., 0]) ** 2).mean(axis=1)
    fits = misfit <= MOST_MISFIT * np.median(misfit)
    unit = half_mm ** -np.array([0.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    covariance *= unit[:, np.newaxis] * unit
    # Half a window is three pixels: beyond half of it the nearest element is at an edge or a gap.
    reach_mm = 0.5 * half_mm
    return SurfaceElements(centres[fits], (c * unit)[fits], covariance[fits], apart[fits], reach_mm)
