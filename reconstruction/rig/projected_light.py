"""Light of a projector for 8-bit levels: response curve, DMD pixel box and lens blur.

Frame: projector pixels along one axis, integer = centre of a pixel. Symbols: g gamma, s standard
deviation of the lens blur, L relative light, 0 for level 0 and 1 for level 255.

A pixel emits L; the lens spreads it by the DMD's pixel box and a Gaussian. Light of level 0 (finite
contrast) is a constant in addition to the light of every frame, and is not included in L.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.special import erf

from reconstruction.arrays import FloatArray, Levels
from reconstruction.errors import InputError, require_number

GAMMA_RANGE = (0.3, 4.0)
MOST_BLUR_PX = 10.0
_REACH_SIGMAS = 6.0


@dataclass(frozen=True)
class ProjectorResponse:
    """Known relation between a projector's levels and its light.

    Parameters
    ----------
    gamma : L = (level / 255) ** gamma
    gamma_uncertainty : its standard uncertainty
    blur_px : standard deviation of the lens blur, projector px, in addition to the pixel box
    blur_uncertainty_px : its standard uncertainty; defaults of both are for a lens focused by
        hand
    curve : measured instead of gamma: L at equally spaced levels from 0 to 255, from 0 to 1,
        rising; () if not measured

    Raises
    ------
    InputError : a number out of range, or both a gamma and a curve
    """

    gamma: float = 1.0
    gamma_uncertainty: float = 0.0
    blur_px: float = 0.7
    blur_uncertainty_px: float = 0.3
    curve: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        require_number("response gamma", self.gamma, *GAMMA_RANGE)
        require_number("response gamma_uncertainty", self.gamma_uncertainty, 0.0, GAMMA_RANGE[1])
        require_number("response blur_px", self.blur_px, 0.0, MOST_BLUR_PX)
        require_number("response blur_uncertainty_px", self.blur_uncertainty_px, 0.0, MOST_BLUR_PX)
        object.__setattr__(self, "curve", self._checked_curve())

    def _checked_curve(self) -> tuple[float, ...]:
        values = self.curve
        if not isinstance(values, (tuple, list)):
            raise InputError(f"response curve is {values!r}; give a list of numbers")
        for value in values:
            require_number("response curve", value, 0.0, 1.0)
        if values and self.gamma != 1.0:
            raise InputError("response has a gamma and a curve; give either of them")
        rises = all(higher > lower for lower, higher in pairwise(values))
        if values and (len(values) < 2 or (values[0], values[-1]) != (0.0, 1.0) or not rises):
            raise InputError("response curve must rise from 0 to 1, level 0 to level 255")
        return tuple(float(value) for value in values)

    def light(self, levels: Levels) -> FloatArray:
        """Return L of 8-bit levels of any shape."""
        return relative_light(levels, self.gamma, self.curve)


def relative_light(
    levels: Levels | FloatArray, gamma: float, curve: tuple[float, ...] = ()
) -> FloatArray:
    """Return the light of levels, 0 to 255: power law, or a curve at equally spaced levels."""
    relative = levels.astype(np.float64) / 255.0
    if curve:
        return np.asarray(np.interp(relative, np.linspace(0.0, 1.0, len(curve)), curve))
    return np.asarray(relative**gamma)


def blurred(light: FloatArray, nodes_px: FloatArray, blur_px: float) -> FloatArray:
    """Convolve pixel values (pixel, frame) with the DMD box and a Gaussian, at the nodes.

    The weight of pixel j at x is the Gaussian's mass over [x - j - 1/2, x - j + 1/2]; outside the
    image there is no light.
    """
    reach = int(np.ceil(0.5 + _REACH_SIGMAS * blur_px))
    pixel = np.rint(nodes_px).astype(int)[:, None] + np.arange(-reach, reach + 1)
    inside = (pixel >= 0) & (pixel < len(light))
    weight = _mass(nodes_px[:, None] - pixel, blur_px) * inside
    row_starts = np.arange(len(nodes_px) + 1) * pixel.shape[1]
    pixel = np.clip(pixel, 0, len(light) - 1)
    weights = csr_array(
        (weight.ravel(), pixel.ravel(), row_starts), shape=(len(nodes_px), len(light))
    )
    return np.asarray(weights @ light)


def _mass(offset_px: FloatArray, blur_px: float) -> FloatArray:
    def below(edge_px: FloatArray) -> FloatArray:
        # The limit of no blur: a node on the border of two pixels belongs to each by 50 %;
        # otherwise the ramp to the next node would shift the border by half a node.
        return np.sign(edge_px) if blur_px == 0.0 else erf(edge_px / (np.sqrt(2.0) * blur_px))

    return np.asarray(0.5 * (below(offset_px + 0.5) - below(offset_px - 0.5)))
