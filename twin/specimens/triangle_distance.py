"""Exact distance of lattice nodes to a triangle mesh.

Node (i, j, k) of a lattice lies at (i, j, k) times the pitch in the body's frame. A cell is a cube
of n^3 nodes: cell (a, b, c) begins with node (n a, n b, n c). Nothing depends on which other cells
are asked for.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from reconstruction.cores import threads
from twin.specimens.distance import compiled
from twin.specimens.pose import FloatArray

IntArray = npt.NDArray[np.int64]
Found = TypeVar("Found")

# Of the largest coordinate; rounding of a distance is far below, the next triangle far above it.
_SLACK = 1e-12
_CHUNK = 64


@dataclass(frozen=True, eq=False)
class TriangleSoup:
    """The triangles of a closed mesh."""

    #: (n, corner, xyz) mm
    corners_mm: FloatArray
    #: indices of those with an area; the others are met on their neighbours' edges
    wide: IntArray

    @classmethod
    def of(cls, corners_mm: FloatArray) -> "TriangleSoup":
        """Sort out triangles without area."""
        corners = np.ascontiguousarray(corners_mm, dtype=np.float64)
        sides = corners[:, 1:] - corners[:, :1]
        longest = np.linalg.norm(sides, axis=-1).max(axis=-1)
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1)
        return cls(corners, np.flatnonzero(area > 1e-12 * longest**2))


@dataclass(frozen=True, eq=False)
class Lists:
    """Several lists of triangles, one after the other."""

    #: (list + 1) where each begins
    start: IntArray
    member: IntArray

    @classmethod
    def joined(cls, parts: Sequence[tuple[IntArray, IntArray]]) -> "Lists":
        """Join (counts, members) of consecutive lists."""
        counts = np.concatenate([counts for counts, _ in parts])
        start = np.concatenate(([0], np.cumsum(counts)))
        return cls(start, np.concatenate([members for _, members in parts]))


@dataclass(frozen=True, eq=False)
class Candidates:
    """The triangles that may be the nearest to a node of each cell."""

    lists: Lists
    #: (n,) distance of each cell's middle
    middle_mm: FloatArray


def nearest_candidates(
    soup: TriangleSoup, cells: IntArray, nodes: int, pitch_mm: float
) -> Candidates:
    """List for each cell the triangles that may be the nearest to one of its nodes.

    Parameters
    ----------
    soup : TriangleSoup
        Triangles.
    cells : (n, xyz) int
        Places of cells: each once, sorted by x, y, z.
    nodes : int
        Nodes along a cell's side.
    pitch_mm : float, mm
        Distance between nodes.

    Notes
    -----
    Cells of doubled size hold all the others at the top. Each passes to its children what is, seen
    from its middle, at most the diagonal of its nodes farther away than the nearest triangle.
    """
    top = int(np.ceil(np.log2(1 + np.abs(cells).max(initial=0)))) + 1
    parents = np.zeros((1, 3), np.int64)
    found = Candidates(Lists(np.array([0, soup.wide.size]), soup.wide), np.zeros(1))
    for level in range(top, -1, -1):
        now = np.unique(cells >> level, axis=0) if level else cells
        parent = _places_in(parents, now >> 1) if level < top else np.zeros(len(now), np.int64)
        found = _narrowed(soup, found.lists, parent, middles_mm(now, nodes << level, pitch_mm))
        parents = now
    return found


def middles_mm(cells: IntArray, nodes: int, pitch_mm: float) -> tuple[FloatArray, float]:
    """Return the middles (n, xyz) of the cells' nodes, and how far a node may be from them."""
    middles = (cells.astype(np.float64) * nodes + (nodes - 1) / 2) * pitch_mm
    return middles, float(np.sqrt(3) / 2 * (nodes - 1) * pitch_mm)


def unsigned_samples(
    soup: TriangleSoup, cells: IntArray, nodes: int, pitch_mm: float
) -> FloatArray:
    """Return the distance (n, x, y, z) of cells' nodes, mm; cells as in `nearest_candidates`."""
    near = nearest_candidates(soup, cells, nodes, pitch_mm).lists
    middles, _ = middles_mm(cells, nodes, pitch_mm)
    samples = np.zeros((len(cells), nodes, nodes, nodes))

    def sample(band: slice) -> None:
        lists = near.start[band.start : band.stop + 1], near.member
        _sample(soup.corners_mm, lists, middles[band], pitch_mm, samples[band])

    over_bands(sample, len(cells))
    return samples


