"""Heterodyne periods: the beats of two or three similar fringe periods number the fringes.

Source: Zuo et al., Opt. Lasers Eng. 85, 84 (2016), there called "multi-wavelength".
"""

from reconstruction.codes import CODES, AxisFrames, AxisFringes, PatternCode, Rule
from reconstruction.errors import InputError
from reconstruction.several_periods import Chain, make_chain, require_range

# By the number of periods: weights c_ij of the beats of two or three similar periods, and of the
# measuring period, which is the first.
BEATS = {2: ((1, -1), (1, 0)), 3: ((1, -2, 1), (1, -1, 0), (1, 0, 0))}


class HeterodyneCode(PatternCode):
    """Pattern code that unwraps from the longest beat period to the measuring period."""

    name = "heterodyne"
    title = "heterodyne periods"
    summary = "further_periods_px: one or two periods slightly above period_px, rising"
    rule = Rule.CHAIN
    takes_further_periods = True

    def check(self, fringes: AxisFringes) -> None:
        """Raise InputError unless the longest beat period is at least the image length."""
        require_range(self.chain(fringes), fringes.periods_px, fringes.length_px)

    def chain(self, fringes: AxisFringes) -> Chain:
        """Return one level per beat, coarse to fine, then the level of the measuring period."""
        count = len(fringes.periods_px)
        if count not in BEATS:
            raise InputError(
                f"patterns heterodyne has {count} periods; give one or two further_periods_px"
            )
        return make_chain(BEATS[count], fringes.periods_px)

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True if the frames show several periods, no code words, no single images.

        No period may be as long as the image.
        """
        several = len(layout.periods_px) > 1 and not layout.has_single_images
        return not layout.words and several and not layout.is_unambiguous


CODES.register(HeterodyneCode())
