"""Noise of the camera by a function of the user, instead of the EMVA 1288 model.

    def gaussian(mean_e, rng):
        return mean_e + rng.normal(0.0, 20.0, mean_e.shape)

    twin.measure(experiment, noise=gaussian)

The arguments and the result of such a function are described at `NoiseFunction`.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from reconstruction.arrays import FloatImage
from reconstruction.errors import InputError

NoiseFunction = Callable[[FloatImage, np.random.Generator], Any]
"""Function from the mean electrons of a frame to its electrons with noise, both (row, col).

The mean (float32) contains light, relative response of the pixels and dark current. The noise of
the function replaces shot and read noise. Full well, dark offsets, gain, rounding and the limits of
the converter are applied to its result. The function is called once for each frame, in order of the
frames, with a random generator that is seeded by experiment, trial and frame.
"""


def noisy_electrons(
    noise: NoiseFunction, mean_e: FloatImage, rng: np.random.Generator
) -> FloatImage:
    """Return the electrons of a frame (row, col), float32, by a function or by a kind of noise.

    Raises
    ------
    InputError : the function returns another shape, or values that are not finite
    """
    electrons = np.asarray(noise(mean_e, rng), np.float32)
    if electrons.shape != mean_e.shape:
        raise InputError(
            f"noise: {name_of(noise)} returned the shape {electrons.shape}, needed "
            f"{mean_e.shape}: the electrons of each pixel"
        )
    if not np.isfinite(electrons).all():
        raise InputError(f"noise: {name_of(noise)} returned values that are not finite")
    return electrons


def name_of(noise: NoiseFunction) -> str:
    """Return the name of a function of the user."""
    return str(getattr(noise, "__name__", type(noise).__name__))
