"""Which lattice nodes lie inside a closed triangle mesh: where its surface winds round them.

Seen along z from above a node, as many facets look up as down where it is outside. Needles and
shared edges do no harm to that, as they would to a sign taken from normals; bodies that overlap
within one mesh are joined. Nodes, cells and pitch as in `triangle_distance`.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, IntArray
from twin.specimens.distance import compiled
from twin.specimens.triangle_distance import over_bands

# A node's column leaves the lattice by this many pitches, so that it meets no edge: not by a ratio
# that a designer's dimensions would have.
_ASIDE = (0.6180339e-6, 0.4142135e-6)


@dataclass(frozen=True, eq=False)
class Columns:
    """The triangles above or below each cell of a rectangle of cells."""

    #: (n, corner, xyz) mm
    corners_mm: FloatArray
    nodes: int
    pitch_mm: float
    #: (xy) place of the first cell, and (xy) number of them
    low: IntArray
    count: IntArray
    #: (place + 1) where the list of each cell begins, and all members
    start: IntArray
    member: IntArray

    @classmethod
    def of(
        cls, corners_mm: FloatArray, nodes: int, pitch_mm: float, low: IntArray, count: IntArray
    ) -> "Columns":
        """Sort the triangles by the cells that their outline, seen along z, may meet."""
        cell_mm = nodes * pitch_mm
        begin, end = corners_mm.min(axis=1)[:, :2], corners_mm.max(axis=1)[:, :2]
        # A pitch of slack on both sides: a column stands beside its node, at most beyond the last.
        first = np.floor((begin - pitch_mm) / cell_mm).astype(np.int64) - low
        last = np.floor((end + pitch_mm) / cell_mm).astype(np.int64) - low
        lists = _sorted_in(np.maximum(first, 0), np.minimum(last, count - 1), count)
        return cls(corners_mm, nodes, pitch_mm, low, count, *lists)

    def negate_inside(self, cells: IntArray, samples: FloatArray) -> None:
        """Negate the samples (n, x, y, z) of the cells' nodes that lie inside."""

        def negate(band: slice) -> None:
            place = cells[band], self.pitch_mm
            _negate(self.corners_mm, self._over(cells[band]), place, samples[band])

        over_bands(negate, len(cells))

    def inside(self, points_mm: FloatArray) -> BoolImage:
        """Tell which points (n, xyz) lie inside."""
        cells = np.floor(points_mm / (self.nodes * self.pitch_mm)).astype(np.int64)
        inside = np.zeros(len(points_mm), np.bool_)
        points = points_mm + np.array([*_ASIDE, 0.0]) * self.pitch_mm
        _inside(self.corners_mm, self._over(cells), points, inside)
        return inside

    def _over(self, cells: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """Return begin and end of each cell's list, and all members."""
        x, y = (cells[:, :2] - self.low).T
        place = x * self.count[1] + y
        return self.start[place], self.start[place + 1], self.member


@compiled  # type: ignore[untyped-decorator]
def _left_of(a: FloatArray, b: FloatArray, x: float, y: float) -> bool:
    """Tell whether a point is left of a line from a to b: right of the same line from b to a."""
    if a[0] < b[0] or (a[0] == b[0] and a[1] < b[1]):
        return bool((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) > 0)
    return not (a[0] - b[0]) * (y - b[1]) - (a[1] - b[1]) * (x - b[0]) > 0


@compiled  # type: ignore[untyped-decorator]
def _crossing(corners: FloatArray, x: float, y: float) -> tuple[int, float]:
    """Return the facet's side seen from above (+1, -1, 0 where missed), and z of the crossing."""
    a, b, c = corners[0], corners[1], corners[2]
    left = _left_of(a, b, x, y)
    if left != _left_of(b, c, x, y) or left != _left_of(c, a, x, y):
        return 0, 0.0
    ux, uy, vx, vy, px, py = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1], x - a[0], y - a[1]
    area = ux * vy - uy * vx
    rise = (px * vy - py * vx) * (b[2] - a[2]) + (ux * py - uy * px) * (c[2] - a[2])
    z = min(max(a[2] + rise / area, min(a[2], b[2], c[2])), max(a[2], b[2], c[2]))
    return (1 if left else -1), z


@compiled  # type: ignore[untyped-decorator]
def _covered(
    corners: FloatArray, axis: int, pitch: float, first: int, count: int
) -> tuple[int, int]:
    """Return begin and end of those of a cell's nodes, along x or y, that a facet may cover."""
    a, b, c = corners[0, axis], corners[1, axis], corners[2, axis]
    begin = np.ceil(min(a, b, c) / pitch - 1e-3) - first
    end = np.floor(max(a, b, c) / pitch + 1e-3) - first + 1
    return int(max(begin, 0.0)), int(min(end, float(count)))


@compiled  # type: ignore[untyped-decorator]
def _negate(
    corners: FloatArray,
    lists: tuple[IntArray, IntArray, IntArray],
    place: tuple[IntArray, float],
    samples: FloatArray,
) -> None:
    begin, end, member = lists
    cells, pitch = place
    count = samples.shape[1]
    # below[i, j, k]: windings of the facets that have just k of the column's nodes below them.
    below = np.zeros((count, count, count + 1), np.int64)
    for n in range(len(cells)):
        x0, y0, z0 = cells[n, 0] * count, cells[n, 1] * count, cells[n, 2] * count
        below[:] = 0
        for m in range(begin[n], end[n]):
            facet = corners[member[m]]
            first_i, end_i = _covered(facet, 0, pitch, x0, count)
            first_j, end_j = _covered(facet, 1, pitch, y0, count)
            for i in range(first_i, end_i):
                for j in range(first_j, end_j):
                    x, y = (x0 + i + _ASIDE[0]) * pitch, (y0 + j + _ASIDE[1]) * pitch
                    side, z = _crossing(facet, x, y)
                    if side != 0:
                        under = min(max(np.ceil(z / pitch) - z0, 0.0), float(count))
                        below[i, j, int(under)] += side
        for i in range(count):
            for j in range(count):
                winding = 0
                for k in range(count - 1, -1, -1):
                    winding += below[i, j, k + 1]
                    if winding != 0:
                        samples[n, i, j, k] *= -1


@compiled  # type: ignore[untyped-decorator]
def _inside(
    corners: FloatArray,
    lists: tuple[IntArray, IntArray, IntArray],
    points: FloatArray,
    inside: BoolImage,
) -> None:
    begin, end, member = lists
    for n in range(len(points)):
        winding = 0
        for m in range(begin[n], end[n]):
            side, z = _crossing(corners[member[m]], points[n, 0], points[n, 1])
            if z > points[n, 2]:
                winding += side
        inside[n] = winding != 0


@compiled  # type: ignore[untyped-decorator]
def _sorted_in(first: IntArray, last: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Return lists of the boxes first..last that hold each place of a grid, row by row."""
    start = np.zeros(count[0] * count[1] + 1, np.int64)
    for n in range(len(first)):
        for x in range(first[n, 0], last[n, 0] + 1):
            for y in range(first[n, 1], last[n, 1] + 1):
                start[x * count[1] + y + 1] += 1
    start = np.cumsum(start)
    filled = start[:-1].copy()
    member = np.zeros(start[-1], np.int64)
    for n in range(len(first)):
        for x in range(first[n, 0], last[n, 0] + 1):
            for y in range(first[n, 1], last[n, 1] + 1):
                member[filled[x * count[1] + y]] = n
                filled[x * count[1] + y] += 1
    return start, member
