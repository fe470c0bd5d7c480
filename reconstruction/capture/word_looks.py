"""Bits of words among the images of an unknown set: their order, their inverses, their doubts.

The order is that of the names where the view confirms it or does not decide; another one only where
the view clearly contradicts the names. See `word_order`.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from reconstruction.arrays import BoolImage, FloatImage
from reconstruction.capture.image_looks import FrameGroup, Look
from reconstruction.capture.phase_looks import are_opposite
from reconstruction.capture.word_order import (
    MARGIN,
    BitOrder,
    Changes,
    inverted,
    movable,
    named_order,
    order_bits,
)
from reconstruction.errors import few
from reconstruction.patterns import Axis

# Share of a bit's changes that may contradict the finer bits without a doubt.
CONTRADICTS = 0.3
# Share of the striped images in pairs of opposite ones from which others are paired as well.
MOST_PAIRED = 0.6
# Variance of u from which stripes are resolved; with fewer cycles edges are counted.
RESOLVED, LEAST_CYCLES = 0.09, 4.0


@dataclass(frozen=True, eq=False)
class Bits:
    """Images that are bits along one axis, with their inverses.

    Parameters
    ----------
    looks : in the order of their names; inverses : of each, or none at all
    lone : images without inverse though others have theirs
    changes : between neighbouring pixels
    """

    axis: Axis
    looks: tuple[Look, ...]
    inverses: tuple[Look, ...]
    lone: tuple[Look, ...]
    changes: Changes

    @property
    def everyone(self) -> range:
        """The indices of all bits."""
        return range(len(self.looks))

    @property
    def cost(self) -> float:
        """What contradicts their order by names, see `BitOrder`, and the bits without inverse."""
        cost = named_order(self.changes).cost
        if self.inverses:
            cost = min(cost, named_order(self.changes.inverted(self.everyone)).cost)
        return cost + len(self.lone)


def bits_of(
    looks: Sequence[Look], chosen: Sequence[int], axis: Axis, mean: FloatImage | None
) -> Bits:
    """Return the images of some indices as bits along an axis.

    Parameters
    ----------
    mean : (line, sample) u - 1/2 that bits without inverse are compared with; None: 0
    """
    partner = _partners(looks, chosen, axis)
    firsts = [k for k in chosen if k in partner] if partner else list(chosen)
    seconds = set(partner.values())
    lone = [k for k in chosen if partner and k not in partner and k not in seconds]
    gray = tuple(looks[k] for k in firsts)
    inverse = tuple(looks[partner[k]] for k in firsts) if partner else ()
    limit = np.float32(0.0) if mean is None else mean
    against: list[Any] = [one.along[axis] for one in inverse] or [limit] * len(gray)
    levels = [one.along[axis] > other for one, other in zip(gray, against, strict=True)]
    lit = looks[0].lit[axis]
    shown = np.stack(levels) if levels else np.zeros((0, *lit.shape), bool)
    changes = Changes.of(_neighbours(shown, lit))
    return Bits(axis, gray, inverse, tuple(looks[k] for k in lone), changes)


def _neighbours(levels: BoolImage, is_lit: BoolImage) -> BoolImage:
    """Return four lit neighbours of a line wherever a bit changes, (bit, place, 4)."""
    last = levels.shape[2] - 3
    parts = [slice(k, last + k) for k in range(4)]
    is_used = np.all([is_lit[:, part] for part in parts], axis=0)
    is_used &= np.any(levels[:, :, parts[1]] != levels[:, :, parts[2]], axis=0)
    return np.stack([levels[:, :, part][:, is_used] for part in parts], axis=-1)


def _partners(looks: Sequence[Look], chosen: Sequence[int], axis: Axis) -> dict[int, int]:
    """Return of each bit the index of its inverse, which follows it; {}: there are no inverses.

    Images without stripes, or with stripes that are hardly resolved, have theirs where most of the
    others have it.
    """
    striped = [k for k in chosen if looks[k].kind == "striped"]
    partner: dict[int, int] = {}
    for k in striped:
        if k not in partner.values():
            free = (n for n in striped if n > k and n not in partner.values())
            found = next((n for n in free if are_opposite(looks[k], looks[n])), None)
            if found is not None:
                partner[k] = found
    # Bits of a binary word may be opposite within a small view.
    if not partner or 2 * len(partner) < MOST_PAIRED * len(striped):
        return {}
    step = Counter(n - k for k, n in partner.items()).most_common(1)[0][0]
    for k in chosen:
        paired = {*partner, *partner.values()}
        other = k + step
        if {k, other}.isdisjoint(paired) and other in chosen and _may_be_opposite(looks, k, other):
            partner[k] = other
    return partner


def _may_be_opposite(looks: Sequence[Look], k: int, other: int) -> bool:
    kinds = {looks[k].kind, looks[other].kind}
    return kinds == {"white", "black"} or kinds.isdisjoint({"white", "black"})


@dataclass(frozen=True)
class ArrangedBits:
    """Bits and their inverses as groups, the coarsest first, the kind of word, and the doubts.

    is_confirmed : the view shows that the order is that of the names
    """

    groups: tuple[FrameGroup, ...] = ()
    word: str = "reflected"
    doubts: tuple[str, ...] = ()
    is_by_names: bool = True
    is_confirmed: bool = True


def arranged(bits: Bits) -> ArrangedBits:
    """Return the bits in the order that the view confirms, see `order_bits`."""
    if not bits.looks:
        return ArrangedBits()
    changes, is_turned = bits.changes, False
    found = order_bits(changes)
    if bits.inverses:
        turned = changes.inverted(bits.everyone)
        other = order_bits(turned)
        is_turned = other.cost < found.cost - MARGIN
        changes, found = (turned, other) if is_turned else (changes, found)
    wrong, uncertain = inverted(changes, found) if bits.inverses else ((), ())
    changes = changes.inverted(wrong)
    found = replace(found, cost=changes.cost(found.order, found.shown))
    doubts = _order_doubts(bits.looks, changes, found)
    is_confirmed = not doubts
    doubts += _faint_doubts(bits.looks)
    doubts += _inverse_doubts(bits, is_turned=is_turned, wrong=wrong, uncertain=uncertain)
    sides: dict[str, list[str]] = {"gray": [], "inverse": []}
    for bit in found.order:
        shown = [bits.looks[bit].file, *(one.file for one in bits.inverses[bit : bit + 1])]
        if is_turned != (bit in wrong):
            shown = shown[::-1]
        for kind, name in zip(sides, shown, strict=False):
            sides[kind].append(name)
    frequency = max(_finest_frequency(bits, found.order), 1e-6)
    groups = [
        FrameGroup(kind, bits.axis, tuple(files), (), frequency)
        for kind, files in sides.items()
        if files
    ]
    return ArrangedBits(tuple(groups), found.shown, tuple(doubts), found.is_by_names, is_confirmed)


def _finest_frequency(bits: Bits, order: Sequence[int]) -> float:
    """Return the frequency of the finest bit, cycles per pixel, from the finest one resolved."""
    last = len(order) - 1
    for place in range(last, -1, -1):
        one = bits.looks[order[place]]
        levels, is_lit = one.along[bits.axis], one.lit[bits.axis]
        if is_lit.any() and float(np.var(levels[is_lit])) > RESOLVED:
            frequency = one.frequency
            if frequency * levels.shape[1] < LEAST_CYCLES:
                both = int(np.count_nonzero(is_lit[:, 1:] & is_lit[:, :-1]))
                frequency = 0.5 * float(bits.changes.count[order[place]]) / max(both, 1)
            return frequency * 2.0 ** (last - place)
    return bits.looks[order[last]].frequency


def _order_doubts(looks: Sequence[Look], changes: Changes, found: BitOrder) -> list[str]:
    doubts = []
    listed = [looks[bit] for bit in found.order]
    if not found.is_by_names:
        doubts.append(
            f"{_names(listed)}: this order of the bits follows from their stripes, their names have"
            " another"
        )
    shares = changes.contradictions(found.order, found.shown)
    strange = [one for one, share in zip(listed, shares, strict=True) if share > CONTRADICTS]
    if strange:
        doubts.append(
            f"{_names(strange)}: at up to {shares.max():.0%} of their edges the finer bits"
            " contradict the order; one is missing, exchanged, or its stripes are hardly resolved"
        )
    places = [looks[bit] for bit in movable(changes, found)]
    if places or len(listed) < 3:
        doubts.append(
            f"{_names(places or listed)}: the place among the bits follows from the names only, in"
            " this view other places fit as well"
        )
    return doubts


def _faint_doubts(looks: Sequence[Look]) -> list[str]:
    faint = [one for one in looks if one.kind in ("faint", "grey")]
    return [f"{_names(faint)}: stripes hardly resolved, taken for the finest bits"] if faint else []


def _names(looks: Sequence[Look]) -> str:
    return ", ".join(one.file for one in looks)


def _inverse_doubts(
    bits: Bits, *, is_turned: bool, wrong: Sequence[int], uncertain: Sequence[int]
) -> list[str]:
    doubts = []
    if bits.lone:
        doubts.append(
            f"{_names(bits.lone)}: no inverse along {bits.axis}, though other bits have theirs,"
            " left out"
        )
    if uncertain:
        names = [bits.looks[bit].file for bit in uncertain]
        doubts.append(
            f"{few(names)}: bit or inverse follows from the order of the names; the other way round"
            " the words grow from the other end of the projector"
        )
    if is_turned or wrong:
        turned = [bits.looks[bit].file for bit in (range(len(bits.looks)) if is_turned else wrong)]
        doubts.append(f"{few(turned)}: the inverse comes before its bit, as the other bits show")
    return doubts
