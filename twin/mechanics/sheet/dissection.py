"""Nested dissection of the graph of a sparse matrix: order of elimination, and its fronts.

The matrix couples control points of a grid that are at most two apart. Its unknowns are numbered
point by point along lines. Lines and positions are recognised in the pattern: two consecutive
points are on different lines if they are not coupled. A domain is halved along its longer side; the
points of one half that are coupled with the other half are eliminated after both. Any symmetric
pattern gives a valid order; the order is good for grids.

George, A. (1973): Nested dissection of a regular finite element mesh. SIAM J. Numer. Anal. 10,
345-363.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

IntArray = npt.NDArray[np.int64]

_LEAF_POINTS = 24
"""Domains with fewer points are not halved: dense arithmetic on them is faster."""


@dataclass(frozen=True, eq=False)
class Graph:
    """Points, which are unknowns with a common row of the pattern, and their couplings.

    Attributes
    ----------
    point : (unknown,) number of its point
    first, second : (coupling,) coupled points, first < second; a coupling may be repeated
    """

    point: IntArray
    first: IntArray
    second: IntArray

    @property
    def size(self) -> int:
        """Number of points."""
        return int(self.point[-1]) + 1

    @classmethod
    def of(cls, start: npt.NDArray[np.int32], columns: npt.NDArray[np.int32]) -> "Graph":
        """Return the graph of an upper triangle, in CSR with sorted columns."""
        length = np.diff(start)
        row = np.repeat(np.arange(length.size), length)
        # Column p of a row is compared with the column of the next row that is as far from its end.
        below = np.minimum(np.arange(columns.size) + length[row] - 1, columns.size - 1)
        differs = columns != columns[below]
        differs[start[:-1]] = False
        same = np.add.reduceat(differs, start[:-1]) == 0
        joined = same[:-1] & (length[1:] == length[:-1] - 1)
        point = np.concatenate(([0], np.cumsum(~joined)))
        # The first unknown of a point is coupled with all that the others are coupled with.
        leading = np.concatenate(([True], ~joined))[row]
        first, second = point[row[leading]], point[columns[leading]]
        kept = (first != second) & np.concatenate(([True], (np.diff(second) | np.diff(first)) != 0))
        return cls(point, first[kept], second[kept])

    def places(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return line and position of each point; positions of lines of any length are scaled."""
        next_coupled = np.zeros(self.size, dtype=bool)
        next_coupled[self.first[self.second == self.first + 1]] = True
        line = np.concatenate(([0], np.cumsum(~next_coupled[:-1])))
        count = np.bincount(line)
        position = np.arange(self.size) - (np.cumsum(count) - count)[line]
        return line.astype(np.float64), (position + 0.5) / count[line] * count.max()


@dataclass(frozen=True, eq=False)
class Front:
    """Unknowns that are eliminated together, by their rank in the order of elimination.

    Attributes
    ----------
    first, end : first rank, and rank after the last
    border : (unknown,) ascending ranks of the later unknowns that are coupled with these
    children : numbers of the fronts whose remainders are added to this one
    """

    first: int
    end: int
    border: IntArray
    children: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Elimination:
    """Order of elimination.

    Attributes
    ----------
    rank : (unknown,) rank of each unknown
    fronts : children first
    """

    rank: IntArray
    fronts: tuple[Front, ...]


def dissected(start: npt.NDArray[np.int32], columns: npt.NDArray[np.int32]) -> Elimination:
    """Return the order of elimination of an upper triangle, in CSR with sorted columns."""
    graph = Graph.of(start, columns)
    domain, parents = _domains(graph)
    order = _children_first(parents)
    place = np.zeros(len(parents), np.int64)
    place[order] = np.arange(len(parents))
    points = np.argsort(place[domain], kind="stable")
    ends = np.cumsum(np.bincount(place[domain], minlength=len(parents)))
    children: list[list[int]] = [[] for _ in parents]
    for number, parent in enumerate(parents):
        if parent >= 0:
            children[place[parent]].append(int(place[number]))
    ranked = np.zeros(graph.size, np.int64)
    ranked[points] = np.arange(graph.size)
    borders = _borders(graph, ranked, ends, children)
    # From points to their unknowns, which are consecutive.
    count = np.bincount(graph.point)
    before = np.concatenate(([0], np.cumsum(count[points])))
    own = np.arange(graph.point.size) - (np.cumsum(count) - count)[graph.point]
    rank = before[ranked[graph.point]] + own
    starts = np.concatenate(([0], ends[:-1]))
    fronts = (
        Front(int(before[low]), int(before[high]), _unknowns(border, before), tuple(below))
        for low, high, border, below in zip(starts, ends, borders, children, strict=True)
    )
    return Elimination(rank, tuple(fronts))


