"""Identify the bits of code words among images of unknown content, their order and inverses.

The order of the bits is that of the file names, if the images confirm it or do not determine an
order. Another order is used only if the images clearly contradict the names, see `word_order`.
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

# Largest share of the changes of a bit that finer bits may contradict without a message.
CONTRADICTS = 0.3
# If at least this share of the striped images is in complementary pairs, other images are paired,
# too.
MOST_PAIRED = 0.6
# Variance of the normalised level u from which stripes are resolved. With fewer cycles in view the
# frequency is computed from the number of edges.
RESOLVED, LEAST_CYCLES = 0.09, 4.0


@dataclass(frozen=True, eq=False)
class Bits:
    """Images that are bits along one axis, with their inverses.

    Parameters
    ----------
    axis : projector axis along which the bits vary
    features : features of the bits in the order of their file names
    inverses : features of the inverse of each bit; (): there are no inverses
    lone : images without an inverse, although other bits have one
    changes : statistics of the changes of the bits between neighbouring pixels
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
        """Cost of the order by names (see `BitOrder`) plus the number of bits without inverse."""
        cost = named_order(self.changes).cost
        if self.inverses:
            cost = min(cost, named_order(self.changes.inverted(self.everyone)).cost)
        return cost + len(self.lone)


def bits_of(
    features: Sequence[ImageFeatures], chosen: Sequence[int], axis: Axis, mean: FloatImage | None
) -> Bits:
    """Return the images with the indices `chosen` as bits along an axis.

    Parameters
    ----------
    mean : (line, sample) threshold of bits without inverse, as normalised level u - 1/2 (see
        `image_features`); None: 0
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
    """Return rows of four lit pixels, (bit, row, 4) bool, wherever a bit changes in the middle.

    Parameters
    ----------
    levels : (bit, line, sample) bool, values of the bits
    is_lit : (line, sample) bool
    """
    last = levels.shape[2] - 3
    parts = [slice(k, last + k) for k in range(4)]
    is_used = np.all([is_lit[:, part] for part in parts], axis=0)
    is_used &= np.any(levels[:, :, parts[1]] != levels[:, :, parts[2]], axis=0)
    return np.stack([levels[:, :, part][:, is_used] for part in parts], axis=-1)


def _partners(
    features: Sequence[ImageFeatures], chosen: Sequence[int], axis: Axis
) -> dict[int, int]:
    """Return the index of the inverse of each bit, by the index of the bit; {}: no inverses.

    The inverse follows its bit in the order of the names. Images without stripes, or with hardly
    resolved stripes, get an inverse if most of the striped images have one.
    """
    striped = [k for k in chosen if features[k].kind == "striped"]
    partner: dict[int, int] = {}
    for k in striped:
        if k not in partner.values():
            free = (n for n in striped if n > k and n not in partner.values())
            inverse_index = next((n for n in free if are_opposite(features[k], features[n])), None)
            if inverse_index is not None:
                partner[k] = inverse_index
    # A small share of pairs are no inverses: bits of a binary word may be opposite in a small view.
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
    """Bits along one axis and their inverses, in order.

    groups : group of the bits and group of their inverses, each with the coarsest bit first
    word : encoding of the code word, "reflected" or "binary"
    doubts : messages about uncertain values
    is_by_names : whether the order is that of the file names or its reverse
    is_confirmed : whether the images confirm the order of the bits
    """

    groups: tuple[FrameGroup, ...] = ()
    word: str = "reflected"
    doubts: tuple[str, ...] = ()
    is_by_names: bool = True
    is_confirmed: bool = True


def arranged(bits: Bits) -> ArrangedBits:
    """Return the bits along an axis in the order that the images confirm, see `order_bits`."""
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
    """Return the frequency of the finest bit, cycles per camera pixel.

    It is extrapolated from the finest bit that the camera resolves: each finer bit has twice the
    frequency.
    """
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
