"""Spatial phase unwrapping of one fringe period, guided by the quality of the phase.

Fringe orders follow from neighbouring pixels, which is possible on continuous surfaces only. Every
pair of neighbouring pixels is an edge of a graph. Its cost is the sum of the second differences of
the phase at both pixels: the reliability of Herraez et al., Appl. Opt. 41, 7437 (2002), who join
the edges in this order. This is the minimum spanning tree of the graph, which scipy computes. Along
each edge of the tree the order changes by the whole number that makes the step of the phase less
than half a turn.

An edge is a jump if its step of the phase differs from the median step around it, in the same line
of the image, by more than `LEAST_JUMP` turns plus `JUMP_SIGMAS` standard deviations. Jumps are no
edges of the graph, so that they divide the image into islands. Fringe orders are relative to the
island. A jump of the surface by a whole number of periods is not visible in the phase.
"""

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from reconstruction.arrays import BoolArray, BoolImage, FloatArray, FloatImage, IntArray

Labels = NDArray[np.uint16]
Islands = Literal["mask", "join", "all"]
ISLANDS: tuple[Islands, ...] = ("mask", "join", "all")

LEAST_JUMP = 0.1
JUMP_SIGMAS = 6.0
# A second difference a - 2 b + c of independent values has the variance 6 sigma^2.
SECOND_DIFFERENCE = 6.0
# No step of half a turn can be unwrapped.
LARGEST_LIMIT = 0.45
LEAST_ISLAND_PIXELS = 30
# Cost of a jump, per turn, where the user states that islands are to be joined.
JUMP_COST = 1e3
TINY_COST = 1e-9


class SpatialOrders(NamedTuple):
    """Fringe orders relative to the island of each pixel.

    orders : (row, col) int, 0 outside islands
    islands : (row, col) uint16, number of the island, 1 for the largest; 0: no island, or fewer
        than LEAST_ISLAND_PIXELS pixels
    consistent : (row, col) bool, False where two paths around a loop of pixels give two orders
    """

    orders: IntArray
    islands: Labels
    consistent: BoolImage


class _Edges(NamedTuple):
    """Edges between usable neighbouring pixels, as flat pixel indices; all fields are (edge,)."""

    first: IntArray
    second: IntArray
    cost: FloatArray
    is_jump: BoolArray


def wrapped(turns: FloatArray) -> FloatArray:
    """Return phases in turns, reduced to [-1/2, 1/2]."""
    return np.asarray(turns - np.rint(turns))


def unwrap_spatially(
    turns: FloatImage, sigma_turns: FloatImage, usable: BoolImage, *, join: bool = False
) -> SpatialOrders:
    """Return the fringe orders of a phase image by quality-guided spatial unwrapping.

    Parameters
    ----------
    turns, sigma_turns : (row, col), wrapped phase and its standard deviation, turns
    usable : (row, col) bool, pixels with a phase
    join : connect islands where their jump is least doubtful, for surfaces whose jumps are known to
        be less than half a period
    """
    edges = _edges(np.where(usable, turns, 0.0), sigma_turns, usable)
    taken = np.ones_like(edges.is_jump) if join else ~edges.is_jump
    kept = _Edges._make(values[taken] for values in edges)
    flat = np.where(usable, turns, 0.0).ravel()
    orders, labels = _along_tree(kept, flat, usable.ravel())
    islands = _by_size(labels, usable.ravel()).reshape(usable.shape)
    step = flat[kept.second] + orders[kept.second] - flat[kept.first] - orders[kept.first]
    is_wrong = (np.abs(step) > 0.5) & ~kept.is_jump
    consistent = np.ones(flat.size, np.bool_)
    consistent[kept.first[is_wrong]] = consistent[kept.second[is_wrong]] = False
    orders[islands.ravel() == 0] = 0
    return SpatialOrders(orders.reshape(usable.shape), islands, consistent.reshape(usable.shape))


