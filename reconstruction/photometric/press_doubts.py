"""What speaks against a calibration: another unit's, or another day's.

A colour map of another unit gives relief that looks plausible and is false by about 1 mm, with not
one pixel out of its range: nothing in the heights themselves tells.
"""

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatImage
from reconstruction.photometric.relighting import LEAST_SHARE
from reconstruction.photometric.sensor import HeightMap, UntouchedGel

# Backgrounds of two units differ by some 15 %, of one unit within a session by 0.5 %.
SAME_UNIT = 0.05
# On presses of a real sensor untouched gel drifts by 50 to 63 um RMS.
LARGEST_DRIFT_MM = 0.2
_SMOOTHING_PX = 8.0


def background_difference(own: FloatImage, given: FloatImage) -> float:
    """Return how far two backgrounds (row, col, 3) differ, RMS over their mean level.

    Of the light alone: noise and texture are smoothed away.
    """
    one, other = (cv2.GaussianBlur(image, (0, 0), _SMOOTHING_PX) for image in (own, given))
    return float(np.sqrt(np.mean((one - other) ** 2)) / max(float(one.mean()), 1.0))


def untouched_drift_mm(height_map: HeightMap, untouched: BoolImage) -> float | None:
    """Return the RMS height of untouched gel, whose true height is 0; None where there is none."""
    if untouched.mean() < LEAST_SHARE:
        return None
    return float(np.sqrt(np.mean(height_map.height_mm[untouched].astype(np.float64) ** 2)))


def doubts_of_background(own: FloatImage, given: FloatImage) -> tuple[str, ...]:
    """Tell whether a background may be of another unit than the calibration's own."""
    difference = background_difference(own, given)
    if difference <= SAME_UNIT:
        return ()
    return (
        f"background: differs by {difference:.0%} from the one that the calibration was made with; "
        "another unit's calibration gives false relief: calibrate this unit",
    )


def doubts_of_image(height_map: HeightMap, untouched: UntouchedGel) -> tuple[str, ...]:
    """Tell whether untouched gel is missing, has another light, or shows relief."""
    drift_mm = untouched_drift_mm(height_map, untouched.where)
    if drift_mm is None:
        return (
            f"image: {untouched.where.mean():.1%} of it has the colour of the background; heights "
            "have no zero, and background or calibration may be of another unit",
        )
    found = []
    if untouched.light_change > SAME_UNIT:
        found.append(
            f"image: its light differs by {untouched.light_change:.0%} from the background's, more "
            "than lamps drift; the background may be of another unit"
        )
    if drift_mm > LARGEST_DRIFT_MM:
        found.append(
            f"image: untouched gel shows {1e3 * drift_mm:.0f} um of relief (RMS); take a new "
            "background, or calibrate again"
        )
    return tuple(found)
