"""Mean level and contrast of fringes in closed form, without rendering the frames.

The light of N shifted fringes at a surface point is E (a + b cos(phi + 2 pi n / N)). E is the
irradiance of a white field. a and b are the mean and the first Fourier coefficient of the
projector's response to a cosine of levels. Two factors reduce b:

- the box of the DMD's pixels: sinc(1 / p), where p is the period in px;
- lens blur, defocus and the extent of the camera pixel: exp(-2 pi^2 v / p^2), where v is the sum of
  their variances along the projector axis in px^2.

The rounding of levels to 8 bits is not modelled. Harmonics of the response that N steps alias to
the first harmonic (orders N - 1, N + 1, ...) are not modelled either.

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
    """Light of a projector's fringes and uniform frames, relative to full white (level 255).

    Attributes
    ----------
    mean : mean light over a period
    amplitude : amplitude of a fringe of infinite period, without blur
    white, black : light of uniform frames with the levels `high_level` and `low_level`
    """

    mean: float
    amplitude: float
    white: float
    black: float

    @classmethod
    def of(cls, projector: Projector, patterns: Patterns) -> "FringeLight":
        """Return the light of cosine fringes between the lowest and highest level of `patterns`."""
        turn = 2.0 * np.pi * (np.arange(_TURN_STEPS) + 0.5) / _TURN_STEPS
        low, high = float(patterns.low_level), float(patterns.high_level)
        light = response(low + (high - low) * (0.5 + 0.5 * np.cos(turn)), projector)
        black, white = response(np.array([low, high]), projector).tolist()
        first = float(2.0 * np.mean(light * np.cos(turn)))
        return cls(float(light.mean()), first, white, black)


def transfer(period_px: Any, variance_px2: Any) -> Any:
    """Return the factor by which pixel box and blur reduce a fringe's contrast; number or array."""
    return np.sinc(1.0 / period_px) * np.exp(-2.0 * np.pi**2 * variance_px2 / period_px**2)


def outline(position_px: Any, length_px: int, sigma_px: Any) -> Any:
    """Return the relative light of a white image along one projector axis.

    The light is 1 except at the blurred edges of the image.

    Parameters
    ----------
    position_px : projector coordinate
    length_px : pixels of the image along the axis
    sigma_px : standard deviation of the blur
    """
    scale = 1.0 / (np.sqrt(2.0) * (sigma_px + _LEAST_BLUR_PX))
    low, high = position_px + 0.5, length_px - 0.5 - position_px
    return 0.5 * (erf(low * scale) + erf(high * scale))


def extent_variance_px2(range_px: Any, samples: int) -> Any:
    """Return the variance of a camera pixel's samples along a projector axis, px^2.

    Parameters
    ----------
    range_px : distance along the axis between the farthest two samples; the samples are assumed to
        be equally spaced
    samples : number of samples of the pixel, a square number
    """
    side = round(samples**0.5)
    return range_px**2 * (side + 1) / (12.0 * (side - 1)) if side > 1 else 0.0 * range_px
