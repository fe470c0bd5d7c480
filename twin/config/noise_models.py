"""Camera noise as data: the base class of all kinds of noise.

A kind is one file of `twin.camera.noise_models`, of an installed package (entry points of the group
`fringe_twin.noise_models`) or of the user (`--plugin`): a subclass of `NoiseModel` that sets
`kind`, adds its numbers with ranges and sources, and overrides `electrons`.
"""

from typing import Annotated, ClassVar

import numpy as np

from reconstruction.arrays import FloatImage
from reconstruction.registry import Registry
from reconstruction.rig.sensor import SensorNoise
from twin.config.base import Model
from twin.config.kinds import OneOf, kind_of


class NoiseModel(Model):
    """Base class of all camera noise: electrons of a pixel from their mean."""

    kind: str

    is_emva1288: ClassVar[bool] = False
    """Whether it is the shot and read noise of EMVA 1288, which a compiled kernel draws."""

    def electrons(
        self, mean_e: FloatImage, rng: np.random.Generator, sensor: SensorNoise
    ) -> FloatImage:
        """Return the electrons of a frame with noise; here shot and read noise of EMVA 1288.

        Full well, dark offsets, gain, rounding and the limits of the converter follow. Frames may
        be drawn at the same time by several threads.

        Parameters
        ----------
        mean_e : (row, col) float32, mean of light and dark current
        rng : seeded by experiment, trial and frame
        sensor : read noise (e-), gain and limits of a binned pixel
        """
        read_e = rng.normal(0.0, sensor.read_noise_e, mean_e.shape)
        return (rng.poisson(mean_e) + read_e).astype(np.float32)


NOISE_MODELS: Registry[type[NoiseModel]] = Registry(
    "noise_models", "twin.camera.noise_models", kind_of
)
"""The kinds of camera noise."""

AnyNoise = Annotated[NoiseModel, OneOf(NOISE_MODELS, default="emva1288")]
