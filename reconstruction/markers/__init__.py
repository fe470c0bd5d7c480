"""Printed dots on an elastomer: detected, their size estimated, and tracked during a press.

Images are linear: proportional to the light. Places and displacements are (row, column) in px, with
row 0 at the top and whole numbers at pixel centres.
"""

from reconstruction.markers.detection import (
    DotPattern,
    covered_pixels,
    find_alike,
    find_pattern,
    linear_light,
)
from reconstruction.markers.field import MotionField
from reconstruction.markers.fitting import FittedDots
from reconstruction.markers.motion import MeanMotion, mean_motion
from reconstruction.markers.tracking import DotStatus, DotTracks, track

__all__ = [
    "DotPattern",
    "DotStatus",
    "DotTracks",
    "FittedDots",
    "MeanMotion",
    "MotionField",
    "covered_pixels",
    "find_alike",
    "find_pattern",
    "linear_light",
    "mean_motion",
    "track",
]
