"""Run the stages of a virtual measurement: press, trace, light, record, reconstruct, score.

A `Memory` caches the results of stages. A single measurement starts with an empty memory; a sweep
uses one memory for all its measurements. A module of this package is imported at the first use of
one of its names, so that a command imports only the stages that it runs.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.pipeline.fringes import record, render, render_bare, take
    from twin.pipeline.memory import Memory
    from twin.pipeline.methods import measure
    from twin.pipeline.press import press_specimen
    from twin.results.record import Measurement, Recording

__all__ = [
    "Measurement",
    "Memory",
    "Recording",
    "measure",
    "press_specimen",
    "record",
    "render",
    "render_bare",
    "take",
]

_PLACES = {
    "Measurement": "twin.results.record",
    "Memory": "twin.pipeline.memory",
    "Recording": "twin.results.record",
    "measure": "twin.pipeline.methods",
    "press_specimen": "twin.pipeline.press",
    "record": "twin.pipeline.fringes",
    "render": "twin.pipeline.fringes",
    "render_bare": "twin.pipeline.fringes",
    "take": "twin.pipeline.fringes",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), name)
