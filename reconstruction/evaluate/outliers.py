"""Which residuals are too large to be noise."""

import numpy as np

from reconstruction.arrays import BoolImage, Doubles

# 1.4826 MAD estimates the standard deviation of a normal distribution.
MAD_TO_SIGMA = 1.4826
REJECT_BEYOND_SIGMAS = 4.0
"""One of 16,000 normal residuals lies beyond."""


def spread(residuals_mm: Doubles) -> float:
    """Robust standard deviation of residuals, (n,) mm."""
    return float(MAD_TO_SIGMA * np.median(np.abs(residuals_mm - np.median(residuals_mm))))


def inliers(residuals_mm: Doubles) -> BoolImage:
    """Tell which residuals, (n,) mm, lie within four robust standard deviations of their median."""
    limit = REJECT_BEYOND_SIGMAS * max(spread(residuals_mm), 1e-12)
    kept: BoolImage = np.abs(residuals_mm - np.median(residuals_mm)) <= limit
    return kept
