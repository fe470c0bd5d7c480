"""The light of one press against that of the background.

If a lamp's flux changes, a channel's levels change by one factor everywhere (also with a power law
of the display). If some LEDs of a row change, the factor varies slowly over the image. Without
correction the change is read as slope, and integration converts it to relief: on 67 presses of a
real sensor the height of undeformed gel drifts by 50 to 63 um RMS. It drifts by 28 to 35 um if each
channel's factor is fitted over undeformed gel by a quadratic of the place.
"""

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage

# 1/16 of the undeformed pixels is enough for six numbers.
EVERY = 4
# Next to a contact the gel is tilted, but its colour differs by less than the contact threshold.
SKIRT_PX = 16
# Smaller regions above the threshold are noise, or a speck.
SPECK_PX = 3
# Least share of undeformed gel in the image for a fit over the whole image.
LEAST_SHARE = 0.05


def untouched_gel(levels: FloatImage, flat: FloatImage, highest: float) -> BoolImage:
    """Return True, (row, col), where colour and background differ by less than `highest`."""
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
        Of the image and of the background.
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
    """Return (row, col, 6) products of the place up to its square, from -1 to 1."""
    y, x = np.meshgrid(*(np.linspace(-1.0, 1.0, n) for n in shape), indexing="ij")
    return np.stack([np.ones(shape), x, y, x * x, x * y, y * y], axis=-1)


def _factor(
    levels: FloatImage, flat: FloatImage, basis: FloatArray, undeformed: BoolImage, channel: int
) -> FloatArray:
    """Return the ratio of a channel's illumination to that in the background, (row, col).

    Fitted to differences of levels and not to ratios, which are noisy in dark areas.
    """
    background = flat[undeformed, channel].astype(np.float64)
    change = np.linalg.lstsq(
        basis[undeformed] * background[:, None], levels[undeformed, channel] - background
    )
    factor: FloatArray = 1.0 + basis @ change[0]
    return factor
