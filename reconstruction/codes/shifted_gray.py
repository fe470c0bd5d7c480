"""Shifted Gray code: two words, the second half a period after the first; they check each other.

Wu, Guo and Zhang, Opt. Express 27, 22631 (2019), both words in every set.
"""

import numpy as np

from reconstruction.codes import (
    CODES,
    AxisFrames,
    AxisFringes,
    CodeWord,
    PatternCode,
    Rule,
    period_word,
)


class ShiftedGrayCode(PatternCode):
    """k = floor(x / period), then s = floor(x / period + 1/2)."""

    name = "shifted_gray"
    title = "shifted Gray code"
    summary = "two words per period, the second displaced by half a period"
    rule = Rule.TWO_WORDS

    def words(self, fringes: AxisFringes) -> tuple[CodeWord, ...]:
        """Return the period index, and the displaced one with one value more if needed."""
        last = period_word(fringes, 0.5).at(np.array([fringes.length_px - 1]))
        return period_word(fringes), period_word(fringes, 0.5, int(last[0]).bit_length())

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True for two words as wide as a fringe, the second displaced."""
        return layout.words == ((1.0, False), (1.0, True))


CODES.register(ShiftedGrayCode())
