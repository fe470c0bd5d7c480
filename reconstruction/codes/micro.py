"""Micro phase shifting: N steps of one period, and single images of several similar periods.

The periods are so similar that the mean and the modulation of a pixel are equal in all images. The
fringe order is the one that predicts the single images best. Source: Gupta and Nayar, Proc. CVPR
2012, 813.
"""

import math
from functools import lru_cache

import numpy as np

from reconstruction.codes import CODES, AxisFrames, AxisFringes, PatternCode, Rule
from reconstruction.errors import InputError

# Least allowed value of `least_distance`. No camera distinguishes two fringes with a smaller one.
LEAST_DISTANCE = 0.02
_NODES_PER_PERIOD = 16


class MicroCode(PatternCode):
    """Pattern code in which the single images select the fringe of the measuring period."""

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
        """Return True if one period has several images and each other period one, without words."""
        return not layout.words and layout.has_single_images


@lru_cache
def least_distance(periods_px: tuple[float, ...], length_px: int) -> float:
    """Return the smallest difference between two fringes in the single images.

    The difference is that of two points of equal phase in the measuring period: the root of the sum
    of its squares over the single images, divided by the modulation.
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
