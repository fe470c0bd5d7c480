"""The order of the bits of a word, from changes between neighbouring pixels.

Where a bit of a Gray word changes, the next finer bit is 1 and the next but one is 0; where a bit
of a binary word changes, both change as well, in the opposite direction. In another order of bits,
or with a bit and its inverse exchanged, this is violated. Contradictions are counted as a share of
the changes of each bit, so that a bit with few changes has the same weight as one with many. Fine
stripes that the camera hardly resolves therefore do not hide the order of the coarse bits.

A bit of place k that does not change within the view has at most one coarser bit that does: of the
places 2^k words from each other every other one is an edge of that bit.

A bit that does not change within the view, or rarely, may fit several places, see `movable`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, IntArray

Shown = Literal["reflected", "binary"]
SHOWN: tuple[Shown, Shown] = ("reflected", "binary")
# Least number of changes of a bit for a contradiction.
LEAST_CHANGES = 8
# Changes of other bits per change of a bit that is steady: noise, or an edge of depth.
STEADY = 4
# Its mean is nearer to 0 or 1: a bit with edges on dark parts of the object is not steady.
STEADY_MEAN = 0.45
# Contradictory shares, summed over the bits, by which one order is better than another: an
# exchange of two bits or an inverse add 0.9 to 3, noise and depth edges up to 0.3.
MARGIN = 0.4
MOST_ROUNDS = 30


@dataclass(frozen=True, eq=False)
class Changes:
    """Statistics of all bits at pairs of neighbouring pixels between which a bit changes.

    Parameters
    ----------
    count : (bit,) number of changes of a bit
    mean : (bit,) mean value of a bit, 0 to 1, at all places where any bit changes
    level : (bit, other) mean value of the second bit, 0 to 1, at the changes of the first bit
    against, along : (bit, other) share of the first bit's changes at which the second bit changes
        as well, in the opposite (against) or in the same direction (along)
    """

    count: IntArray
    mean: FloatArray
    level: FloatArray
    against: FloatArray
    along: FloatArray

    @classmethod
    def of(cls, samples: BoolImage) -> "Changes":
        """Count the changes in rows of four neighbours, (bit, place, 4), between the inner two."""
        step = samples[..., 1:].astype(np.int8) - samples[..., :-1].astype(np.int8)
        inner, outer = step[..., 1], step.sum(axis=-1, dtype=np.int8)
        bits = len(samples)
        level, against, along = (np.zeros((bits, bits)) for _ in range(3))
        count = np.count_nonzero(inner, axis=1)
        for bit in np.flatnonzero(count):
            at = inner[bit] != 0
            level[bit] = samples[:, at, 1:3].mean(axis=(1, 2))
            # Edges of several bits that coincide may be displaced by blur and noise.
            signs = np.where(inner[:, at] != 0, inner[:, at], outer[:, at]) * inner[bit, at]
            against[bit] = np.mean(signs < 0, axis=1)
            along[bit] = np.mean(signs > 0, axis=1)
        mean = samples.mean(axis=(1, 2)) if samples.size else np.full(bits, 0.5)
        return cls(count, mean, level, against, along)

    def inverted(self, bits: Sequence[int]) -> "Changes":
        """Return the state with some bits replaced by their inverse."""
        is_other = np.zeros(len(self.count), bool)
        is_other[list(bits)] = True
        crossed = is_other[:, np.newaxis] ^ is_other
        return replace(
            self,
            mean=np.where(is_other, 1.0 - self.mean, self.mean),
            level=np.where(is_other, 1.0 - self.level, self.level),
            against=np.where(crossed, self.along, self.against),
            along=np.where(crossed, self.against, self.along),
        )

    def contradictions(self, order: Sequence[int], shown: Shown) -> FloatArray:
        """Return for every bit of an order the share of its changes that finer bits contradict.

        0 for the finest bit, and for bits with fewer than LEAST_CHANGES changes; but 1 for a steady
        bit if two coarser bits change.
        """
        shares = np.zeros(len(order))
        is_steady = np.abs(self.mean - 0.5) > STEADY_MEAN
        for place, bit in enumerate(order):
            if self.count[bit] < LEAST_CHANGES:
                least = max(LEAST_CHANGES, STEADY * self.count[bit])
                shares[place] = float(
                    np.count_nonzero(self.count[list(order[:place])] >= least) > 1
                    and is_steady[bit]
                )
                continue
            for finer, neighbour in enumerate(order[place + 1 : place + 3]):
                if shown == "binary":
                    share = 1.0 - self.against[bit, neighbour]
                else:
                    share = abs((finer == 0) - self.level[bit, neighbour])
                shares[place] = max(shares[place], share)
        return shares

    def cost(self, order: Sequence[int], shown: Shown) -> float:
        """Return the contradictory shares of an order, summed over the bits."""
        return float(self.contradictions(list(order), shown).sum())


@dataclass(frozen=True)
class BitOrder:
    """An order of bits, the coarsest first.

    Parameters
    ----------
    order : indices into the bits as given
    shown : as Gray code or as binary word
    cost : contradictory shares, summed over the bits
    is_by_names : the order is the given one or its reverse
    """

    order: tuple[int, ...]
    shown: Shown
    cost: float
    is_by_names: bool


def named_order(changes: Changes) -> BitOrder:
    """Return the given order of the bits or its reverse, the one that fits better."""
    natural = tuple(range(len(changes.count)))
    # If the changes do not decide: the coarsest first, if the stripes get finer.
    rises = np.sum(np.diff(changes.count)) >= 0.0
    both = [
        _best_shown(changes, candidate)
        for candidate in (natural, natural[::-1])[:: 1 if rises else -1]
    ]
    return both[1] if both[1].cost < both[0].cost - MARGIN else both[0]


def order_bits(changes: Changes) -> BitOrder:
    """Return the order of bits that the changes between neighbours confirm.

    The given order, or its reverse, is returned unless another order is clearly better.
    """
    named = named_order(changes)
    if named.cost <= MARGIN:
        return named
    by_changes = tuple(np.argsort(changes.count, kind="stable").tolist())
    climbed = [_climb(changes, start) for start in (named.order, by_changes)]
    best = min(climbed, key=lambda order: order.cost)
    return best if best.cost < named.cost - MARGIN else named


def _best_shown(changes: Changes, order: tuple[int, ...], *, is_by_names: bool = True) -> BitOrder:
    costs = {shown: changes.cost(order, shown) for shown in SHOWN}
    # Two bits have no finer bits that would distinguish both kinds.
    is_binary = costs["binary"] < costs["reflected"] - MARGIN and len(order) > 2
    shown: Shown = "binary" if is_binary else "reflected"
    return BitOrder(order, shown, costs[shown], is_by_names)


def _climb(changes: Changes, start: tuple[int, ...]) -> BitOrder:
    """Move or exchange bits while that lowers the cost."""
    best = _best_shown(changes, start, is_by_names=False)
    for _ in range(MOST_ROUNDS):
        candidates = (
            _best_shown(changes, candidate, is_by_names=False) for candidate in _changed(best.order)
        )
        better = min(candidates, key=lambda candidate: candidate.cost, default=best)
        if better.cost >= best.cost:
            return best
        best = better
    return best


def _changed(order: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    for i, j in combinations(range(len(order)), 2):
        swapped = list(order)
        swapped[i], swapped[j] = swapped[j], swapped[i]
        yield tuple(swapped)
    for i in range(len(order)):
        yield from _moved(order, i)


def _moved(order: tuple[int, ...], place: int) -> Iterator[tuple[int, ...]]:
    """Yield the orders with one bit moved to every other place."""
    rest = order[:place] + order[place + 1 :]
    for position in range(len(order)):
        if position != place:
            yield (*rest[:position], order[place], *rest[position:])


def movable(changes: Changes, order: BitOrder) -> tuple[int, ...]:
    """Return the bits, indices as given, that fit about as well at another place of the order."""
    limit = order.cost + MARGIN
    return tuple(
        bit
        for place, bit in enumerate(order.order)
        if any(
            changes.cost(moved_order, order.shown) < limit
            for moved_order in _moved(order.order, place)
        )
    )


def inverted(changes: Changes, order: BitOrder) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the bits that fit clearly better as their inverse, and those that fit both ways.

    The coarsest bit is always among the latter: its inverse numbers the words from the other end.
    """
    wrong: list[int] = []
    uncertain, cost = [], order.cost
    for bit in order.order:
        flipped_cost = changes.inverted([*wrong, bit]).cost(order.order, order.shown)
        if flipped_cost < cost - MARGIN:
            wrong.append(bit)
            cost = flipped_cost
        elif flipped_cost < cost + MARGIN:
            uncertain.append(bit)
    return tuple(wrong), tuple(uncertain)
