"""Pattern codes: how fringes are numbered. One kind per module, registered in `CODES`.

A kind defines the projected words and further periods, and how the fringe order is decoded: either
by one of the compiled rules (`Rule`), or by its own `unwrap` in numpy. Minimal example:

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


class Rule(Enum):
    """Compiled rules for the fringe order; coordinates are px, phases in [0, 2 pi)."""

    WORD_PER_PERIOD = auto()
    """The word changes where the phase is 0 (at `displacement`: minus that share of a turn)."""
    WORD_PER_HALF_PERIOD = auto()
    """The word changes where the phase is 0 and pi."""
    TWO_WORDS = auto()
    """The first word changes where the phase is 0, the second where it is pi."""
    CHAIN = auto()
    """Phases of several periods, coarse to fine; all of them are averaged. See `Chain`."""
    SINGLE_IMAGES = auto()
    """N steps of the first period, a single image of each further one."""
    OWN = auto()
    """The kind's own `unwrap`."""


@dataclass(frozen=True)
class AxisFringes:
    """The fringes along one projector axis.

    Parameters
    ----------
    length_px : projector pixels along the axis
    periods_px : all periods, the measuring one first; without fringes the width of one word
    """

    length_px: int
    periods_px: tuple[float, ...]

    @property
    def period_px(self) -> float:
        """The measuring period."""
        return self.periods_px[0]

    @property
    def bits(self) -> int:
        """Number of bits that number all periods of the image."""
        return (math.ceil(self.length_px / self.period_px) - 1).bit_length()


@dataclass(frozen=True)
class CodeWord:
    """A number that is shown as bits, one frame each.

    Parameters
    ----------
    bits : number of frames, the most significant bit first
    at : values (n,) int64 at projector pixels (n,) int64
    """

    bits: int
    at: Callable[[IntArray], IntArray]

    def count(self, length_px: int) -> int:
        """Return the number of different values in an image of this length."""
        last = int(self.at(np.array([length_px - 1]))[0])
        return int(min(last + 1, 2**self.bits))


def period_word(
    fringes: AxisFringes, displacement: float = 0.0, bits: int | None = None
) -> CodeWord:
    """Return the word floor(x / period + displacement)."""

    def at(x_px: IntArray) -> IntArray:
        return np.floor(x_px / fringes.period_px + displacement).astype(np.int64)

    return CodeWord(fringes.bits if bits is None else bits, at)


@dataclass(frozen=True, eq=False)
class Wrapped:
    """Wrapped phases and words of one projector axis, before the fringes are numbered.

    Parameters
    ----------
    fringes : length of the axis and all periods, px
    phase_rad : (period, row, col) float32 in [0, 2 pi); 0 where `usable` is False. The phase is
        2 pi x / period modulo 2 pi. Periods with a single image have none
    sigma_rad : (period, row, col) float32, standard deviation of each phase
    usable : (row, col) bool, pixels that have a phase along all axes
    words : for each word of the code its decoded values (row, col) int64
    nearest_sigmas : (row, col) float32, smallest distance of a bit from its threshold in standard
        deviations of that distance; infinite without words
    """

    fringes: AxisFringes
    phase_rad: FloatImage
    sigma_rad: FloatImage
    usable: BoolImage
    words: tuple[IntArray, ...]
    nearest_sigmas: FloatImage

    @property
    def turns(self) -> FloatArray:
        """Phases as shares of a turn, (period, row, col) float64 in [0, 1)."""
        return np.asarray(self.phase_rad / (2.0 * np.pi), np.float64)

    def coordinate_px(self, order: IntArray | FloatArray) -> FloatArray:
        """Return (order + phase / 2 pi) period of the measuring period, (row, col) float64."""
        return np.asarray(self.fringes.period_px * (order + self.turns[0]))


Unwrap = Callable[[Wrapped], FloatArray]
"""Function from the wrapped phases of one axis to absolute coordinates, (row, col) float, px.

NaN marks pixels whose fringe order is unknown. Values of pixels that are not `usable` are ignored.
The standard deviation of the coordinate is that of the measuring period's phase.
"""


@dataclass(frozen=True)
class AxisFrames:
    """Content of a list of recorded frames along one axis.

    Parameters
    ----------
    length_px : projector pixels along the axis
    periods_px : of the fringes, increasing, periods with several images first; () without fringes
    images : number of images of each period
    words : of each word its width in fringe periods, and whether it is displaced by half a period
    """

    length_px: int
    periods_px: tuple[float, ...]
    images: tuple[int, ...]
    words: tuple[tuple[float, bool], ...]

    @property
    def is_unambiguous(self) -> bool:
        """Whether one period spans the image; periods may miss its length by rounding."""
        return max(self.periods_px, default=0.0) >= self.length_px * (1.0 - 1e-9)

    @property
    def has_single_images(self) -> bool:
        """Whether the first period has several images and each further one a single image."""
        return len(self.images) > 1 and self.images[0] > 1 and set(self.images[1:]) == {1}


class PatternCode:
    """A code that numbers fringes. A kind sets `name`, `title`, `summary` and its own methods.

    Attributes
    ----------
    name : value of the key `code`
    title : name in reports and documentation
    summary : one line of documentation, with the further periods that the kind needs
    rule : how the order is decoded
    takes_further_periods : whether `further_periods_px` may be given
    has_free_words : whether words may be shown in encodings except reflected, or without fringes
    displacement : of the words, in periods, in [0, 1); for WORD_PER_PERIOD
    takes_response : whether the projector's response can be corrected
    has_closed_form : whether the standard deviation of a coordinate follows from its phase only
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

    def words(self, fringes: AxisFringes) -> tuple[CodeWord, ...]:
        """Return the words along an axis; () without any."""
        return ()

    def images(self, number: int, steps: int) -> int:
        """Return the number of images, `steps` or 1, of period `number`; 0: measuring period."""
        return steps

    def check(self, fringes: AxisFringes) -> None:
        """Raise InputError, one line, if these periods cannot number the fringes of this length."""

    def chain(self, fringes: AxisFringes) -> Chain:
        """Return the levels of Rule.CHAIN."""
        raise NotImplementedError(f"pattern code {self.name!r} has no chain of periods")

    def unwrap(self, wrapped: Wrapped) -> FloatArray:
        """Return the absolute coordinates of Rule.OWN, see `Unwrap`."""
        raise NotImplementedError(f"pattern code {self.name!r} has no function unwrap")

    def order_error(self, wrapped: Wrapped, coordinate_px: FloatArray) -> FloatArray:
        """Return the probability that the order of Rule.OWN is wrong, (row, col) float.

        A kind that does not override it reports probability 0, so no pixel is masked for it.
        """
        return np.zeros(coordinate_px.shape)

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Whether frames with this layout identify this code; if not, capture.toml must name it."""
        return False


CODES: Registry[PatternCode] = Registry("codes", "reconstruction.codes", lambda code: code.name)


def code_of(name: object) -> PatternCode:
    """Return the code of a name.

    Raises
    ------
    InputError : there is no such code; the message lists the allowed ones
    """
    if not isinstance(name, str) or name not in CODES:
        raise InputError(f"patterns code is {name!r}; allowed are {', '.join(CODES.names())}")
    return CODES[name]
