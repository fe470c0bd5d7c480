"""Camera noise in digital numbers (DN), by the figures of a data sheet (EMVA 1288).

Symbols: K is `gain_dn_per_e`, sigma_d is `read_noise_e`.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError, require_number

QUANTISATION_DN2 = 1.0 / 12.0

# With 6 sigmas one saturated pixel in 1e9 is not recognised; with 4 sigmas it was one in 30,000.
# Each of them has a phase error far beyond its sigma, because its light is unknown.
CLIP_SIGMAS = 6.0


def noise_variance_dn2(
    mean_dn: Any, gain_dn_per_e: Any, read_noise_e: Any, black_level_dn: Any
) -> Any:
    """Return the temporal variance, DN^2, of a pixel value with the expected value `mean_dn`.

    The arguments are scalars or arrays.

    Notes
    -----
    The variance is (K sigma_d)^2 + K max(mean - black, 0) + 1/12: EMVA 1288 release 4, linear
    model. This is a function, not a method, so that the compiled kernels and `SensorNoise` share
    one definition.
    """
    read_dn = gain_dn_per_e * read_noise_e
    shot_dn2 = gain_dn_per_e * np.maximum(mean_dn - black_level_dn, 0.0)
    return read_dn * read_dn + shot_dn2 + QUANTISATION_DN2


@dataclass(frozen=True)
class SensorNoise:
    """Noise of the camera, and its black and saturation levels.

    Parameters
    ----------
    gain_dn_per_e : system gain K, DN per electron
    read_noise_e : temporal dark noise sigma_d, electrons
    black_level_dn : mean pixel value without light, DN
    saturation_dn : value of a saturated pixel without noise, DN, mostly the largest value of the
        converter; see `clipped_from_dn`
    dsnu_e : standard deviation of the dark offset from pixel to pixel, electrons. The offset is
        also added to the values of saturated pixels

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
        """Least value, DN, that a saturated pixel can have; pixels of at least this are clipped.

        A pixel saturates before it is read. Therefore read noise and dark offset, `CLIP_SIGMAS`
        standard deviations of both together, and rounding by 0.5 DN may reduce its value below
        `saturation_dn`.
        """
        spread_e = math.hypot(self.read_noise_e, self.dsnu_e)
        return self.saturation_dn - CLIP_SIGMAS * self.gain_dn_per_e * spread_e - 0.5

    def variance_dn2(self, mean_dn: float | FloatArray) -> FloatArray:
        """Return the temporal variance, DN^2, of a pixel with the expected value `mean_dn`, DN.

        It is the sum of shot, dark and rounding noise; `dsnu_e` is not included.
        """
        variance = noise_variance_dn2(
            mean_dn, self.gain_dn_per_e, self.read_noise_e, self.black_level_dn
        )
        return np.asarray(variance, dtype=np.float64)
