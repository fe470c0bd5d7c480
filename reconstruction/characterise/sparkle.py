"""Local contrast of a coat: of a white frame, without the camera's noise.

Mirror-like flakes, grain of the coat and differing response of pixels make a white frame
uneven from pixel to pixel. Slow changes (form, light, lens) are removed by a high-pass, the image
minus its mean over 7 x 7 pixels, which preserves 48/49 of the variance of independent pixels; of
coarser grain it removes more. Shares are of the local mean above black.
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
# Negative covariance that the high-pass gives to independent neighbours.
_OWN = 2.0 / _BOX**2 - (_BOX - 1.0) / _BOX**3
_LEAST_PIXELS = 1000
_FAR = 4.0
# Least ratio of a variance to its standard uncertainty at which it is significant.
_SIGNIFICANT = 3.0


@dataclass(frozen=True)
class Sparkle:
    """Local contrast of a coat in even light.

    Attributes
    ----------
    contrast : relative standard deviation from pixel to pixel, without the camera's noise; 0 if
        noise explains all of it
    uncertainty : standard, from the number of pixels
    neighbours : correlation of the remainder between adjacent pixels: 0 for single flakes and for
        the pixels' own response, up to 1 for coarse grain; None if noise explains all
    glints : share of pixels brighter than four standard deviations of all pixels; 3e-5 for a
        normal distribution
    """

    contrast: float
    uncertainty: float
    neighbours: float | None
    glints: float


def sparkle_of(white: NDArray[Any], sensor: SensorNoise, lit: BoolImage) -> Sparkle:
    """Return the local contrast of a white frame.

    Parameters
    ----------
    white : (row, col) DN
    sensor : black level and noise
    lit : (row, col) illuminated pixels of the coat

    Raises
    ------
    InputError : too few pixels with lit and unclipped surroundings
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
    """Return the covariance of adjacent pixels, without the high-pass's share of the noise."""
    both = inside[:, 1:] & inside[:, :-1]
    product = float((rest[:, 1:] * rest[:, :-1])[both].mean())
    return product + _OWN * float(np.square(rest[inside]).mean()) / _PRESERVED
