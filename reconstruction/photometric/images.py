"""Check and smooth colour images of a photometric sensor, and find dots printed on its gel.

Levels are 8-bit display values, red first, row 0 at the top.
"""

import cv2
import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Levels
from reconstruction.errors import InputError

CHANNELS = ("red", "green", "blue")
# Default distance by which found dots are enlarged, because their rims are only partly dark.
GROWTH_PX = 2
# Upper limit of a dot's width, px (dots have a radius of 0.5 mm at 0.0634 mm/px), and of the ratio
# of its level to that of the adjacent gel.
WIDEST_PX, DOT_CONTRAST = 25, 0.8
# Number of smoothings of filled slopes: enough for dots of 8 px radius (0.5 mm at 0.0634 mm/px),
# because they start from the values of the nearest visible pixels.
SMOOTHINGS = 40


def checked_image(image: ArrayLike, name: str, shape: tuple[int, ...] | None = None) -> Levels:
    """Return `image` if it is (row, col, 3) uint8, or raise InputError.

    Parameters
    ----------
    name : name of the image in the error message
    shape : required shape; None: any shape
    """
    levels = np.asarray(image)
    if levels.dtype != np.uint8 or levels.ndim != 3 or levels.shape[2] != 3:
        raise InputError(
            f"{name} is {levels.dtype} {levels.shape}; give 8-bit RGB (row, col, 3) uint8"
        )
    if shape is not None and levels.shape != shape:
        raise InputError(f"{name} has shape {levels.shape}; the background has {shape}")
    return levels


def mean_background(images: ArrayLike) -> FloatImage:
    """Return the mean (row, col, 3) float32 of images (frame, row, col, 3) uint8 of undeformed gel.

    Raises
    ------
    InputError : there is no image, or the images have a wrong type or shape
    """
    frames = np.asarray(images)
    if frames.ndim != 4 or len(frames) == 0:
        raise InputError(f"background frames have shape {frames.shape}; give (frame, row, col, 3)")
    for frame in frames:
        checked_image(frame, "background")
    return np.asarray(frames.mean(axis=0, dtype=np.float64), dtype=np.float32)


def smoothed(image: Levels | FloatImage, side_px: int) -> FloatImage:
    """Return levels (row, col, 3) float32, averaged over a square of odd side about each pixel.

    A side of 1 px copies the levels.
    """
    levels = image.astype(np.float32)
    if side_px == 1:
        return levels
    return np.asarray(cv2.blur(levels, (side_px, side_px), borderType=cv2.BORDER_REPLICATE))


def find_markers(
    levels: FloatImage, highest_level: float, grow_px: int, small: bool = False
) -> BoolImage:
    """Return the pixels of printed dots, (row, col) bool: those with a low grey level.

    Parameters
    ----------
    levels : (row, col, 3) float32, red first; grey = 0.299 R + 0.587 G + 0.114 B
    highest_level : largest grey level of a dot; 0: the gel has no dots, no pixel is True
    grow_px : distance by which the dark areas are enlarged
    small : True to exclude dark areas larger than a dot, such as the corners of the field, which
        receive little light; the vendor's programs include these areas
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
    """Return slopes (2, row, col) in which hidden pixels have the slopes of a near visible pixel.

    It is approximately the nearest visible pixel, as in the vendor's programs.
    """
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
    """Return slopes (2, row, col) in which hidden pixels are interpolated smoothly.

    The result approximates that of Laplace's equation between the visible pixels, by repeated
    averaging over 3 x 3 pixels. Slopes that are linear functions of the position, as on a
    paraboloid, are continued linearly, whereas `fill_nearest` copies a near value. If all pixels or
    no pixel is hidden, `slopes` is returned unchanged.
    """
    if not hidden.any() or hidden.all():
        return slopes
    filled = fill_nearest(slopes, hidden).astype(np.float32)
    inside = hidden.astype(np.uint8)
    for slope in filled:
        for _ in range(SMOOTHINGS):
            cv2.copyTo(cv2.blur(slope, (3, 3), borderType=cv2.BORDER_REPLICATE), inside, slope)
    return np.where(hidden, filled, slopes)
