"""Exact distance of lattice nodes to a triangle mesh, and whether each node is inside the mesh.

Node (i, j, k) of a lattice is at (i, j, k) times the pitch in the body's frame. A cell is a cube
of n^3 nodes: cell (a, b, c) starts with node (n a, n b, n c). Results of a cell do not depend on
which cells are computed together.

A node is inside a closed mesh if the winding number of the surface round the node is not zero. On
the vertical line above a node outside, as many facets face up as down. This criterion is robust
against needle-like triangles and shared edges, unlike the sign of a normal. Overlapping bodies
within one mesh are treated as their union.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, IntArray
from reconstruction.machine import threads
from twin.specimens.distance import compiled, nested

_CHUNK = 64
_LEAF = 2
_KEY_BITS = 16
_DEEPEST = 64


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """The triangles of a closed mesh, and a binary tree of boxes round groups of triangles.

    Triangles are sorted along a Z-order curve (Morton 1966) and grouped in pairs. Box 1 contains
    all triangles, box n contains boxes 2 n and 2 n + 1. The second half of the boxes contains one
    pair each.
    """

    #: (n, corner, xyz) mm, all triangles
    corners_mm: FloatArray
    #: (n, corner, xyz) mm, sorted triangles without those of zero area, which are on edges of
    #: their neighbours
    sorted_mm: FloatArray
    #: (box, low or high, xyz) mm; an empty box is infinitely far
    boxes_mm: FloatArray

    @classmethod
    def of(cls, corners_mm: FloatArray) -> "TriangleTree":
        """Return the tree of triangles (n, corner, xyz)."""
        corners = np.ascontiguousarray(corners_mm, dtype=np.float64)
        sides = corners[:, 1:] - corners[:, :1]
        longest = np.linalg.norm(sides, axis=-1).max(axis=-1)
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1)
        wide = corners[area > 1e-12 * longest**2]
        in_order = wide[np.argsort(_keys(wide.mean(axis=1)), kind="stable")]
        return cls(corners, in_order, _boxes(in_order))


def _keys(points_mm: FloatArray) -> IntArray:
    """Return the position (n,) of each point (n, xyz) along a Z-order curve."""
    low = points_mm.min(axis=0)
    step = max(float((points_mm.max(axis=0) - low).max()), 1e-9) / (2**_KEY_BITS - 1)
    steps = ((points_mm - low) / step).astype(np.int64)
    key = np.zeros(len(points_mm), np.int64)
    for bit in range(_KEY_BITS):
        for axis in range(3):
            key |= (steps[:, axis] >> bit & 1) << 3 * bit + axis
    return key


def _boxes(triangles_mm: FloatArray) -> FloatArray:
    """Return the boxes (box, low or high, xyz), mm, of a `TriangleTree` of sorted triangles."""
    first = np.arange(0, len(triangles_mm), _LEAF)
    pairs = 2 ** int(np.ceil(np.log2(max(len(first), 1))))
    boxes = np.full((2 * pairs, 2, 3), np.inf)
    for side, of in enumerate((np.minimum, np.maximum)):
        row = of.reduceat(of.reduce(triangles_mm, axis=1), first)
        boxes[pairs : pairs + len(first), side] = row
    for level in range(pairs.bit_length() - 2, -1, -1):
        two = boxes[2 << level : 4 << level].reshape(-1, 2, 2, 3)
        boxes[1 << level : 2 << level, 0] = two[:, :, 0].min(axis=1)
        high = np.where(np.isfinite(two[:, :, 0]), two[:, :, 1], -np.inf).max(axis=1)
        boxes[1 << level : 2 << level, 1] = high
    return boxes


def middles_mm(cells: IntArray, nodes: int, pitch_mm: float) -> tuple[FloatArray, float]:
    """Return the middles (n, xyz) of cells, mm, and their distance to the cell's farthest nodes."""
    middles = (cells.astype(np.float64) * nodes + (nodes - 1) / 2) * pitch_mm
    return middles, float(np.sqrt(3) / 2 * (nodes - 1) * pitch_mm)


