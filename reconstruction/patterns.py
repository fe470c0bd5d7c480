"""Definition of the projected patterns, from which both projector images and decoder are made.

Frame: projector pixels, x right (column), y down (row), integer = centre of a pixel.

| symbol | meaning |
|---|---|
| x | coordinate along the axis, px |
| phi = 2 pi x / period | phase, increases with x |
| I_n = A + B cos(phi + 2 pi n / N) | phase frame n of N |
| k = floor(x / period) | period index (fringe order) |
| w | code word: integer that numbers the fringes, see `codes`; without phase frames it is k |

A code word w is projected as bits in one of the encodings of `words`, one frame per bit, the most
significant bit first. An inverse frame shows the complement of one bit.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from reconstruction.arrays import LATER, BoolArray, FloatArray, IntArray, Levels
from reconstruction.codes import CODES, AxisFringes, CodeWord, PatternCode, Rule, code_of
from reconstruction.errors import InputError, require_integer, require_number
from reconstruction.pixel_shape import PixelRatio, require_pixel_ratio
from reconstruction.stepping import STEPS_RANGE, Stepping, stepping_of
from reconstruction.words import WORDS, WordEncoding

Kind = Literal["phase", "gray", "inverse", "white", "black"]
Axis = Literal["column", "row"]
AXES: tuple[Axis, Axis] = ("column", "row")
Waveform = Literal["sinusoidal", "square"]
WAVEFORMS: tuple[Waveform, ...] = ("sinusoidal", "square")

# Below 4 px a Gray stripe of a fractional period may be displaced by 0.25 periods, the whole margin
# of the edge-safe rules.
PERIOD_RANGE_PX = (4.0, 65536.0)
# Least width of a code word without phase frames, which needs no margin for the phase.
LEAST_STRIPE_PX = 1.0
LARGEST_EDGE_ERROR_PX = 1e-3
MOST_FURTHER_PERIODS = 31


@dataclass(frozen=True)
class PatternFrame:
    """One projected image of a pattern set.

    Parameters
    ----------
    kind : phase frame, bit of a code word, inverse of such a bit, white or black
    axis : projector axis along which the image varies; None: a uniform image
    index : number of the image among those of equal kind and axis, from 0
    """

    kind: Kind
    axis: Axis | None
    index: int

    @property
    def name(self) -> str:
        """Name such as `phase_column_03`; uniform frames are `white` and `black`."""
        return self.kind if self.axis is None else f"{self.kind}_{self.axis}_{self.index:02d}"


@dataclass(frozen=True)
class PatternSet:
    """Projected images: phase-shifted sinusoids, frames that number the fringes, white and black.

    Parameters
    ----------
    width_px, height_px : size of the projector image
    period_px : measuring period, >= 4 px: the fringe period that gives the coordinate
    steps : number N of phase steps of every period, >= 3. With code "micro" only the measuring
        period has N steps. 0: no fringes, only code words, whose integer changes every
        `period_px`
    low_level, high_level : 8-bit projector levels of black and white
    code : pattern code that numbers the fringes, a name in `codes.CODES`
    further_periods_px : fringe periods in addition to the measuring period, if the code needs them
    row_periods_px : all fringe periods along the row axis, the measuring period first; (): equal to
        those along the column axis
    axes : projector axes along which patterns are shown
    word : encoding of code words as bits, a name in `words.WORDS`; values except "reflected" only
        with code "gray"
    inverse : whether the inverse of every Gray frame is shown, for comparison with that frame
    uniform : whether a white and a black frame are shown
    first_shifts_deg : phase at x = 0 of the first phase step, degrees, of every period along
        the column axis, then of every period along the row axis; for the shown axes only; (): all 0
    pixel_ratio : width of a projector pixel divided by its height, or "diamond", see
        `pixel_shape`; the patterns do not depend on it, a calibration does
    stepping : phase shifts of the `steps` frames of a period, a name in `stepping.STEPPINGS`; other
        than "equal": for scenes in motion
    waveform : brightness over one fringe period: "square" has the levels black and white only (one
        bit), which the blur of the projector makes sinusoidal
    """

    width_px: int
    height_px: int
    period_px: float = 18.0
    steps: int = 18
    low_level: int = 0
    high_level: int = 255
    code: str = "complementary_gray"
    further_periods_px: tuple[float, ...] = ()
    row_periods_px: tuple[float, ...] = ()
    axes: tuple[Axis, ...] = AXES
    word: str = "reflected"
    inverse: bool = False
    uniform: bool = True
    first_shifts_deg: tuple[float, ...] = ()
    pixel_ratio: PixelRatio = 1.0
    stepping: str = field(default="equal", metadata=LATER)
    waveform: Waveform = field(default="sinusoidal", metadata=LATER)

    def __post_init__(self) -> None:
        require_integer("patterns width_px", self.width_px, 1, 65536)
        require_integer("patterns height_px", self.height_px, 1, 65536)
        shortest_px, longest_px = self._period_range_px()
        require_number("patterns period_px", self.period_px, shortest_px, longest_px)
        self._check_steps()
        require_integer("patterns low_level", self.low_level, 0, 254)
        require_integer("patterns high_level", self.high_level, self.low_level + 1, 255)
        require_pixel_ratio("patterns pixel_ratio", self.pixel_ratio)
        if self.waveform not in WAVEFORMS:
            allowed = ", ".join(WAVEFORMS)
            raise InputError(f"patterns waveform is {self.waveform!r}; allowed are {allowed}")
        for name in ("further_periods_px", "row_periods_px"):
            allowed_px = (shortest_px, longest_px)
            object.__setattr__(self, name, _periods(name, getattr(self, name), allowed_px))
        object.__setattr__(self, "axes", _axes(self.axes))
        object.__setattr__(self, "first_shifts_deg", self._checked_shifts())
        self._check_words()
        self._check_periods()
        self._check_edges()

    @cached_property
    def frames(self) -> tuple[PatternFrame, ...]:
        """All frames, in the order of projection, which is also that of the image stack."""

        def along(kind: Kind, axis: Axis, count: int) -> list[PatternFrame]:
            return [PatternFrame(kind, axis, n) for n in range(count)]

        shots = sum(self.images(number) for number in range(len(self.periods_px)))
        ordered = [frame for axis in self.axes for frame in along("phase", axis, shots)]
        for axis in self.axes:
            ordered += along("gray", axis, self.word_bits(axis))
            ordered += along("inverse", axis, self.word_bits(axis) * self.inverse)
        last = [PatternFrame("white", None, 0), PatternFrame("black", None, 0)]
        return (*ordered, *last[: 2 * self.uniform])

    @property
    def exposure_frame(self) -> int | None:
        """Stack index of the frame for the automatic exposure, the white one; None without one."""
        return self.index("white").start if self.uniform else None

    @property
    def periods_px(self) -> tuple[float, ...]:
        """Fringe periods along the column axis, px, in projection order, measuring one first."""
        return (self.period_px, *self.further_periods_px)

    def periods_along(self, axis: Axis) -> tuple[float, ...]:
        """Return the fringe periods along `axis`, px, in projection order, measuring one first."""
        return self.row_periods_px if axis == "row" and self.row_periods_px else self.periods_px

    def period_along(self, axis: Axis) -> float:
        """Return the measuring period along `axis`, px.

        Without fringes it is the length over which the integer of the code word is constant.
        """
        return self.periods_along(axis)[0]

    @property
    def kind(self) -> PatternCode:
        """The pattern code that numbers the fringes, from `CODES`."""
        return CODES[self.code]

    @property
    def phase_shifts(self) -> Stepping:
        """The phase shifts of the frames of one period, from `STEPPINGS`."""
        return stepping_of(self.stepping)

    @property
    def encoding(self) -> WordEncoding:
        """The encoding of words as bits."""
        return WORDS[self.word]

    def fringes(self, axis: Axis) -> AxisFringes:
        """Return image length and fringe periods along `axis`, px, as the input of a code."""
        return AxisFringes(self.length_px(axis), self.periods_along(axis))

    def fused_periods(self, axis: Axis) -> tuple[float, ...]:
        """Return the fringe periods, px, of the phases that give the coordinate along `axis`.

        With a multi-frequency code these are all periods, with other codes the measuring period.
        """
        periods_px = self.periods_along(axis)
        return periods_px if self.kind.rule is Rule.CHAIN else periods_px[:1]

    def images(self, number: int) -> int:
        """Return the number of images of the period with index `number`; 0: measuring period."""
        return self.kind.images(number, self.steps)

    @property
    def sets(self) -> int:
        """Number of periods per axis with N phase steps; periods with one image follow them."""
        return sum(self.images(number) == self.steps for number in range(len(self.periods_px)))

    def step_sets(self, axis: Axis) -> tuple[slice, ...]:
        """Return the stack slice of each period with N phase steps along `axis`; () if none."""
        if not self.steps or axis not in self.axes:
            return ()
        first = self.index("phase", axis).start
        starts = range(first, first + self.sets * self.steps, self.steps)
        return tuple(slice(start, start + self.steps) for start in starts)

    def length_px(self, axis: Axis) -> int:
        """Return the number of projector pixels along `axis`."""
        if axis not in AXES:
            raise InputError(f"pattern axis is {axis!r}; allowed are 'column' and 'row'")
        return self.width_px if axis == "column" else self.height_px

    def periods(self, axis: Axis) -> int:
        """Return the number of complete and partial fringe periods along `axis`."""
        return math.ceil(self.length_px(axis) / self.period_along(axis))

    def gray_bits(self, axis: Axis) -> int:
        """Return the least number of bits that can number the periods; a code may add bits."""
        return (self.periods(axis) - 1).bit_length()

    def words(self, axis: Axis) -> tuple[CodeWord, ...]:
        """Return the code words along `axis`; () if it is not shown or the code has no words."""
        return self.kind.words(self.fringes(axis)) if axis in self.axes else ()

    def word_bits(self, axis: Axis) -> int:
        """Return the number of Gray frames along `axis`, not counting inverse frames."""
        return sum(word.bits for word in self.words(axis))

    def word_count(self, axis: Axis) -> int:
        """Return how many integers the first code word has along `axis`; 1 without code words."""
        words = self.kind.words(self.fringes(axis))
        return words[0].count(self.length_px(axis)) if words else 1

    def bits(self, axis: Axis) -> BoolArray:
        """Return the projected bits of all code words along `axis`, (bit, projector pixel) bool."""
        x_px = np.arange(self.length_px(axis))
        rows = [self._bits_of(word, x_px) for word in self.words(axis)]
        return np.concatenate(rows) if rows else np.zeros((0, x_px.size), np.bool_)

    def shown(self, axis: Axis) -> FloatArray:
        """Return the brightness of all Gray frames along `axis`, (frame, projector pixel)."""
        x_px = np.arange(self.length_px(axis))
        rows = [
            word.brightness(word.at(x_px)) if word.brightness else self._bits_of(word, x_px)
            for word in self.words(axis)
        ]
        return np.concatenate(rows).astype(np.float64)

    def binary(self, bits: BoolArray) -> BoolArray:
        """Return the binary digits of a code word from its projected bits, both (bit, ...) bool."""
        return self.encoding.binary(bits)

    def _bits_of(self, word: CodeWord, x_px: IntArray) -> BoolArray:
        shown = self.encoding.shown(word.at(x_px), word.bits)
        places = np.arange(word.bits)[::-1, None]
        return np.asarray((shown >> places) & 1, np.bool_)

    def index(self, kind: Kind, axis: Axis | None = None) -> slice:
        """Return the stack slice of the frames of one kind and axis; most significant bit first."""
        indices = [i for i, f in enumerate(self.frames) if f.kind == kind and f.axis == axis]
        if not indices and not (kind in ("gray", "inverse") and axis in AXES):
            raise InputError(f"there are no {kind!r} frames along axis {axis!r}")
        return slice(indices[0], indices[-1] + 1) if indices else slice(0, 0)

    def profile(self, frame: PatternFrame) -> Levels:
        """Return the levels (pixel,) uint8 along the axis of a frame; uniform frames: along x."""
        if frame not in self.frames:
            raise InputError(f"{frame.name} is no frame of this pattern set")
        bright = self._brightness(frame)
        levels = self.low_level + (self.high_level - self.low_level) * bright
        return np.rint(levels).astype(np.uint8)

    def image(self, frame: PatternFrame) -> Levels:
        """Return the projector image of `frame`, (height, width) uint8."""
        levels = self.profile(frame)
        line = levels[:, np.newaxis] if frame.axis == "row" else levels[np.newaxis, :]
        return np.ascontiguousarray(np.broadcast_to(line, (self.height_px, self.width_px)))

    def phase_of(self, frame: PatternFrame) -> tuple[float, float]:
        """Return the fringe period, px, and the phase shift, turns, of a phase frame."""
        fringes, step = 0, frame.index
        while step >= self.images(fringes):
            step -= self.images(fringes)
            fringes += 1
        axis = frame.axis or "column"
        return self.periods_along(axis)[fringes], self.shifts(axis, fringes)[step]

    def shifts(self, axis: Axis, fringes: int) -> tuple[float, ...]:
        """Return the phase shifts, turns, of the steps of period `periods_along(axis)[fringes]`."""
        first = 0.0
        if self.first_shifts_deg:
            place = self.axes.index(axis) * len(self.periods_px) + fringes
            first = self.first_shifts_deg[place] / 360.0
        images = self.images(fringes)
        if images < self.steps:
            return (first,) * images
        return tuple(first + shift for shift in self.phase_shifts.shifts(images))

    def _brightness(self, frame: PatternFrame) -> FloatArray:
        if frame.axis is None:
            return np.full(self.width_px, float(frame.kind == "white"))
        x_px = np.arange(self.length_px(frame.axis), dtype=np.float64)
        if frame.kind == "phase":
            period_px, shift = self.phase_of(frame)
            if self.waveform == "square":
                return self._square(x_px / period_px + shift)
            return 0.5 + 0.5 * np.cos(2.0 * np.pi * (x_px / period_px + shift))
        bright = self.shown(frame.axis)[frame.index]
        return np.asarray(1.0 - bright if frame.kind == "inverse" else bright)

    @staticmethod
    def _square(turns: FloatArray) -> FloatArray:
        """Return 1 in the half of a turn around 0, otherwise 0, at phases in turns."""
        # Rounded, so that a pixel at the border of the half has the same level in every period.
        return np.asarray(np.round(turns + 0.25, 9) % 1.0 < 0.5, np.float64)

    def _check_edges(self) -> None:
        """Raise InputError if an edge of a square fringe is not between two projector pixels.

        The edge would be displaced by up to half a pixel, and the phase with it.
        """
        if self.waveform == "sinusoidal" or not self.steps:
            return
        for axis in self.axes:
            for fringes, period_px in enumerate(self.periods_along(axis)):
                shifts = np.array(self.shifts(axis, fringes))
                edges_px = period_px * (np.array([[-0.25], [0.25]]) - shifts)
                if np.abs(edges_px % 1.0 - 0.5).max() > LARGEST_EDGE_ERROR_PX:
                    raise InputError(
                        f"patterns waveform is 'square' with period_px {period_px:g} and shifts"
                        f" {', '.join(f'{shift:.4g}' for shift in shifts)} turns: edges are not"
                        " between pixels; choose period_px / 2 odd and a multiple of steps, or"
                        f" first_shifts_deg {180.0 / period_px:g} and a multiple of steps"
                    )

    def _check_steps(self) -> None:
        shifts, code = stepping_of(self.stepping), code_of(self.code)
        if self.steps != 0 or isinstance(self.steps, bool):
            require_integer("patterns steps", self.steps, min(shifts.least, STEPS_RANGE[0]), 1000)
            shifts.check(self.stepping, self.steps)
        elif self.stepping != "equal":
            raise InputError(
                f"patterns stepping is {self.stepping!r} with steps 0, without fringes; leave it"
                " out, or give the number of phase frames"
            )
        if self.stepping != "equal" and code.rule is Rule.SINGLE_IMAGES:
            raise InputError(
                f"patterns stepping is {self.stepping!r} with code {self.code!r}, which needs"
                " 'equal'; leave it out or use another code"
            )

    def _period_range_px(self) -> tuple[float, float]:
        return (PERIOD_RANGE_PX[0] if self.steps else LEAST_STRIPE_PX), PERIOD_RANGE_PX[1]

    def _checked_shifts(self) -> tuple[float, ...]:
        values = self.first_shifts_deg
        count = len(self.axes) * len(self.periods_px)
        if not isinstance(values, (tuple, list)) or len(values) not in (0, count):
            raise InputError(
                f"patterns first_shifts_deg is {values!r}; give {count} numbers, one for each"
                " period along each axis, or leave it out"
            )
        for value in values:
            require_number("patterns first_shifts_deg", value, -360.0, 360.0)
        return tuple(float(value) for value in values)

    def _check_words(self) -> None:
        if not isinstance(self.word, str) or self.word not in WORDS:
            allowed = ", ".join(WORDS.names())
            raise InputError(f"patterns word is {self.word!r}; allowed are {allowed}")
        for name in ("inverse", "uniform"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"patterns {name} is {getattr(self, name)!r}; give true or false")
        if len(self.row_periods_px) not in (0, len(self.periods_px)):
            raise InputError(
                f"patterns row_periods_px is {self.row_periods_px}; give as many periods as along"
                f" columns, {len(self.periods_px)}, or leave it out"
            )
        if not self.kind.has_free_words and (self.word != "reflected" or self.steps == 0):
            stated = f"word {self.word!r}" if self.word != "reflected" else "steps 0"
            free = " or ".join(f"'{code.name}'" for code in CODES if code.has_free_words)
            raise InputError(f"patterns code is {self.code!r} with {stated}; use code {free}")
        if self.steps == 0 and min(self.word_count(axis) for axis in self.axes) < 2:
            raise InputError(
                f"patterns period_px is {self.period_px:g} with steps 0: one word for the whole"
                " image; give the width of a word"
            )
        if self.steps == 0 and not (self.inverse or self.uniform):
            raise InputError(
                "patterns steps is 0 without inverse and uniform frames: nothing to compare the"
                " bits with; show inverse frames, or white and black"
            )

    def _check_periods(self) -> None:
        if self.further_periods_px and not self.kind.takes_further_periods:
            taking = ", ".join(code.name for code in CODES if code.takes_further_periods)
            raise InputError(
                f"patterns further_periods_px is {self.further_periods_px} with code"
                f" {self.code!r}; leave it out or use a code of {taking}"
            )
        if self.inverse and not self.words(self.axes[0]):
            raise InputError(f"patterns inverse is true with code {self.code!r}, which has no bits")
        for fringes in self._checked_fringes():
            self.kind.check(fringes)

    def _checked_fringes(self) -> list[AxisFringes]:
        """Return the fringes to check: of each axis, or of the longer one if periods are equal."""
        if self.row_periods_px:
            return [self.fringes(axis) for axis in self.axes]
        return [AxisFringes(max(map(self.length_px, self.axes)), self.periods_px)]


def _periods(name: str, values: object, allowed_px: tuple[float, float]) -> tuple[float, ...]:
    if not isinstance(values, (tuple, list)) or len(values) > MOST_FURTHER_PERIODS + 1:
        raise InputError(
            f"patterns {name} is {values!r}; give up to {MOST_FURTHER_PERIODS} periods"
        )
    for value in values:
        require_number(f"patterns {name}", value, *allowed_px)
    return tuple(float(value) for value in values)


def _axes(values: object) -> tuple[Axis, ...]:
    axes = tuple(values) if isinstance(values, (tuple, list)) else ()
    if axes not in (AXES, AXES[:1], AXES[1:]):
        raise InputError(
            f"patterns axes is {values!r}; allowed are ['column', 'row'], ['column'] and ['row']"
        )
    return axes
