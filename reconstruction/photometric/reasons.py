"""Why a pixel's height is not measured: one reason code per pixel, 0 for a measured one."""

from enum import IntEnum


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
