"""Assign the dots of an image of a pressed elastomer to the dots of the image without contact.

A displacement of half the spacing makes the nearest dot ambiguous, but the displacement of an
elastomer is continuous. The assignment therefore grows from dots that are certain to their
neighbours. The displacement of a dot is predicted from its assigned neighbours, by an affine
function where these are enough. It is accepted if one dot, and only one, is near the predicted
place. At the end all assignments are made again as one problem (Hungarian method), with the
prediction from the neighbours of each dot.

The first assignments are of dots that hardly move relative to the whole: the common displacement is
the one that most dots share, the smallest if several are equal. A second solution starts with the
dots that are next to their places by `drift`. The result is the solution with the smaller sum of
squared distances from the predictions.
"""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.markers.drift import drifted

# Distances in units of the spacing: of the neighbours of a dot; of certain dots from the common
# displacement; of an accepted dot from its predicted place; of dots with one displacement.
_NEIGHBOURS, _CERTAIN, _GATE, _SAME = 2.3, 0.2, 0.35, 0.15
# Largest common displacement that is tried.
_FARTHEST = 0.75
# Neighbours that an affine prediction needs; with fewer, it is their mean.
_FOR_AFFINE = 5
_NEAR_MEAN = 1.6
UNASSIGNED = -1


def assign(
    before_px: FloatArray,
    after_px: FloatArray,
    spacing_px: float,
    expected_px: FloatArray | None = None,
) -> IntArray:
    """Return for each dot before the index of the same dot after, or `UNASSIGNED`, (dot,).

    Parameters
    ----------
    before_px, after_px : (n, 2) and (m, 2), centres of dots, row and column
    spacing_px : distance of neighbouring dots
    expected_px : (n, 2) displacements, for example those of the frame before; None: 0
    """
    if not len(before_px) or not len(after_px):
        return np.full(len(before_px), UNASSIGNED, np.int64)
    first_px = np.zeros_like(before_px) if expected_px is None else expected_px
    first_px = first_px + _common_displacement(before_px + first_px, after_px, spacing_px)
    neighbours = _Neighbours(before_px, spacing_px)
    certain = _mutual(before_px + first_px, after_px, _CERTAIN * spacing_px)
    places = before_px + drifted(before_px, after_px, spacing_px, first_px)
    grown = _fully_grown(neighbours, after_px, certain, spacing_px)
    near = _mutual(places, after_px, _GATE * spacing_px)
    starts = [grown] if np.array_equal(grown, near) else [grown, near]
    solutions = [_assigned_at_once(neighbours, after_px, start, spacing_px) for start in starts]
    return min(solutions, key=lambda partner: _cost(neighbours, after_px, partner, spacing_px))


def deviation_from_neighbours(
    before_px: FloatArray, moved_px: FloatArray, known: BoolArray, spacing_px: float
) -> FloatArray:
    """Return how far each displacement is from that predicted from its neighbours, (dot,) px.

    It is 0 for a dot without known neighbours.

    Parameters
    ----------
    moved_px : (dot, 2), displacements
    known : dots that have a displacement
    """
    neighbours = _Neighbours(before_px, spacing_px)
    off_px = np.zeros(len(before_px))
    for dot in np.flatnonzero(known):
        expected = neighbours.predicted(int(dot), moved_px, known)
        if expected is not None:
            off_px[dot] = np.hypot(*(moved_px[dot] - expected))
    return off_px


def filled_from_neighbours(
    before_px: FloatArray, moved_px: FloatArray, known: BoolArray, spacing_px: float
) -> FloatArray:
    """Return displacements (dot, 2) px in which unknown ones follow from their neighbours.

    A dot without known neighbours has the displacement of the nearest known dot.

    Parameters
    ----------
    moved_px : (dot, 2), displacements
    known : dots that have a displacement, at least one
    """
    neighbours, filled = _Neighbours(before_px, spacing_px), moved_px.copy()
    nearest = np.flatnonzero(known)[KDTree(before_px[known]).query(before_px)[1]]
    for dot in np.flatnonzero(~known):
        expected = neighbours.predicted(int(dot), moved_px, known)
        filled[dot] = moved_px[nearest[dot]] if expected is None else expected
    return filled


class _Neighbours:
    """Dots before the press, and the prediction of one displacement from the neighbours' ones."""

    def __init__(self, before_px: FloatArray, spacing_px: float) -> None:
        self.before_px, self._spacing_px = before_px, spacing_px
        tree = KDTree(before_px)
        around = tree.query_ball_point(before_px, _NEIGHBOURS * spacing_px)
        self.of = [np.array([k for k in near if k != dot], np.int64)
                   for dot, near in enumerate(around)]  # fmt: skip

    def predicted(self, dot: int, moved_px: FloatArray, known: BoolArray) -> FloatArray | None:
        """Return the displacement (2,) px of a dot from its known neighbours; None without any.

        It is the median of several affine functions: of all known neighbours, without each of the
        others, so that one wrong neighbour does not change it.
        """
        near = self.of[dot][known[self.of[dot]]]
        if not len(near):
            return None
        offset = self.before_px[near] - self.before_px[dot]
        distance = np.hypot(*offset.T) / self._spacing_px
        weight = np.exp(-0.5 * distance**2)
        close = distance < _NEAR_MEAN
        if len(near) < _FOR_AFFINE or not _surrounded(offset, weight):
            chosen = near[close] if close.any() else near
            return np.asarray(np.median(moved_px[chosen], axis=0))
        return _robust_constant(offset, weight, moved_px[near])


