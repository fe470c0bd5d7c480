"""Hierarchical periods: each coarser period numbers the next finer one.

Zuo et al., Opt. Lasers Eng. 85, 84 (2016).
"""

from reconstruction.codes import CODES, AxisFrames, AxisFringes, PatternCode, Rule
from reconstruction.errors import InputError
from reconstruction.several_periods import Chain, make_chain, require_range


class HierarchicalCode(PatternCode):
    """Levels are the periods themselves, coarse to fine."""

    name = "hierarchical"
    title = "hierarchical periods"
    summary = "further_periods_px: any coarser periods, the coarsest at least the image"
    rule = Rule.CHAIN
    takes_further_periods = True

    def check(self, fringes: AxisFringes) -> None:
        """Raise InputError unless the coarsest period spans the image."""
        require_range(self.chain(fringes), fringes.periods_px, fringes.length_px)

    def chain(self, fringes: AxisFringes) -> Chain:
        """Return one level per period."""
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
        """Return True for periods without words, the coarsest at least the image."""
        return not layout.words and not layout.has_single_images and layout.is_unambiguous


CODES.register(HierarchicalCode())
