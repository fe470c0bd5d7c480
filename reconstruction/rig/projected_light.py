"""Compute the light of a projector from 8-bit levels: response curve, pixel box and lens blur.

Frame: projector pixels along one axis, integer = centre of a pixel.

A pixel emits the relative light L, which is 0 for level 0 and 1 for level 255. On the surface this
light is distributed as the convolution of a box of one DMD pixel with a Gaussian, the lens blur.
The light that a projector of finite contrast emits at level 0 is equal in all frames and not
included in L.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
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
    """Relation between the levels of a projector and its light, as known to the decoder.

    Parameters
    ----------
    gamma : exponent in L = (level / 255) ** gamma
    gamma_uncertainty : standard uncertainty of gamma
    blur_px : standard deviation of the lens blur, projector px, in addition to the pixel box
    blur_uncertainty_px : standard uncertainty of `blur_px`; the defaults of both are for a lens
        that is focused by hand
    curve : measured L, rising from 0 to 1, at equally spaced levels from 0 to 255; replaces gamma;
        (): not measured

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
        """Return the relative light L, 0 to 1, for 8-bit levels; arrays of any shape."""
        return relative_light(levels, self.gamma, self.curve)


def relative_light(
    levels: Levels | FloatArray, gamma: float, curve: tuple[float, ...] = ()
) -> FloatArray:
    """Return the relative light L, 0 to 1, of levels 0 to 255 of any shape.

    L is (level / 255) ** gamma. If `curve` is given, which has L at equally spaced levels from 0 to
    255, L is interpolated in it instead.
    """
    relative = levels.astype(np.float64) / 255.0
    if curve:
        return np.asarray(np.interp(relative, np.linspace(0.0, 1.0, len(curve)), curve))
    return np.asarray(relative**gamma)


def blurred(
    light: FloatArray, nodes_px: FloatArray, blur_px: float, smear_px: float = 0.0
) -> FloatArray:
    """Return the light (node, frame) at positions `nodes_px` after the pixel box and lens blur.

    The weight of pixel j at position x is the integral of the Gaussian over
    [x - j - 1/2, x - j + 1/2]. Outside the image there is no light.

    Parameters
    ----------
    light : (pixel, frame), relative light of each pixel
    nodes_px : (node,) positions along the axis, projector px
    blur_px : standard deviation of the Gaussian, projector px
    smear_px : width of a further box over which the light is averaged, see `pixel_shape`
    """
    reach = int(np.ceil(0.5 + 0.5 * smear_px + _REACH_SIGMAS * blur_px))
    pixel = np.rint(nodes_px).astype(int)[:, None] + np.arange(-reach, reach + 1)
    inside = (pixel >= 0) & (pixel < len(light))
    offset_px = nodes_px[:, None] - pixel
    weight = _once_per_row(offset_px, partial(_smeared_mass, blur_px=blur_px, smear_px=smear_px))
    weight *= inside
    row_starts = np.arange(len(nodes_px) + 1) * pixel.shape[1]
    pixel = np.clip(pixel, 0, len(light) - 1)
    weights = csr_array(
        (weight.ravel(), pixel.ravel(), row_starts), shape=(len(nodes_px), len(light))
    )
    return np.asarray(weights @ light)


def _once_per_row(offset_px: FloatArray, mass: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return `mass` of offsets (node, pixel), computed once for all equal rows.

    Nodes on a grid of 1 / n px have n different rows only, of some ten thousand.
    """
    _, first, row = np.unique(offset_px[:, 0], return_index=True, return_inverse=True)
    distinct = offset_px[first]
    if np.array_equal(distinct[row], offset_px):
        return mass(distinct)[row]
    return mass(offset_px)


def _mass(offset_px: FloatArray, blur_px: float) -> FloatArray:
    def below(edge_px: FloatArray) -> FloatArray:
        # Without blur a node on the border of two pixels gets 50 % of the light of each. Otherwise
        # linear interpolation to the next node would shift the border by half a node distance.
        return np.sign(edge_px) if blur_px == 0.0 else erf(edge_px / (np.sqrt(2.0) * blur_px))

    return np.asarray(0.5 * (below(offset_px + 0.5) - below(offset_px - 0.5)))


def _smeared_mass(offset_px: FloatArray, blur_px: float, smear_px: float) -> FloatArray:
    """Return the mean of `_mass` over a box of width `smear_px` around each offset."""
    if not smear_px:
        return _mass(offset_px, blur_px)

    def integral(edge_px: FloatArray) -> FloatArray:
        """Return the integral of the Gaussian's distribution function up to `edge_px`."""
        if blur_px == 0.0:
            return np.maximum(edge_px, 0.0)
        share = 0.5 * (1.0 + erf(edge_px / (np.sqrt(2.0) * blur_px)))
        density = np.exp(-0.5 * (edge_px / blur_px) ** 2) / np.sqrt(2.0 * np.pi)
        return np.asarray(edge_px * share + blur_px * density)

    half_px = 0.5 * smear_px
    ends = [
        integral(offset_px + edge_px + half_px) - integral(offset_px + edge_px - half_px)
        for edge_px in (0.5, -0.5)
    ]
    return np.asarray((ends[0] - ends[1]) / smear_px)