def _surrounded(offset: FloatArray, weight: FloatArray) -> bool:
    """Return True if neighbours are on all sides: an affine function is then not extrapolated."""
    mean = weight @ offset / weight.sum()
    spread = np.sqrt(np.linalg.eigvalsh((offset * weight[:, None]).T @ offset / weight.sum()))
    return bool(np.hypot(*mean) < spread[0])


def _robust_constant(offset: FloatArray, weight: FloatArray, moved: FloatArray) -> FloatArray:
    """Return the value at offset 0 of an affine function, by weighted fits without outliers."""
    basis = np.column_stack([np.ones(len(offset)), offset])
    share = weight.copy()
    for _ in range(3):
        root = np.sqrt(share)[:, None]
        fit = np.linalg.lstsq(basis * root, moved * root)[0]
        off = np.hypot(*(moved - basis @ fit).T)
        share = weight / (1.0 + (off / (2.0 * np.median(off) + 1e-3)) ** 2)
    return np.asarray(fit[0])


def _common_displacement(
    before_px: FloatArray, after_px: FloatArray, spacing_px: float
) -> FloatArray:
    tree, reach = KDTree(after_px), _FARTHEST * spacing_px
    pairs = [after_px[near] - place for place, near in
             zip(before_px, tree.query_ball_point(before_px, reach), strict=True)]  # fmt: skip
    moved = np.concatenate([np.zeros((0, 2)), *pairs])
    if not len(moved):
        return np.zeros(2)
    votes = np.array([len(near) for near in
                      KDTree(moved).query_ball_point(moved, _SAME * spacing_px)])  # fmt: skip
    # A larger displacement must have more votes: on a lattice it is also one to the next dot.
    chosen = int(np.argmax(votes - len(before_px) * 0.25 * np.hypot(*moved.T) / spacing_px))
    same = np.hypot(*(moved - moved[chosen]).T) < _SAME * spacing_px
    return np.asarray(np.median(moved[same], axis=0))


def _mutual(places_px: FloatArray, after_px: FloatArray, reach_px: float) -> IntArray:
    """Return for each place the nearest dot, if the place is also the nearest to the dot."""
    distance, nearest = KDTree(after_px).query(places_px)
    back = KDTree(places_px).query(after_px)[1]
    mutual = (back[nearest] == np.arange(len(places_px))) & (distance < reach_px)
    return np.where(mutual, nearest, UNASSIGNED).astype(np.int64)


def _fully_grown(
    neighbours: _Neighbours, after_px: FloatArray, partner: IntArray, spacing_px: float
) -> IntArray:
    """Return the assignments, continued to all dots that neighbours predict."""
    for _ in range(len(partner)):
        grown = _grown(neighbours, after_px, partner, spacing_px)
        if np.array_equal(grown, partner):
            break
        partner = grown
    return partner


def _grown(
    neighbours: _Neighbours, after_px: FloatArray, partner: IntArray, spacing_px: float
) -> IntArray:
    """Return the assignments with those of dots next to assigned ones added."""
    places, known = _predictions(neighbours, after_px, partner)
    free = known & (partner == UNASSIGNED)
    taken = np.isin(np.arange(len(after_px)), partner)
    grown = partner.copy()
    if free.any() and not taken.all():
        left = np.flatnonzero(~taken)
        new = _mutual(places[free], after_px[left], _GATE * spacing_px)
        at = np.flatnonzero(free)[new != UNASSIGNED]
        grown[at] = left[new[new != UNASSIGNED]]
    return grown


def _predictions(
    neighbours: _Neighbours, after_px: FloatArray, partner: IntArray
) -> tuple[FloatArray, BoolArray]:
    """Return the predicted places (dot, 2) of all dots, and whether a dot has a prediction."""
    known = partner != UNASSIGNED
    moved = np.where(known[:, None], after_px[partner] - neighbours.before_px, 0.0)
    places, has = neighbours.before_px.copy(), np.zeros(len(known), np.bool_)
    for dot in range(len(known)):
        expected = neighbours.predicted(dot, moved, known)
        if expected is not None:
            places[dot] += expected
            has[dot] = True
    return places, has


def _assigned_at_once(
    neighbours: _Neighbours, after_px: FloatArray, partner: IntArray, spacing_px: float
) -> IntArray:
    """Return the assignment with the smallest sum of squared distances from the predictions.

    A dot without a partner within the gate costs as much as one at the gate.
    """
    for _ in range(2):
        cost, near = _costs(neighbours, after_px, partner, spacing_px)
        before, after = linear_sum_assignment(cost)
        partner = np.full(len(partner), UNASSIGNED, np.int64)
        chosen = near[before, after]
        partner[before[chosen]] = after[chosen]
    return partner


def _cost(
    neighbours: _Neighbours, after_px: FloatArray, partner: IntArray, spacing_px: float
) -> float:
    cost = _costs(neighbours, after_px, partner, spacing_px)[0]
    known = np.flatnonzero(partner != UNASSIGNED)
    lost = len(partner) - len(known)
    return float(cost[known, partner[known]].sum()) + lost * (_GATE * spacing_px) ** 2


def _costs(
    neighbours: _Neighbours, after_px: FloatArray, partner: IntArray, spacing_px: float
) -> tuple[FloatArray, BoolArray]:
    """Return squared distances (n, m) from the predictions, at most the gate's, and the near ones.

    The predictions follow from the assignments of the neighbours.
    """
    gate = _GATE * spacing_px
    places, has = _predictions(neighbours, after_px, partner)
    apart = np.where(has[:, None], cdist(places, after_px), gate)
    return np.minimum(apart, gate) ** 2, apart < gate
