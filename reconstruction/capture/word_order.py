"""Determine the order of the bits of a code word from changes between neighbouring pixels.

Where a bit of a Gray word changes, the next finer bit is 1, and the finer bit after that is 0.
Where a bit of a binary word changes, both finer bits change, too, in the opposite direction. These
rules are violated in another order of the bits, or if a bit and its inverse are exchanged.
Violations, called contradictions, are counted as a share of the changes of each bit. A bit with few
changes therefore has the same weight as a bit with many. Thus fine stripes that the camera hardly
resolves do not hide the order of the coarse bits.

If a bit does not change within the view, at most one coarser bit changes there. Reason: the changes
of bit k and of all coarser bits are at multiples of 2^k words, and every other one of these changes
is of bit k.

A bit that does not change within the view, or rarely, may fit at several positions, see `movable`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, IntArray

Shown = Literal["reflected", "binary"]
SHOWN: tuple[Shown, Shown] = ("reflected", "binary")
# Least number of changes of a bit from which contradictions are counted.
LEAST_CHANGES = 8
# A bit is constant in the view if other bits change at least this number of times as often. The few
# changes are noise or depth edges.
STEADY = 4
# Least deviation of the mean of a constant bit from 0.5: a bit with edges on dark parts of the
# object is not constant.
STEADY_MEAN = 0.45
# Least difference of the cost by which one order is better than another. An exchange of two bits or
# an inverse adds 0.9 to 3 to the cost, noise and depth edges add up to 0.3.
MARGIN = 0.4
MOST_ROUNDS = 30


@dataclass(frozen=True, eq=False)
class Changes:
    """Statistics of all bits at pairs of neighbouring pixels between which a bit changes.

    Parameters
    ----------
    count : (bit,) number of changes of each bit
    mean : (bit,) mean value of each bit, 0 to 1, at all positions where any bit changes
    level : (bit, other) mean value of bit `other`, 0 to 1, at the changes of `bit`
    against, along : (bit, other) share of the changes of `bit` at which bit `other` changes, too:
        in the opposite direction (against), or in the same direction (along)
    """

    count: IntArray
    mean: FloatArray
    level: FloatArray
    against: FloatArray
    along: FloatArray

    @classmethod
    def of(cls, samples: BoolImage) -> "Changes":
        """Return the statistics of rows of four neighbouring pixels, (bit, row, 4) bool.

        A bit changes in a row if its values at the inner two pixels differ.
        """
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
        """Return the statistics after replacing some bits by their inverse."""
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
        """Return for each bit of an order the share of its changes that finer bits contradict.

        The share is 0 for the finest bit. For a bit with fewer than LEAST_CHANGES changes it is 1
        if the bit is constant and two coarser bits change, otherwise 0.

        Parameters
        ----------
        order : indices of the bits, the coarsest first
        shown : encoding of the code word
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
        """Return the sum over the bits of `contradictions`."""
        return float(self.contradictions(list(order), shown).sum())


@dataclass(frozen=True)
class BitOrder:
    """An order of the bits of a code word, the coarsest first, and how well it fits.

    Parameters
    ----------
    order : indices of the bits in the order of their file names
    shown : encoding of the code word
    cost : sum over the bits of the contradictory shares, see `Changes.contradictions`
    is_by_names : whether the order is that of the file names or its reverse
    """

    order: tuple[int, ...]
    shown: Shown
    cost: float
    is_by_names: bool


def named_order(changes: Changes) -> BitOrder:
    """Return the order of the file names or its reverse, whichever fits better."""
    natural = tuple(range(len(changes.count)))
    # If both fit equally well, the order is used in which the stripes become finer.
    rises = np.sum(np.diff(changes.count)) >= 0.0
    both = [
        _best_shown(changes, candidate)
        for candidate in (natural, natural[::-1])[:: 1 if rises else -1]
    ]
    return both[1] if both[1].cost < both[0].cost - MARGIN else both[0]


def order_bits(changes: Changes) -> BitOrder:
    """Return the order of the bits that the changes between neighbouring pixels confirm.

    This is the order of the file names or its reverse, unless another order fits clearly better.
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
    # With two bits only, no finer bits distinguish the two encodings.
    is_binary = costs["binary"] < costs["reflected"] - MARGIN and len(order) > 2
    shown: Shown = "binary" if is_binary else "reflected"
    return BitOrder(order, shown, costs[shown], is_by_names)


def _climb(changes: Changes, start: tuple[int, ...]) -> BitOrder:
    """Return the best order that is reached from `start` by moves and exchanges of bits.

    Each move or exchange reduces the cost.
    """
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
    """Yield the orders in which the bit at `place` is moved to each other position."""
    rest = order[:place] + order[place + 1 :]
    for position in range(len(order)):
        if position != place:
            yield (*rest[:position], order[place], *rest[position:])


def movable(changes: Changes, order: BitOrder) -> tuple[int, ...]:
    """Return the indices of the bits that fit about as well at another position of the order."""
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
    """Return the bits that fit clearly better as their inverse, and the bits that fit both ways.

    The coarsest bit always fits both ways: its inverse numbers the words from the opposite end.
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
