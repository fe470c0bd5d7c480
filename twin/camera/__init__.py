"""Camera model by EMVA 1288: exposure and sensor (`sensor`), noise (`noise`, `noise_function`)."""

from twin.camera.noise_function import NoiseFunction
from twin.camera.sensor import (
    Exposed,
    choose_exposure_ms,
    electrons_per_ms,
    expose,
    full_well_e,
    gain_dn_per_e,
    largest_code_dn,
    noise_model,
    read_noise_e,
)

__all__ = [
    "Exposed",
    "NoiseFunction",
    "choose_exposure_ms",
    "electrons_per_ms",
    "expose",
    "full_well_e",
    "gain_dn_per_e",
    "largest_code_dn",
    "noise_model",
    "read_noise_e",
]
