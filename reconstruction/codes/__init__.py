"""Pattern codes, which number the fringes. Each module registers one code in `CODES`.

The fringe order is the number of the fringe period that a pixel is in. A pattern code defines the
projected code words and further fringe periods, and how the fringe order is decoded from them:
either by one of the compiled rules (`Rule`), or by its own method `unwrap` in numpy. Minimal
example:

    class TernaryCode(PatternCode):
        name, title = "ternary", "ternary code"
        summary = "words in base 3"

        def words(self, fringes): ...
        def unwrap(self, wrapped): ...

    CODES.register(TernaryCode())

Frame: projector pixels, integer = centre of a pixel.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, IntArray
from reconstruction.errors import InputError
from reconstruction.registry import Registry
from reconstruction.several_periods import Chain
from reconstruction.spatial_unwrapping import Islands, Labels


class Rule(Enum):
    """Rules by which the fringe order is decoded from phases in [0, 2 pi) and code words.

    All rules except OWN are compiled functions of the decoder. OWN is a method in numpy.
    """

    WORD_PER_PERIOD = auto()
    """One code word, which changes where the phase is -2 pi `displacement`, modulo 2 pi."""
    WORD_PER_HALF_PERIOD = auto()
    """One code word, which changes where the phase is 0 and where it is pi."""
    TWO_WORDS = auto()
    """Two code words: the first changes where the phase is 0, the second where it is pi."""
    CHAIN = auto()
    """Phases of several periods, unwrapped from coarse to fine and averaged. See `Chain`."""
    SINGLE_IMAGES = auto()
    """N phase steps of the first period and a single image of each further period."""
    OWN = auto()
    """The method `unwrap` of the pattern code."""


@dataclass(frozen=True)
class AxisFringes:
    """The fringes along one projector axis.

    Parameters
    ----------
    length_px : projector pixels along the axis
    periods_px : all fringe periods, the measuring one first; without fringes the length over which
        the integer of the code word is constant
    """

    length_px: int
    periods_px: tuple[float, ...]

    @property
    def period_px(self) -> float:
        """The measuring period, px: the fringe period that gives the coordinate."""
        return self.periods_px[0]

    @property
    def bits(self) -> int:
        """Number of bits that are needed to number all measuring periods along the axis."""
        return (math.ceil(self.length_px / self.period_px) - 1).bit_length()


@dataclass(frozen=True)
class CodeWord:
    """A code word: an integer per projector pixel that is projected as bits, one frame per bit.

    Parameters
    ----------
    bits : number of bits and frames, the most significant bit first
    at : function that returns the integers (n,) int64 at projector pixels (n,) int64
    brightness : function that returns the brightness (frame, n) of `bits` frames in [0, 1] from the
        integers (n,), for codes with several grey levels; None: one bit per frame
    """

    bits: int
    at: Callable[[IntArray], IntArray]
    brightness: Callable[[IntArray], FloatArray] | None = None

    def count(self, length_px: int) -> int:
        """Return the number of different integers along an axis of `length_px` pixels."""
        last = int(self.at(np.array([length_px - 1]))[0])
        return int(last + 1 if self.brightness else min(last + 1, 2**self.bits))


def period_word(
    fringes: AxisFringes, displacement: float = 0.0, bits: int | None = None
) -> CodeWord:
    """Return the code word floor(x / period + displacement); `bits` None: `fringes.bits`."""

    def at(x_px: IntArray) -> IntArray:
        return np.floor(x_px / fringes.period_px + displacement).astype(np.int64)

    return CodeWord(fringes.bits if bits is None else bits, at)


@dataclass(frozen=True, eq=False)
class Expected:
    """Coordinates along one projector axis that are known without the fringe order.

    Parameters
    ----------
    coordinate_px : (row, col) float, projector px; NaN where unknown
    sigma_px : (row, col) float, standard deviation; its error is common to all pixels
    islands : islands of continuous phase that may be numbered by it: "mask" the largest one, others
        are masked; "all" each one with known coordinates; "join" one island, connected where the
        jumps are least doubtful
    is_exact : whether two coordinates of one island must agree, as those of marked pixels
    """

    coordinate_px: FloatArray
    sigma_px: FloatArray
    islands: Islands = "mask"
    is_exact: bool = False


@dataclass(frozen=True, eq=False)
class Ordered:
    """Coordinates along one projector axis with further results of the unwrapping.

    Parameters
    ----------
    coordinate_px : (row, col) float, px; NaN where the fringe order is unknown
    error : (row, col) float, probability of a wrong fringe order
    islands : (row, col) uint16, number of the island of continuous phase, 1 for the largest; 0:
        none
    """

    coordinate_px: FloatArray
    error: FloatArray
    islands: Labels


@dataclass(frozen=True, eq=False)
class Wrapped:
    """Wrapped phases and code words of one projector axis: the input of `PatternCode.unwrap`.

    Parameters
    ----------
    fringes : length of the axis and all fringe periods, px
    phase_rad : (period, row, col) float32 in [0, 2 pi); 0 where `usable` is False. The phase is
        2 pi x / period modulo 2 pi. Periods with a single image have no phase and are left out
    sigma_rad : (period, row, col) float32, standard deviation of each phase
    usable : (row, col) bool, pixels that have a phase along all axes
    words : the decoded integers (row, col) int64 of each code word
    nearest_sigmas : (row, col) float32, smallest distance of a bit from its threshold, divided by
        the standard deviation of that distance; infinite without code words
    levels, level_sigmas : (frame, row, col) float32, brightness of the frames of code words with
        several grey levels, 0 for black and 1 for white, and its standard deviation; empty without
    expected : coordinates that are known otherwise, for codes with relative orders; None: none
    """

    fringes: AxisFringes
    phase_rad: FloatImage
    sigma_rad: FloatImage
    usable: BoolImage
    words: tuple[IntArray, ...]
    nearest_sigmas: FloatImage
    levels: FloatImage
    level_sigmas: FloatImage
    expected: "Expected | None" = None

    @property
    def turns(self) -> FloatArray:
        """Phases as shares of a turn, (period, row, col) float64 in [0, 1)."""
        return np.asarray(self.phase_rad / (2.0 * np.pi), np.float64)

    def coordinate_px(self, order: IntArray | FloatArray) -> FloatArray:
        """Return measuring period * (order + phase / 2 pi), (row, col) float64, px."""
        return np.asarray(self.fringes.period_px * (order + self.turns[0]))


Unwrap = Callable[[Wrapped], FloatArray | Ordered]
"""Function that returns absolute coordinates, (row, col) float, px, from the wrapped phases.

