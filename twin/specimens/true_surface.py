"""True surface of a specimen in its final position: the reference for a measured surface.

World frame, mm. A distance is in closed form if the shape has one, otherwise the exact distance to
its triangles. The interpolated distance of `sampled_distance` is not used: it rounds edges.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray
from twin.shape import Shape
from twin.specimens.catalogue import Assembly
from twin.specimens.meshes import MeshShape
from twin.specimens.triangles import Columns, TriangleTree, distances_mm

# Mean number of facets over a cell of the grid in plan; a point is tested against all of them.
_FACETS_PER_CELL = 8
_REACH_MM = 1e6


@dataclass(frozen=True, eq=False)
class TrueSurface:
    """A specimen's surface, raised from first touch to its final height, and offset by a skin.

    Attributes
    ----------
    shape : shape at first touch, with its foremost point at z = 0
    raised_mm : final world z of the foremost point
    skin_mm : thickness of the layer between the specimen and the measured face; points at this
        distance from the specimen have distance 0
    """

    shape: Shape
    raised_mm: float
    skin_mm: float = 0.0

    def distance_mm(self, points_mm: FloatArray) -> FloatArray:
        """Return the signed distance (n,), mm, of points (n, xyz), mm, positive outside."""
        local = points_mm - np.array([0.0, 0.0, self.raised_mm])
        distances = [part.distance_mm(local) for part in self._parts]
        return np.asarray(np.min(distances, axis=0) - self.skin_mm)

    def heights_mm(self, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
        """Return world z, mm, of the upper side at (row y, column x); -inf outside the specimen."""
        return self.raised_mm - self.shape.height_above_lowest(x_mm, y_mm)

    @cached_property
    def _parts(self) -> "list[_Closed | _Facets]":
        return [_part(leaf) for leaf in _leaves(self.shape)]


def _leaves(shape: Shape) -> list[Shape]:
    if not isinstance(shape, Assembly):
        return [shape]
    return [leaf for part in shape.parts for leaf in _leaves(part)]


@dataclass(frozen=True, eq=False)
class _Closed:
    """A shape that has a closed form of its distance."""

    shape: Shape

    def distance_mm(self, points_mm: FloatArray) -> FloatArray:
        distances = [body.evaluate(points_mm, _REACH_MM)[0] for body in self.shape.distances()]
        return np.asarray(np.min(distances, axis=0))


@dataclass(frozen=True, eq=False)
class _Facets:
    """A closed mesh, with the search structures for its exact distance."""

    tree: TriangleTree
    columns: Columns

    @classmethod
    def of(cls, corners_mm: FloatArray) -> "_Facets":
        ends = corners_mm.reshape(-1, 3)[:, :2]
        outline = float(np.prod(np.ptp(ends, axis=0)))
        cell = np.sqrt(_FACETS_PER_CELL * outline / len(corners_mm))
        low = np.floor(ends.min(axis=0) / cell).astype(np.int64)
        count = np.floor(ends.max(axis=0) / cell).astype(np.int64) + 1 - low
        return cls(TriangleTree.of(corners_mm), Columns.of(corners_mm, 1, cell, low, count))

    def distance_mm(self, points_mm: FloatArray) -> FloatArray:
        distances = distances_mm(self.tree, points_mm)
        under = self._over(points_mm)
        inside = self.columns.inside(points_mm[under])
        distances[np.flatnonzero(under)[inside]] *= -1
        return distances

    def _over(self, points_mm: FloatArray) -> BoolImage:
        """Return whether each point (n,) is, in plan, within the rectangle of `columns`."""
        cells = np.floor(points_mm[:, :2] / self.columns.pitch_mm) - self.columns.low
        return np.asarray(np.all((cells >= 0) & (cells < self.columns.count), axis=1))


def _part(shape: Shape) -> _Closed | _Facets:
    if isinstance(shape, MeshShape) and shape.exact is None:
        return _Facets.of(np.ascontiguousarray(shape.surface.triangles, np.float64))
    return _Closed(shape)