def over_bands(call: Callable[[slice], Found], count: int) -> list[Found]:
    """Call a function with bands of cells on all cores; return what it found, in order."""
    bands = [slice(first, min(first + _CHUNK, count)) for first in range(0, count, _CHUNK)]
    with ThreadPoolExecutor(threads()) as pool:
        return list(pool.map(call, bands))


def _places_in(sorted_rows: IntArray, rows: IntArray) -> IntArray:
    """Return where each of `rows` is in `sorted_rows`, which holds all of them."""
    low = sorted_rows.min(axis=0)
    base = sorted_rows.max(axis=0) - low + 1

    def key(of: IntArray) -> IntArray:
        x, y, z = (of - low).T
        return np.asarray((x * base[1] + y) * base[2] + z)

    return np.searchsorted(key(sorted_rows), key(rows))


def _narrowed(
    soup: TriangleSoup, lists: Lists, parent: IntArray, round_middles: tuple[FloatArray, float]
) -> Candidates:
    """Keep of each parent's list what can be nearest within a radius round each middle."""
    middles, radius = round_middles
    nearest = np.zeros(len(middles))
    farther = 2 * radius + _SLACK * float(np.abs(soup.corners_mm).max())

    def narrow(band: slice) -> tuple[IntArray, IntArray]:
        own = lists.start, lists.member, parent[band]
        found: tuple[IntArray, IntArray] = _narrow(
            soup.corners_mm, own, middles[band], farther, nearest[band]
        )
        return found

    return Candidates(Lists.joined(over_bands(narrow, len(parent))), nearest)


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
def _narrow(
    corners: FloatArray,
    lists: tuple[IntArray, IntArray, IntArray],
    middles: FloatArray,
    farther: float,
    nearest: FloatArray,
) -> tuple[IntArray, IntArray]:
    """Return how many candidates each cell keeps, and which."""
    start, member, parent = lists
    counts = np.zeros(len(parent), np.int64)
    kept = np.zeros(1024, np.int64)
    total = 0
    for cell in range(len(parent)):
        first, end = start[parent[cell]], start[parent[cell] + 1]
        away = np.zeros(end - first)
        x, y, z = middles[cell, 0], middles[cell, 1], middles[cell, 2]
        for i in range(first, end):
            away[i - first] = np.sqrt(_squared(corners[member[i]], x, y, z))
        nearest[cell] = away.min()
        while total + away.size > kept.size:
            kept = np.concatenate((kept, np.zeros_like(kept)))
        for i in range(away.size):
            if away[i] <= nearest[cell] + farther:
                kept[total] = member[first + i]
                total += 1
                counts[cell] += 1
    return counts, kept[:total].copy()


@compiled  # type: ignore[untyped-decorator]
def _sample(
    corners: FloatArray,
    lists: tuple[IntArray, IntArray],
    middles: FloatArray,
    pitch: float,
    samples: FloatArray,
) -> None:
    """Set the distances of the nodes; what is too far from the cell's middle is not looked at."""
    start, member = lists
    half = (samples.shape[1] - 1) / 2
    for n in range(len(middles)):
        near = member[start[n] : start[n + 1]]
        x, y, z = middles[n, 0], middles[n, 1], middles[n, 2]
        away = np.zeros(near.size)
        for c in range(near.size):
            away[c] = np.sqrt(_squared(corners[near[c]], x, y, z))
        guess = int(away.argmin())
        for node in range(samples[n].size):
            k = node % samples.shape[3]
            j = node // samples.shape[3] % samples.shape[2]
            i = node // (samples.shape[2] * samples.shape[3])
            dx, dy, dz = (i - half) * pitch, (j - half) * pitch, (k - half) * pitch
            off = np.sqrt(dx * dx + dy * dy + dz * dz)
            best = _squared(corners[near[guess]], x + dx, y + dy, z + dz)
            limit = np.sqrt(best) + off
            for c in range(near.size):
                if away[c] > limit:
                    continue
                squared = _squared(corners[near[c]], x + dx, y + dy, z + dz)
                if squared < best:
                    best, guess, limit = squared, c, np.sqrt(squared) + off
            samples[n, i, j, k] = np.sqrt(best)
