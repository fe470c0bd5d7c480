"""Camera noise as in a data sheet (EMVA 1288), in digital numbers (DN).

Symbols: K `gain_dn_per_e`, sigma_d `read_noise_e`.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError, require_number

QUANTISATION_DN2 = 1.0 / 12.0

# One saturated pixel in 1e9 is missed; with 4 sigmas it was one in 30,000. Each has a phase error
# far beyond its sigma, because the light of a saturated pixel is unknown.
CLIP_SIGMAS = 6.0


def noise_variance_dn2(
    mean_dn: Any, gain_dn_per_e: Any, read_noise_e: Any, black_level_dn: Any
) -> Any:
    """Return the variance of one pixel value, DN^2; scalars and arrays alike.

    Notes
    -----
    (K sigma_d)^2 + K (mean - black)+ + 1/12, EMVA 1288 release 4, linear model. It is a plain
    function so that the compiled kernels and `SensorNoise` share one definition.
    """
    read_dn = gain_dn_per_e * read_noise_e
    shot_dn2 = gain_dn_per_e * np.maximum(mean_dn - black_level_dn, 0.0)
    return read_dn * read_dn + shot_dn2 + QUANTISATION_DN2


@dataclass(frozen=True)
class SensorNoise:
    """Noise and limits of the camera.

    Parameters
    ----------
    gain_dn_per_e : system gain K, DN per electron
    read_noise_e : temporal dark noise, electrons
    black_level_dn : DN without light
    saturation_dn : DN of a saturated pixel, mostly the largest code; see `clipped_from_dn`
    dsnu_e : standard deviation of the dark offsets of pixels, electrons; also that of the level
        of a saturated pixel

    Raises
    ------
    InputError : a number is out of range, or no value between black and clipped remains
    """

    gain_dn_per_e: float
    read_noise_e: float
    black_level_dn: float
    saturation_dn: float
    dsnu_e: float = 0.0

    def __post_init__(self) -> None:
        require_number("sensor gain_dn_per_e", self.gain_dn_per_e, 0.0)
        require_number("sensor read_noise_e", self.read_noise_e, 0.0)
        require_number("sensor black_level_dn", self.black_level_dn, 0.0)
        require_number(
            "sensor saturation_dn", self.saturation_dn, self.black_level_dn, open_low=True
        )
        require_number("sensor dsnu_e", self.dsnu_e, 0.0)
        if self.clipped_from_dn <= self.black_level_dn:
            raise InputError(
                f"sensor read_noise_e {self.read_noise_e:g} and dsnu_e {self.dsnu_e:g} leave no "
                f"value between black_level_dn and saturation_dn {self.saturation_dn:g}: values "
                f"from {self.clipped_from_dn:g} on may be clipped; correct gain or noise"
            )

    @property
    def clipped_from_dn(self) -> float:
        """Least value of a saturated pixel: from this level pixels count as clipped.

        A pixel saturates before it is read, so that read noise and dark offset (`CLIP_SIGMAS` of
        both) and half a level of rounding may reduce it below `saturation_dn`.
        """
        spread_e = math.hypot(self.read_noise_e, self.dsnu_e)
        return self.saturation_dn - CLIP_SIGMAS * self.gain_dn_per_e * spread_e - 0.5

    def variance_dn2(self, mean_dn: float | FloatArray) -> FloatArray:
        """Return the variance of a pixel with the expected value `mean_dn`, DN^2."""
        variance = noise_variance_dn2(
            mean_dn, self.gain_dn_per_e, self.read_noise_e, self.black_level_dn
        )
        return np.asarray(variance, dtype=np.float64)
