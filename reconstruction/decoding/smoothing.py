"""The filter on the projector coordinate: a Gaussian that gives back what it takes from relief.

On a plane a Gaussian G changes nothing but the noise. On relief the coordinate x loses the lift
l = G x - x, of which the coarse part c = G l holds curvature, and the fine part f = l - c texture
and edges. Both are seen in the data together with noise of known variance n; with E the mean square
of a part over 17 x 17 pixels, the share w = max(0, 1 - t n / E) of it is relief and is given back
(a Wiener estimate): x + (1 - w_c) c + (1 - w_f) f. Where nothing stands out of the noise that is
G x, on strong relief x itself. What stays of the relief, (1 - w)^2 w E, is part of sigma.

Compared with a Gaussian on the complex phasor nothing is lost by the turning of the phase within
the window, and a pixel that is brighter than its neighbours draws the mean to itself no more.
"""

import numpy as np
from scipy.signal import convolve2d

from reconstruction._jit import run_over_rows
from reconstruction.arrays import FloatImage
from reconstruction.decoding._filter import Smoothed, Unfiltered, mark_edges, smooth_rows
from reconstruction.decoding._half import BIAS
from reconstruction.decoding._lift import Smoothing

# The 20 rows on either side of a band are smoothed twice; fewer bands would leave cores idle.
BAND_ROWS = 128


def smooth(
    source: Unfiltered, taps: int, sigma_px: float, limit_px: float, unit_px: float
) -> Smoothed:
    """Return the filtered coordinates, their sigmas and the share of bias in the variance.

    A pixel beside one without light may lie half beyond the edge of what is lit: such a one takes
    no part and is masked EDGE.

    Parameters
    ----------
    source : what was decoded pixel by pixel
    taps, sigma_px : the Gaussian
    limit_px : a pair of pixels whose mean is off by more than half of this is left out
    unit_px : of packed sigmas
    """
    target = Smoothed(
        np.zeros(source.coordinate_px.shape, np.float32),
        np.zeros(source.sigma.shape, np.uint16),
        np.zeros(source.sigma.shape, np.uint8),
        np.zeros(source.reason.shape, np.uint8),
    )
    smoothing = make_smoothing(gaussian_weights(taps, sigma_px), limit_px, unit_px)
    rows = source.reason.shape[0]
    run_over_rows(mark_edges, rows, source.reason, target.reason, band_rows=BAND_ROWS)
    lit = source._replace(reason=target.reason)
    run_over_rows(smooth_rows, rows, lit, smoothing, target, band_rows=BAND_ROWS)
    return target


def make_smoothing(weights: FloatImage, limit_px: float, unit_px: float) -> Smoothing:
    """Return the kernel and the noise that it leaves in each part, see `Smoothing`."""
    gauss = np.outer(weights, weights).astype(np.float64)
    whole = np.pad(gauss, gauss.shape[0] // 2)
    lift = whole.copy()
    lift[lift.shape[0] // 2, lift.shape[1] // 2] -= 1.0
    inner = np.s_[gauss.shape[0] // 2 : -(gauss.shape[0] // 2)] if gauss.size > 1 else np.s_[:]
    coarse = convolve2d(lift[inner, inner], gauss)
    parts = np.stack([whole, coarse, lift - coarse])
    middle = parts.shape[1] // 2
    return Smoothing(
        weights,
        np.einsum("aij,bij->ab", parts, parts).astype(np.float32),
        parts[:, middle, middle].astype(np.float32),
        np.float32(limit_px),
        np.float32(unit_px / BIAS),
        np.float32(BIAS / unit_px),
    )


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
