"""Bits of words among the images of an unknown set: their order, their inverses, their doubts.

The order is that of the names if the view confirms it or does not decide. Another order is used
only if the view clearly contradicts the names. See `word_order`.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from reconstruction.arrays import BoolImage, FloatImage
from reconstruction.capture.image_features import FrameGroup, ImageFeatures
from reconstruction.capture.phase_steps import are_opposite
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
# Share of striped images in complementary pairs above which further images are paired as well.
MOST_PAIRED = 0.6
# Variance of u from which stripes are resolved; with fewer cycles edges are counted.
RESOLVED, LEAST_CYCLES = 0.09, 4.0


@dataclass(frozen=True, eq=False)
class Bits:
    """Images that are bits along one axis, with their inverses.

    Parameters
    ----------
    features : in the order of their names; inverses : of each, or none
    lone : images without inverse, though further bits have theirs
    changes : between neighbouring pixels
    """

    axis: Axis
    features: tuple[ImageFeatures, ...]
    inverses: tuple[ImageFeatures, ...]
    lone: tuple[ImageFeatures, ...]
    changes: Changes

    @property
    def everyone(self) -> range:
        """The indices of all bits."""
        return range(len(self.features))

    @property
    def cost(self) -> float:
        """Sum of contradictions to the order by names, see `BitOrder`, and bits without inverse."""
        cost = named_order(self.changes).cost
        if self.inverses:
            cost = min(cost, named_order(self.changes.inverted(self.everyone)).cost)
        return cost + len(self.lone)


def bits_of(
    features: Sequence[ImageFeatures], chosen: Sequence[int], axis: Axis, mean: FloatImage | None
) -> Bits:
    """Return the images of some indices as bits along an axis.

    Parameters
    ----------
    mean : (line, sample) u - 1/2 that bits without inverse are compared with; None: 0
    """
    partner = _partners(features, chosen, axis)
    firsts = [k for k in chosen if k in partner] if partner else list(chosen)
    seconds = set(partner.values())
    lone = [k for k in chosen if partner and k not in partner and k not in seconds]
    gray = tuple(features[k] for k in firsts)
    inverse = tuple(features[partner[k]] for k in firsts) if partner else ()
    limit = np.float32(0.0) if mean is None else mean
    against: list[Any] = [inverse_image.along[axis] for inverse_image in inverse] or [limit] * len(
        gray
    )
    levels = [level.along[axis] > limit for level, limit in zip(gray, against, strict=True)]
    lit = features[0].lit[axis]
    shown = np.stack(levels) if levels else np.zeros((0, *lit.shape), bool)
    changes = Changes.of(_neighbours(shown, lit))
    return Bits(axis, gray, inverse, tuple(features[k] for k in lone), changes)


def _neighbours(levels: BoolImage, is_lit: BoolImage) -> BoolImage:
    """Return four lit neighbours of a line wherever a bit changes, (bit, place, 4)."""
    last = levels.shape[2] - 3
    parts = [slice(k, last + k) for k in range(4)]
    is_used = np.all([is_lit[:, part] for part in parts], axis=0)
    is_used &= np.any(levels[:, :, parts[1]] != levels[:, :, parts[2]], axis=0)
    return np.stack([levels[:, :, part][:, is_used] for part in parts], axis=-1)


def _partners(
    features: Sequence[ImageFeatures], chosen: Sequence[int], axis: Axis
) -> dict[int, int]:
    """Return the index of the inverse of each bit, which follows it; {}: there are no inverses.

    Images without stripes, or with hardly resolved stripes, have an inverse if most of the striped
    ones have.
    """
    striped = [k for k in chosen if features[k].kind == "striped"]
    partner: dict[int, int] = {}
    for k in striped:
        if k not in partner.values():
            free = (n for n in striped if n > k and n not in partner.values())
            inverse_index = next((n for n in free if are_opposite(features[k], features[n])), None)
            if inverse_index is not None:
                partner[k] = inverse_index
    # Bits of a binary word may be opposite within a small view.
    if not partner or 2 * len(partner) < MOST_PAIRED * len(striped):
        return {}
    step = Counter(n - k for k, n in partner.items()).most_common(1)[0][0]
    for k in chosen:
        paired = {*partner, *partner.values()}
        candidate = k + step
        if (
            {k, candidate}.isdisjoint(paired)
            and candidate in chosen
            and _may_be_opposite(features, k, candidate)
        ):
            partner[k] = candidate
    return partner


def _may_be_opposite(features: Sequence[ImageFeatures], k: int, candidate: int) -> bool:
    kinds = {features[k].kind, features[candidate].kind}
    return kinds == {"white", "black"} or kinds.isdisjoint({"white", "black"})


@dataclass(frozen=True)
class ArrangedBits:
    """Bits and their inverses as groups, the coarsest first, the kind of word, and the doubts.

    is_confirmed : the view confirms the order of the names
    """

    groups: tuple[FrameGroup, ...] = ()
    word: str = "reflected"
    doubts: tuple[str, ...] = ()
    is_by_names: bool = True
    is_confirmed: bool = True


def arranged(bits: Bits) -> ArrangedBits:
    """Return the bits in the order that the view confirms, see `order_bits`."""
    if not bits.features:
        return ArrangedBits()
    changes, is_turned = bits.changes, False
    order = order_bits(changes)
    if bits.inverses:
        turned = changes.inverted(bits.everyone)
        turned_order = order_bits(turned)
        is_turned = turned_order.cost < order.cost - MARGIN
        changes, order = (turned, turned_order) if is_turned else (changes, order)
    wrong, uncertain = inverted(changes, order) if bits.inverses else ((), ())
    changes = changes.inverted(wrong)
    order = replace(order, cost=changes.cost(order.order, order.shown))
    doubts = _order_doubts(bits.features, changes, order)
    is_confirmed = not doubts
    doubts += _faint_doubts(bits.features)
    doubts += _inverse_doubts(bits, is_turned=is_turned, wrong=wrong, uncertain=uncertain)
    sides: dict[str, list[str]] = {"gray": [], "inverse": []}
    for bit in order.order:
        shown = [bits.features[bit].file, *(image.file for image in bits.inverses[bit : bit + 1])]
        if is_turned != (bit in wrong):
            shown = shown[::-1]
        for kind, name in zip(sides, shown, strict=False):
            sides[kind].append(name)
    frequency = max(_finest_frequency(bits, order.order), 1e-6)
    groups = [
        FrameGroup(kind, bits.axis, tuple(files), (), frequency)
        for kind, files in sides.items()
        if files
    ]
    return ArrangedBits(tuple(groups), order.shown, tuple(doubts), order.is_by_names, is_confirmed)


def _finest_frequency(bits: Bits, order: Sequence[int]) -> float:
    """Return the frequency of the finest bit, cycles per pixel, from the finest one resolved."""
    last = len(order) - 1
    for place in range(last, -1, -1):
        image = bits.features[order[place]]
        levels, is_lit = image.along[bits.axis], image.lit[bits.axis]
        if is_lit.any() and float(np.var(levels[is_lit])) > RESOLVED:
            frequency = image.frequency
            if frequency * levels.shape[1] < LEAST_CYCLES:
                both = int(np.count_nonzero(is_lit[:, 1:] & is_lit[:, :-1]))
                frequency = 0.5 * float(bits.changes.count[order[place]]) / max(both, 1)
            return frequency * 2.0 ** (last - place)
    return bits.features[order[last]].frequency


def _order_doubts(
    features: Sequence[ImageFeatures], changes: Changes, order: BitOrder
) -> list[str]:
    doubts = []
    listed = [features[bit] for bit in order.order]
    if not order.is_by_names:
        doubts.append(
            f"{_names(listed)}: this order of the bits follows from their stripes, their names have"
            " another"
        )
    shares = changes.contradictions(order.order, order.shown)
    strange = [image for image, share in zip(listed, shares, strict=True) if share > CONTRADICTS]
    if strange:
        doubts.append(
            f"{_names(strange)}: at up to {shares.max():.0%} of their edges the finer bits"
            " contradict the order; one is missing, exchanged, or its stripes are hardly resolved"
        )
    places = [features[bit] for bit in movable(changes, order)]
    if places or len(listed) < 3:
        doubts.append(
            f"{_names(places or listed)}: the place among the bits follows from the names only, in"
            " this view other places fit as well"
        )
    return doubts


def _faint_doubts(features: Sequence[ImageFeatures]) -> list[str]:
    faint = [image for image in features if image.kind in ("faint", "grey")]
    return [f"{_names(faint)}: stripes hardly resolved, taken for the finest bits"] if faint else []


def _names(features: Sequence[ImageFeatures]) -> str:
    return ", ".join(image.file for image in features)


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
        names = [bits.features[bit].file for bit in uncertain]
        doubts.append(
            f"{few(names)}: bit or inverse follows from the order of the names; if exchanged,"
            " the words increase from the opposite end of the projector"
        )
    if is_turned or wrong:
        turned = [
            bits.features[bit].file for bit in (range(len(bits.features)) if is_turned else wrong)
        ]
        doubts.append(f"{few(turned)}: the inverse precedes its bit, as the other bits show")
    return doubts
