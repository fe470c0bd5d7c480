"""The projected patterns: the one definition that the projector shows and the decoder expects.

Frame: projector pixels, x right (column), y down (row), integer = centre of a pixel.

| symbol | meaning |
|---|---|
| x | coordinate along the axis, px |
| phi = 2 pi x / period | phase, grows with x |
| I_n = A + B cos(phi + 2 pi n / N) | phase frame n of N |
| h = floor(2 x / period) | half-period index, shown as Gray code when complementary |
| k = floor(x / period) | period index (fringe order) |
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from reconstruction.arrays import Doubles, Levels
from reconstruction.checks import require_flag, require_integer, require_number
from reconstruction.errors import InputError

Kind = Literal["phase", "gray", "white", "black"]
Axis = Literal["column", "row"]
AXES: tuple[Axis, Axis] = ("column", "row")

# Below 4 px the half-pixel offset between a Gray edge (pixel border) and the phase (pixel centre)
# eats the quarter-period margin of the edge-safe rule.
MIN_PERIOD_PX = 4.0


@dataclass(frozen=True)
class Frame:
    """One projected image: its kind, the axis it varies along (None when uniform), its number."""

    kind: Kind
    axis: Axis | None
    index: int

    @property
    def name(self) -> str:
        """Name such as `phase_column_03`; uniform frames are `white` and `black`."""
        return self.kind if self.axis is None else f"{self.kind}_{self.axis}_{self.index:02d}"


@dataclass(frozen=True)
class PatternSet:
    """Phase-shifted sinusoids plus Gray code along both projector axes, white and black.

    Parameters
    ----------
    width_px, height_px : projector image size
    period_px : fringe period, >= 4 px
    steps : phase steps N, >= 3
    complementary : append one Gray bit, so that the order is safe at period edges
    low_level, high_level : 8-bit projector levels of black and white

    Notes
    -----
    Complementary Gray code: Zhang et al., Opt. Lasers Eng. 50, 574 (2012).
    """

    width_px: int
    height_px: int
    period_px: float = 18.0
    steps: int = 18
    complementary: bool = True
    low_level: int = 0
    high_level: int = 255

    def __post_init__(self) -> None:
        require_integer("patterns width_px", self.width_px, 1, 65536)
        require_integer("patterns height_px", self.height_px, 1, 65536)
        require_number("patterns period_px", self.period_px, MIN_PERIOD_PX, 65536)
        require_integer("patterns steps", self.steps, 3, 1000)
        require_flag("patterns complementary", self.complementary)
        require_integer("patterns low_level", self.low_level, 0, 254)
        require_integer("patterns high_level", self.high_level, self.low_level + 1, 255)

    @cached_property
    def frames(self) -> tuple[Frame, ...]:
        """All frames in the order of projection and of the stack."""
        phase = [Frame("phase", axis, n) for axis in AXES for n in range(self.steps)]
        gray = [Frame("gray", axis, n) for axis in AXES for n in range(self.word_bits(axis))]
        return (*phase, *gray, Frame("white", None, 0), Frame("black", None, 0))

    def length_px(self, axis: Axis) -> int:
        """Return the number of projector pixels along `axis`."""
        if axis not in AXES:
            raise InputError(f"pattern axis is {axis!r}; allowed are 'column' and 'row'")
        return self.width_px if axis == "column" else self.height_px

    def periods(self, axis: Axis) -> int:
        """Return how many fringe periods are begun along `axis`."""
        return math.ceil(self.length_px(axis) / self.period_px)

    def gray_bits(self, axis: Axis) -> int:
        """Return the bits that number the periods, without the complementary bit."""
        return (self.periods(axis) - 1).bit_length()

    def word_bits(self, axis: Axis) -> int:
        """Return the Gray frames along `axis`, the complementary bit included."""
        return self.gray_bits(axis) + int(self.complementary)

    def words(self, axis: Axis) -> int:
        """Return how many different words are shown: half-periods when complementary."""
        return self._word_at(self.length_px(axis) - 1) + 1

    def index(self, kind: Kind, axis: Axis | None = None) -> slice:
        """Return the stack indices of a kind of frames, most significant Gray bit first."""
        found = [i for i, f in enumerate(self.frames) if f.kind == kind and f.axis == axis]
        if not found and not (kind == "gray" and axis in AXES):
            raise InputError(f"there are no {kind!r} frames along axis {axis!r}")
        return slice(found[0], found[-1] + 1) if found else slice(0, 0)

    def profile(self, frame: Frame) -> Levels:
        """Return the levels along the axis of `frame`, (length,) uint8; uniform: (width,)."""
        if frame not in self.frames:
            raise InputError(f"{frame.name} is no frame of this pattern set")
        bright = self._brightness(frame)
        levels = self.low_level + (self.high_level - self.low_level) * bright
        return np.rint(levels).astype(np.uint8)

    def image(self, frame: Frame) -> Levels:
        """Return the projector image of `frame`, (height, width) uint8."""
        levels = self.profile(frame)
        line = levels[:, np.newaxis] if frame.axis == "row" else levels[np.newaxis, :]
        return np.ascontiguousarray(np.broadcast_to(line, (self.height_px, self.width_px)))

    def _brightness(self, frame: Frame) -> Doubles:
        if frame.axis is None:
            return np.full(self.width_px, float(frame.kind == "white"))
        x_px = np.arange(self.length_px(frame.axis), dtype=np.float64)
        if frame.kind == "phase":
            turns = x_px / self.period_px + frame.index / self.steps
            return 0.5 + 0.5 * np.cos(2.0 * np.pi * turns)
        word = np.array([self._word_at(x) for x in range(x_px.size)])
        shift = self.word_bits(frame.axis) - 1 - frame.index
        bits: Doubles = (((word ^ (word >> 1)) >> shift) & 1).astype(np.float64)
        return bits

    def _word_at(self, x_px: int) -> int:
        return math.floor((2 * x_px if self.complementary else x_px) / self.period_px)
