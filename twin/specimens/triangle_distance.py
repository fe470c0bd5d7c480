"""Exact distance of lattice nodes to a triangle mesh.

Node (i, j, k) of a lattice lies at (i, j, k) times the pitch in the body's frame. A cell is a cube
of n^3 nodes: cell (a, b, c) begins with node (n a, n b, n c). Nothing depends on which other cells
are asked for.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.machine import threads
from twin.specimens.distance import compiled

_CHUNK = 64
_LEAF = 2
_KEY_BITS = 16
_DEEPEST = 64


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """The triangles of a closed mesh, and boxes round ever larger groups of them.

    Triangles are sorted along a Z-order curve (Morton 1966) and taken in pairs. Box 1 holds all,
    box n holds boxes 2 n and 2 n + 1, the last half of the boxes hold the pairs.
    """

    #: (n, corner, xyz) mm, all of them
    corners_mm: FloatArray
    #: (n, corner, xyz) mm, sorted; without those that have no area: they are met on their
    #: neighbours' edges
    sorted_mm: FloatArray
    #: (box, low or high, xyz) mm; one that holds nothing is infinitely far
    boxes_mm: FloatArray

    @classmethod
    def of(cls, corners_mm: FloatArray) -> "TriangleTree":
        """Build the tree."""
        corners = np.ascontiguousarray(corners_mm, dtype=np.float64)
        sides = corners[:, 1:] - corners[:, :1]
        longest = np.linalg.norm(sides, axis=-1).max(axis=-1)
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1)
        wide = corners[area > 1e-12 * longest**2]
        in_order = wide[np.argsort(_keys(wide.mean(axis=1)), kind="stable")]
        return cls(corners, in_order, _boxes(in_order))


def _keys(points_mm: FloatArray) -> IntArray:
    """Return the places of points along a Z-order curve."""
    low = points_mm.min(axis=0)
    step = max(float((points_mm.max(axis=0) - low).max()), 1e-9) / (2**_KEY_BITS - 1)
    steps = ((points_mm - low) / step).astype(np.int64)
    key = np.zeros(len(points_mm), np.int64)
    for bit in range(_KEY_BITS):
        for axis in range(3):
            key |= (steps[:, axis] >> bit & 1) << 3 * bit + axis
    return key


def _boxes(triangles_mm: FloatArray) -> FloatArray:
    """Return the boxes (box, low or high, xyz) round triangles, their pairs, pairs of pairs ..."""
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
    """Return the middles (n, xyz) of the cells' nodes, and how far a node may be from them."""
    middles = (cells.astype(np.float64) * nodes + (nodes - 1) / 2) * pitch_mm
    return middles, float(np.sqrt(3) / 2 * (nodes - 1) * pitch_mm)


def distances_mm(tree: TriangleTree, points_mm: FloatArray) -> FloatArray:
    """Return the distance (n,) of points (n, xyz) to the nearest triangle."""
    samples = np.zeros((len(points_mm), 1, 1, 1))
    _sample_all(tree, points_mm, 0.0, samples)
    return samples.ravel()


def unsigned_samples(
    tree: TriangleTree, cells: IntArray, nodes: int, pitch_mm: float
) -> FloatArray:
    """Return the distance (n, x, y, z) of the nodes of cells (n, xyz), mm."""
    samples = np.zeros((len(cells), nodes, nodes, nodes))
    _sample_all(tree, middles_mm(cells, nodes, pitch_mm)[0], pitch_mm, samples)
    return samples


def _sample_all(
    tree: TriangleTree, middles: FloatArray, pitch_mm: float, samples: FloatArray
) -> None:
    def sample(band: slice) -> None:
        _sample((tree.sorted_mm, tree.boxes_mm), middles[band], pitch_mm, samples[band])

    over_bands(sample, len(middles))


def over_bands(call: Callable[[slice], None], count: int) -> None:
    """Call a function with bands of cells, on all cores."""
    bands = [slice(first, min(first + _CHUNK, count)) for first in range(0, count, _CHUNK)]
    with ThreadPoolExecutor(threads()) as pool:
        list(pool.map(call, bands))


@compiled  # type: ignore[untyped-decorator]
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


@compiled  # type: ignore[untyped-decorator]
def _nearest_shares(uu: float, uv: float, vv: float, up: float, vp: float) -> tuple[float, float]:
    """Return how much of the sides u and v leads to the point of a triangle nearest to p."""
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


@compiled  # type: ignore[untyped-decorator]
def _to_box(box: FloatArray, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point to a box."""
    dx = max(box[0, 0] - x, x - box[1, 0], 0.0)
    dy = max(box[0, 1] - y, y - box[1, 1], 0.0)
    dz = max(box[0, 2] - z, z - box[1, 2], 0.0)
    return float(dx * dx + dy * dy + dz * dz)


@compiled  # type: ignore[untyped-decorator]
def _nearest(
    tree: tuple[FloatArray, FloatArray],
    at: tuple[float, float, float],
    guess: int,
    waiting: tuple[IntArray, FloatArray],
) -> tuple[float, int]:
    """Return the squared distance to the nearest triangle, and which it is."""
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


@compiled  # type: ignore[untyped-decorator]
def _sample(
    tree: tuple[FloatArray, FloatArray], middles: FloatArray, pitch: float, samples: FloatArray
) -> None:
    """Set the distances of cells' nodes, beginning with what was nearest to the node before."""
    waiting = np.zeros(_DEEPEST, np.int64), np.zeros(_DEEPEST)
    count = samples.shape[1]
    half = (count - 1) / 2
    for n in range(len(middles)):
        # Afresh for each cell: where rounding decides, its neighbours must not show.
        guess = 0
        for i in range(count):
            for j in range(count):
                for k in range(count):
                    x, y = middles[n, 0] + (i - half) * pitch, middles[n, 1] + (j - half) * pitch
                    at = x, y, middles[n, 2] + (k - half) * pitch
                    squared, guess = _nearest(tree, at, guess, waiting)
                    samples[n, i, j, k] = np.sqrt(squared)
