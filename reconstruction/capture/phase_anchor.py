"""Determine first shift and sign of a phase set from the borders of its code words.

The code words number the fringes of the phase set.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.capture.image_features import FrameGroup, ImageFeatures
from reconstruction.capture.phase_steps import phasor
from reconstruction.patterns import Axis

# Least number of borders between words in view; step to which first shifts are rounded; largest
# change by rounding without a message.
LEAST_BORDERS, ROUND_DEG, MOST_OFF_DEG = 30, 15.0, 5.0
# Typical first shifts of programs are multiples of one of these.
USUAL_DEG = (30.0, 45.0)
# Least magnitude, without a message, of the mean unit phasor at the borders, and of the mean change
# of the word there.
COHERENT, ONE_WAY = 0.7, 0.7
# Percentile of the words in view that is used as their maximum: noise produces larger words.
LARGEST = 99.5


@dataclass(frozen=True, eq=False)
class NumberedLines:
    """The code words at the pixels of the lines along one axis.

    Parameters
    ----------
    axis : projector axis that the words number
    bits : group of the Gray frames, and group of their inverses if there are any
    word : encoding of the code word, "reflected" or "binary"
    number : (line, sample) value of the code word at each pixel
    is_lit : (line, sample) bool
    """

    axis: Axis
    bits: tuple[FrameGroup, ...]
    word: str
    number: FloatArray
    is_lit: BoolImage

    @cached_property
    def last(self) -> int:
        """The largest code word in view; 0 if no pixel is lit."""
        return int(np.percentile(self.number[self.is_lit], LARGEST)) if self.is_lit.any() else 0

    @classmethod
    def of(
        cls,
        features: Sequence[ImageFeatures],
        bits: tuple[FrameGroup, ...],
        word: str,
        mean: FloatImage | None,
    ) -> "NumberedLines":
        """Read the code words from images.

        Parameters
        ----------
        mean : (line, sample) threshold of bits without inverse, as u - 1/2; None: 0
        """
        by_file = {image.file: image for image in features}
        axis = bits[0].axis or "column"
        gray, *inverse = ([by_file[name].along[axis] for name in group.files] for group in bits)
        limits = inverse[0] if inverse else [0.0 if mean is None else mean] * len(gray)
        levels = np.stack([level > limit for level, limit in zip(gray, limits, strict=True)])
        binary = levels if word == "binary" else np.logical_xor.accumulate(levels)
        number = np.tensordot(2.0 ** np.arange(len(levels))[::-1], binary, axes=1)
        return cls(axis, bits, word, np.asarray(number), features[0].lit[axis])


def anchored(
    phase: FrameGroup, words: NumberedLines, features: Sequence[ImageFeatures], length_px: int
) -> tuple[FrameGroup, str]:
    """Return a phase set with the shifts and sign that its code words determine, and a doubt.

    The doubt is a message about an uncertain value; "": there is none.

    The border between the words n - 1 and n, of the width w, is at x = n w - 1/2. Frame k of the
    set shows cos(v + s_k), with a phase v that increases along the line. If the words increase
    along the line, v = c + 2 pi x / p, otherwise v = c - 2 pi x / p. The constant c follows from
    the phase at the borders. The shifts t_k in cos(2 pi x / p + sign t_k) are t_k = s_k + c.

    Parameters
    ----------
    phase : phase set, with shifts relative to its first image
    words : code words along the same axis
    features : all images
    length_px : projector pixels along the axis
    """
    name = f"{phase.files[0]} ..."
    per_fringe = words_per_fringe(phase, words.bits[0], words.word)
    if per_fringe < 1.0:
        return phase, f"{name}: fringes are finer than the words; bits are missing"
    by_file = {image.file: image for image in features}
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
    elif abs(exact_deg - first_deg) > MOST_OFF_DEG or all(
        first_deg % angle_deg for angle_deg in USUAL_DEG
    ):
        doubt = f"{name}: first shift is {exact_deg:.0f} degrees, rounded; check shift_deg"
    shifts = tuple((shift + first_deg) % 360.0 for shift in phase.shifts_deg)
    return replace(phase, shifts_deg=shifts, sign=sign), doubt


def words_per_fringe(phase: FrameGroup, bits: FrameGroup, word: str) -> float:
    """Return the number of code words per fringe, rounded to a power of two.

    The finest bit of a reflected code word has a period of four words, that of a binary code word a
    period of two words.
    """
    words = 2.0 if word == "binary" else 4.0
    return float(2.0 ** round(math.log2(words * bits.frequency / phase.frequency)))


def word_px(bits: int, length_px: int) -> float:
    """Return the width of a code word, px, from the number of bits.

    It is the least power of two, at least 1, for which 2^bits words cover all `length_px` pixels.
    """
    least = length_px / 2.0**bits
    return max(2.0 ** math.ceil(math.log2(least) - 1e-9), 1.0)
