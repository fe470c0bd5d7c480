"""Expected projector coordinates of marked pixels."""

from collections.abc import Mapping

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.codes import Expected
from reconstruction.decoding import Expect, PhaseReference
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, Axis

PIXEL_SIGMA_PX = 1.0
"""Standard deviation of the stated projector coordinate of a marked pixel."""


def expect_at_pixels(reference: PhaseReference | None, shape: tuple[int, ...]) -> Expect | None:
    """Return the function that expects the coordinates of marked pixels; None: there are none.

    Parameters
    ----------
    shape : (rows, cols) of the image

    Raises
    ------
    InputError : a marked pixel is outside the image
    """
    if reference is None or not reference.pixels:
        return None
    rows, cols = shape
    for x, y, *_ in reference.pixels:
        if not (-0.5 <= x < cols - 0.5 and -0.5 <= y < rows - 0.5):
            raise InputError(
                f"reference_pixels has the camera column {x:g} and row {y:g}; the image has"
                f" {cols} columns and {rows} rows"
            )

    def expect(axis: Axis, known: Mapping[Axis, FloatArray]) -> Expected | None:
        places = [pixel for pixel in reference.pixels if len(pixel) > 2 + AXES.index(axis)]
        if not places:
            return None
        coordinate_px = np.full((rows, cols), np.nan)
        for x, y, *projector_px in places:
            coordinate_px[round(y), round(x)] = projector_px[AXES.index(axis)]
        sigma_px = np.full((rows, cols), PIXEL_SIGMA_PX)
        return Expected(coordinate_px, sigma_px, reference.islands, is_exact=True)

    return expect
