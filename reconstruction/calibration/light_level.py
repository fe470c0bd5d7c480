"""The board without its lighting: brightness relative to the white print around."""

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatImage
from reconstruction.decoding.decode import Decoded
from reconstruction.errors import InputError
from reconstruction.rig.sensor import SensorNoise

# The white level is the local maximum over this share of the image height: larger than any dot or
# square, small enough to follow the projector's fall-off.
WINDOW_SHARE = 0.25
WORK_HEIGHT_PX = 180


def brightness(decoded: Decoded, sensor: SensorNoise) -> FloatImage:
    """Return the mean of all phase frames above black, (row, col) DN: no fringe, little noise."""
    mean_dn = 0.5 * (decoded.column.mean_dn + decoded.row.mean_dn)
    above_dn = np.maximum(mean_dn - np.float32(sensor.black_level_dn), 0.0)
    return np.asarray(above_dn, dtype=np.float32)


def relative_brightness(image_dn: FloatImage) -> FloatImage:
    """Divide by the local white level, (row, col); white is about 1.

    Raises
    ------
    InputError : the image is black
    """
    rows, cols = image_dn.shape
    if not image_dn.max() > 0.0:
        raise InputError("the board image is black: no projector light reached the camera")
    scale = min(1.0, WORK_HEIGHT_PX / rows)
    small = cv2.resize(image_dn, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    side = max(3, round(WINDOW_SHARE * small.shape[0]))
    white = cv2.blur(cv2.dilate(small, np.ones((side, side), np.uint8)), (side, side))
    white = cv2.resize(white, (cols, rows), interpolation=cv2.INTER_LINEAR)
    # Where the board ends there is no white to compare with.
    floor = np.float32(0.05) * image_dn.max()
    return np.asarray(image_dn / np.maximum(white, floor), dtype=np.float32)


def ink_threshold(relative: FloatImage) -> float:
    """Return the level between ink and white (Otsu 1979)."""
    levels = np.clip(relative * 200.0, 0, 255).astype(np.uint8)
    return float(cv2.threshold(levels, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0]) / 200.0


def white_print(relative: FloatImage, threshold: float, margin_px: int) -> BoolImage:
    """Return the white pixels at least `margin_px` away from ink, (row, col) bool.

    Pixels on an edge mix two places of the board and lean their fringe towards the brighter one.
    """
    white = (relative > threshold).astype(np.uint8)
    kernel = np.ones((2 * margin_px + 1, 2 * margin_px + 1), np.uint8)
    return np.asarray(cv2.erode(white, kernel, borderValue=1), dtype=np.bool_)
