"""Whole measurements: from the experiment to millimetres."""

from twin.modalities.contact_fpp import press_specimen, record
from twin.modalities.direct_fpp import record_direct
from twin.modalities.measurement import Measurement, measure
from twin.modalities.recording import Recording

__all__ = [
    "Measurement",
    "Recording",
    "measure",
    "press_specimen",
    "record",
    "record_direct",
]
