"""The way of a measurement in stages: press, trace, light, record, reconstruct, score.

A single measurement is the way with an empty memory, a sweep the same way with one that lasts.
"""

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
