"""Array types, names of alignments, and the reason codes of pixels without a measurement.

The axis order is (frame, row, col) for image stacks and (row, col, xyz) for point maps, with row 0
at the top. Each pixel has one reason code, which is 0 for a valid measurement.
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

LATER = {"later": True}
"""Metadata of a dataclass field that is newer than stored digests, see `config.digest` of the twin:
at its default, it does not change the digest of the content."""

Alignment = Literal["none", "offset", "offset_tilt", "rigid"]
"""Motion that is fitted and removed before two surfaces are compared, see `evaluate.deviation`."""


def at_pixels(image: NDArray[Any], where: BoolImage) -> NDArray[Any]:
    """Return the values (pixel, ...) of an image (row, col, ...) where the mask `where` is True.

    A list of points (n, ...) with a mask (n,) is treated in the same way.
    """
    # 10 times faster than a boolean index.
    pixels = image.reshape(-1, *image.shape[where.ndim :])
    return pixels.take(np.flatnonzero(where), axis=0)


class Reason(IntEnum):
    """Reason why a pixel of a fringe measurement has no point.

    If several reasons apply, the one with the lowest code is stored; EPIPOLAR_MISMATCH and NO_POINT
    apply to decoded pixels only.
    """

    VALID = 0
    DARK = 1
    """The white and the black frame do not differ, so no projector light reaches the pixel."""
    LOW_MODULATION = 2
    """The fringe contrast is too small for the required phase uncertainty."""
    SATURATED = 3
    """So many phase frames are clipped or lost that the others do not suffice for a fit."""
    ORDER_UNCERTAIN = 4
    """The Gray code word fits two fringe orders, or contradicts the phase."""
    OUTSIDE_PROJECTOR = 5
    """The decoded coordinate is outside the projector image."""
    EDGE = 6
    """The pixel is next to one without light, so its footprint may extend beyond the lit area.

    Only the spatial filter sets this reason."""
    EPIPOLAR_MISMATCH = 7
    """No point on the camera ray has both the decoded column and the decoded row coordinate."""
    NO_POINT = 8
    """The camera pixel has no ray, because the lens model cannot be inverted there. Or its ray does
    not intersect the projector plane in front of both devices and within the range of the
    projector's lens model."""
    MOTION = 9
    """The levels of the phase frames are not those of a fringe at rest: the surface moved, or the
    pixel is lit by two surfaces. Only `DecodeOptions.max_residual_sigmas` sets this reason, and
    only for pixels without another one."""


class PhotometricReason(IntEnum):
    """Reason why a pixel of photometric stereo has no measured slope.

    If several reasons apply, the one with the lowest code above 0 is stored. At a pixel with a code
    above 0 the slope is an estimate (filled in or extrapolated). Heights are integrated over all
    slopes. All numbers are finite, but only pixels with code 0 are measurements.
    """

    VALID = 0
    MARKER = 1
    """A printed dot, in this image or in the reference image without contact, covers the pixel. The
    slope is filled in from the border of the dot."""
    CLIPPED = 2
    """A colour channel is at 0 or 255, so the true value is unknown beyond this limit."""
    UNCALIBRATED = 3
    """No calibration press has this colour; the slope is that of the nearest calibrated colour."""
