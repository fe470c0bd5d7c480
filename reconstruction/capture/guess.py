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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatImage
from reconstruction.capture.image_looks import FrameGroup, Look, LookedAt, look_at, named, peak
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

CERTAIN = 3.0
# Grey images so near to a bit, by the order of the names, are bits; an inverse may be between.
NEAR_NAMES = 2
# So few bits say little about which images are white and black.
FEW_BITS = 3
# From so many fringes in view on one period is not taken for a single fringe.
SEVERAL_FRINGES = 1.5
# Less than this of a fringe in view leaves the three steps of a set without a check.
LITTLE_OF_A_FRINGE = 1.2
# Difference of two frequencies, cycles per line, below which they may be one.
SAME_PERIOD_CYCLES = 0.25


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
    doubts = [f"{name}: has another size, left out" for name in looked.left_out]
    phases, striped, fringe_doubts = _fringes(looks)
    bits, plain, is_needed = _words(looks, phases, striped)
    doubts += fringe_doubts + [doubt for axis in AXES for doubt in bits[axis].doubts]
    groups: list[FrameGroup] = []
    words = []
    scattered = _scattered(looks, phases)
    if scattered:
        plain = replace(plain, is_certain=False)
        doubts += [
            f"{one.files[0]} ...: the images of this set of {len(one.files)} steps do not follow"
            " one another by their names"
            for one in scattered
        ]
    doubts += _plain_doubts(looks, plain, is_needed=is_needed)
    for axis in AXES:
        own = [one for one in phases if one.axis == axis]
        if bits[axis].groups:
            lines = NumberedLines.of(
                looks, bits[axis].groups, bits[axis].word, _mean(looks, phases, axis)
            )
            words.append(lines)
            found = [anchored(one, lines, looks, size[AXES.index(axis)]) for one in own]
            own = [one for one, _ in found]
            doubts += [doubt for _, doubt in found if doubt]
            if own and not (bits[axis].is_confirmed and plain.is_certain):
                doubts.append(f"{own[0].files[0]} ...: shifts and sign follow from unsure bits")
        elif len(own) == 1:
            doubts += _unnumbered(own[0], looks)
        groups += [*own, *bits[axis].groups]
    for kind, k in (("white", plain.white), ("black", plain.black)):
        groups += [FrameGroup(kind, None, (looks[k].file,))] if k is not None else []
    doubts += _left_out(looks, groups, doubts)
    doubts += _look_doubts(looks, groups)
    kinds = sorted({one.word for one in words})
    if len(kinds) > 1:
        doubts.append("word: Gray and binary bits along different axes; list one axis only")
    word = kinds[0] if kinds else "reflected"
    return Guess(tuple(groups), word, tuple(doubts), looked, tuple(words))


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


def _scattered(looks: Sequence[Look], phases: Sequence[FrameGroup]) -> list[FrameGroup]:
    """Return the phase sets whose images do not follow one another by their names."""
    place = {one.file: k for k, one in enumerate(looks)}

    def length(group: FrameGroup) -> int:
        places = [place[name] for name in group.files]
        return max(places) - min(places) + 1

    return [one for one in phases if length(one) != len(one.files)]


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
    doubts += _uneven(phases, looks) + _repeated(phases, looks)
    excluded = {one.file for one in lone}
    bits = {
        k: one.axis
        for k, one in enumerate(looks)
        if one.kind == "striped" and one.file not in taken | excluded
    }
    return phases, bits, doubts


def _uneven(phases: Sequence[FrameGroup], looks: Sequence[Look]) -> list[str]:
    """Return doubts about unlike numbers of steps, and about sets of which little is in view."""
    doubts = []
    if len({len(one.files) for one in phases}) > 1:
        sets = ", ".join(f"{len(one.files)} from {one.files[0]} on" for one in phases)
        doubts.append(f"{sets}: unlike numbers of phase steps; images may be missing")
    for one in phases:
        cycles = one.frequency * looks[0].along[one.axis or "column"].shape[1]
        is_only = all(other is one or other.axis != one.axis for other in phases)
        if is_only and cycles < LITTLE_OF_A_FRINGE and len(one.files) == 3:
            doubts.append(
                f"{one.files[0]} ...: {cycles:.1f} of a fringe is in view, too little to make sure"
                " of its steps"
            )
    return doubts


