"""Estimate the ratio of the light in an image of a press to that in the background.

If the flux of a lamp changes, the levels of a colour channel change by one factor in the whole
image. This is true also if levels are a power of the light. If some LEDs of a row of LEDs change,
the factor varies slowly over the image. Without correction the change is interpreted as slope, and
integration converts it to relief. On 67 presses of a real sensor undeformed gel then has heights of
50 to 63 um RMS. The heights are 28 to 35 um RMS if the factor of each channel is fitted to
undeformed gel by a quadratic function of the position.
"""

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage

# Every fourth row and column is used: 1/16 of the undeformed pixels is enough for six coefficients.
EVERY = 4
# Distance from a contact within which gel is tilted although its colour is near the background's.
SKIRT_PX = 16
# Regions narrower than this above the threshold are noise or dirt, and not a contact.
SPECK_PX = 3
# Least share of undeformed gel in the image for a fit over the whole image.
LEAST_SHARE = 0.05


def untouched_gel(levels: FloatImage, flat: FloatImage, highest: float) -> BoolImage:
    """Return the pixels, (row, col) bool, with a colour near that of the background.

    Parameters
    ----------
    levels, flat : (row, col, 3) smoothed levels of the image and of the background
    highest : Euclidean colour difference below which gel counts as undeformed, levels
    """
    difference = levels - flat
    distance = np.einsum("rcb,rcb->rc", difference, difference)
    return np.asarray(distance < highest**2)


def light_over_background(
    levels: FloatImage, flat: FloatImage, hidden: BoolImage, highest: float
) -> FloatArray | None:
    """Return the ratio of illumination in an image to that in the background, (row, col, channel).

    The ratio is a quadratic function of image position, fitted per channel to undeformed gel.
    None if less than `LEAST_SHARE` of the pixels show undeformed gel.

    Parameters
    ----------
    levels, flat : (row, col, 3) float32
        Smoothed levels of the image and of the background.
    hidden : (row, col)
        True at printed dots, which are left out of the fit.
    highest : Euclidean colour difference below which gel counts as undeformed, levels
    """
    undeformed = _far_from_contact(untouched_gel(levels, flat, highest)) & ~hidden
    if undeformed.mean() < LEAST_SHARE:
        return None
    thin = np.zeros_like(undeformed)
    thin[::EVERY, ::EVERY] = undeformed[::EVERY, ::EVERY]
    basis = _quadratic(undeformed.shape)
    return np.stack([_factor(levels, flat, basis, thin, c) for c in range(3)], axis=-1)


def _far_from_contact(untouched: BoolImage) -> BoolImage:
    square = np.ones((SPECK_PX, SPECK_PX), np.uint8)
    touched = cv2.morphologyEx((~untouched).astype(np.uint8), cv2.MORPH_OPEN, square)
    reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * SKIRT_PX + 1, 2 * SKIRT_PX + 1))
    return np.asarray(cv2.dilate(touched, reach) == 0) & untouched


def _quadratic(shape: tuple[int, int]) -> FloatArray:
    """Return the six terms of a quadratic function of the position at each pixel, (row, col, 6).

    Row and column are scaled to -1 to 1 over the image.
    """
    y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in shape), indexing="ij")
    return np.stack([np.ones(shape), x, y, x * x, x * y, y * y], axis=-1)


def _factor(
    levels: FloatImage, flat: FloatImage, basis: FloatArray, undeformed: BoolImage, channel: int
) -> FloatArray:
    """Return the ratio of a channel's illumination to that in the background, (row, col).

    The fit is to differences of levels and not to ratios, which are noisy in dark areas.

    Parameters
    ----------
    basis : (row, col, 6) terms of the fitted function
    undeformed : (row, col) bool, pixels used in the fit
    """
    background = flat[undeformed, channel].astype(np.float64)
    change = np.linalg.lstsq(
        basis[undeformed] * background[:, None], levels[undeformed, channel] - background
    )
    factor: FloatArray = 1.0 + basis @ change[0]
    return factor
