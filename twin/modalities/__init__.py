"""Whole measurements: from the experiment to millimetres."""

from twin.modalities.contact_fpp import press_specimen, record
from twin.modalities.direct_fpp import record_direct
from twin.modalities.measurement import Measurement, measure
from twin.modalities.photometric_stereo import PhotometricMeasurement, measure_photometric
from twin.modalities.recording import Recording

__all__ = [
    "Measurement",
    "PhotometricMeasurement",
    "Recording",
    "measure",
    "measure_photometric",
    "press_specimen",
    "record",
    "record_direct",
]
