"""Signed distance to a closed mesh: sampled on a lattice, interpolated by cubic B-splines.

The interpolant is C2 and smooths the facets of a round surface. Its coefficients are
c = (-f[-1] + 8 f[0] - f[1]) / 6 along each axis, with the samples f. They are exact for cubic
functions, so that the error is of fourth order. They depend on neighbouring nodes only, unlike
those of an interpolating spline, which depend on all samples. Bricks (cubes of the lattice) can
therefore be computed when a point is inside them for the first time; their bytes do not depend on
the order in which they are computed.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from threading import Lock

import numpy as np
import numpy.typing as npt
import trimesh

from reconstruction.arrays import BoolImage, FloatArray, IntArray
from twin.shape import Distances, Placement
from twin.specimens.distance import compiled, nested, over_points
from twin.specimens.triangles import (
    Columns,
    TriangleTree,
    distances_mm,
    middles_mm,
    unsigned_samples,
)

#: Distance between nodes; edges and creases are rounded with approximately this radius.
PITCH_MM = 0.05
# Lattice cells along a brick, which stores coefficients, and along a block, which stores samples.
_BRICK, _BLOCK = 8, 4
# The coefficients of a brick depend on 4 blocks per axis, starting with the block before it.
_BLOCKS = np.stack(np.meshgrid(*3 * (np.arange(-1, 3),), indexing="ij"), axis=-1)
_MARGIN_MM = 1.0
_UNMADE = -1
_KEPT_FIELDS = 8
_GATHERED = 256


@dataclass(frozen=True, eq=False)
class MeshDistance:
    """Signed distance to a closed mesh in a pose, interpolated."""

    #: the mesh in its original frame; all poses share the same samples
    body: trimesh.Trimesh
    pose: Placement
    pitch_mm: float = PITCH_MM

    def evaluate(self, points_mm: FloatArray, reach_mm: float) -> Distances:
        """Return distance, gradient and Hessian, see `SignedDistance`."""
        return self._samples.evaluate(points_mm, reach_mm, self.pose)

    @cached_property
    def _samples(self) -> "SampledField":
        vertices = np.ascontiguousarray(self.body.vertices, dtype=np.float64)
        faces = np.ascontiguousarray(self.body.faces, dtype=np.int64)
        return _field(vertices.tobytes(), faces.tobytes(), self.pitch_mm)


@lru_cache(maxsize=_KEPT_FIELDS)
def _field(vertices: bytes, faces: bytes, pitch_mm: float) -> "SampledField":
    corners = np.frombuffer(vertices).reshape(-1, 3)[np.frombuffer(faces, np.int64)]
    return SampledField(TriangleTree.of(corners.reshape(-1, 3, 3)), pitch_mm)


class _Store:
    """Sparse storage of an array (x, y, z) for each cube of a lattice."""

    def __init__(self, low: IntArray, count: IntArray, side: int) -> None:
        #: (xyz) index of the first cube
        self.low = low
        #: (x, y, z) slot of each cube in `contents`, or _UNMADE
        self.slot = np.full(count, _UNMADE, np.int32)
        #: (slot, x, y, z) arrays of the stored cubes, with unused slots at the end
        self.contents = np.zeros((64, side, side, side))
        self._used = 0

    def add(self, cubes: IntArray, contents: FloatArray) -> None:
        """Store the arrays `contents` (n, x, y, z) of the cubes with indices `cubes` (n, xyz)."""
        first, end = self._used, self._used + len(contents)
        if end > len(self.contents):
            room = np.zeros((2 * end, *self.contents.shape[1:]))
            room[:first] = self.contents[:first]
            self.contents = room
        self.contents[first:end] = contents
        self.slot[tuple((cubes - self.low).T)] = np.arange(first, end)
        self._used = end

    def slots(self, cubes: IntArray) -> npt.NDArray[np.int32]:
        """Return the slots (...) of the cubes with indices `cubes` (..., xyz)."""
        return np.asarray(self.slot[tuple(np.moveaxis(cubes - self.low, -1, 0))])


class SampledField:
    """Signed distance to one mesh; samples within a margin round it are computed on demand."""

    def __init__(self, tree: TriangleTree, pitch_mm: float) -> None:
        self._tree, self._pitch_mm, self._lock = tree, pitch_mm, Lock()
        self._begin(_MARGIN_MM)

    def evaluate(self, points_mm: FloatArray, reach_mm: float, pose: Placement) -> Distances:
        """Return distance, gradient and Hessian of the mesh in a pose, see `SignedDistance`."""
        points = np.ascontiguousarray(points_mm, dtype=np.float64)
        with self._lock:
            if reach_mm > self._margin_mm:
                self._begin(reach_mm)
            frame = pose.rotation, pose.shift_mm, self._pitch_mm
            self._make(self._touched(points, reach_mm, frame), reach_mm)
            made = self._bricks
            table = (*frame, made.low, self._least_mm, made.slot)
            return over_points(_interpolated, points, reach_mm, table, made.contents)

    def _begin(self, margin_mm: float) -> None:
        """Delete all bricks, and allocate the tables for a margin of `margin_mm` round the mesh."""
        self._margin_mm, brick_mm = margin_mm, _BRICK * self._pitch_mm
        corners = self._tree.corners_mm.reshape(-1, 3)
        low = np.floor((corners.min(axis=0) - margin_mm) / brick_mm).astype(np.int64)
        count = np.floor((corners.max(axis=0) + margin_mm) / brick_mm).astype(np.int64) - low + 1
        self._bricks = _Store(low, count, _BRICK + 3)
        #: (x, y, z) lower bound of the brick's distances, mm; NaN: not computed yet
        self._least_mm = np.full(count, np.nan)
        low, count = _BRICK // _BLOCK * low - 1, _BRICK // _BLOCK * count + 2
        self._blocks = _Store(low, count, _BLOCK)
        self._columns = Columns.of(
            self._tree.corners_mm, _BLOCK, self._pitch_mm, low[:2], count[:2]
        )

    def _touched(
        self, points: FloatArray, reach_mm: float, frame: tuple[FloatArray, FloatArray, float]
    ) -> IntArray:
        """Return the indices (n, xyz) of bricks that the points need and that are not computed."""
        needed = np.zeros(self._bricks.slot.shape, np.bool_)
        table = (*frame, self._bricks.low, self._least_mm, self._bricks.slot)
        _mark_needed(points, float(reach_mm), table, needed)
        return np.argwhere(needed) + self._bricks.low

    def _make(self, bricks: IntArray, reach_mm: float) -> None:
        """Store a lower bound of the distance in each brick; compute the bricks within reach."""
        if len(bricks) == 0:
            return
        least = self._least_of(bricks)
        self._least_mm[tuple((bricks - self._bricks.low).T)] = least
        bricks = bricks[least <= reach_mm]
        self._sample(bricks)
        for part in np.array_split(bricks, range(_GATHERED, len(bricks), _GATHERED)):
            self._bricks.add(part, _coefficients(self._nodes_of(part)))

    def _least_of(self, bricks: IntArray) -> FloatArray:
        """Return a lower bound (n,), mm, of the distance in each brick.

        It is -inf if the brick's middle is inside the mesh.
        """
        middles, radius = middles_mm(bricks, _BRICK, self._pitch_mm)
        beyond_nodes = np.sqrt(3) * self._pitch_mm
        least = distances_mm(self._tree, middles) - (radius + beyond_nodes)
        return np.where(self._columns.inside(middles), -np.inf, least)

    def _sample(self, bricks: IntArray) -> None:
        """Compute the samples of all blocks that these bricks need and that are missing."""
        round_them = (bricks[:, None] * (_BRICK // _BLOCK) + _BLOCKS.reshape(-1, 3)).reshape(-1, 3)
        blocks = np.unique(round_them[self._blocks.slots(round_them) == _UNMADE], axis=0)
        if len(blocks) == 0:
            return
        samples = unsigned_samples(self._tree, blocks, _BLOCK, self._pitch_mm)
        self._columns.negate_inside(blocks, samples)
        self._blocks.add(blocks, samples)

    def _nodes_of(self, bricks: IntArray) -> FloatArray:
        """Return the samples (n, x, y, z) of bricks, mm, with 2 further nodes on every side."""
        blocks = bricks[:, None, None, None] * (_BRICK // _BLOCK) + _BLOCKS
        samples = self._blocks.contents[self._blocks.slots(blocks)]
        side = 4 * _BLOCK
        nodes = samples.transpose(0, 1, 4, 2, 5, 3, 6).reshape(-1, side, side, side)
        return np.asarray(nodes[:, 2:-1, 2:-1, 2:-1])


def _coefficients(samples: FloatArray) -> FloatArray:
    """Return the spline coefficients (n, x, y, z) of samples, one node fewer on every side."""
    for axis in (1, 2, 3):
        f = np.moveaxis(samples, axis, 0)
        samples = np.moveaxis((8 * f[1:-1] - f[:-2] - f[2:]) / 6, 0, axis)
    return samples


Table = tuple[FloatArray, FloatArray, float, IntArray, FloatArray, npt.NDArray[np.int32]]
#: Work arrays of a point: brick and cell, weights, sums, derivatives.
Scratch = tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]


@nested
def _in_body(
    point: FloatArray, rotation: FloatArray, shift: FloatArray, pitch: float
) -> tuple[float, float, float]:
    """Return the coordinates (x, y, z) of a point in the body's frame, divided by the pitch."""
    x, y, z = point[0] - shift[0], point[1] - shift[1], point[2] - shift[2]
    return (
        (x * rotation[0, 0] + y * rotation[1, 0] + z * rotation[2, 0]) / pitch,
        (x * rotation[0, 1] + y * rotation[1, 1] + z * rotation[2, 1]) / pitch,
        (x * rotation[0, 2] + y * rotation[1, 2] + z * rotation[2, 2]) / pitch,
    )


