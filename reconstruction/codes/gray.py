"""Plain Gray code: one code word per period, which changes where the phase wraps."""

from reconstruction.codes import (
    CODES,
    AxisFrames,
    AxisFringes,
    CodeWord,
    PatternCode,
    Rule,
    period_word,
)


class GrayCode(PatternCode):
    """Pattern code with one code word, the period index k = floor(x / period)."""

    name = "gray"
    title = "Gray code"
    summary = "one word per period; the only code with other words, or without fringes (steps = 0)"
    rule = Rule.WORD_PER_PERIOD
    has_free_words = True

    def words(self, fringes: AxisFringes) -> tuple[CodeWord, ...]:
        """Return the period index as the only code word."""
        return (period_word(fringes),)

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True if the frames show one code word, one fringe period wide, not displaced."""
        return layout.words == ((1.0, False),)


CODES.register(GrayCode())
