"""Complementary Gray code: one code word per half period, with one bit more than the periods need.

Zhang et al., Opt. Lasers Eng. 50, 574 (2012).
"""

import numpy as np

from reconstruction.arrays import IntArray
from reconstruction.codes import CODES, AxisFrames, AxisFringes, CodeWord, PatternCode, Rule


class ComplementaryGrayCode(PatternCode):
    """Pattern code with one code word, the half-period index h = floor(2 x / period)."""

    name = "complementary_gray"
    title = "complementary Gray code"
    summary = "one word per half period, safe at the borders of the periods"
    rule = Rule.WORD_PER_HALF_PERIOD

    def words(self, fringes: AxisFringes) -> tuple[CodeWord, ...]:
        """Return the half-period index as the only code word."""

        def half_periods(x_px: IntArray) -> IntArray:
            return np.floor(2 * x_px / fringes.period_px).astype(np.int64)

        return (CodeWord(fringes.bits + 1, half_periods),)

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True if the frames show one code word, half a fringe period wide."""
        return layout.words == ((0.5, False),)


CODES.register(ComplementaryGrayCode())
