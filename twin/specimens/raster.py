"""The upper side of a triangle mesh as a height map: vertical rays, exact at every cell."""

import numpy as np

from reconstruction.arrays import FloatArray, IntArray

# Rays per batch: bounds the memory of a mesh with few large triangles.
_BATCH = 2_000_000
# A ray through an edge belongs to both triangles, so that no gap opens between them.
_ON_EDGE_MM = 1e-9
# Triangles of less area seen from above stand upright: their neighbours carry the outline.
_EDGE_ON_MM2 = 1e-14


def upper_side(triangles_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return the highest z of a mesh over each point of a grid.

    Parameters
    ----------
    triangles_mm : (n, 3, xyz) float, mm; corners
    x_mm, y_mm : (col,) and (row,) float, mm; grid lines in any order

    Returns
    -------
    (row, col) float, mm; -inf where no triangle is met
    """
    order_x, order_y = np.argsort(x_mm, kind="stable"), np.argsort(y_mm, kind="stable")
    sorted_x, sorted_y = x_mm[order_x], y_mm[order_y]
    triangles = triangles_mm[np.abs(_doubled_area(triangles_mm)) > 2 * _EDGE_ON_MM2]
    owner, row = _expanded(*_covered(sorted_y, *_limits(triangles[..., 1])))
    low, high = _crossing(triangles[owner], sorted_y[row])
    first, count = _covered(sorted_x, low, high)
    top = np.full((y_mm.size, x_mm.size), -np.inf)
    for scan in np.split(np.arange(owner.size), _cuts(count)):
        which, col = _expanded(first[scan], count[scan])
        which = scan[which]
        z = _height(triangles[owner[which]], sorted_x[col], sorted_y[row[which]])
        np.maximum.at(top, (row[which], col), z)
    found = np.zeros_like(top)
    found[np.ix_(order_y, order_x)] = top
    return found


def _doubled_area(triangles: FloatArray) -> FloatArray:
    """Return twice the signed area seen from above."""
    ab, ac = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    area: FloatArray = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    return area


def _limits(values_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    return values_mm.min(axis=1), values_mm.max(axis=1)


def _covered(
    lines_mm: FloatArray, low_mm: FloatArray, high_mm: FloatArray
) -> tuple[IntArray, IntArray]:
    """Return the first grid line within each interval, and how many there are."""
    first = np.searchsorted(lines_mm, low_mm - _ON_EDGE_MM, side="left")
    after = np.searchsorted(lines_mm, high_mm + _ON_EDGE_MM, side="right")
    return first, np.maximum(after - first, 0)


def _expanded(first: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Return owner and grid line of every member of intervals first..first + count - 1."""
    owner = np.repeat(np.arange(first.size), count)
    within = np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count)
    return owner, first[owner] + within


def _crossing(triangles: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the line y = const enters and leaves each triangle, along x."""
    begin, end = triangles[..., :2], np.roll(triangles, -1, axis=1)[..., :2]
    rise = end[..., 1] - begin[..., 1]
    level = np.abs(rise) <= _ON_EDGE_MM
    share = (y_mm[:, None] - begin[..., 1]) / np.where(level, 1.0, rise)
    x = begin[..., 0] + np.clip(share, 0, 1) * (end[..., 0] - begin[..., 0])
    slack = _ON_EDGE_MM / np.maximum(np.abs(rise), _ON_EDGE_MM)
    met = ~level & (share >= -slack) & (share <= 1 + slack)
    return (
        np.where(met, x, np.inf).min(axis=1, initial=np.inf),
        np.where(met, x, -np.inf).max(axis=1, initial=-np.inf),
    )


def _cuts(rays: IntArray) -> IntArray:
    return np.flatnonzero(np.diff(np.cumsum(rays) // _BATCH)) + 1


def _height(triangles: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return z of each triangle's plane, within the triangle's own z."""
    a = triangles[:, 0]
    ab, ac = triangles[:, 1] - a, triangles[:, 2] - a
    dx, dy = x_mm - a[:, 0], y_mm - a[:, 1]
    along_ab = dx * ac[:, 1] - dy * ac[:, 0]
    along_ac = dy * ab[:, 0] - dx * ab[:, 1]
    rise = (along_ab * ab[:, 2] + along_ac * ac[:, 2]) / _doubled_area(triangles)
    z: FloatArray = np.clip(a[:, 2] + rise, *_limits(triangles[..., 2]))
    return z
