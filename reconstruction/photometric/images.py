"""Colour images of a photometric sensor, and the dots printed on its gel.

8-bit display values, red first, row 0 at the top.
"""

import cv2
import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Levels
from reconstruction.errors import InputError

CHANNELS = ("red", "green", "blue")
# Default growth of dots: their rims are half dark.
GROWTH_PX = 2
# Dots are narrower than this, 0.5 mm in radius at 0.0634 mm/px, and darker than the adjacent gel
# by this.
WIDEST_PX, DOT_CONTRAST = 25, 0.8
# Smoothings of filled slopes: enough for dots of 8 px radius (0.5 mm at 0.0634 mm/px), since the
# nearest neighbours they start from are already right at the rim.
SMOOTHINGS = 40


def checked_image(image: ArrayLike, name: str, shape: tuple[int, ...] | None = None) -> Levels:
    """Return `image` as (row, col, 3) uint8 or raise InputError naming it."""
    levels = np.asarray(image)
    if levels.dtype != np.uint8 or levels.ndim != 3 or levels.shape[2] != 3:
        raise InputError(
            f"{name} is {levels.dtype} {levels.shape}; give 8-bit RGB (row, col, 3) uint8"
        )
    if shape is not None and levels.shape != shape:
        raise InputError(f"{name} has shape {levels.shape}; the background has {shape}")
    return levels


def mean_background(images: ArrayLike) -> FloatImage:
    """Return the mean of images of the undeformed gel, (frame, row, col, 3) uint8, as float32.

    Raises
    ------
    InputError : no image, wrong type or shape
    """
    frames = np.asarray(images)
    if frames.ndim != 4 or len(frames) == 0:
        raise InputError(f"background frames have shape {frames.shape}; give (frame, row, col, 3)")
    for frame in frames:
        checked_image(frame, "background")
    return np.asarray(frames.mean(axis=0, dtype=np.float64), dtype=np.float32)


def smoothed(image: Levels | FloatImage, side_px: int) -> FloatImage:
    """Return float32 levels averaged over a square of odd side; side 1 copies the levels."""
    levels = image.astype(np.float32)
    if side_px == 1:
        return levels
    return np.asarray(cv2.blur(levels, (side_px, side_px), borderType=cv2.BORDER_REPLICATE))


def find_markers(
    levels: FloatImage, highest_level: float, grow_px: int, small: bool = False
) -> BoolImage:
    """Return where the grey level is at most `highest_level`, grown by `grow_px`, (row, col).

    Level 0 is for a gel without dots.

    Parameters
    ----------
    levels : (row, col, 3) float32, red first; grey = 0.299 R + 0.587 G + 0.114 B
    small : exclude dark areas larger than a dot, such as the corners of the field, which the
        lamps hardly reach; the vendor's programs include them
    """
    if highest_level == 0:
        return np.zeros(levels.shape[:2], dtype=np.bool_)
    grey = cv2.cvtColor(levels, cv2.COLOR_RGB2GRAY)
    dark = (grey <= highest_level).astype(np.uint8)
    if small:
        window = np.ones((WIDEST_PX, WIDEST_PX), np.uint8)
        without_dots = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, window)
        dark &= (grey < DOT_CONTRAST * without_dots).astype(np.uint8)
    if grow_px:
        dark = cv2.dilate(dark, np.ones((3, 3), np.uint8), iterations=grow_px)
    return np.asarray(dark, dtype=np.bool_)


def fill_nearest(slopes: FloatArray, hidden: BoolImage) -> FloatArray:
    """Replace hidden slopes by approximately those of the nearest visible pixel, as the vendor."""
    if not hidden.any() or hidden.all():
        return slopes
    _, label = cv2.distanceTransformWithLabels(
        hidden.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    place_of_label = np.zeros(int(label.max()) + 1, dtype=np.intp)
    visible = np.flatnonzero(~hidden)
    place_of_label[label.ravel()[visible]] = visible
    source = place_of_label[label.ravel()]
    return np.stack([slope.ravel()[source].reshape(slope.shape) for slope in slopes])


def fill_smooth(slopes: FloatArray, hidden: BoolImage) -> FloatArray:
    """Replace hidden slopes by a membrane through their surroundings.

    Exact where the slopes are linear, as on a paraboloid; nearest neighbours make it a plateau.
    """
    if not hidden.any() or hidden.all():
        return slopes
    filled = fill_nearest(slopes, hidden).astype(np.float32)
    inside = hidden.astype(np.uint8)
    for slope in filled:
        for _ in range(SMOOTHINGS):
            cv2.copyTo(cv2.blur(slope, (3, 3), borderType=cv2.BORDER_REPLICATE), inside, slope)
    return np.where(hidden, filled, slopes)
