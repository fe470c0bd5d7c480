"""Specimens as triangle meshes.

The upper side of a mesh as a height map is computed with vertical rays, exactly at each grid point.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from twin.shape import UNMOVED, Placement, Shape, SignedDistance
from twin.specimens.solids import along_axis, prism, rounded_box

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, eq=False)
class MeshShape(Shape):
    """Shape of a specimen that is a closed surface of triangles."""

    #: the surface in its original frame
    body: "trimesh.Trimesh"
    #: rigid motion from the original frame
    pose: Placement = UNMOVED
    #: function that returns the closed-form distance of the body in a pose; None: sampled distance
    exact: Callable[[Placement], SignedDistance] | None = None

    @cached_property
    def surface(self) -> "trimesh.Trimesh":
        """The surface in its pose."""
        moved = self.body.copy()
        moved.apply_transform(self.pose.matrix)
        return moved

    @property
    def top_mm(self) -> float:
        """Height of the foremost vertex."""
        return float(self.surface.bounds[1, 2])

    @property
    def bottom_mm(self) -> float:
        """Height of the lowest vertex."""
        return float(self.surface.bounds[0, 2])

    def placed(self, pose: Placement) -> "MeshShape":
        """Return the shape moved by a rigid motion."""
        return replace(self, pose=self.pose.then(pose))

    def distances(self) -> tuple[SignedDistance, ...]:
        """Return the signed distance to the surface, the only body of this shape."""
        from twin.specimens.sampled_distance import MeshDistance

        return (self.exact(self.pose) if self.exact else MeshDistance(self.body, self.pose),)

    def bounds_mm(self) -> tuple[float, float, float, float]:
        """Return the bounds in world xy, mm: (x low, x high, y low, y high)."""
        (x_low, y_low, _), (x_high, y_high, _) = self.surface.bounds
        return float(x_low), float(x_high), float(y_low), float(y_high)

    def height_above_lowest(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return the distance (row, col), mm, of the upper side behind the touched plane.

        It is inf outside the outline of the surface.
        """
        return -upper_side(np.asarray(self.surface.triangles), x_mm, y_mm)

    def mesh(self, touched_z_mm: float) -> "trimesh.Trimesh":
        """Return the surface in its pose, shifted by `touched_z_mm` along z."""
        raised = self.surface.copy()
        raised.apply_translation((0.0, 0.0, touched_z_mm))
        return raised


def block(
    low_mm: tuple[float, float, float], high_mm: tuple[float, float, float], edge_radius_mm: float
) -> MeshShape:
    """Return a block with rounded edges between two opposite corners (xyz)."""
    low, high = np.array(low_mm), np.array(high_mm)

    def exact(pose: Placement) -> SignedDistance:
        from twin.specimens.distance import BoxDistance

        middle = pose.apply((low + high) / 2)
        return BoxDistance(middle, pose.rotation, (high - low) / 2, edge_radius_mm)

    return MeshShape(rounded_box(low_mm, high_mm, edge_radius_mm), exact=exact)


def uniform_along_y(outline_xz_mm: Sequence[tuple[float, float]], length_y_mm: float) -> MeshShape:
    """Return the body with a constant outline along y, centred on y = 0.

    The outline is a list of points (x, z), counter-clockwise with x to the right and z up.
    """
    x, y, z = np.eye(3)
    upright = prism(np.array(outline_xz_mm), -length_y_mm / 2, length_y_mm / 2)
    return MeshShape(along_axis(upright, x, z, -y))


# Number of rays per batch, which limits the memory for a mesh with few large triangles.
_BATCH = 2_000_000
# A ray through an edge belongs to both triangles, so that no gap opens between them.
_ON_EDGE_MM = 1e-9
# Triangles with a smaller area in plan are vertical and are left out: their neighbours define the
# outline.
_EDGE_ON_MM2 = 1e-14


def upper_side(triangles_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return the highest z of a mesh over each point of a grid.

    Parameters
    ----------
    triangles_mm : (n, 3, xyz) float, mm; corners
    x_mm, y_mm : (col,) and (row,) float, mm; grid lines in any order

    Returns
    -------
    (row, col) float, mm; -inf if the vertical ray has no hit
    """
    order_x, order_y = np.argsort(x_mm, kind="stable"), np.argsort(y_mm, kind="stable")
    sorted_x, sorted_y = x_mm[order_x], y_mm[order_y]
    triangles = triangles_mm[np.abs(_doubled_area(triangles_mm)) > 2 * _EDGE_ON_MM2]
    owner, row = _expanded(*_covered(sorted_y, *_limits(triangles[..., 1])))
    low, high = _crossing(triangles[owner], sorted_y[row])
    first, count = _covered(sorted_x, low, high)
    top = np.full((y_mm.size, x_mm.size), -np.inf)
    cuts = np.flatnonzero(np.diff(np.cumsum(count) // _BATCH)) + 1
    for scan in np.split(np.arange(owner.size), cuts):
        which, col = _expanded(first[scan], count[scan])
        which = scan[which]
        z = _height(triangles[owner[which]], sorted_x[col], sorted_y[row[which]])
        np.maximum.at(top, (row[which], col), z)
    highest = np.zeros_like(top)
    highest[np.ix_(order_y, order_x)] = top
    return highest


def _doubled_area(triangles: FloatArray) -> FloatArray:
    """Return twice the signed area (n,), mm^2, of triangles projected on the xy plane."""
    ab, ac = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])


def _limits(values_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    return values_mm.min(axis=1), values_mm.max(axis=1)


def _covered(
    lines_mm: FloatArray, low_mm: FloatArray, high_mm: FloatArray
) -> tuple[IntArray, IntArray]:
    """Return the number of the first grid line in each interval, and how many lines are in it."""
    first = np.searchsorted(lines_mm, low_mm - _ON_EDGE_MM, side="left")
    after = np.searchsorted(lines_mm, high_mm + _ON_EDGE_MM, side="right")
    return first, np.maximum(after - first, 0)


def _expanded(first: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Return the numbers of interval and grid line for all grid lines of all intervals.

    Interval n contains the grid lines from first[n] to first[n] + count[n] - 1.
    """
    owner = np.repeat(np.arange(first.size), count)
    within = np.arange(owner.size) - np.repeat(np.cumsum(count) - count, count)
    return owner, first[owner] + within


def _crossing(triangles: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest x (n,), mm, of each triangle on its line y = `y_mm`."""
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


def _height(triangles: FloatArray, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Return z (n,), mm, of each triangle's plane at a point, limited to the triangle's own z."""
    a = triangles[:, 0]
    ab, ac = triangles[:, 1] - a, triangles[:, 2] - a
    dx, dy = x_mm - a[:, 0], y_mm - a[:, 1]
    along_ab = dx * ac[:, 1] - dy * ac[:, 0]
    along_ac = dy * ab[:, 0] - dx * ab[:, 1]
    rise = (along_ab * ab[:, 2] + along_ac * ac[:, 2]) / _doubled_area(triangles)
    return np.asarray(np.clip(a[:, 2] + rise, *_limits(triangles[..., 2])))
