"""Sort listed frames into the order of decoding, and determine their pattern set.

The frames are sorted by their stated period, shift and bit, not by their names or their order in
the list. Phase frames of one period form a set of equal steps, Gray frames form code words. The
pattern code is the stated one. Without a statement it is the only code with `is_shown_by` True for
the widths of the code words and the periods of the fringes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from reconstruction.codes import CODES, AxisFrames, AxisFringes, PatternCode, code_of
from reconstruction.errors import CaptureError, require_integer
from reconstruction.patterns import AXES, Axis, Kind, PatternSet
from reconstruction.pixel_shape import PixelRatio, require_pixel_ratio
from reconstruction.stepping import STEPS_RANGE
from reconstruction.words import WORDS

# Largest deviation of a shift from equal steps, as a share of a step: shifts may be rounded.
EQUAL_STEPS = 0.02


@dataclass(frozen=True)
class ListedFrame:
    """One listed image and its pattern.

    Parameters
    ----------
    file : path of the image, relative to the folder of capture.toml
    kind, axis : as in `PatternFrame`
    period_px : period of the fringes; for a bit the width of its code word; None: not stated
    shift_deg : phase shift that is added to 2 pi x / period, in [0, 360)
    bit : number of the bit, 0 for the coarsest
    shifted : whether the bit is of the second code word
    exposure_ms : exposure time; 0: there is a single exposure
    """

    file: str
    kind: Kind
    axis: Axis | None = None
    period_px: float | None = None
    shift_deg: float = 0.0
    bit: int = 0
    shifted: bool = False
    exposure_ms: float = 0.0

    @property
    def text(self) -> str:
        """Description of the pattern, for messages."""
        along = f" along {self.axis}" if self.axis else ""
        if self.kind == "phase":
            return f"phase{along}, period {self.period_px:g} px, shift {self.shift_deg:g} degrees"
        bit = f", bit {self.bit}{' of the shifted word' * self.shifted}"
        return f"{self.kind}{along}{bit if self.axis else ''}"


@dataclass(frozen=True)
class ProjectorSize:
    """Image size of the projector, px, and shape of its pixels, see `pixel_shape`."""

    width_px: int
    height_px: int
    pixel_ratio: PixelRatio = 1.0

    def __post_init__(self) -> None:
        require_integer("projector width_px", self.width_px, 1, 65536)
        require_integer("projector height_px", self.height_px, 1, 65536)
        require_pixel_ratio("projector pixel_ratio", self.pixel_ratio)


class Arrangement:
    """The listed frames of one exposure in the order of decoding.

    Attributes
    ----------
    patterns : pattern set that the frames show
    files : paths of the images in the order of `patterns.frames`

    Raises
    ------
    InputError : two images show the same pattern, an image is missing, or the set cannot be decoded
    """

    def __init__(
        self, frames: Sequence[ListedFrame], size: ProjectorSize, word: str, code: str = ""
    ) -> None:
        _require_distinct(frames)
        self._stated = code_of(code) if code else None
        self._frames = frames
        self._size = size
        self._axes = tuple(axis for axis in AXES if any(frame.axis == axis for frame in frames))
        self._word = word
        if not self._axes:
            raise CaptureError("no frame along column or row is listed; list phase or Gray frames")
        self.patterns, self.files = self._sorted()

    def _of(
        self, kind: Kind, axis: Axis | None = None, *, shifted: bool = False
    ) -> list[ListedFrame]:
        matching = (f for f in self._frames if (f.kind, f.axis, f.shifted) == (kind, axis, shifted))
        return sorted(matching, key=lambda frame: frame.bit)

    def _sorted(self) -> tuple[PatternSet, list[str]]:
        phases = {axis: self._phase_sets(axis) for axis in self._axes}
        counts = {axis: len(sets) for axis, sets in phases.items()}
        if len(set(counts.values())) > 1:
            raise CaptureError(
                f"there are {counts['column']} fringe periods along column and {counts['row']} "
                "along row; list the same number, or one axis only"
            )
        steps = {_sizes(sets) for sets in phases.values() if sets}
        sizes = sorted({size for counts_of_axis in steps for size in counts_of_axis})
        if len(steps) > 1 or (len(sizes) > 1 and not _has_single_images(next(iter(steps)))):
            raise CaptureError(
                f"there are phase sets of {sizes} steps; list sets of the same number, or for "
                "micro phase shifting several steps of one period and one of each other"
            )
        words = {axis: self._coded(axis, phases[axis]) for axis in self._axes}
        patterns = self._patterns(phases, words)
        ordered = [frame for sets in phases.values() for frames in sets for frame in frames]
        for gray, inverse in (word[1:] for word in words.values()):
            ordered += [*gray, *inverse]
        uniform = [self._of("white"), self._of("black")]
        ordered += [frame for images in uniform for frame in images] if patterns.uniform else []
        if len(ordered) != len(patterns.frames):
            raise CaptureError(
                f"{len(ordered)} frames are listed, {patterns.code} of this size has "
                f"{len(patterns.frames)}; list exactly the bits of both words"
            )
        return patterns, [frame.file for frame in ordered]

    def _phase_sets(self, axis: Axis) -> list[list[ListedFrame]]:
        frames = self._of("phase", axis)
        periods = sorted({frame.period_px or 0.0 for frame in frames})
        sets = [[frame for frame in frames if frame.period_px == period] for period in periods]
        if _has_single_images(tuple(sorted(map(len, sets), reverse=True))):
            return [
                _equal_steps(step_set) if len(step_set) > 1 else step_set
                for step_set in sorted(sets, key=lambda step_set: len(step_set) == 1)
            ]
        return [_equal_steps(step_set) for step_set in sets]

    def _coded(
        self, axis: Axis, phases: list[list[ListedFrame]]
    ) -> tuple[str, list[ListedFrame], list[ListedFrame]]:
        """Return the name of the code along one axis, its Gray frames and their inverse frames."""
        first, second = self._of("gray", axis), self._of("gray", axis, shifted=True)
        is_displaced = bool(second) and not first
        if is_displaced:
            first, second = second, []
        if not first:
            return self._code(axis, phases, ()).name, [], []
        if len(phases) > 1 and self._stated is None:
            raise CaptureError(
                f"there are Gray frames and {len(phases)} fringe periods along {axis}; list the "
                "period that the words number"
            )
        fringe_px = phases[0][0].period_px if phases else None
        if self._stated is not None and fringe_px is not None:
            fringes = AxisFringes(self._length(axis), (fringe_px,))
            if self._stated.has_levels(fringes):
                return self._levels(axis, self._stated, fringes)
        bits = _WordBits(first, fringe_px, self._length(axis), bool(second), self._word)
        widths = ((bits.width_periods, is_displaced), *[(1.0, True)][: len(second)])
        code = self._code(axis, phases, widths)
        needed = bits.needed_bits(code)
        gray = [*first[needed], *second]
        inverse = self._of("inverse", axis, shifted=is_displaced)[needed]
        inverse += [] if is_displaced else self._of("inverse", axis, shifted=True)
        if inverse and [frame.bit for frame in inverse] != [frame.bit for frame in gray]:
            raise CaptureError(
                f"along {axis} there are {len(gray)} Gray frames and {len(inverse)} inverse ones "
                "of other bits; every Gray frame needs its inverse, or none"
            )
        return code.name, gray, inverse

    def _levels(
        self, axis: Axis, code: PatternCode, fringes: AxisFringes
    ) -> tuple[str, list[ListedFrame], list[ListedFrame]]:
        """Return the name of a code with several grey levels, its Gray and its inverse frames."""
        gray, inverse = self._of("gray", axis), self._of("inverse", axis)
        needed = sum(word.bits for word in code.words(fringes))
        if len(gray) != needed or len(inverse) not in (0, needed):
            raise CaptureError(
                f"along {axis} there are {len(gray)} Gray frames and {len(inverse)} inverse ones;"
                f" code {code.name!r} with fringes of {fringes.period_px:g} px has {needed}"
            )
        return code.name, gray, inverse

    def _code(
        self, axis: Axis, phases: list[list[ListedFrame]], words: tuple[tuple[float, bool], ...]
    ) -> PatternCode:
        """Return the stated pattern code, or the only code that has frames with this layout.

        Parameters
        ----------
        phases : frames of each fringe period
        words : width of each code word in periods, and whether the word is displaced
        """
        periods_px = tuple(frames[0].period_px or 0.0 for frames in phases)
        layout = AxisFrames(self._length(axis), periods_px, _sizes(phases), words)
        codes = [self._stated] if self._stated else [c for c in CODES if c.is_shown_by(layout)]
        if len(codes) == 1:
            return codes[0]
        if codes:
            names = ", ".join(code.name for code in codes)
            raise CaptureError(f"along {axis} the frames may be of the codes {names}; state code")
        if words:
            raise CaptureError(
                f"along {axis} all Gray frames are shifted = true, but no words as wide as the "
                "fringes; list the phase frames that they number, or the first word as well"
            )
        raise CaptureError(
            f"along {axis} there is one period of {periods_px[-1]:g} px, "
            "without a word or period that numbers its fringes; list Gray frames or further "
            "periods, or state code = 'spatial' for a continuous surface"
        )

    def _patterns(self, phases: dict[Axis, Any], words: dict[Axis, Any]) -> PatternSet:
        codes = {word[0] for word in words.values()}
        has_inverse = {bool(word[2]) for word in words.values()}
        if len(codes) > 1 or len(has_inverse) > 1:
            raise CaptureError(
                f"along column and row there are different codes ({', '.join(sorted(codes))}) or "
                "inverse frames along one axis only; list one axis only"
            )
        uniform = {kind: bool(self._of(kind)) for kind in ("white", "black")}
        periods = {axis: self._periods_px(axis, phases, words) for axis in self._axes}
        first = periods[self._axes[0]]
        differs = len(periods) == 2 and periods["row"] != first
        shifts = [frames[0].shift_deg for sets in phases.values() for frames in sets]
        return PatternSet(
            self._size.width_px,
            self._size.height_px,
            first[0],
            len(phases[self._axes[0]][0]) if phases[self._axes[0]] else 0,
            code=codes.pop(),
            further_periods_px=first[1:],
            row_periods_px=periods["row"] if differs else (),
            axes=self._axes,
            word=self._word,
            inverse=has_inverse.pop(),
            uniform=all(uniform.values()),
            first_shifts_deg=tuple(shifts) if any(shifts) else (),
            pixel_ratio=self._size.pixel_ratio,
        )

    def _periods_px(
        self, axis: Axis, phases: dict[Axis, Any], words: dict[Axis, Any]
    ) -> tuple[float, ...]:
        if phases[axis]:
            return tuple(frames[0].period_px for frames in phases[axis])
        return (words[axis][1][0].period_px,)

    def _length(self, axis: Axis) -> int:
        return self._size.width_px if axis == "column" else self._size.height_px


def _sizes(sets: list[list[ListedFrame]]) -> tuple[int, ...]:
    return tuple(len(step_set) for step_set in sets)


def _has_single_images(sizes: tuple[int, ...]) -> bool:
    """Return True if the first period has several images and each further one a single image."""
    return len(sizes) > 1 and sizes[0] >= STEPS_RANGE[0] and set(sizes[1:]) == {1}


def _require_distinct(frames: Sequence[ListedFrame]) -> None:
    listed: dict[Any, ListedFrame] = {}
    names: dict[str, ListedFrame] = {}
    for frame in frames:
        key = (
            frame.kind,
            frame.axis,
            frame.period_px,
            round(frame.shift_deg, 3),
            frame.bit,
            frame.shifted,
        )
        if key in listed:
            raise CaptureError(
                f"{listed[key].file} and {frame.file} are both listed as {frame.text}; correct one"
            )
        if frame.file in names:
            raise CaptureError(
                f"{frame.file} is listed twice: as {names[frame.file].text}, and as {frame.text}"
            )
        listed[key], names[frame.file] = frame, frame


def _equal_steps(frames: list[ListedFrame]) -> list[ListedFrame]:
    """Return the frames of a phase set sorted by shift; raise CaptureError for unequal steps."""
    count = len(frames)
    step_deg = 360.0 / count
    slack_deg = EQUAL_STEPS * step_deg
    # A shift just below a full turn is a rounded shift of 0.
    ordered = sorted(frames, key=lambda frame: (frame.shift_deg + slack_deg) % 360.0)
    shifts = [(frame.shift_deg + slack_deg) % 360.0 for frame in ordered]
    uneven = [b - a for a, b in pairwise(shifts) if abs(b - a - step_deg) > slack_deg]
    if count < 3 or uneven:
        texts = ", ".join(f"{frame.shift_deg:g}" for frame in ordered)
        raise CaptureError(
            f"the {count} phase frames along {ordered[0].axis} of period "
            f"{ordered[0].period_px:g} px have the shifts {texts} degrees: no {max(count, 3)} "
            "equal steps of a turn; record the missing ones, or correct shift_deg, steps and sign"
        )
    return ordered


class _WordBits:
    """The bits of the first code word along one axis, the coarsest first.

    Attributes
    ----------
    width_periods : width of the code word in fringe periods, 1 or 1/2, after removal of the finest
        bits that the fringes do not need
    """

    def __init__(
        self, frames: list[ListedFrame], fringe_px: float | None, length_px: int, shifted: bool,
        word: str,
    ) -> None:  # fmt: skip
        _require_all_bits(frames)
        stated_px = frames[0].period_px
        if stated_px is None and fringe_px is None:
            raise CaptureError(
                f"period_px of the Gray frames along {frames[0].axis} is missing; give the width "
                "of one word"
            )
        self._frames, self._length_px = frames, length_px
        if fringe_px is not None and stated_px is None:
            stated_px = _inferred_px(frames, fringe_px, length_px, shifted)
        width_px = stated_px or 0.0
        self._fringe_px = fringe_px or width_px
        self._left_out = _left_out(frames, self._fringe_px, width_px, shifted, word)
        self.width_periods = width_px * 2**self._left_out / self._fringe_px

    def needed_bits(self, code: PatternCode) -> slice:
        """Return the slice of the bits that a code needs; coarser bits are 0 in the whole image."""
        words = code.words(AxisFringes(self._length_px, (self._fringe_px,)))
        if not words:
            axis = self._frames[0].axis
            raise CaptureError(f"along {axis} Gray frames are listed, code '{code.name}' has none")
        needed = words[0].bits
        count = len(self._frames) - self._left_out
        if count < needed:
            width_px = self.width_periods * self._fringe_px
            raise CaptureError(
                f"along {self._frames[0].axis} {count} Gray frames number {2**count} words of "
                f"{width_px:g} px, the {self._length_px} px need {needed} frames; record the "
                "missing ones, or correct period_px or [projector]"
            )
        return slice(count - needed, count)


def _require_all_bits(frames: list[ListedFrame]) -> None:
    bits = [frame.bit for frame in frames]
    if bits != list(range(bits[0], bits[0] + len(bits))):
        missing = sorted(set(range(bits[0], bits[-1])) - set(bits))
        raise CaptureError(
            f"along {frames[0].axis} bits {missing} are missing among the Gray frames; record them"
        )


def _left_out(
    frames: list[ListedFrame], fringe_px: float, stated_px: float, shifted: bool, word: str
) -> int:
    """Return the number of the finest bits that the fringes do not need.

    Parameters
    ----------
    stated_px : width of the code word with all bits
    shifted : whether there is a second code word
    """
    finer, has_spare_bits = math.log2(fringe_px / stated_px), WORDS[word].has_spare_bits
    count = max(round(finer) - (1 if has_spare_bits and not shifted else 0), 0)
    if abs(finer - round(finer)) > 1e-9 or finer < -1e-9 or (count and not has_spare_bits):
        raise CaptureError(
            f"along {frames[0].axis} words are {stated_px:g} px wide and fringes {fringe_px:g} px; "
            "words must be as wide as a fringe, half of it, or that divided by 2, 4, 8 ..."
        )
    return count


def _inferred_px(
    frames: list[ListedFrame], fringe_px: float, length_px: int, shifted: bool
) -> float:
    """Return the width of the code word, px, if the number of bits determines it."""
    count, plain = len(frames), AxisFringes(length_px, (fringe_px,)).bits
    if shifted or count == plain:
        return fringe_px
    if count == plain + 1:
        return 0.5 * fringe_px
    low_px, high_px = length_px / 2.0**count, length_px / 2.0 ** (count - 2)
    raise CaptureError(
        f"along {frames[0].axis} there are {count} Gray frames; fringes of {fringe_px:g} px need "
        f"{plain}, or {plain + 1} with half-period words: record the missing ones, or give "
        "period_px of the Gray frames, the width of one word; or the axes, or width_px and "
        f"height_px, are exchanged, or period_px is wrong: {count} frames number fringes of "
        f"{low_px:.4g} to {high_px:.4g} px on {length_px} px"
    )
