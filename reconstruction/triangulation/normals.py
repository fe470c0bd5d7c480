"""Normals of a measured surface from the differences of points at neighbouring camera pixels.

A tangent along image rows and a tangent along image columns each join the neighbours on both sides
of a pixel, or the pixel and its only neighbour. Their cross product is the normal. A difference
that is longer than `LONGEST_OVER_TYPICAL` times the median one crosses a jump in height and is
left out. With a pitch p of the points and a standard deviation s of their heights, the standard
deviation of a slope is s / (sqrt(2) p) between two neighbours and sqrt(2) s / p with one, as far as
the errors of these points are independent.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatImage

LONGEST_OVER_TYPICAL = 5.0
# The arrays of a band fit the cache; the normals do not depend on it.
_BAND_ROWS = 64

Floats = NDArray[np.floating[Any]]


def surface_normals(points_mm: Floats, valid: BoolImage) -> FloatImage:
    """Return the unit normals of a surface, (row, col, xyz) float32, towards the camera.

    Parameters
    ----------
    points_mm : (row, col, xyz) points in any frame, in which the normals are returned
    valid : (row, col) bool, whether the pixel has a point

    Returns
    -------
    (0, 0, 0) where a pixel has no point, or no valid neighbour without a jump in height to it along
    its row or along its column
    """
    rows = len(valid)
    normals = np.zeros((*valid.shape, 3), np.float32)
    longest_mm = LONGEST_OVER_TYPICAL * _typical_mm(points_mm, valid)
    for first in range(0, rows, _BAND_ROWS):
        above, last = max(first - 1, 0), min(first + _BAND_ROWS, rows)
        band = np.s_[above : min(last + 1, rows)]
        normal = _normals_of_band(points_mm[band], valid[band], longest_mm)
        normals[first:last] = normal[first - above :][: last - first]
    return normals


def _typical_mm(points_mm: Floats, valid: BoolImage) -> float:
    """Return the median distance, mm, of valid points at adjacent pixels of a row; 0 without any.

    At most about 200 rows are read.
    """
    step = max(len(valid) // 100, 1)
    points, known = points_mm[::step], valid[::step]
    both = known[:, 1:] & known[:, :-1]
    distances = np.linalg.norm((points[:, 1:] - points[:, :-1])[both], axis=-1)
    return float(np.median(distances)) if len(distances) else 0.0


def _normals_of_band(points_mm: Floats, valid: BoolImage, longest_mm: float) -> FloatImage:
    x, y, z = np.ascontiguousarray(np.moveaxis(points_mm, -1, 0), np.float32)
    right = _tangents((x, y, z), valid, longest_mm)
    down = _tangents((x.T, y.T, z.T), valid.T, longest_mm)
    (a, b, c), (d, e, f) = (item.T for item in down), right
    # Rows run down and the camera looks along the rays: down x right is towards the camera.
    crossed = b * f - c * e, c * d - a * f, a * e - b * d
    lengths = np.sqrt(sum(item * item for item in crossed))
    scale = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0)
    return np.stack([item * scale for item in crossed], axis=-1)


def _tangents(
    axes: tuple[FloatImage, FloatImage, FloatImage], valid: BoolImage, longest_mm: float
) -> list[FloatImage]:
    """Return the sums (x, y, z) of the differences to the neighbours in columns on both sides."""
    steps = [values[:, 1:] - values[:, :-1] for values in axes]
    used = valid[:, 1:] & valid[:, :-1]
    used &= sum(step * step for step in steps) <= np.float32(longest_mm**2)
    tangents = [np.zeros_like(values) for values in axes]
    for tangent, step in zip(tangents, steps, strict=True):
        step *= used
        tangent[:, 1:] += step
        tangent[:, :-1] += step
    return tangents
