"""Array types, names of alignments, and the reason codes of pixels without a measurement.

Axis order is (frame, row, col) and (row, col, xyz), row 0 at the top. One reason code per pixel, 0
for a valid one.
"""

from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]
OrderImage = NDArray[np.int16]
ReasonImage = NDArray[np.uint8]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
BoolImage = BoolArray
Levels = NDArray[np.uint8]
Stack = NDArray[Any]

Alignment = Literal["none", "offset", "offset_tilt", "rigid"]
"""What is taken off a surface before it is compared, see `evaluate.deviation`."""


def at_pixels(image: NDArray[Any], where: BoolImage) -> NDArray[Any]:
    """Return what an image (row, col, ...) holds at some pixels, row by row: (pixel, ...)."""
    # Ten times as fast as an index of bools.
    pixels = image.reshape(-1, *image.shape[2:])
    return pixels.take(np.flatnonzero(where), axis=0)


class Reason(IntEnum):
    """Reason code of a pixel; when several apply the lowest code is kept."""

    VALID = 0
    DARK = 1
    """White and black frame do not differ: no projector light."""
    LOW_MODULATION = 2
    """Fringe contrast too small for the phase uncertainty asked for."""
    SATURATED = 3
    """Clipped or lost phase frames leave too few for a fit."""
    ORDER_UNCERTAIN = 4
    """The Gray word could stand for another fringe order, or contradicts the phase."""
    OUTSIDE_PROJECTOR = 5
    """The decoded coordinate lies outside the projector image."""
    EDGE = 6
    """Beside a pixel without light: part of it may see past the edge. Only marked by the filter."""
    EPIPOLAR_MISMATCH = 7
    """Column and row coordinate belong to no common point of this camera ray."""
    NO_POINT = 8
    """No camera ray (the lens folds before it), or none that meets the projector plane in front of
    both devices and before the projector's lens folds."""


class PhotometricReason(IntEnum):
    """Reason code; when several apply the lowest code above 0 is kept.

    Slopes of coded pixels are estimates (filled in or extrapolated), heights are integrated over
    them: finite numbers everywhere, measurements only where the code is 0.
    """

    VALID = 0
    MARKER = 1
    """A printed dot, in this image or in the background: the slope is filled in from around it."""
    CLIPPED = 2
    """A channel is at 0 or 255: the colour is a bound, not a value."""
    UNCALIBRATED = 3
    """The calibration presses showed no such colour: the slope is the nearest known one."""
