"""Hierarchical periods: the phase of each coarser period numbers the fringes of the next finer one.

Source: Zuo et al., Opt. Lasers Eng. 85, 84 (2016).
"""

from reconstruction.codes import CODES, AxisFrames, AxisFringes, PatternCode, Rule
from reconstruction.errors import InputError
from reconstruction.several_periods import Chain, make_chain, require_range


class HierarchicalCode(PatternCode):
    """Pattern code that unwraps from the longest fringe period to the shortest."""

    name = "hierarchical"
    title = "hierarchical periods"
    summary = "further_periods_px: any coarser periods, the coarsest at least the image"
    rule = Rule.CHAIN
    takes_further_periods = True

    def check(self, fringes: AxisFringes) -> None:
        """Raise InputError unless the longest period is at least the image length."""
        require_range(self.chain(fringes), fringes.periods_px, fringes.length_px)

    def chain(self, fringes: AxisFringes) -> Chain:
        """Return one level per fringe period, from the longest to the shortest."""
        periods_px = fringes.periods_px
        order = sorted(range(len(periods_px)), key=lambda j: -periods_px[j])
        if order[-1] != 0 or len(set(periods_px)) != len(periods_px):
            raise InputError(
                f"patterns periods {periods_px} px: hierarchical needs period_px below all of"
                " further_periods_px, and no period twice"
            )
        weights = tuple(tuple(int(j == k) for k in range(len(periods_px))) for j in order)
        return make_chain(weights, periods_px)

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True if the frames show fringes, no code words and no single images.

        The longest period must be at least the image length.
        """
        return not layout.words and not layout.has_single_images and layout.is_unambiguous


CODES.register(HierarchicalCode())
