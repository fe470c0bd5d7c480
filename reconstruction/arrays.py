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
"""Motion that is fitted and removed before a surface is compared, see `evaluate.deviation`."""


def at_pixels(image: NDArray[Any], where: BoolImage) -> NDArray[Any]:
    """Return the values of an image (row, col, ...) at the selected pixels: (pixel, ...)."""
    # 10 times faster than a boolean index.
    pixels = image.reshape(-1, *image.shape[2:])
    return pixels.take(np.flatnonzero(where), axis=0)


class Reason(IntEnum):
    """Reason code of a pixel; when several apply the lowest code is stored."""

    VALID = 0
    DARK = 1
    """White and black frame do not differ: no projector light."""
    LOW_MODULATION = 2
    """Fringe contrast too small for the required phase uncertainty."""
    SATURATED = 3
    """Clipped or lost phase frames leave too few for a fit."""
    ORDER_UNCERTAIN = 4
    """The Gray word fits two fringe orders, or contradicts the phase."""
    OUTSIDE_PROJECTOR = 5
    """The decoded coordinate is outside the projector image."""
    EDGE = 6
    """Next to a pixel without light: its footprint may cross the edge. Set by the filter only."""
    EPIPOLAR_MISMATCH = 7
    """The column and the row coordinate correspond to no common point of this camera ray."""
    NO_POINT = 8
    """The camera pixel has no ray (the lens model folds before it), or its ray has no intersection
    with the projector plane in front of both devices and within the projector's lens model."""


class PhotometricReason(IntEnum):
    """Reason code; when several apply the lowest code above 0 is stored.

    Slopes of coded pixels are estimates (filled in or extrapolated), heights are integrated over
    them: finite numbers everywhere, measurements only where the code is 0.
    """

    VALID = 0
    MARKER = 1
    """A printed dot, in this image or in the background: the slope is filled in from its border."""
    CLIPPED = 2
    """A channel is at 0 or 255: the colour is a bound, not a value."""
    UNCALIBRATED = 3
    """No calibration press contains this colour: the slope is that of the nearest known colour."""