@compiled
def _mark_needed(points: FloatArray, reach: float, table: Table, needed: BoolImage) -> None:
    """Mark in `needed` the bricks of all points that are not computed and may be within reach."""
    rotation, shift, pitch, low, least, slot = table
    for n in range(len(points)):
        x, y, z = _in_body(points[n], rotation, shift, pitch)
        i = int(np.floor(x / _BRICK)) - low[0]
        j = int(np.floor(y / _BRICK)) - low[1]
        k = int(np.floor(z / _BRICK)) - low[2]
        if i < 0 or j < 0 or k < 0:
            continue
        if i >= slot.shape[0] or j >= slot.shape[1] or k >= slot.shape[2]:
            continue
        if slot[i, j, k] == _UNMADE and not least[i, j, k] > reach:
            needed[i, j, k] = True


@nested
def _weigh(t: float, weight: FloatArray) -> None:
    """Set `weight` (3, 4) to the four cubic B-splines of a cell at t and to their derivatives.

    t is the position in the cell, 0 to 1; the first index is the order of the derivative.
    """
    u = 1 - t
    weight[0, 0], weight[0, 3] = u * u * u / 6, t * t * t / 6
    weight[0, 1] = (4 - 6 * t * t + 3 * t * t * t) / 6
    weight[0, 2] = (4 - 6 * u * u + 3 * u * u * u) / 6
    weight[1, 0], weight[1, 1] = -u * u / 2, (3 * t - 4) * t / 2
    weight[1, 2], weight[1, 3] = (4 - 3 * u) * u / 2, t * t / 2
    weight[2, 0], weight[2, 1], weight[2, 2], weight[2, 3] = u, 3 * t - 2, 3 * u - 2, t


