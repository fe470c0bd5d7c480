"""Estimate black level, read noise and pixel differences from dark and flat frames.

The definitions are those of EMVA 1288 release 4. The spatial variance of the mean of L frames is
the variance between pixels plus 1 / L of the temporal variance of a pixel. In flat frames the slow
variation of light over the image is removed by a high-pass filter: the image minus its mean over
7 x 7 pixels. The filter preserves 1 - 1/49 of the variance of independent pixels.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from reconstruction.arrays import FloatArray, Stack
from reconstruction.characterise.photon_transfer import LEAST_VARIANCE_DN2, UncertainValue
from reconstruction.errors import InputError
from reconstruction.rig.sensor import QUANTISATION_DN2

LEAST_FRAMES = 2
MOST_PRNU = 0.1
"""Largest plausible photo response non-uniformity, standard deviation over mean.

Sensors have 0.2 to 3 %, frames of a textured surface have more.
"""
_MOST_SATURATED = 0.01
_BOX = 7
_PRESERVED = 1.0 - 1.0 / _BOX**2


@dataclass(frozen=True)
class Dark:
    """Properties of a camera that follow from frames without light, in DN.

    Attributes
    ----------
    black_level_dn : mean value of all pixels
    noise_dn : temporal standard deviation of a pixel, without the rounding noise; None: rounding
        dominates
    dsnu_dn : dark signal non-uniformity: standard deviation of the offset from pixel to pixel
    """

    black_level_dn: UncertainValue
    noise_dn: UncertainValue | None
    dsnu_dn: UncertainValue


def dark_of(frames: Stack) -> Dark:
    """Return black level, noise and offsets from dark frames, (frame, row, col) DN, at least two.

    Raises
    ------
    InputError : too few frames
    """
    _require(frames, "dark")
    temporal, spatial = _variances(frames, is_flat=False)
    is_ruled = temporal.value < LEAST_VARIANCE_DN2
    # If rounding dominates, every value is rounded to the same number: averaging does not reduce
    # the uncertainty of the level below that of the rounding.
    rounding = QUANTISATION_DN2 if is_ruled else 0.0
    sampling = (spatial.value + temporal.value / len(frames)) / float(frames[0].size)
    level = UncertainValue(
        float(frames.mean(dtype=np.float64)), float(np.sqrt(sampling + rounding))
    )
    # Largest error, over all levels, of Sheppard's 1/12 for the variance that rounding adds to a
    # normal distribution.
    variance = max(temporal.value - QUANTISATION_DN2, 0.0)
    rounding_error = np.exp(-2.0 * np.pi**2 * variance) * (4.0 * variance + 1.0 / np.pi**2)
    noise = _root(variance, float(np.hypot(temporal.uncertainty, rounding_error / np.sqrt(2.0))))
    return Dark(level, None if is_ruled else noise, _root_of(spatial))


def prnu_of(
    frames: Stack, black_level_dn: float, dsnu_dn: float = 0.0, clipped_from_dn: float = np.inf
) -> UncertainValue:
    """Return the photo response non-uniformity of a camera from uniformly lit ("flat") frames.

    It is the standard deviation of the pixels' response divided by the mean response.

    Parameters
    ----------
    frames : (frame, row, col) DN, at least two, of a bright and uniform surface out of focus
    black_level_dn : black level of the camera
    dsnu_dn : standard deviation of the dark offset from pixel to pixel, DN; its variance is
        subtracted
    clipped_from_dn : level, DN, from which a pixel may be saturated, see `SensorNoise`

    Raises
    ------
    InputError : too few frames, too little light, saturated pixels, or a result above `MOST_PRNU`
    """
    _require(frames, "flat")
    saturated = float(np.mean(frames >= clipped_from_dn))
    if saturated > _MOST_SATURATED:
        raise InputError(
            f"flat frames: {saturated:.1%} of the pixels are saturated (from {clipped_from_dn:.5g} "
            f"DN on), allowed {_MOST_SATURATED:.0%}; expose them to half of full scale"
        )
    above_dn = float(frames.mean(dtype=np.float64)) - black_level_dn
    if not above_dn > 10.0:
        raise InputError(f"flat frames are {above_dn:.3g} DN above black; light them evenly")
    _, spatial = _variances(frames, is_flat=True)
    share2 = max(spatial.value - dsnu_dn**2, 0.0) / above_dn**2
    prnu = _root(share2, spatial.uncertainty / above_dn**2)
    if prnu.value > MOST_PRNU:
        raise InputError(
            f"flat frames: pixels differ by {prnu.value:.1%} (standard deviation), allowed "
            f"{MOST_PRNU:.0%}; record an even surface, out of focus and evenly lit"
        )
    return prnu


def _require(frames: Stack, kind: str) -> None:
    if frames.ndim != 3 or len(frames) < LEAST_FRAMES:
        raise InputError(f"found {len(frames)} {kind} frames; give at least {LEAST_FRAMES}")


def _variances(frames: Stack, *, is_flat: bool) -> tuple[UncertainValue, UncertainValue]:
    """Return the temporal variance of a pixel and the variance between pixels, both DN^2."""
    count = len(frames)
    values = frames.astype(np.float64)
    # Removes the drift of the light from frame to frame, which is not noise of a pixel.
    values -= values.mean(axis=(1, 2), keepdims=True) - values.mean()
    temporal = values.var(axis=0, ddof=1)
    mean = values.mean(axis=0)
    around = _high_pass(mean) if is_flat else mean - mean.mean()
    preserved = _PRESERVED if is_flat else 1.0
    within = UncertainValue(float(temporal.mean()), float(temporal.std() / np.sqrt(temporal.size)))
    spread = float(np.mean(around**2)) / preserved
    spatial = max(spread - within.value / count, 0.0)
    sampling = spread * np.sqrt(2.0 / around.size)
    return within, UncertainValue(spatial, float(np.hypot(sampling, within.uncertainty / count)))


def _high_pass(image: FloatArray) -> FloatArray:
    smooth = uniform_filter(image, _BOX, mode="nearest")
    edge = _BOX // 2
    return np.asarray((image - smooth)[edge:-edge, edge:-edge])


def _root_of(variance: UncertainValue) -> UncertainValue:
    return _root(variance.value, variance.uncertainty)


def _root(variance: float, uncertainty: float) -> UncertainValue:
    """Return the root of a variance, with its standard uncertainty.

    If the uncertainty of the variance is at least as large as the variance, the uncertainty of the
    root is the square root of it.
    """
    root = float(np.sqrt(max(variance, 0.0)))
    if variance <= uncertainty:
        return UncertainValue(root, float(np.sqrt(uncertainty)))
    return UncertainValue(root, uncertainty / (2.0 * root))