def distances_mm(tree: TriangleTree, points_mm: FloatArray) -> FloatArray:
    """Return the unsigned distance (n,), mm, of points (n, xyz) to the nearest triangle."""
    samples = np.zeros((len(points_mm), 1, 1, 1))
    _sample_all(tree, points_mm, 0.0, samples)
    return samples.ravel()


def unsigned_samples(
    tree: TriangleTree, cells: IntArray, nodes: int, pitch_mm: float
) -> FloatArray:
    """Return the unsigned distances (n, x, y, z), mm, of the nodes of cells (n, xyz)."""
    samples = np.zeros((len(cells), nodes, nodes, nodes))
    _sample_all(tree, middles_mm(cells, nodes, pitch_mm)[0], pitch_mm, samples)
    return samples


def _sample_all(
    tree: TriangleTree, middles: FloatArray, pitch_mm: float, samples: FloatArray
) -> None:
    def sample(band: slice) -> None:
        waiting = np.zeros(_DEEPEST, np.int64), np.zeros(_DEEPEST)
        boxed = tree.sorted_mm, tree.boxes_mm
        _sample(boxed, middles[band], pitch_mm, waiting, samples[band])

    over_bands(sample, len(middles))


def over_bands(call: Callable[[slice], None], count: int) -> None:
    """Call a function with each of the slices that divide `count` cells, on all cores."""
    bands = [slice(first, min(first + _CHUNK, count)) for first in range(0, count, _CHUNK)]
    with ThreadPoolExecutor(threads()) as pool:
        list(pool.map(call, bands))


