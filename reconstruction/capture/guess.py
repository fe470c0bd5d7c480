"""Guess what the images of an unknown set show.

- Three or more striped images of one axis and one frequency whose phases are equal steps of a turn
  are a phase set; the phase of each is its cross spectrum with the first.
- Other striped images are bits, the coarsest first; two that are each other's complement are a bit
  and its inverse. Words of which several bits change at once are binary, not Gray.
- Images without stripes are white or black.
- Where bits number the fringes, the phase at the borders of the words tells the shift of the first
  image, and the direction in which the words grow the sign of the shifts.
- How wide a stripe is in projector pixels cannot be seen. It follows from the width of the image,
  as the coarsest fringe or the number of bits should just cover it.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from reconstruction.capture.image_looks import PADDED, Look, LookedAt, look_at, spectrum
from reconstruction.patterns import AXES, Axis

# Frequencies that differ by less are one, cycles per line: with few fringes the phase moves the
# peak of the spectrum.
SAME_CYCLES, SAME_OF_FEW, FEW_CYCLES = 0.4, 0.8, 3.0
# Least share of neither dark nor bright pixels of a cosine: with three steps and nothing else a
# pixel is darkest in one, brightest in another.
SMOOTH = 0.12
# How far phases may be from equal steps, of a step.
EVEN = 0.2
COMPLEMENTARY = -0.8
CERTAIN = 3.0
# Share of the places where bits change at which several do: none in a Gray code.
MANY_CHANGE = 0.25
# Borders of words that must be seen; first shifts are told in steps of these.
LEAST_BORDERS, ROUND_DEG = 30, 15.0
NAMED = {
    "white": ("white", "bright", "full_on"),
    "black": ("black", "dark", "full_off"),
    "column": ("column", "col_", "vertical", "_x_", "_v_"),
    "row": ("row", "horizontal", "_y_", "_h_"),
}


@dataclass(frozen=True)
class FrameGroup:
    """Images that stand in one [[frames]] table.

    Parameters
    ----------
    files : in the order shown
    shifts_deg : of phase frames; relative to the first, unless a sign is known
    sign : of the shifts; 0: not known
    frequency : cycles per camera pixel; of bits those of the finest
    """

    kind: str
    axis: Axis | None
    files: tuple[str, ...]
    shifts_deg: tuple[float, ...] = ()
    frequency: float = 0.0
    sign: int = 0


@dataclass(frozen=True)
class Guess:
    """What a folder seems to hold.

    Parameters
    ----------
    groups : in the order of the list
    unsure : what to check, one line each
    """

    groups: tuple[FrameGroup, ...]
    word: str
    unsure: tuple[str, ...]
    looked: LookedAt


def guess(folder: Path, size: tuple[int, int]) -> Guess:
    """Guess what the images below a folder show, by a projector of `size`, px.

    Raises
    ------
    CaptureError : there are too few images, one is damaged, or they do not change
    """
    looked = look_at(folder)
    unsure = [f"{name}: has another size, left out" for name in looked.left_out]
    groups: list[FrameGroup] = []
    words = set()
    steady = _steady_bits(looked.looks)
    for axis in AXES:
        looks = [one for one in looked.looks if one.kind == "striped" and one.axis == axis]
        phases, rest = _phase_sets(looks, axis)
        coarse = [looked.looks[k] for k, along in steady.items() if along == axis]
        rest = [*_as_bits(coarse, rest), *rest] if rest else rest
        bits, told = _bits(rest, axis)
        unsure += told
        if coarse:
            names = ", ".join(one.file for one in coarse)
            unsure.append(f"{names}: without stripes, taken for the coarsest bits along {axis}")
        if bits:
            word = _word(rest, bits)
            words.add(word)
            length_px = size[AXES.index(axis)]
            phases = [_anchored(one, bits[0], [*looks, *rest], word, length_px) for one in phases]
        groups += [*phases, *bits]
    for kind in ("white", "black"):
        plain = (one for k, one in enumerate(looked.looks) if k not in steady)
        found = [one.file for one in plain if one.kind == kind]
        groups += [FrameGroup(kind, None, (found[0],))] if found else []
        unsure += [f"{name}: {kind} like {found[0]}, left out" for name in found[1:]]
    grey = [one.file for one in looked.looks if one.kind == "grey"]
    unsure += [f"{name}: uniform, but neither white nor black, left out" for name in grey]
    unsure += _doubts(one for one in looked.looks if one.kind != "grey")
    if len(words) > 1:
        unsure.append("word: Gray and binary bits along different axes; list one axis alone")
    return Guess(tuple(groups), sorted(words)[0] if words else "reflected", tuple(unsure), looked)


def _steady_bits(looks: Sequence[Look]) -> dict[int, Axis]:
    """Return the uniform images that are bits which do not change within the view, and their axis.

    There are some where more than one image is white, or black. White and black themselves stand
    side by side, named so, or at the end or the beginning; the others belong to the bits that
    follow, as the coarsest.
    """
    uniform = [k for k, one in enumerate(looks) if one.kind in ("white", "black")]
    kinds = [looks[k].kind for k in uniform]
    if max(kinds.count("white"), kinds.count("black")) < 2:
        return {}
    pairs = [(a, b) for a, b in pairwise(uniform) if b == a + 1 and looks[a].kind != looks[b].kind]
    named = [pair for pair in pairs if all(_named(looks[k]) & {looks[k].kind} for k in pair)]
    outer = [pair for pair in pairs if pair[1] == len(looks) - 1 or pair[0] == 0]
    true = (*named, *outer[::-1], (-1, -1))[0]
    found: dict[int, Axis] = {}
    for k in uniform:
        striped = [one.axis for one in (*looks[k:], *looks[k::-1]) if one.kind == "striped"]
        by_name = [axis for axis in AXES if axis in _named(looks[k])]
        if k not in true and (by_name or striped):
            found[k] = (by_name or striped)[0]
    return found


def _as_bits(steady: Sequence[Look], striped: Sequence[Look]) -> list[Look]:
    """Return uniform images as bits that are 1 or 0 all along the lines of the others."""
    lit = striped[0].is_lit
    return [
        replace(
            one,
            axis=striped[0].axis,
            frequency=0.0,
            lines=np.where(lit, 0.5 if one.kind == "white" else -0.5, 0.0),
            is_lit=lit,
        )
        for one in steady
    ]


def _phase_sets(looks: Sequence[Look], axis: Axis) -> tuple[list[FrameGroup], list[Look]]:
    """Return the phase sets among images of one axis, and the other images."""
    rest, sets = list(looks), []
    for first in looks:
        same = [one for one in rest if _is_same(one, first)]
        shifts = _even_steps(same)
        if first not in rest or shifts is None:
            continue
        rest = [one for one in rest if one not in same]
        files = tuple(one.file for one in same)
        sets.append(FrameGroup("phase", axis, files, shifts, _frequency(same, shifts)))
    return sets, rest


def _frequency(looks: Sequence[Look], shifts_deg: tuple[float, ...]) -> float:
    """Return by how much the phase of a set grows from pixel to pixel, turns.

    Unlike the peak of a spectrum it is right for a single fringe as well.
    """
    shifts = np.radians(shifts_deg)
    z = np.tensordot(np.exp(-1j * shifts), np.stack([one.lines for one in looks]), axes=1)
    both = looks[0].is_lit[:, 1:] & looks[0].is_lit[:, :-1]
    return abs(float(np.angle(np.sum((z[:, 1:] * np.conj(z[:, :-1]))[both])))) / (2.0 * np.pi)


def _is_same(one: Look, other: Look) -> bool:
    length = one.lines.shape[1]
    is_few = other.frequency * length < FEW_CYCLES
    apart = abs(one.frequency - other.frequency) * length
    return bool(apart < (SAME_OF_FEW if is_few else SAME_CYCLES))


def _even_steps(looks: Sequence[Look]) -> tuple[float, ...] | None:
    """Return the shifts, degrees, if the phases of these images are equal steps of a turn."""
    count = len(looks)
    if count < 3 or np.median([one.smooth for one in looks]) < SMOOTH:
        return None
    at = round(
        float(np.median([one.frequency for one in looks])) * PADDED * looks[0].lines.shape[1]
    )
    values = [spectrum(one.lines)[:, max(at - PADDED, 1) : at + PADDED + 1] for one in looks]
    phases = [float(np.angle(np.sum(value * np.conj(values[0])))) for value in values]
    steps = np.array(phases) * count / (2.0 * np.pi)
    whole = np.rint(steps)
    is_even = bool(np.all(np.abs(steps - whole) < EVEN)) and len(set(whole % count)) == count
    return tuple(float(k % count) * 360.0 / count for k in whole) if is_even else None


def _bits(looks: Sequence[Look], axis: Axis) -> tuple[list[FrameGroup], list[str]]:
    """Return bits and inverses, the coarsest first."""
    gray: list[Look] = []
    inverse: dict[str, Look] = {}
    # Steady bits are anybody's opposite: they are paired only where the others are.
    striped = [one for one in looks if one.kind == "striped"]
    has_pairs = any(_are_opposite(one, other) for one, other in combinations(striped, 2))
    for one in looks:
        partner = (
            None
            if not has_pairs
            else next((g for g in gray if g.file not in inverse and _are_opposite(g, one)), None)
        )
        if partner is None:
            gray.append(one)
        else:
            inverse[partner.file] = one
    gray.sort(key=_changes)
    if not gray:
        return [], []
    told = []
    if inverse and len(inverse) < len(gray):
        lone = [one.file for one in gray if one.file not in inverse]
        told.append(f"{', '.join(lone)}: no inverse found along {axis}, though others have theirs")
        gray = [one for one in gray if one.file in inverse]
    finest = gray[-1].frequency
    groups = [FrameGroup("gray", axis, tuple(one.file for one in gray), (), finest)]
    if inverse:
        files = tuple(inverse[one.file].file for one in gray)
        groups.append(FrameGroup("inverse", axis, files, (), finest))
        told.append(
            f"{gray[0].file}: taken for the bit, {files[0]} for its inverse, as it comes first"
        )
    return groups, told


def _anchored(
    phase: FrameGroup, bits: FrameGroup, looks: Sequence[Look], word: str, length_px: int
) -> FrameGroup:
    """Return a phase set with the shifts that its words tell, and their sign.

    The words n - 1 and n, w wide, meet at x = n w - 1/2. The frames are cos(v + s_n) with v growing
    along the line; where the words fall along it v = c - 2 pi x / p, otherwise c + 2 pi x / p.
    Wanted are shifts t_n with cos(2 pi x / p + sign t_n): t_n = s_n + c.
    """
    by_file = {one.file: one for one in looks}
    shifts = np.radians(phase.shifts_deg)
    frames = np.stack([by_file[name].lines for name in phase.files])
    z = np.tensordot(np.exp(-1j * shifts), frames, axes=1)
    levels = np.stack([by_file[name].lines > 0.0 for name in bits.files])
    binary = levels if word == "binary" else np.logical_xor.accumulate(levels)
    number = np.tensordot(2.0 ** np.arange(len(levels))[::-1], binary, axes=1)
    is_lit = by_file[bits.files[0]].is_lit
    step = np.diff(number, axis=1)
    ends = (np.abs(step) == 1.0) & is_lit[:, 1:] & is_lit[:, :-1]
    if np.count_nonzero(ends) < LEAST_BORDERS:
        return phase
    sign = 1 if np.sum(step[ends]) > 0.0 else -1
    turns = np.maximum(number[:, 1:], number[:, :-1])[ends] / words_per_fringe(phase, bits)
    middle = (z[:, 1:] + z[:, :-1])[ends]
    anchor = np.angle(np.sum(middle * np.exp(-2j * np.pi * sign * turns)))
    period_px = words_per_fringe(phase, bits) * word_px(len(bits.files), length_px)
    first_deg = math.degrees(float(anchor)) + sign * 180.0 / period_px
    first_deg = ROUND_DEG * round(first_deg / ROUND_DEG)
    anchored = tuple((shift + first_deg) % 360.0 for shift in phase.shifts_deg)
    return FrameGroup("phase", phase.axis, phase.files, anchored, phase.frequency, sign)


def words_per_fringe(phase: FrameGroup, bits: FrameGroup) -> float:
    """Return how many words one fringe spans: a power of two.

    The finest bit of a reflected word has stripes of two words, a period of four.
    """
    return float(2.0 ** round(math.log2(4.0 * bits.frequency / phase.frequency)))


def _are_opposite(one: Look, other: Look) -> bool:
    both = one.is_lit & other.is_lit
    a, b = one.lines[both], other.lines[both]
    size = math.sqrt(float(np.sum(a * a) * np.sum(b * b)))
    return bool(float(np.sum(a * b)) < COMPLEMENTARY * size)


def _changes(look: Look) -> float:
    """Return how often a bit changes along a line."""
    both = look.is_lit[:, 1:] & look.is_lit[:, :-1]
    flips = (look.lines[:, 1:] > 0.0) != (look.lines[:, :-1] > 0.0)
    return int(np.count_nonzero(flips & both)) / max(int(np.count_nonzero(both)), 1)


def _word(looks: Sequence[Look], bits: Sequence[FrameGroup]) -> str:
    by_file = {one.file: one for one in looks}
    gray = [by_file[name] for name in bits[0].files]
    flips = np.stack([(one.lines[:, 1:] > 0.0) != (one.lines[:, :-1] > 0.0) for one in gray])
    count = flips.sum(axis=0)
    share = int(np.count_nonzero(count > 1)) / max(int(np.count_nonzero(count)), 1)
    return "binary" if share > MANY_CHANGE and len(gray) > 2 else "reflected"


def _doubts(looks: Iterable[Look]) -> list[str]:
    """Say where content is not clear, or names say something else."""
    told = []
    for one in looks:
        if one.kind in ("white", "black") and _named(one) & set(AXES):
            continue
        seen = one.kind if one.kind != "striped" else one.axis
        if one.kind == "striped" and one.certainty < CERTAIN:
            told.append(f"{one.file}: stripes along {one.axis} are hardly clearer than across")
        named = _named(one)
        if (
            named
            and seen not in named
            and not (one.kind == "striped" and named & {"white", "black"})
        ):
            told.append(
                f"{one.file}: looks like {seen}, its name says {' and '.join(sorted(named))}"
            )
    return told


def _named(look: Look) -> set[str]:
    """Return what the name of an image says."""
    padded = f"_{look.file.lower()}_"
    return {name for name, parts in NAMED.items() if any(part in padded for part in parts)}


def word_px(bits: int, length_px: int) -> float:
    """Return the width of a word: the power of two with which so many bits just cover the image."""
    least = length_px / 2.0**bits
    return max(2.0 ** math.ceil(math.log2(least) - 1e-9), 1.0)
