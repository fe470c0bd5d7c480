"""Camera model by EMVA 1288: exposure and sensor (`sensor`), and its noise (`noise`).

Other noise: `noise_models`, `noise_function`. A module is imported at the first use of one of its
names: the kinds of noise are loaded with each experiment, the compiled kernels are not.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "noise_function" if name == "NoiseFunction" else "sensor"
    return getattr(import_module(f"{__name__}.{module}"), name)
