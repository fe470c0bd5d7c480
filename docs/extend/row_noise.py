"""Camera noise as a plug-in: shot and read noise, and an offset that each row has of its own."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from reconstruction.arrays import FloatImage
from reconstruction.rig.sensor import SensorNoise
from twin.config.noise_models import NOISE_MODELS, NoiseModel


@NOISE_MODELS.register
class RowNoise(NoiseModel):
    """Normal offset of each row, drawn for each frame: a CMOS sensor is read row by row."""

    kind: Literal["row_noise"] = "row_noise"
    row_sigma_e: Annotated[float, Field(ge=0, le=1e5)] = Field(
        default=2.0, description="standard deviation of the rows' offsets; assumed"
    )

    def electrons(
        self, mean_e: FloatImage, rng: np.random.Generator, sensor: SensorNoise
    ) -> FloatImage:
        """Return the electrons of EMVA 1288, plus the same offset in each pixel of a row."""
        rows_e = rng.normal(0.0, self.row_sigma_e, (len(mean_e), 1)).astype(np.float32)
        return super().electrons(mean_e, rng, sensor) + rows_e