def _domains(graph: Graph) -> tuple[IntArray, list[int]]:
    """Return the domain of each point, and the parent of each domain, -1 for the first.

    The points of a domain that was halved are those that separate its halves.
    """
    line, position = graph.places()
    domain, parents = np.zeros(graph.size, np.int64), [-1]
    first, second = graph.first, graph.second
    while True:
        inner = domain[first] == domain[second]
        first, second = first[inner], second[inner]
        large = np.bincount(domain, minlength=len(parents)) >= _LEAF_POINTS
        large[parents[1:]] = False  # halved before
        upper = _upper_half(domain, len(parents), line, position)
        across = large[domain[first]] & (upper[first] != upper[second])
        separates = np.zeros(graph.size, dtype=bool)
        separates[first[across & upper[first]]] = True
        separates[second[across & upper[second]]] = True
        moved = large[domain] & ~separates
        if not moved.any():
            return domain, parents
        halves, renumbered = np.unique(2 * domain[moved] + upper[moved], return_inverse=True)
        domain[moved] = len(parents) + renumbered
        parents += (halves // 2).tolist()


def _upper_half(
    domain: IntArray,
    size: int,
    line: npt.NDArray[np.float64],
    position: npt.NDArray[np.float64],
) -> npt.NDArray[np.bool_]:
    """Return the points in the upper half of their domain, along its longer side.

    `size` is the number of domains.
    """
    lows, extents = [], []
    for values in (line, position):
        low, high = np.full(size, np.inf), np.full(size, -np.inf)
        np.minimum.at(low, domain, values)
        np.maximum.at(high, domain, values)
        lows.append(low)
        extents.append(high - low)
    by_line = extents[0] >= extents[1]
    along = np.where(by_line[domain], line, position)
    order = np.lexsort((along, domain))
    count = np.bincount(domain, minlength=size)
    middle = np.minimum(np.cumsum(count) - count + count // 2, domain.size - 1)
    cut = along[order[middle]]
    # More than half of the points can be on the first line: then the others are the upper half.
    cut = np.where(cut > np.where(by_line, *lows), cut, np.nextafter(cut, np.inf))
    return np.asarray(along >= cut[domain])


def _children_first(parents: list[int]) -> list[int]:
    """Return the domains in an order in which each follows its children."""
    children: list[list[int]] = [[] for _ in parents]
    for number, parent in enumerate(parents[1:], 1):
        children[parent].append(number)
    order, left = [], [0]
    while left:
        order.append(left.pop())
        left += children[order[-1]]
    return order[::-1]


def _borders(
    graph: Graph, ranked: IntArray, ends: IntArray, children: list[list[int]]
) -> list[IntArray]:
    """Return for each front the ranks of the later points that are coupled with its points."""
    low = np.minimum(ranked[graph.first], ranked[graph.second])
    high = np.maximum(ranked[graph.first], ranked[graph.second])
    front = np.searchsorted(ends, low, side="right")
    later = high >= ends[front]
    pairs = np.unique(front[later] * graph.size + high[later])
    coupled = np.split(
        pairs % graph.size, np.searchsorted(pairs, graph.size * np.arange(1, ends.size))
    )
    borders: list[IntArray] = []
    for number, own in enumerate(coupled):
        below = [borders[child] for child in children[number]]
        border = np.unique(np.concatenate([own, *below])) if below else own
        borders.append(border[border >= ends[number]])
    return borders


def _unknowns(points: IntArray, before: IntArray) -> IntArray:
    """Return the ranks of the unknowns of points, given the number of unknowns before each."""
    count = before[points + 1] - before[points]
    first = np.repeat(before[points] - (np.cumsum(count) - count), count)
    return np.asarray(first + np.arange(first.size))
