"""Whole measurements: contact-FPP from press to millimetres."""

from twin.modalities.contact_fpp import Measurement, Recording, measure, press_specimen, record

__all__ = ["Measurement", "Recording", "measure", "press_specimen", "record"]