@nested
def _squared(corners: FloatArray, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point to a triangle (Ericson 2005, section 5.1.5)."""
    ax, ay, az = corners[0, 0], corners[0, 1], corners[0, 2]
    ux, uy, uz = corners[1, 0] - ax, corners[1, 1] - ay, corners[1, 2] - az
    vx, vy, vz = corners[2, 0] - ax, corners[2, 1] - ay, corners[2, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    uu, uv, vv = (
        ux * ux + uy * uy + uz * uz,
        ux * vx + uy * vy + uz * vz,
        vx * vx + vy * vy + vz * vz,
    )
    up, vp = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    s, t = _nearest_shares(uu, uv, vv, up, vp)
    dx, dy, dz = px - s * ux - t * vx, py - s * uy - t * vy, pz - s * uz - t * vz
    return float(dx * dx + dy * dy + dz * dz)


@nested
def _nearest_shares(uu: float, uv: float, vv: float, up: float, vp: float) -> tuple[float, float]:
    """Return s and t of the point s u + t v of a triangle that is nearest to a point p.

    u and v are two sides from one corner, p is relative to it. Arguments are dot products.
    """
    up_b, vp_b, up_c, vp_c = up - uu, vp - uv, up - uv, vp - vv
    a, b, c = up_b * vp_c - up_c * vp_b, up_c * vp - up * vp_c, up * vp_b - up_b * vp
    toward_c, toward_b = vp_b - up_b, up_c - vp_c
    if up <= 0 and vp <= 0:
        s, t = 0.0, 0.0
    elif up_b >= 0 and toward_c <= 0:
        s, t = 1.0, 0.0
    elif c <= 0 and up >= 0 and up_b <= 0:
        s, t = up / (up - up_b), 0.0
    elif vp_c >= 0 and toward_b <= 0:
        s, t = 0.0, 1.0
    elif b <= 0 and vp >= 0 and vp_c <= 0:
        s, t = 0.0, vp / (vp - vp_c)
    elif a <= 0 and toward_c >= 0 and toward_b >= 0:
        t = toward_c / (toward_c + toward_b)
        s = 1 - t
    else:
        s, t = b / (a + b + c), c / (a + b + c)
    return s, t


@nested
def _to_box(box: FloatArray, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point to a box."""
    dx = max(box[0, 0] - x, x - box[1, 0], 0.0)
    dy = max(box[0, 1] - y, y - box[1, 1], 0.0)
    dz = max(box[0, 2] - z, z - box[1, 2], 0.0)
    return float(dx * dx + dy * dy + dz * dz)


@nested
def _nearest(
    tree: tuple[FloatArray, FloatArray],
    at: tuple[float, float, float],
    guess: int,
    waiting: tuple[IntArray, FloatArray],
) -> tuple[float, int]:
    """Return the squared distance to the nearest triangle, and its index; tests `guess` first."""
    triangles, boxes = tree
    stack, least = waiting
    x, y, z = at
    pairs = len(boxes) // 2
    best = _squared(triangles[guess], x, y, z)
    stack[0], least[0], height = 1, _to_box(boxes[1], x, y, z), 1
    while height > 0:
        height -= 1
        if least[height] >= best:
            continue
        box = stack[height]
        if box >= pairs:
            for n in range((box - pairs) * _LEAF, min((box - pairs + 1) * _LEAF, len(triangles))):
                squared = _squared(triangles[n], x, y, z)
                if squared < best:
                    best, guess = squared, n
            continue
        near, far = 2 * box, 2 * box + 1
        to_near, to_far = _to_box(boxes[near], x, y, z), _to_box(boxes[far], x, y, z)
        if to_far < to_near:
            near, far, to_near, to_far = far, near, to_far, to_near
        if to_far < best:
            stack[height], least[height] = far, to_far
            height += 1
        if to_near < best:
            stack[height], least[height] = near, to_near
            height += 1
    return best, guess


@compiled
def _sample(
    tree: tuple[FloatArray, FloatArray],
    middles: FloatArray,
    pitch: float,
    waiting: tuple[IntArray, FloatArray],
    samples: FloatArray,
) -> None:
    """Set the distances of cells' nodes; each search starts with the previous node's triangle."""
    count = samples.shape[1]
    half = (count - 1) / 2
    for n in range(len(middles)):
        # The same guess for the first node of every cell: rounding must not depend on other cells.
        guess = 0
        for i in range(count):
            for j in range(count):
                for k in range(count):
                    x, y = middles[n, 0] + (i - half) * pitch, middles[n, 1] + (j - half) * pitch
                    at = x, y, middles[n, 2] + (k - half) * pitch
                    squared, guess = _nearest(tree, at, guess, waiting)
                    samples[n, i, j, k] = np.sqrt(squared)


# Offset in x and y of the vertical line through a node, in pitches, so that the line crosses no
# edge: the numbers are no ratios of usual dimensions.
_ASIDE = (0.6180339e-6, 0.4142135e-6)


@dataclass(frozen=True, eq=False)
class Columns:
    """Lists of the triangles above or below each cell of a rectangle of cells in x and y."""

    #: (n, corner, xyz) mm
    corners_mm: FloatArray
    #: number of nodes along a cell
    nodes: int
    pitch_mm: float
    #: (xy) index of the first cell, and (xy) number of cells
    low: IntArray
    count: IntArray
    #: (cell + 1,) start of the list of each cell in `member`, and triangle numbers of all lists
    start: IntArray
    member: IntArray

    @classmethod
    def of(
        cls, corners_mm: FloatArray, nodes: int, pitch_mm: float, low: IntArray, count: IntArray
    ) -> "Columns":
        """Return the lists of triangles that may overlap each cell in their projection along z."""
        cell_mm = nodes * pitch_mm
        begin, end = corners_mm.min(axis=1)[:, :2], corners_mm.max(axis=1)[:, :2]
        # One pitch of margin on both sides, because a column is offset from its node.
        first = np.floor((begin - pitch_mm) / cell_mm).astype(np.int64) - low
        last = np.floor((end + pitch_mm) / cell_mm).astype(np.int64) - low
        lists = _sorted_in(np.maximum(first, 0), np.minimum(last, count - 1), count)
        return cls(corners_mm, nodes, pitch_mm, low, count, *lists)

    def negate_inside(self, cells: IntArray, samples: FloatArray) -> None:
        """Negate the samples (n, x, y, z) of those nodes of the cells that are inside the mesh."""

        def negate(band: slice) -> None:
            place, count = (cells[band], self.pitch_mm), self.nodes
            below = np.zeros((count, count, count + 1), np.int64)
            _negate(self.corners_mm, self._over(cells[band]), place, below, samples[band])

        over_bands(negate, len(cells))

    def inside(self, points_mm: FloatArray) -> BoolImage:
        """Return whether each point (n, xyz), mm, is inside the mesh."""
        cells = np.floor(points_mm / (self.nodes * self.pitch_mm)).astype(np.int64)
        inside = np.zeros(len(points_mm), np.bool_)
        points = points_mm + np.array([*_ASIDE, 0.0]) * self.pitch_mm
        _inside(self.corners_mm, self._over(cells), points, inside)
        return inside

    def _over(self, cells: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """Return start and end (n,) of the lists of cells (n, xyz) in `member`, and `member`."""
        x, y = (cells[:, :2] - self.low).T
        place = x * self.count[1] + y
        return self.start[place], self.start[place + 1], self.member


@nested
def _left_of(a: FloatArray, b: FloatArray, x: float, y: float) -> bool:
    """Return True if a point is left of the line from a to b, in plan.

    For the line from b to a the result is always the opposite, also with rounding.
    """
    if a[0] < b[0] or (a[0] == b[0] and a[1] < b[1]):
        return bool((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) > 0)
    return not (a[0] - b[0]) * (y - b[1]) - (a[1] - b[1]) * (x - b[0]) > 0


@nested
def _crossing(corners: FloatArray, x: float, y: float) -> tuple[int, float]:
    """Return the sign of a facet's normal along z, and z of the vertical line's crossing.

    The line is at (x, y); the sign is 0 if the line does not cross the facet.
    """
    a, b, c = corners[0], corners[1], corners[2]
    left = _left_of(a, b, x, y)
    if left != _left_of(b, c, x, y) or left != _left_of(c, a, x, y):
        return 0, 0.0
    ux, uy, vx, vy, px, py = b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1], x - a[0], y - a[1]
    area = ux * vy - uy * vx
    rise = (px * vy - py * vx) * (b[2] - a[2]) + (ux * py - uy * px) * (c[2] - a[2])
    z = min(max(a[2] + rise / area, min(a[2], b[2], c[2])), max(a[2], b[2], c[2]))
    return (1 if left else -1), z


@nested
def _covered(
    corners: FloatArray, axis: int, pitch: float, first: int, count: int
) -> tuple[int, int]:
    """Return start and end of the nodes of a cell, along x or y, that a facet may cover in plan."""
    a, b, c = corners[0, axis], corners[1, axis], corners[2, axis]
    begin = np.ceil(min(a, b, c) / pitch - 1e-3) - first
    end = np.floor(max(a, b, c) / pitch + 1e-3) - first + 1
    return int(max(begin, 0.0)), int(min(end, float(count)))


@compiled
def _negate(
    corners: FloatArray,
    lists: tuple[IntArray, IntArray, IntArray],
    place: tuple[IntArray, float],
    below: IntArray,
    samples: FloatArray,
) -> None:
    """Negate the samples (n, x, y, z) of nodes inside the mesh.

    below[i, j, k] is set to the winding of the facets above k nodes of a cell's column (i, j).
    """
    begin, end, member = lists
    cells, pitch = place
    count = samples.shape[1]
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


@compiled
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


def _sorted_in(first: IntArray, last: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Return the list of boxes that contain each cell of a grid of `count` (xy) cells.

    Box n contains the cells from first[n] to last[n] (xy). Returns start (cell + 1,) of each list
    and the members of all lists, in row order of the cells.
    """
    sides = np.maximum(last - first + 1, 0)
    places = sides[:, 0] * sides[:, 1]
    member = np.repeat(np.arange(len(first)), places)
    within = np.arange(len(member)) - np.repeat(np.cumsum(places) - places, places)
    x, y = (first[member] + np.array(np.divmod(within, sides[member, 1])).T).T
    place = x * count[1] + y
    start = np.zeros(count[0] * count[1] + 1, np.int64)
    np.cumsum(np.bincount(place, minlength=len(start) - 1), out=start[1:])
    return start, member[np.argsort(place, kind="stable")]