def _repeated(phases: Sequence[FrameGroup], looks: Sequence[Look]) -> list[str]:
    """Return doubts about sets of one axis whose periods can hardly be told from each other."""
    doubts = []
    for number, one in enumerate(phases):
        for other in phases[:number]:
            length = looks[0].along[one.axis or "column"].shape[1]
            difference = abs(one.frequency - other.frequency) * length
            if one.axis == other.axis and difference < SAME_PERIOD_CYCLES:
                doubts.append(
                    f"{one.files[0]} ...: has the period of {other.files[0]} ...; the same set"
                    " twice, or two periods that this view does not resolve"
                )
    return doubts


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


def _plain_doubts(looks: Sequence[Look], plain: PlainLooks, *, is_needed: bool) -> list[str]:
    doubts = []
    shown = [k for k in (plain.white, plain.black) if k is not None]
    if plain.bits and not plain.is_certain:
        names = ", ".join(looks[k].file for k in sorted(plain.bits))
        doubts.append(f"{names}: without stripes, taken for bits that do not change in this view")
    if shown and not plain.is_certain:
        names = " and ".join(looks[k].file for k in shown)
        doubts.append(f"{names}: taken for white and black, may be bits as well")
    if len(shown) == 1:
        lacking = "black" if plain.black is None else "white"
        doubts.append(f"{looks[shown[0]].file}: there is no {lacking} image to it, needs both")
    if is_needed and len(shown) < 2:
        doubts.append(
            "gray: neither inverse images nor white and black, nothing to compare the bits with"
        )
    return doubts


def _left_out(
    looks: Sequence[Look], groups: Sequence[FrameGroup], doubts: Sequence[str]
) -> list[str]:
    """Return a line for each image that is in no group and no doubt so far."""
    listed = {name for group in groups for name in group.files}
    plain = {group.kind: group.files[0] for group in groups if group.axis is None}
    named_before = {name for doubt in doubts if "left out" in doubt for name in _files(doubt)}
    result = []
    for one in looks:
        if one.file in listed | named_before:
            continue
        like = f"{one.kind} like {plain[one.kind]}" if one.kind in plain else one.kind
        if one.kind in ("grey", "faint"):
            like = "uniform, but neither white nor black"
        result.append(f"{one.file}: {like}, left out")
    return result


def _files(doubt: str) -> list[str]:
    return doubt.split(": ")[0].split(", ")


def _look_doubts(looks: Iterable[Look], groups: Sequence[FrameGroup]) -> list[str]:
    """Say where content is not clear, or names say something else."""
    shown = {name: group for group in groups for name in group.files}
    doubts = []
    for one in looks:
        group = shown.get(one.file)
        if group is None:
            continue
        says = named(one)
        seen = group.axis or group.kind
        if says & set(AXES) and group.axis and group.axis not in says:
            doubts.append(
                f"{one.file}: looks like {seen}, its name says {' and '.join(sorted(says))}"
            )
        if not group.axis and says and group.kind not in says:
            doubts.append(
                f"{one.file}: looks like {seen}, its name says {' and '.join(sorted(says))}"
            )
        if group.kind != "phase" and one.kind == "striped" and one.certainty < CERTAIN:
            doubts.append(f"{one.file}: stripes along {one.axis} are hardly clearer than across")
    return doubts


def _unnumbered(phase: FrameGroup, looks: Sequence[Look]) -> list[str]:
    cycles = phase.frequency * looks[0].along[phase.axis or "column"].shape[1]
    if cycles < SEVERAL_FRINGES:
        return []
    return [
        f"{phase.files[0]} ...: about {cycles:.0f} fringes of one period along {phase.axis} and"
        " nothing that numbers them; images may be missing"
    ]