def _edges(turns: FloatImage, sigma_turns: FloatImage, usable: BoolImage) -> _Edges:
    numbers = np.arange(usable.size).reshape(usable.shape)
    images: tuple[NDArray[Any], ...] = (
        turns,
        sigma_turns,
        usable,
        numbers,
        _roughness(turns, usable),
    )
    parts = []
    for axis in (0, 1):
        t, s, u, n, r = (np.moveaxis(image, axis, -1) for image in images)
        exists, step = u[:, 1:] & u[:, :-1], wrapped(np.diff(t, axis=1))
        limit = LEAST_JUMP + JUMP_SIGMAS * np.sqrt(SECOND_DIFFERENCE) * 0.5 * (s[:, 1:] + s[:, :-1])
        is_jump = _bend(step, exists) > np.minimum(limit, LARGEST_LIMIT)
        doubt = JUMP_COST * is_jump * (1.0 + np.abs(step))
        whole = (n[:, :-1], n[:, 1:], r[:, 1:] + r[:, :-1] + TINY_COST + doubt, is_jump)
        parts.append([values[exists] for values in whole])
    return _Edges(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _bend(steps: FloatArray, exists: BoolArray) -> FloatArray:
    """Return how much each step differs from the median of five steps of its line, turns.

    These are the two steps before it, itself, and the two after it. A missing step is replaced by
    its mirror image. The median follows neither a jump of one step nor one that a mixed pixel
    divides into two.
    """
    around = [np.zeros_like(steps)]
    margin = ((0, 0), (2, 2))
    s, e = np.pad(steps, margin), np.pad(exists, margin)
    length = steps.shape[1]
    for lag in (1, 2):
        before, after = np.s_[:, 2 - lag : 2 - lag + length], np.s_[:, 2 + lag : 2 + lag + length]
        back, ahead = wrapped(s[before] - steps), wrapped(s[after] - steps)
        around.append(np.where(e[before], back, np.where(e[after], ahead, 0.0)))
        around.append(np.where(e[after], ahead, np.where(e[before], back, 0.0)))
    return np.abs(np.median(around, axis=0))


def _roughness(turns: FloatImage, usable: BoolImage) -> FloatImage:
    """Return the root of the summed squares of the second differences in four directions, turns.

    It is 1 at the border of the usable pixels.
    """
    t: FloatArray = np.pad(np.asarray(turns, np.float64), 1)
    u = np.pad(usable, 1)
    centre = t[1:-1, 1:-1]
    total, inside = np.zeros(turns.shape), usable.copy()
    rows, cols = turns.shape
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        after = np.s_[1 + down : 1 + down + rows, 1 + right : 1 + right + cols]
        before = np.s_[1 - down : 1 - down + rows, 1 - right : 1 - right + cols]
        total += np.square(wrapped(t[after] - centre) - wrapped(centre - t[before]))
        inside &= u[after] & u[before]
    return np.where(inside, np.sqrt(total), 1.0)


def _along_tree(edges: _Edges, turns: FloatArray, usable: BoolArray) -> tuple[IntArray, IntArray]:
    """Return order and component number of each pixel, both (pixel,) int.

    A further node is joined to one pixel of each component, so that one search reaches all pixels.
    """
    count = turns.size
    graph = coo_array((edges.cost, (edges.first, edges.second)), (count, count)).tocsr()
    labels = connected_components(graph, directed=False)[1]
    roots = np.unique(np.where(usable, labels, -1), return_index=True)[1]
    tree = minimum_spanning_tree(graph).tocoo()
    first = np.concatenate([tree.row, np.full(roots.size, count)])
    second = np.concatenate([tree.col, roots])
    whole = coo_array((np.ones(first.size), (first, second)), (count + 1, count + 1)).tocsr()
    before = breadth_first_order(whole, count, directed=False)[1][:count]
    is_inner = (before >= 0) & (before < count)
    parent = np.where(is_inner, before, np.arange(count))
    return _sums_to_root(parent, np.rint(turns[parent] - turns).astype(np.int64)), labels


def _sums_to_root(parent: IntArray, step: IntArray) -> IntArray:
    """Return the sum of the steps from each node to its root; a root is its own parent, step 0."""
    total = step
    while True:
        further = parent[parent]
        if np.array_equal(further, parent):
            return np.asarray(total)
        total = total + np.where(parent == np.arange(parent.size), 0, total[parent])
        parent = further


def _by_size(labels: IntArray, usable: BoolArray) -> Labels:
    """Return island numbers (pixel,) by decreasing size, from 1; 0 for unusable or small ones."""
    sizes = np.bincount(labels[usable], minlength=labels.max() + 1)
    order = np.argsort(-sizes, kind="stable")
    large = order[sizes[order] >= LEAST_ISLAND_PIXELS][: np.iinfo(np.uint16).max]
    numbers = np.zeros(sizes.size, np.uint16)
    numbers[large] = np.arange(1, large.size + 1)
    return np.asarray(np.where(usable, numbers[labels], 0), np.uint16)
