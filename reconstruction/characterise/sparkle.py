"""How unevenly a coat shines: what is left of a white frame's local contrast without the noise.

Flakes that mirror by themselves, grain of the coat and pixels of unlike response make a white frame
uneven from pixel to pixel. Slow changes (form, light, lens) are taken off by a high-pass, the image
less its mean over 7 x 7 pixels, which leaves 48/49 of the variance of independent pixels; of grain
wider than a pixel it takes more. Shares are of the local mean above black.
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
_KEPT = 1.0 - 1.0 / _BOX**2
# Covariance that the high-pass gives neighbours which have none, less than zero.
_OWN = 2.0 / _BOX**2 - (_BOX - 1.0) / _BOX**3
_LEAST_PIXELS = 1000
_FAR = 4.0
# Standard uncertainties from which a variance counts as seen.
_SEEN = 3.0


@dataclass(frozen=True)
class Sparkle:
    """Local contrast of a coat in even light.

    Attributes
    ----------
    contrast : standard deviation from pixel to pixel, without the camera's noise, as a share; 0
        where noise explains all
    uncertainty : standard, by the number of pixels
    neighbours : correlation of what is left between pixels side by side: 0 of single flakes and of
        the pixels' own response, towards 1 of wider grain; None where noise explains all
    glints : share of pixels brighter than four standard deviations of the whole; 3e-5 of normal
        numbers
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
    sensor : black level and noise, as it is
    lit : (row, col) pixels of the coat that see light

    Raises
    ------
    InputError : too few pixels with lit surroundings, none of them clipped
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
    square = rest[inside] ** 2 / _KEPT
    variance = float(square.mean() - noise2[inside].mean())
    spread = float(square.std() / np.sqrt(square.size))
    contrast = float(np.sqrt(max(variance, 0.0)))
    return Sparkle(
        contrast,
        spread / (2.0 * max(contrast, np.sqrt(spread))),
        _neighbours(rest, inside) / variance if variance > _SEEN * spread else None,
        float(np.mean(rest[inside] > _FAR * np.sqrt(square.mean()))),
    )


def _neighbours(rest: FloatArray, inside: BoolImage) -> float:
    """Return the covariance of pixels side by side, without what the high-pass makes of noise."""
    both = inside[:, 1:] & inside[:, :-1]
    product = float((rest[:, 1:] * rest[:, :-1])[both].mean())
    return product + _OWN * float(np.square(rest[inside]).mean()) / _KEPT
