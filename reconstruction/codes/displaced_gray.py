"""Displaced Gray code: only the second code word of the shifted Gray code.

The number of bits is that needed to number the periods. If there are exactly 2^bits periods, the
last half period has the same bits as the code word before it.
"""

from reconstruction.codes import (
    CODES,
    AxisFrames,
    AxisFringes,
    CodeWord,
    PatternCode,
    Rule,
    period_word,
)


class DisplacedGrayCode(PatternCode):
    """Pattern code with one code word, the displaced period index s = floor(x / period + 1/2)."""

    name = "displaced_gray"
    title = "Gray code displaced by half a period"
    summary = "one word per period, displaced by half a period"
    rule = Rule.WORD_PER_PERIOD
    displacement = 0.5

    def words(self, fringes: AxisFringes) -> tuple[CodeWord, ...]:
        """Return the period index, displaced by half a period, as the only code word."""
        return (period_word(fringes, self.displacement),)

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True if the frames show fringes and a single code word that is displaced.

        Each value of the code word must be one fringe period wide.
        """
        return layout.words == ((1.0, True),) and layout.periods_px != ()


CODES.register(DisplacedGrayCode())
