"""Camera rays that cross an edge during a sequence: linear between the times of their traces.

The nodes are the times at which the light of the frames is needed, of all exposures. Rays are
traced at five nodes. An interval between two traced nodes is halved until it is

- dark at both ends,
- or linear: together with a traced node before or behind it. Three points of a parabola show the
  error of linear interpolation; across an edge the deviation of the middle one is large,
- or has no node in it.

A ray that crosses an edge is therefore traced at both nodes around the crossing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, IntArray
from reconstruction.compiling import NESTED, Function, compile_and_keep, digest_of_sources
from twin.optics.connection import Connection
from twin.optics.moving_rig import LanePaths
from twin.optics.time_paths import WEIGHT_SHARE, polynomial_at

Numbers = NDArray[np.int32]
TraceNodes = Callable[[Numbers, Numbers], LanePaths]
"""Returns the paths of rays, from the node and the lane of each."""

_FIRST_NODES = 5
# Largest error of a coordinate between two traces. With 0.03 px the error of the light doubles, and
# that of decoded points at edges is 30 % larger.
_COORDINATE_PX = 0.01
_NAMES = ("column_px", "row_px", "axial_mm", "weight")
_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, ("piecewise_paths.py",))
_OPTIONS: dict[str, Any] = {"nogil": True, "_nrt": False, "error_model": "numpy"}


def _compiled(function: Function) -> Function:
    return compile_and_keep(function, _OPTIONS, _SOURCE_DIGEST)


def _nested(function: Function) -> Function:
    return compile_and_keep(function, _OPTIONS | NESTED, _SOURCE_DIGEST)


@dataclass(frozen=True, eq=False)
class NodePaths:
    """Paths of lanes at all nodes.

    Attributes
    ----------
    values : by quantity, (lane, node) float32
    crossed : (lane,) True for lanes that cross an edge, a shadow or the end of the light
    """

    values: dict[str, FloatImage]
    crossed: BoolImage

    def of_nodes(self, numbers: IntArray) -> "NodePaths":
        """Return the paths at some nodes."""
        return NodePaths({name: of[:, numbers] for name, of in self.values.items()}, self.crossed)

    def connection(self) -> Connection:
        """Return the paths, ordered by lane and node, as input of the light tables."""
        return LanePaths(*(self.values[name].ravel() for name in _NAMES)).connection()


def traced_where_needed(
    trace: TraceNodes, places: FloatArray, lanes: int, white: float
) -> NodePaths:
    """Return lanes that are traced at some nodes, and linear in time between them.

    Parameters
    ----------
    trace : traces rays
    places : (node,) ascending relative times
    lanes : number of lanes
    white : mean weight of all lit rays
    """
    shape = lanes, len(places)
    values = {name: np.zeros(shape, np.float32) for name in _NAMES}
    known, crossed = np.zeros(shape, bool), np.zeros(lanes, bool)
    criteria = _Criteria(places, _COORDINATE_PX, WEIGHT_SHARE * white)
    quantities = _Quantities(values["column_px"], values["row_px"], values["weight"])
    first = np.unique(np.linspace(0.0, len(places) - 1.0, _FIRST_NODES).astype(np.int32))
    lane_of = np.repeat(np.arange(lanes, dtype=np.int32), len(first))
    nodes = np.tile(first, lanes)
    while len(nodes):
        traced = trace(nodes, lane_of)
        for name in _NAMES:
            values[name][lane_of, nodes] = getattr(traced, name)
        known[lane_of, nodes] = True
        changed = np.flatnonzero(np.bincount(lane_of, minlength=lanes)).astype(np.int32)
        middles = np.zeros((2, len(changed) * (len(places) // 2)), np.int32)
        count = _gaps(known, quantities, criteria, changed, middles)
        lane_of, nodes = middles[:, :count]
    _fill(known, quantities, criteria, values["axial_mm"], crossed)
    return NodePaths(values, crossed)


def between_moments(
    moments: FloatArray, paths: list[LanePaths], places: FloatArray, steady: BoolImage
) -> NodePaths:
    """Return lanes that are interpolated between their traces at the moments.

    Parameters
    ----------
    moments : (moment,) ascending relative times of `paths`
    places : (node,) relative times of the nodes
    steady : (lane,) True for lanes that are polynomials of time; the others are linear between two
        moments
    """
    step = np.searchsorted(moments[1:-1], places, side="right")
    share = (places - moments[step]) / (moments[step + 1] - moments[step])
    values = {}
    for name in _NAMES:
        traced = np.stack([getattr(path, name) for path in paths], axis=-1)
        linear = traced[:, step] * (1.0 - share) + traced[:, step + 1] * share
        linear[steady] = polynomial_at(traced[steady].T, places).T
        values[name] = linear.astype(np.float32)
    return NodePaths(values, ~steady)


class _Quantities(NamedTuple):
    """Values that have to be linear, (lane, node) each."""

    column_px: Any
    row_px: Any
    weight: Any


class _Criteria(NamedTuple):
    """Relative times of the nodes, and the largest errors of linear interpolation."""

    places: Any
    coordinate_px: float
    weight: float


@_compiled
def _gaps(known: Any, quantities: Any, criteria: Any, lanes: Any, middles: Any) -> int:
    """Write lane and node of the middle of all intervals that are not held; return their number.

    Parameters
    ----------
    known : (lane, node) True where the lane is traced; true at the first and the last node
    lanes : numbers of the lanes that are searched
    middles : (2, interval) is filled from its start
    """
    count = 0
    for lane in lanes:
        before, start = -1, 0
        end = _next(known, start, lane)
        while end >= 0:
            behind = _next(known, end, lane)
            nodes = before, start, end, behind
            if end - start > 1 and not _is_held(quantities, criteria, lane, nodes):
                middles[0, count], middles[1, count] = lane, (start + end) // 2
                count += 1
            before, start, end = start, end, behind
    return count


@_compiled
def _fill(known: Any, quantities: Any, criteria: Any, axial_mm: Any, crossed: Any) -> None:
    """Interpolate all lanes between their known nodes, and mark those that cross an edge."""
    (column_px, row_px, weight), places = quantities, criteria[0]
    for lane in range(known.shape[0]):
        before, start = -1, 0
        end = _next(known, start, lane)
        while end >= 0:
            behind = _next(known, end, lane)
            nodes = before, start, end, behind
            if end - start == 1:
                held = _is_held(quantities, criteria, lane, nodes)
                crossed[lane] = crossed[lane] or not held
            for node in range(start + 1, end):
                share = (places[node] - places[start]) / (places[end] - places[start])
                for values in (column_px, row_px, axial_mm, weight):
                    first, last = values[lane, start], values[lane, end]
                    values[lane, node] = first + share * (last - first)
            before, start, end = start, end, behind


@_nested
def _next(known: Any, node: Any, lane: Any) -> int:
    """Return the next known node behind a node, or -1."""
    for later in range(node + 1, known.shape[1]):
        if known[lane, later]:
            return int(later)
    return -1


@_nested
def _is_held(quantities: Any, criteria: Any, lane: Any, nodes: Any) -> bool:
    """Return True if a lane is interpolated between the second and the third of four known nodes.

    Parameters
    ----------
    nodes : ascending; the first and the last one are -1 if there is none
    """
    before, start, end, behind = nodes
    weight = quantities[2]
    lit_first, lit_last = weight[lane, start] > 0.0, weight[lane, end] > 0.0
    if not (lit_first and lit_last):
        return not (lit_first or lit_last)
    with_first = before >= 0 and weight[lane, before] > 0.0
    with_last = behind >= 0 and weight[lane, behind] > 0.0
    # The interval is between the middle and the last node of both triples.
    return (with_first and _are_on_line(quantities, criteria, lane, (before, start, end))) or (
        with_last and _are_on_line(quantities, criteria, lane, (behind, end, start))
    )


@_nested
def _are_on_line(quantities: Any, criteria: Any, lane: Any, nodes: Any) -> bool:
    """Return True if a lane is linear between the middle and the last of three nodes.

    A parabola with the second derivative c deviates at the middle node by c a b / 2, where a and b
    are the lengths of both intervals, and by c b^2 / 8 from its line in the middle of b. This
    ratio, b / (4 a), is not used below 1/4: across an edge the deviation must not be divided by
    more.
    """
    first, middle, last = nodes
    places = criteria[0]
    length, other = places[last] - places[middle], places[middle] - places[first]
    share, over = other / (length + other), 0.25 * max(1.0, length / other)
    for values, limit in (
        (quantities[0], criteria[1]),
        (quantities[1], criteria[1]),
        (quantities[2], criteria[2]),
    ):
        a, b = values[lane, first], values[lane, last]
        if abs(values[lane, middle] - (a + share * (b - a))) * over > limit:
            return False
    return True
