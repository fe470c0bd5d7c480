"""Displaced Gray code: only the second word of the shifted Gray code.

It has as many bits as number the periods; with 2^bits periods the last half period repeats the word
before it.
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
    """s = floor(x / period + 1/2)."""

    name = "displaced_gray"
    title = "Gray code displaced by half a period"
    summary = "one word per period, displaced by half a period"
    rule = Rule.WORD_PER_PERIOD
    displacement = 0.5

    def words(self, fringes: AxisFringes) -> tuple[CodeWord, ...]:
        """Return the displaced period index."""
        return (period_word(fringes, self.displacement),)

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True for one displaced word as wide as a fringe."""
        return layout.words == ((1.0, True),) and layout.periods_px != ()


CODES.register(DisplacedGrayCode())
