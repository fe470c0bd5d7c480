"""Micro phase shifting: N steps of one period and a single image of each of several near periods.

All periods are so similar that mean and modulation are the same in all images; the order is that
for which the single images agree. Gupta and Nayar, Proc. CVPR 2012, 813.
"""

import math
from functools import lru_cache

import numpy as np

from reconstruction.codes import CODES, AxisFrames, AxisFringes, PatternCode, Rule
from reconstruction.errors import InputError

# Difference of two fringes in the single images, root of the sum of squares, relative to the
# modulation. Below it no camera distinguishes them.
LEAST_DISTANCE = 0.02
_NODES_PER_PERIOD = 16


class MicroCode(PatternCode):
    """The single images decide among the fringes of the first period."""

    name = "micro"
    title = "single images with periods"
    summary = "further_periods_px: two or more periods near period_px, a single image of each"
    rule = Rule.SINGLE_IMAGES
    takes_further_periods = True
    takes_response = False
    has_closed_form = False

    def images(self, number: int, steps: int) -> int:
        """Return `steps` if `number` is 0, the measuring period; 1 for any further period."""
        return 1 if number else steps

    def check(self, fringes: AxisFringes) -> None:
        """Raise InputError unless the single images distinguish all fringes of the image."""
        periods_px, length_px = fringes.periods_px, fringes.length_px
        if len(periods_px) < 3:
            raise InputError(
                f"patterns micro has {len(periods_px)} periods; give two or more further_periods_px"
            )
        least = least_distance(periods_px, length_px)
        if least < LEAST_DISTANCE:
            raise InputError(
                f"patterns periods {periods_px} px: two fringes within {length_px} px differ by"
                f" only {least:.2g} of the modulation, needed is {LEAST_DISTANCE:g}; change"
                " further_periods_px"
            )

    def is_shown_by(self, layout: AxisFrames) -> bool:
        """Return True for several steps of one period and a single image of the others."""
        return not layout.words and layout.has_single_images


@lru_cache
def least_distance(periods_px: tuple[float, ...], length_px: int) -> float:
    """Return the smallest difference of two fringes in the single images, of the modulation.

    At equal phase; root of the sum of squares over the images.
    """
    fringes = np.arange(math.ceil(length_px / periods_px[0]))
    least = np.inf
    for phase in np.arange(_NODES_PER_PERIOD) / _NODES_PER_PERIOD:
        x_px = periods_px[0] * (phase + fringes[:, None])
        shown = np.cos(2.0 * np.pi * x_px / np.array(periods_px[1:]))
        squared = np.square(shown[:, None] - shown).sum(axis=-1)
        least = min(least, float(squared[np.triu_indices(len(fringes), 1)].min(initial=np.inf)))
    return math.sqrt(least)


CODES.register(MicroCode())
