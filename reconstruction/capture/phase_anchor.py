"""First shift and sign of a phase set, from the borders of the words that number its fringes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.capture.image_looks import FrameGroup, Look
from reconstruction.capture.phase_looks import phasor
from reconstruction.patterns import Axis

# Borders of words that must be seen; first shifts are known in steps of these.
LEAST_BORDERS, ROUND_DEG, MOST_OFF_DEG = 30, 15.0, 5.0
# First shifts that programs use are multiples of one of these.
USUAL_DEG = (30.0, 45.0)
# Of the mean of unit phasors at the borders, and of the steps of the words there.
COHERENT, ONE_WAY = 0.7, 0.7
# Percentile of the words in view that is taken for the largest: noise makes larger ones.
LARGEST = 99.5


@dataclass(frozen=True, eq=False)
class NumberedLines:
    """The words along the lines of one axis.

    Parameters
    ----------
    bits : the Gray frames, and their inverses if there are any
    word : "reflected" or "binary"
    number : (line, sample) of every pixel
    is_lit : (line, sample)
    """

    axis: Axis
    bits: tuple[FrameGroup, ...]
    word: str
    number: FloatArray
    is_lit: BoolImage

    @cached_property
    def last(self) -> int:
        """The largest word in view."""
        return int(np.percentile(self.number[self.is_lit], LARGEST)) if self.is_lit.any() else 0

    @classmethod
    def of(
        cls, looks: Sequence[Look], bits: tuple[FrameGroup, ...], word: str, mean: FloatImage | None
    ) -> "NumberedLines":
        """Read the words; bits without inverse are compared with a mean (line, sample), or 0."""
        by_file = {one.file: one for one in looks}
        axis = bits[0].axis or "column"
        gray, *inverse = ([by_file[name].along[axis] for name in one.files] for one in bits)
        limits = inverse[0] if inverse else [0.0 if mean is None else mean] * len(gray)
        levels = np.stack([one > other for one, other in zip(gray, limits, strict=True)])
        binary = levels if word == "binary" else np.logical_xor.accumulate(levels)
        number = np.tensordot(2.0 ** np.arange(len(levels))[::-1], binary, axes=1)
        return cls(axis, bits, word, np.asarray(number), looks[0].lit[axis])


def anchored(
    phase: FrameGroup, words: NumberedLines, looks: Sequence[Look], length_px: int
) -> tuple[FrameGroup, str]:
    """Return a phase set with the shifts that its words determine and their sign; and the doubt.

    The words n - 1 and n, w wide, meet at x = n w - 1/2. The frames are cos(v + s_n) with v growing
    along the line; where the words fall along it v = c - 2 pi x / p, otherwise c + 2 pi x / p.
    Wanted are shifts t_n with cos(2 pi x / p + sign t_n): t_n = s_n + c.
    """
    name = f"{phase.files[0]} ..."
    per_fringe = words_per_fringe(phase, words.bits[0], words.word)
    if per_fringe < 1.0:
        return phase, f"{name}: fringes are finer than the words; bits are missing"
    by_file = {one.file: one for one in looks}
    own = phasor([by_file[file] for file in phase.files], phase.shifts_deg, words.axis)
    step = np.diff(words.number, axis=1)
    ends = (np.abs(step) == 1.0) & own.is_lit[:, 1:] & own.is_lit[:, :-1]
    if np.count_nonzero(ends) < LEAST_BORDERS:
        return phase, f"{name}: too few borders of words in this view for shifts and sign"
    sign = 1 if np.sum(step[ends]) > 0.0 else -1
    turns = np.maximum(words.number[:, 1:], words.number[:, :-1])[ends] / per_fringe
    middle = (own.z[:, 1:] + own.z[:, :-1])[ends]
    total = np.sum(middle * np.exp(-2j * np.pi * sign * turns))
    coherence = abs(total) / max(float(np.sum(np.abs(middle))), 1e-12)
    period_px = per_fringe * word_px(len(words.bits[0].files), length_px)
    exact_deg = math.degrees(float(np.angle(total))) + sign * 180.0 / period_px
    first_deg = ROUND_DEG * round(exact_deg / ROUND_DEG)
    doubt = ""
    if coherence < COHERENT or abs(np.mean(step[ends])) < ONE_WAY:
        doubt = (
            f"{name}: phase and words agree at {coherence:.0%} of the borders only; check order of"
            " the bits, shift_deg and sign"
        )
    elif abs(exact_deg - first_deg) > MOST_OFF_DEG or all(first_deg % one for one in USUAL_DEG):
        doubt = f"{name}: first shift is {exact_deg:.0f} degrees, rounded; check shift_deg"
    shifts = tuple((shift + first_deg) % 360.0 for shift in phase.shifts_deg)
    return replace(phase, shifts_deg=shifts, sign=sign), doubt


def words_per_fringe(phase: FrameGroup, bits: FrameGroup, word: str) -> float:
    """Return how many words one fringe spans: a power of two.

    The finest bit of a reflected word has stripes of two words, a period of four; that of a binary
    one a period of two.
    """
    words = 2.0 if word == "binary" else 4.0
    return float(2.0 ** round(math.log2(words * bits.frequency / phase.frequency)))


def word_px(bits: int, length_px: int) -> float:
    """Return the width of a word: the power of two with which so many bits just cover the image."""
    least = length_px / 2.0**bits
    return max(2.0 ** math.ceil(math.log2(least) - 1e-9), 1.0)
