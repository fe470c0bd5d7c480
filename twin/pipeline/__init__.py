"""The stages of a measurement: press, trace, light, record, reconstruct, score.

A single measurement runs the stages with an empty memory, a sweep with a persistent one. A
command that runs some stages imports only these: imports happen at first use.
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
