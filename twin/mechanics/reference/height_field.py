"""A specimen's height field at scattered points, with slopes and curvatures.

Specimens answer on grids only; finite elements ask anywhere. Sampled once, then bicubic.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline

from reconstruction.arrays import FloatArray
from twin.mechanics.control import BoolArray
from twin.mechanics.errors import PressError
from twin.specimens import Shape

_LARGEST_GRID = 800
_FINEST_PITCH_MM = 0.02
# Beside the specimen the surface is continued for so many cells, out of the spline's reach.
_REACH_CELLS = 2


@dataclass(frozen=True)
class HeightField:
    """Height behind the foremost point, sampled on a grid."""

    x_mm: FloatArray
    y_mm: FloatArray
    #: (row, col) mm, inf where absent
    height_mm: FloatArray

    def value(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the height at points (n,), inf beside the specimen."""
        height = np.asarray(self._spline.ev(y_mm, x_mm), dtype=np.float64)
        return np.where(self._is_present(x_mm, y_mm), height, np.inf)

    def slope(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return (n, [x, y]) first derivatives; continued smoothly beside the specimen."""
        along = [self._spline.ev(y_mm, x_mm, dx=dy, dy=dx) for dx, dy in ((1, 0), (0, 1))]
        return np.stack(along, axis=-1)

    def curvature(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return (n, [x, y], [x, y]) second derivatives."""
        xx, xy, yy = (
            self._spline.ev(y_mm, x_mm, dx=dy, dy=dx) for dx, dy in ((2, 0), (1, 1), (0, 2))
        )
        return np.stack((np.stack((xx, xy), axis=-1), np.stack((xy, yy), axis=-1)), axis=-1)

    def _is_present(self, x_mm: FloatArray, y_mm: FloatArray) -> BoolArray:
        row = np.clip(np.searchsorted(self.y_mm, y_mm) - 1, 0, self.y_mm.size - 2)
        col = np.clip(np.searchsorted(self.x_mm, x_mm) - 1, 0, self.x_mm.size - 2)
        known = np.isfinite(self.height_mm)
        whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
        within = (x_mm >= self.x_mm[0]) & (x_mm <= self.x_mm[-1])
        within &= (y_mm >= self.y_mm[0]) & (y_mm <= self.y_mm[-1])
        return np.asarray(whole[row, col] & within)

    @cached_property
    def _spline(self) -> RectBivariateSpline:
        absent = ~np.isfinite(self.height_mm)
        nearest = ndimage.distance_transform_edt(
            absent, return_distances=False, return_indices=True
        )
        return RectBivariateSpline(self.y_mm, self.x_mm, self.height_mm[tuple(nearest)])


def sample(shape: Shape, length_x_mm: float, length_y_mm: float) -> HeightField:
    """Sample a specimen over a centred rectangle, as finely as 800 cells per axis allow.

    Raises
    ------
    PressError : the specimen lies beside the rectangle
    """
    x_low, x_high, y_low, y_high = shape.bounds_mm()
    x = _axis(max(x_low, -length_x_mm / 2), min(x_high, length_x_mm / 2))
    y = _axis(max(y_low, -length_y_mm / 2), min(y_high, length_y_mm / 2))
    height = shape.height_above_lowest(x, y) if x.size and y.size else np.full((1, 1), np.inf)
    if not np.isfinite(height).any():
        raise PressError("specimen: lies beside the pad's touched face; move it")
    return HeightField(x, y, height)


def _axis(low: float, high: float) -> FloatArray:
    """Return sample positions from a little below `low` to a little above `high`."""
    if high <= low:
        return np.zeros(0)
    pitch = max((high - low) / _LARGEST_GRID, _FINEST_PITCH_MM)
    half = np.ceil((high - low) / 2 / pitch) + _REACH_CELLS
    return (low + high) / 2 + pitch * np.arange(-half, half + 1)