def _interpolated(
    points: FloatArray, reach: float, out: Distances, body: tuple[Table, FloatArray]
) -> None:
    whole = np.zeros(3, np.int64), np.zeros(3, np.int64)
    real = np.zeros((3, 3, 4)), np.zeros((3, 3)), np.zeros((3, 3, 3))
    _interpolate(points, reach, out, body, (*whole, *real))


@compiled
def _interpolate(
    points: FloatArray, reach: float, out: Distances, body: tuple[Table, FloatArray], lines: Scratch
) -> None:
    distance, gradient, hessian = out
    (rotation, shift, pitch, low, least, slot), coefficients = body
    brick, cell, weight, scratch, f = lines
    for n in range(len(points)):
        within, at = True, _in_body(points[n], rotation, shift, pitch)
        for axis in range(3):
            brick[axis] = int(np.floor(at[axis] / _BRICK)) - low[axis]
            within = within and 0 <= brick[axis] < slot.shape[axis]
        distance[n] = reach
        if not within or least[brick[0], brick[1], brick[2]] > reach:
            continue
        for axis in range(3):
            corner = np.floor(at[axis])
            cell[axis] = int(corner) - (brick[axis] + low[axis]) * _BRICK
            _weigh(at[axis] - corner, weight[axis])
        own = coefficients[slot[brick[0], brick[1], brick[2]]]
        _contract(own, cell, weight, scratch, f)
        distance[n] = f[0, 0, 0]
        if distance[n] <= reach:
            _turn_back(f, rotation, pitch, gradient[n], hessian[n])


@nested
def _contract(
    own: FloatArray, cell: IntArray, weight: FloatArray, scratch: FloatArray, f: FloatArray
) -> None:
    """Set f[i, j, k] to the derivatives d^(i + j + k) / dx^i dy^j dz^k, for i + j + k <= 2.

    `own` are the coefficients of the brick, `weight` the splines of the three axes.
    """
    f[:] = 0.0
    for a in range(4):
        scratch[:] = 0.0
        for b in range(4):
            line = own[cell[0] + a, cell[1] + b]
            for k in range(3):
                along = 0.0
                for c in range(4):
                    along += weight[2, k, c] * line[cell[2] + c]
                for j in range(3 - k):
                    scratch[j, k] += weight[1, j, b] * along
        for i in range(3):
            for j in range(3 - i):
                for k in range(3 - i - j):
                    f[i, j, k] += weight[0, i, a] * scratch[j, k]


@nested
def _turn_back(
    f: FloatArray, rotation: FloatArray, pitch: float, gradient: FloatArray, hessian: FloatArray
) -> None:
    """Set gradient and Hessian (1/mm) in the frame of the shape.

    `f` are the derivatives in the frame of the body, in units of the pitch.
    """
    slope = (f[1, 0, 0] / pitch, f[0, 1, 0] / pitch, f[0, 0, 1] / pitch)
    bend = (
        (f[2, 0, 0] / pitch**2, f[1, 1, 0] / pitch**2, f[1, 0, 1] / pitch**2),
        (f[1, 1, 0] / pitch**2, f[0, 2, 0] / pitch**2, f[0, 1, 1] / pitch**2),
        (f[1, 0, 1] / pitch**2, f[0, 1, 1] / pitch**2, f[0, 0, 2] / pitch**2),
    )
    for p in range(3):
        for a in range(3):
            gradient[p] += rotation[p, a] * slope[a]
            turned = 0.0
            for b in range(3):
                turned += rotation[p, b] * bend[b][a]
            for q in range(3):
                hessian[p, q] += turned * rotation[q, a]
