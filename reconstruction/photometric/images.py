"""Colour images of a photometric sensor: 8-bit display values, red first, row 0 at the top."""

import cv2
import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatImage, Levels
from reconstruction.errors import InputError

CHANNELS = ("red", "green", "blue")


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
    """Return the mean of untouched images, (frame, row, col, 3) uint8, as float32 levels.

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
    """Return float32 levels averaged over a square of odd side; side 1 changes nothing."""
    levels = image.astype(np.float32)
    if side_px == 1:
        return levels
    mean: FloatImage = cv2.blur(levels, (side_px, side_px), borderType=cv2.BORDER_REPLICATE)
    return mean
