"""The light of one press against that of the background.

A lamp whose flux has changed multiplies a channel's levels by one factor everywhere (a power law of
the display keeps it a factor), and a row of LEDs that changed by parts by one that varies slowly
over the image. Left alone it passes for slope, and integration turns it into relief: on 67 presses
of a real sensor the height of untouched gel drifts by 50 to 63 um RMS, and by 28 to 35 where each
channel's factor is fitted over untouched gel by a quadratic of the place.
"""

import cv2
import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage

# Of untouched pixels a sixteenth is enough to know six numbers.
EVERY = 4
# Beside contact the gel is bent by less than the threshold of touched gel sees, and still tilted.
SKIRT_PX = 16
# Regions of touched gel smaller than this are noise, or a speck.
SPECK_PX = 3
# Below this share of the image untouched gel tells nothing of the rest.
LEAST_SHARE = 0.05


def untouched_gel(levels: FloatImage, flat: FloatImage, highest: float) -> BoolImage:
    """Return where the colour is nearer than `highest` levels to the background's, (row, col)."""
    difference = levels - flat
    distance = np.einsum("rcb,rcb->rc", difference, difference)
    return np.asarray(distance < highest**2)


def light_over_background(
    levels: FloatImage, flat: FloatImage, hidden: BoolImage, highest: float
) -> FloatArray | None:
    """Return each channel's light over that of the background, (row, col, 3).

    None where too little gel is untouched to tell.

    Parameters
    ----------
    levels, flat : (row, col, 3) float32
        Of the image and of the background.
    hidden : (row, col)
        Printed dots.
    highest : Euclidean colour difference below which gel is untouched, levels
    """
    seen = _far_from_contact(untouched_gel(levels, flat, highest)) & ~hidden
    if seen.mean() < LEAST_SHARE:
        return None
    thin = np.zeros_like(seen)
    thin[::EVERY, ::EVERY] = seen[::EVERY, ::EVERY]
    basis = _quadratic(seen.shape)
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
    levels: FloatImage, flat: FloatImage, basis: FloatArray, seen: BoolImage, channel: int
) -> FloatArray:
    """Return (row, col) a channel's light over the background's.

    Fitted to differences of levels and not to ratios, whose noise is large where it is dark.
    """
    background = flat[seen, channel].astype(np.float64)
    change = np.linalg.lstsq(basis[seen] * background[:, None], levels[seen, channel] - background)
    factor: FloatArray = 1.0 + basis @ change[0]
    return factor
