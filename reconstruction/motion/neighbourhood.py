"""Phase rate and error of every pixel by motion, from the residuals of its neighbourhood.

The residuals of a single pixel determine its phase rate badly: with four steps not at all at some
phases. The rate changes slowly over a surface, so that the Gauss-Newton step of a pixel is the mean
over a Gaussian window, with the information 1 / sigma^2 of each pixel's own step as weights. The
information of four steps has two periods per fringe, and the standard deviation of the window, a
quarter of a fringe in the camera image, reduces this change to 1 %.

With the rate e, the phase phi in the middle of the set follows by least squares, and from both the
error arg(P + Q exp(-2 i phi)) of the decoded phase (`phase_rate`). Light that drifts linearly has
residuals that are orthogonal to those of motion over a whole fringe of four steps.
"""

import math
from collections.abc import Iterator

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, Stack
from reconstruction.decoding import AxisDecode, Decoded
from reconstruction.errors import InputError
from reconstruction.motion.phase_rate import (
    LARGEST_CHANGE,
    TURN,
    PhaseSteps,
    PixelMotion,
    fit_at_rate,
    phase_error,
    steps_of,
)
from reconstruction.patterns import Axis, PatternSet
from reconstruction.rig.sensor import SensorNoise

LEAST_STEPS = 4
_ITERATIONS = 3
_WINDOW_FRINGES, _WINDOW_RANGE_PX = 0.25, (1.0, 64.0)
# Pixels that are fitted at a time: about 50 MB for 18 steps.
_BAND_PIXELS = 1 << 16


def motion_nearby(
    stack: Stack, patterns: PatternSet, decoded: Decoded, sensor: SensorNoise, axis: Axis = "column"
) -> PixelMotion:
    """Return rate and error of every pixel along one projector axis, from its neighbourhood.

    The rate is the mean over the window, and `sigma_rad` its standard deviation by the noise of the
    camera. All fields of masked pixels are 0.

    Parameters
    ----------
    stack, patterns, sensor : as in `decode`
    decoded : result of decoding `stack`

    Raises
    ------
    InputError : fewer than four phase steps along the axis
    """
    steps, valid = steps_of(patterns, axis), decoded.valid
    if steps.weights.size < LEAST_STEPS:
        raise InputError(
            f"patterns steps is {steps.weights.size}: motion leaves no residual; needed are"
            f" {LEAST_STEPS} or more"
        )
    maps = decoded.row if axis == "row" else decoded.column
    frames = stack[patterns.step_sets(axis)[0]]
    noise_dn2 = sensor.variance_dn2(maps.mean_dn[valid].astype(np.float64))
    window_px = _window_px(maps, valid, patterns.period_along(axis))
    rate_rad, weights = np.zeros(valid.shape), np.zeros(valid.shape)
    for _ in range(_ITERATIONS):
        _, change_rad, sigma_share = _fitted(frames[:, valid], steps, rate_rad[valid])
        weights[valid] = 1.0 / (np.square(sigma_share) * noise_dn2)
        # The mean of the whole rates: a mean of the changes would sharpen with every iteration.
        better_rad = _nearby(rate_rad[valid] + change_rad, weights, valid, window_px)
        rate_rad += np.clip(better_rad - rate_rad, -LARGEST_CHANGE, LARGEST_CHANGE)
    phase_rad, _, _ = _fitted(frames[:, valid], steps, rate_rad[valid])
    error_px = np.zeros(valid.shape)
    per_rad = patterns.period_along(axis) / TURN
    error_px[valid] = per_rad * phase_error(phase_rad, rate_rad[valid], steps)
    return PixelMotion(rate_rad * valid, _sigma_nearby(weights, window_px) * valid, error_px)


def _fitted(
    frames: Stack, steps: PhaseSteps, rate_rad: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return phase, change of the rate and its sigma for 1 DN of pixels (pixel,), band by band."""
    fits = [
        fit_at_rate(frames[:, band].astype(np.float64), steps, rate_rad[band])
        for band in _bands(len(rate_rad))
    ]
    phase_rad, change_rad, sigma_share = (
        np.concatenate(parts) for parts in zip(*fits, strict=True)
    )
    return phase_rad, change_rad, sigma_share


def _bands(count: int) -> Iterator[slice]:
    for first in range(0, max(count, 1), _BAND_PIXELS):
        yield slice(first, first + _BAND_PIXELS)


def _window_px(maps: AxisDecode, valid: BoolImage, period_px: float) -> float:
    """Return the standard deviation of the window: a quarter of the median fringe in the image."""
    slopes = [
        np.abs(np.diff(maps.coordinate_px, axis=along))[_both(valid, along)] for along in (0, 1)
    ]
    medians = [float(np.median(slope)) if slope.size else 0.0 for slope in slopes]
    per_px = max(math.hypot(*medians), 1e-9)
    return float(np.clip(_WINDOW_FRINGES * period_px / per_px, *_WINDOW_RANGE_PX))


def _both(valid: BoolImage, along: int) -> BoolImage:
    """Return where two neighbours along an image axis are valid."""
    return valid[1:] & valid[:-1] if along == 0 else valid[:, 1:] & valid[:, :-1]


def _nearby(
    values: FloatArray, weights: FloatArray, valid: BoolImage, window_px: float
) -> FloatArray:
    """Return the weighted mean of the values of valid pixels over the window, (row, col)."""
    weighted = np.zeros(valid.shape)
    weighted[valid] = values * weights[valid]
    total = _blurred(weights, window_px)
    return np.divide(_blurred(weighted, window_px), total, out=weighted, where=total > 0.0)


def _sigma_nearby(weights: FloatArray, window_px: float) -> FloatArray:
    """Return the standard deviation of the weighted mean: sqrt(sum k^2 w) / sum k w.

    The square of a Gaussian window of deviation s is a Gaussian of s / sqrt(2), divided by
    4 pi s^2.
    """
    squares = _blurred(weights, window_px / np.sqrt(2.0)) / (4.0 * np.pi * window_px**2)
    total = _blurred(weights, window_px)
    return np.divide(np.sqrt(squares), total, out=np.zeros_like(total), where=total > 0.0)


def _blurred(image: FloatArray, window_px: float) -> FloatArray:
    from scipy import ndimage  # only a prediction needs it

    return np.asarray(ndimage.gaussian_filter(image, window_px, mode="constant"))
