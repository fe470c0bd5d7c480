"""The Gaussian that acts on the complex phasor: shift-free weights and their noise gain."""

import numpy as np

from reconstruction.arrays import FloatImage


def gaussian_weights(taps: int, sigma_px: float) -> FloatImage:
    """Return symmetric weights of odd length that sum to 1; `taps` 0 gives the identity.

    An even kernel has no centre tap: anchored at either middle tap it shifts the image by half a
    pixel. The mean of both anchors has one tap more and no shift.
    """
    if taps == 0:
        return np.ones(1, np.float32)
    offsets = np.arange(taps) - 0.5 * (taps - 1)
    weights = np.exp(-0.5 * (offsets / sigma_px) ** 2)
    if taps % 2 == 0:
        weights = np.append(weights, 0.0) + np.insert(weights, 0, 0.0)
    normalised: FloatImage = (weights / weights.sum()).astype(np.float32)
    return normalised


def noise_gain(weights: FloatImage) -> float:
    """Return the factor on the sigma of white noise when `weights` act along rows and columns."""
    # Separable: the 2-D sum of squares is the square of the 1-D one.
    return float(np.sum(weights.astype(np.float64) ** 2))
