"""Shifted Gray code: two code words, displaced by half a period, which check each other.

Source: Wu, Guo and Zhang, Opt. Express 27, 22631 (2019). Here every pattern set has both words.
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
    """Pattern code with two code words: k = floor(x / period) and s = floor(x / period + 1/2)."""

    name = "shifted_gray"
    title = "shifted Gray code"
    summary = "two words per period, the second displaced by half a period"
    rule = Rule.TWO_WORDS

    def words(self, fringes: AxisFringes) -> tuple[CodeWord, ...]:
        """Return the period index and the displaced period index.

        The second code word has one bit more if its last value needs that bit.
        """
        last = period_word(fringes, 0.5).at(np.array([fringes.length_px - 1]))
        return period_word(fringes), period_word(fringes, 0.5, int(last[0]).bit_length())

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True if the frames show two code words of which only the second is displaced.

        Each value of both code words must be one fringe period wide.
        """
        return layout.words == ((1.0, False), (1.0, True))


CODES.register(ShiftedGrayCode())
