"""Level and contrast of fringes in closed form, from a trace's irradiance without frames.

The light of N shifted fringes at a surface point is E (a + b cos(phi + 2 pi n / N)), E the
irradiance of a white field. a and b are the mean and the first Fourier coefficient of the
projector's response to a cosine of levels; the cosine is attenuated

- by the box of the DMD's pixels: sinc(1 / p), p the period in px,
- by lens blur, defocus and the camera pixel's extent: exp(-2 pi^2 v / p^2), v the sum of their
  variances along the axis in px^2.

Left out: the rounding of levels to 8 bits, and harmonics of the response that N steps alias to the
first harmonic (orders N - 1, N + 1, ...).

All functions are analytic: complex numbers pass through them, so that a complex step gives their
derivatives to machine precision (Squire and Trapp, SIAM Review 40, 110 (1998)).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import erf

from twin.config.models import Patterns, Projector
from twin.optics.light import response

_TURN_STEPS = 720
_LEAST_BLUR_PX = 1e-3


@dataclass(frozen=True)
class FringeLight:
    """Fringes of one projector, as shares of its white.

    Attributes
    ----------
    mean : of all shifted fringes
    amplitude : of a fringe of infinite period, without blur
    white, black : of the frames `high_level` and `low_level`
    """

    mean: float
    amplitude: float
    white: float
    black: float

    @classmethod
    def of(cls, projector: Projector, patterns: Patterns) -> "FringeLight":
        """Return mean and first coefficient of the response to a cosine of levels."""
        turn = 2.0 * np.pi * (np.arange(_TURN_STEPS) + 0.5) / _TURN_STEPS
        low, high = float(patterns.low_level), float(patterns.high_level)
        light = response(low + (high - low) * (0.5 + 0.5 * np.cos(turn)), projector)
        black, white = response(np.array([low, high]), projector).tolist()
        first = float(2.0 * np.mean(light * np.cos(turn)))
        return cls(float(light.mean()), first, white, black)


def transfer(period_px: Any, variance_px2: Any) -> Any:
    """Return the factor on a fringe's contrast by pixel box and blur; number or array."""
    return np.sinc(1.0 / period_px) * np.exp(-2.0 * np.pi**2 * variance_px2 / period_px**2)


def outline(position_px: Any, length_px: int, sigma_px: Any) -> Any:
    """Return the relative light of a white image at a coordinate: 1 except at its blurred edges."""
    scale = 1.0 / (np.sqrt(2.0) * (sigma_px + _LEAST_BLUR_PX))
    low, high = position_px + 0.5, length_px - 0.5 - position_px
    return 0.5 * (erf(low * scale) + erf(high * scale))


def extent_variance_px2(range_px: Any, samples: int) -> Any:
    """Return the variance of a camera pixel's samples along a projector axis, px^2.

    Parameters
    ----------
    range_px : between the farthest two samples; samples are assumed equally spaced on a line
    samples : of the pixel, a square number
    """
    side = round(samples**0.5)
    return range_px**2 * (side + 1) / (12.0 * (side - 1)) if side > 1 else 0.0 * range_px
