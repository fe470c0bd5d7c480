"""Guess what the images of an unknown set show.

- Sets of equal phase steps are found by their content, see `phase_looks`.
- Other striped images are bits, in the order of their names, unless the view clearly contradicts
  that; two that are each other's complement are a bit and its inverse. Words of which several bits
  change at once are binary, not Gray. See `word_looks`.
- Images without stripes are white, black, or bits that do not change within the view, see
  `plain_looks`; grey ones next to the bits are the finest bits, which the camera does not resolve.
- Where bits number the fringes, the phase at the borders of the words determines the shift of the
  first image, and the direction in which the words grow the sign of the shifts: `phase_anchor`.
- How wide a stripe is in projector pixels cannot be seen: see `guess_file`.

What is not sure is listed as a doubt: a guess without a doubt must be right.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatImage
from reconstruction.capture.guess_doubts import (
    anchor_doubts,
    left_out_doubts,
    look_doubts,
    plain_doubts,
    repeated_doubts,
    scattered_doubts,
    uneven_doubts,
    unnumbered_doubts,
)
from reconstruction.capture.image_looks import CERTAIN, FrameGroup, Look, LookedAt, look_at, peak
from reconstruction.capture.phase_anchor import NumberedLines, anchored
from reconstruction.capture.phase_looks import (
    coarse_sets,
    lone_fringes,
    phase_sets,
    phasor,
    stepped_sets,
    with_whole_ratios,
)
from reconstruction.capture.plain_looks import PlainLooks, choose_plain
from reconstruction.capture.word_looks import ArrangedBits, Bits, arranged, bits_of
from reconstruction.patterns import AXES, Axis

# Grey images so near to a bit, by the order of the names, are bits; an inverse may be between.
NEAR_NAMES = 2
# So few bits say little about which images are white and black.
FEW_BITS = 3


@dataclass(frozen=True)
class Guess:
    """What a folder seems to hold.

    Parameters
    ----------
    groups : in the order of the list
    unsure : what to check, one line each
    words : of the axes that have bits
    """

    groups: tuple[FrameGroup, ...]
    word: str
    unsure: tuple[str, ...]
    looked: LookedAt
    words: tuple[NumberedLines, ...] = ()


def guess(folder: Path, size: tuple[int, int]) -> Guess:
    """Guess what the images below a folder show, by a projector of `size`, px.

    Raises
    ------
    CaptureError : there are too few images, one is damaged, or they do not change
    """
    looked = look_at(folder)
    looks = _with_axes(looked.looks)
    phases, striped, fringe_doubts = _fringes(looks)
    bits, plain, is_needed = _words(looks, phases, striped)
    scattered = scattered_doubts(looks, phases)
    if scattered:
        plain = replace(plain, is_certain=False)
    along = [_along(axis, looks, phases, bits[axis], size) for axis in AXES]
    groups = [group for one in along for group in one.groups] + _plain_groups(looks, plain)
    doubts = [
        *(f"{name}: has another size, left out" for name in looked.left_out),
        *fringe_doubts,
        *(doubt for axis in AXES for doubt in bits[axis].doubts),
        *scattered,
        *plain_doubts(looks, plain, is_needed=is_needed),
        *(doubt for one in along for doubt in one.doubts),
        *(doubt for axis in AXES for doubt in anchor_doubts(groups, axis, bits[axis], plain)),
    ]
    doubts += left_out_doubts(looks, groups, doubts) + look_doubts(looks, groups)
    words = tuple(one.words for one in along if one.words)
    kinds = sorted({one.word for one in words})
    if len(kinds) > 1:
        doubts.append("word: Gray and binary bits along different axes; list one axis only")
    return Guess(tuple(groups), (*kinds, "reflected")[0], tuple(doubts), looked, words)


@dataclass(frozen=True, eq=False)
class _AlongAxis:
    """Groups along one axis, the words that number its fringes, and doubts."""

    groups: tuple[FrameGroup, ...]
    words: NumberedLines | None
    doubts: tuple[str, ...]


def _along(
    axis: Axis,
    looks: Sequence[Look],
    phases: Sequence[FrameGroup],
    bits: ArrangedBits,
    size: tuple[int, int],
) -> _AlongAxis:
    own = [one for one in phases if one.axis == axis]
    if not bits.groups:
        doubts = unnumbered_doubts(own[0], looks) if len(own) == 1 else []
        return _AlongAxis(tuple(own), None, tuple(doubts))
    words = NumberedLines.of(looks, bits.groups, bits.word, _mean(looks, phases, axis))
    found = [anchored(one, words, looks, size[AXES.index(axis)]) for one in own]
    groups = *(one for one, _ in found), *bits.groups
    return _AlongAxis(groups, words, tuple(doubt for _, doubt in found if doubt))


def _plain_groups(looks: Sequence[Look], plain: PlainLooks) -> list[FrameGroup]:
    shown = (("white", plain.white), ("black", plain.black))
    return [FrameGroup(kind, None, (looks[k].file,)) for kind, k in shown if k is not None]


def _words(
    looks: Sequence[Look], phases: Sequence[FrameGroup], striped: dict[int, Axis]
) -> tuple[dict[Axis, ArrangedBits], PlainLooks, bool]:
    """Return the bits along each axis, white and black, and whether these are needed.

    Parameters
    ----------
    striped : axis of the images with stripes that are no phase steps, by index
    """
    taken = {name for group in phases for name in group.files}
    striped = _with_grey(looks, striped, taken)
    means = {axis: _mean(looks, phases, axis) for axis in AXES}

    def bits_along(axes: dict[int, Axis], axis: Axis) -> Bits:
        return bits_of(looks, sorted(k for k in axes if axes[k] == axis), axis, means[axis])

    def cost(axes: dict[int, Axis]) -> float:
        return sum(bits_along(axes, axis).cost for axis in set(axes.values()))

    # A coarse phase step may look like white or black.
    others = [replace(one, kind="phase") if one.file in taken else one for one in looks]
    is_paired = any(bits_along(striped, axis).inverses for axis in set(striped.values()))
    is_needed = bool(striped) and not (phases or is_paired)
    plain = choose_plain(others, striped, cost, needs_uniform=is_needed)
    bits = {axis: arranged(bits_along(striped | plain.bits, axis)) for axis in AXES}
    number = sum(len(one.groups[0].files) for one in bits.values() if one.groups)
    if not all(one.is_by_names for one in bits.values()) or 0 < number < FEW_BITS:
        plain = replace(plain, is_certain=False)
    return bits, plain, is_needed


def _with_axes(looks: Sequence[Look]) -> list[Look]:
    """Return the looks, where the axis is hardly seen with that of both neighbours by name."""
    result = list(looks)
    certain = [k for k, one in enumerate(looks) if _is_striped(one) and one.certainty >= CERTAIN]
    for k, one in enumerate(looks):
        if not _is_striped(one) or one.certainty >= CERTAIN:
            continue
        near = [n for n in certain if n < k][-1:] + [n for n in certain if n > k][:1]
        axes = {looks[n].axis for n in near}
        if len(axes) == 1 and one.axis not in axes:
            axis = axes.pop()
            result[k] = replace(one, axis=axis, frequency=peak(one.along[axis]))
    return result


def _is_striped(one: Look) -> bool:
    return one.kind in ("striped", "faint")


def _fringes(
    looks: Sequence[Look],
) -> tuple[list[FrameGroup], dict[int, Axis], list[str]]:
    """Return the phase sets, the axis of the striped images that are bits by index, and doubts."""
    phases = stepped_sets(looks)
    taken = {name for group in phases for name in group.files}
    for axis in AXES:
        striped = [o for o in looks if _is_striped(o) and o.axis == axis and o.file not in taken]
        phases += phase_sets(striped, axis)[0]
    taken = {name for group in phases for name in group.files}
    coarse, doubts = coarse_sets(looks, phases, taken)
    phases = with_whole_ratios(looks, [*phases, *coarse])
    taken |= {name for group in coarse for name in group.files}
    rest = [one for one in looks if one.file not in taken and one.kind == "striped"]
    lone = [one for axis in AXES for one in lone_fringes([o for o in rest if o.axis == axis])]
    if lone:
        names = ", ".join(one.file for one in lone)
        doubts.append(
            f"{names}: look like fringes, but are no equal steps of a turn, left out; one may be"
            " missing"
        )
    doubts += uneven_doubts(phases, looks) + repeated_doubts(phases, looks)
    excluded = {one.file for one in lone}
    bits = {
        k: one.axis
        for k, one in enumerate(looks)
        if one.kind == "striped" and one.file not in taken | excluded
    }
    return phases, bits, doubts


def _mean(looks: Sequence[Look], phases: Sequence[FrameGroup], axis: Axis) -> FloatImage | None:
    by_file = {one.file: one for one in looks}
    first = next((one for one in phases if one.axis == axis), None)
    if first is None:
        return None
    return np.asarray(
        phasor([by_file[name] for name in first.files], first.shifts_deg, axis).mean, np.float32
    )


def _with_grey(looks: Sequence[Look], bits: dict[int, Axis], taken: set[str]) -> dict[int, Axis]:
    """Add images of hardly resolved stripes that follow the bits, by the order of their names."""
    found = dict(bits)
    for k, one in enumerate(looks):
        if one.kind in ("faint", "grey") and one.file not in taken:
            near = [n for n in found if 0 < k - n <= NEAR_NAMES]
            if near:
                found[k] = found[max(near)]
    return found