It is called once for each projector axis. NaN marks pixels of unknown fringe order. Values of
pixels that are not `usable` are ignored. The standard deviation of the coordinate is computed from
that of the phase of the measuring period only.
"""


@dataclass(frozen=True)
class AxisFrames:
    """The recorded frames along one projector axis, from which their pattern code is identified.

    Parameters
    ----------
    length_px : projector pixels along the axis
    periods_px : fringe periods, increasing, those with several images first; () without fringes
    images : number of images of each fringe period
    words : for each code word its width in fringe periods, and whether the word is displaced by
        half a period
    """

    length_px: int
    periods_px: tuple[float, ...]
    images: tuple[int, ...]
    words: tuple[tuple[float, bool], ...]

    @property
    def is_unambiguous(self) -> bool:
        """Whether the longest period is at least the image length, up to a rounding error."""
        return max(self.periods_px, default=0.0) >= self.length_px * (1.0 - 1e-9)

    @property
    def has_single_images(self) -> bool:
        """Whether the first period has several images and each further one a single image."""
        return len(self.images) > 1 and self.images[0] > 1 and set(self.images[1:]) == {1}


class PatternCode:
    """Base class of the pattern codes, which number the fringes.

    A subclass sets `name`, `title` and `summary`, and overrides the methods that it needs.

    Attributes
    ----------
    name : value of the key `code` that selects the pattern code
    title : name in reports and documentation
    summary : one line of documentation, with the further periods that the code needs
    rule : rule by which the fringe order is decoded
    takes_further_periods : whether `further_periods_px` may be given
    has_free_words : whether code words may have another encoding than "reflected", and may be shown
        without fringes
    displacement : displacement of the code word in periods, in [0, 1); only for WORD_PER_PERIOD
    takes_response : whether the decoder can correct the response of the projector
    has_closed_form : whether the standard deviation of a coordinate follows from its phase only
    numbers_pixels : whether the fringe order of a pixel follows from its own frames
    """

    name: str
    title: str
    summary: str
    rule: Rule = Rule.OWN
    takes_further_periods: bool = False
    has_free_words: bool = False
    displacement: float = 0.0
    takes_response: bool = True
    has_closed_form: bool = True
    numbers_pixels: bool = True

    def has_levels(self, fringes: AxisFringes) -> bool:
        """Return True if a code word is shown by several grey levels."""
        return any(word.brightness is not None for word in self.words(fringes))

    def words(self, fringes: AxisFringes) -> tuple[CodeWord, ...]:
        """Return the code words along the axis that `fringes` describes; () if there are none."""
        return ()

    def images(self, number: int, steps: int) -> int:
        """Return the number of images, `steps` or 1, of the period with index `number`.

        Index 0 is the measuring period.
        """
        return steps

    def check(self, fringes: AxisFringes) -> None:
        """Raise InputError if these periods cannot number all fringes along the axis."""

    def chain(self, fringes: AxisFringes) -> Chain:
        """Return the levels of temporal phase unwrapping for fringes; only for Rule.CHAIN."""
        raise NotImplementedError(f"pattern code {self.name!r} has no chain of periods")

    def unwrap(self, wrapped: Wrapped) -> FloatArray | Ordered:
        """Return the absolute coordinates, (row, col) px; only for Rule.OWN, see `Unwrap`."""
        raise NotImplementedError(f"pattern code {self.name!r} has no function unwrap")

    def order_error(self, wrapped: Wrapped, coordinate_px: FloatArray) -> FloatArray:
        """Return the probability of a wrong fringe order, (row, col) float; only for Rule.OWN.

        Without an override the probability is 0, so that it masks no pixel.
        """
        return np.zeros(coordinate_px.shape)

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True if frames with this layout can only be of this code.

        A code that no layout identifies must be named in capture.toml.
        """
        return False


CODES: Registry[PatternCode] = Registry("codes", "reconstruction.codes", lambda code: code.name)


def code_of(name: object) -> PatternCode:
    """Return the pattern code with this name.

    Raises
    ------
    InputError : there is no code with this name; the message lists the allowed names
    """
    if not isinstance(name, str) or name not in CODES:
        raise InputError(f"patterns code is {name!r}; allowed are {', '.join(CODES.names())}")
    return CODES[name]
