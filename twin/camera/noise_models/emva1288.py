"""Shot and read noise of EMVA 1288, release 4; drawn by `twin.camera.noise`."""

from typing import Literal

from pydantic import Field

from twin.config.noise_models import NOISE_MODELS, NoiseModel


@NOISE_MODELS.register
class Emva1288(NoiseModel):
    """Poisson numbers of light and dark current, then normal read noise."""

    kind: Literal["emva1288"] = Field(
        default="emva1288",
        description="temporal noise; emva1288: shot noise of light and dark current, and "
        "read_noise_e",
    )
    is_emva1288 = True
