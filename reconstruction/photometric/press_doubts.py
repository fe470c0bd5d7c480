"""Check whether a calibration is that of a different sensor unit, or outdated.

A colour map of a different unit gives relief that looks plausible but has errors of about 1 mm.
Every colour may be within the calibrated range, so that the heights themselves do not show the
error.
"""

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatImage
from reconstruction.photometric.height_map import HeightMap
from reconstruction.photometric.relighting import LEAST_SHARE
from reconstruction.photometric.sensor import UntouchedGel

# Largest relative difference of backgrounds of one unit. Backgrounds of two units differ by some
# 15 %, those of one unit within a session by 0.5 %.
SAME_UNIT = 0.05
# Largest RMS height of undeformed gel; on presses of a real sensor it is 50 to 63 um.
LARGEST_DRIFT_MM = 0.2
_SMOOTHING_PX = 8.0


def background_difference(own: FloatImage, given: FloatImage) -> float:
    """Return the RMS difference of two backgrounds (row, col, 3) over the mean level of `own`.

    Both are smoothed first, so that noise and texture have little effect on the result.
    """
    own_light, given_light = (
        cv2.GaussianBlur(image, (0, 0), _SMOOTHING_PX) for image in (own, given)
    )
    return float(
        np.sqrt(np.mean((own_light - given_light) ** 2)) / max(float(own_light.mean()), 1.0)
    )


def untouched_drift_mm(height_map: HeightMap, untouched: BoolImage) -> float | None:
    """Return the RMS height, mm, of undeformed gel above its shape without load: ideally 0.

    None if too few pixels show undeformed gel.

    Parameters
    ----------
    untouched : (row, col) bool, pixels of undeformed gel
    """
    if untouched.mean() < LEAST_SHARE:
        return None
    return float(np.sqrt(np.mean(height_map.relief_mm[untouched].astype(np.float64) ** 2)))


def doubts_of_background(own: FloatImage, given: FloatImage) -> tuple[str, ...]:
    """Return a message if a background may be that of a different unit, else an empty tuple.

    Parameters
    ----------
    own : (row, col, 3) background of the calibration
    given : (row, col, 3) current background
    """
    difference = background_difference(own, given)
    if difference <= SAME_UNIT:
        return ()
    return (
        f"background: differs by {difference:.0%} from that of the calibration; "
        "another unit's calibration gives false relief: calibrate this unit",
    )


def doubts_of_image(height_map: HeightMap, untouched: UntouchedGel) -> tuple[str, ...]:
    """Return messages if an image shows that the calibration may be wrong, else an empty tuple.

    The reasons are: too few pixels show undeformed gel; the light on this gel differs from that of
    the background; or this gel has relief.
    """
    drift_mm = untouched_drift_mm(height_map, untouched.where)
    if drift_mm is None:
        return (
            f"image: {untouched.where.mean():.1%} of it has the colour of the background; heights "
            "have no zero, and background or calibration may be of another unit",
        )
    doubts = []
    if untouched.light_change > SAME_UNIT:
        doubts.append(
            f"image: its light differs by {untouched.light_change:.0%} from the background's, more "
            "than lamps drift; the background may be of another unit"
        )
    if drift_mm > LARGEST_DRIFT_MM:
        doubts.append(
            f"image: undeformed gel has {1e3 * drift_mm:.0f} um of relief (RMS); take a new "
            "background, or calibrate again"
        )
    return tuple(doubts)
