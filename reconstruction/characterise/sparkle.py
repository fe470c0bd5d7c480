"""Estimate the local contrast of a coat from a white frame, without the camera's noise.

Mirror-like flakes, the grain of the coat and differences in response make a white frame uneven from
pixel to pixel. Slow variations over the image (form, light, lens) are removed by a high-pass
filter: the image minus its mean over 7 x 7 pixels. The filter preserves 48/49 of the variance of
independent pixels, and less of the variance of coarser grain. Contrasts are relative to the local
mean above the black level.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError
from reconstruction.rig.sensor import SensorNoise

_BOX = 7
_PRESERVED = 1.0 - 1.0 / _BOX**2
# Magnitude of the negative covariance of adjacent independent pixels after the high-pass filter.
_OWN = 2.0 / _BOX**2 - (_BOX - 1.0) / _BOX**3
_LEAST_PIXELS = 1000
_FAR = 4.0
# Least ratio of a variance to its standard uncertainty at which it is significant.
_SIGNIFICANT = 3.0


@dataclass(frozen=True)
class Sparkle:
    """Local contrast of a coat in uniform light.

    Attributes
    ----------
    contrast : standard deviation from pixel to pixel, without the camera's noise, divided by the
        local mean; 0 if noise explains all of the variation
    uncertainty : standard uncertainty of the contrast, from the number of pixels
    neighbours : correlation between horizontally adjacent pixels, without the camera's noise. It is
        0 for single flakes and differences in pixel response, up to 1 for coarse grain. None: the
        contrast is not significant
    glints : share of pixels above the local mean by more than four standard deviations; 3e-5 for a
        normal distribution
    """

    contrast: float
    uncertainty: float
    neighbours: float | None
    glints: float


def sparkle_of(white: NDArray[Any], sensor: SensorNoise, lit: BoolImage) -> Sparkle:
    """Return the local contrast of a coat in a white frame.

    Parameters
    ----------
    white : (row, col) white frame, DN
    sensor : black level and noise of the camera
    lit : (row, col) bool, True at illuminated pixels of the coat

    Raises
    ------
    InputError : too few pixels whose 7 x 7 surroundings are all lit and not clipped
    """
    image = np.asarray(white, np.float64)
    usable = lit & (image < sensor.clipped_from_dn)
    inside = uniform_filter(usable.astype(np.float64), _BOX) > 1.0 - 0.5 / _BOX**2
    if np.count_nonzero(inside) < _LEAST_PIXELS:
        raise InputError(
            f"white frame: {np.count_nonzero(inside)} pixels have lit surroundings; the coat's "
            f"contrast needs {_LEAST_PIXELS}"
        )
    level = uniform_filter(image, _BOX)
    above = np.maximum(level - sensor.black_level_dn, 1.0)
    rest = (image - level) / above
    noise2 = sensor.variance_dn2(level) / above**2
    square = rest[inside] ** 2 / _PRESERVED
    variance = float(square.mean() - noise2[inside].mean())
    spread = float(square.std() / np.sqrt(square.size))
    contrast = float(np.sqrt(max(variance, 0.0)))
    return Sparkle(
        contrast,
        spread / (2.0 * max(contrast, np.sqrt(spread))),
        _neighbours(rest, inside) / variance if variance > _SIGNIFICANT * spread else None,
        float(np.mean(rest[inside] > _FAR * np.sqrt(square.mean()))),
    )


def _neighbours(rest: FloatArray, inside: BoolImage) -> float:
    """Return the covariance of adjacent pixels, corrected for that which the high-pass makes.

    Parameters
    ----------
    rest : (row, col) relative deviation from the local mean
    inside : (row, col) bool, pixels to use
    """
    both = inside[:, 1:] & inside[:, :-1]
    product = float((rest[:, 1:] * rest[:, :-1])[both].mean())
    return product + _OWN * float(np.square(rest[inside]).mean()) / _PRESERVED
