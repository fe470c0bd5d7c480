"""Photometric stereo: measure heights of a pressed gel from its colours under lamps on three sides.

Image frame: row 0 is at the top, rows increase downwards, columns to the right. Height is positive
towards the camera, so an indentation of the gel is positive. Slopes are (2, row, col) mm/mm: change
of height per distance downwards, and to the right. Images are 8-bit, red
first.
"""

from reconstruction.arrays import PhotometricReason
from reconstruction.photometric.calibration_ball import BallPress, SampleOptions
from reconstruction.photometric.height_map import HeightMap
from reconstruction.photometric.integrate import corrected, integrate, sdk_faithful
from reconstruction.photometric.press_files import (
    DescribedPresses,
    PhotometricResult,
    described_presses,
    read_height_map,
    reconstruct_photometric,
    write_dots,
    write_height_map,
    write_height_points,
)
from reconstruction.photometric.printed_dots import DotOptions, GelMotion, SensorDots, gel_motion
from reconstruction.photometric.rest_surface import RestSurface
from reconstruction.photometric.sensor import (
    PhotometricDecoder,
    PhotometricOptions,
    SensorCalibration,
    calibrate_sensor,
    read_sensor_calibration,
    write_sensor_calibration,
)

__all__ = [
    "BallPress",
    "DescribedPresses",
    "DotOptions",
    "GelMotion",
    "HeightMap",
    "PhotometricDecoder",
    "PhotometricOptions",
    "PhotometricReason",
    "PhotometricResult",
    "RestSurface",
    "SampleOptions",
    "SensorCalibration",
    "SensorDots",
    "calibrate_sensor",
    "corrected",
    "described_presses",
    "gel_motion",
    "integrate",
    "read_height_map",
    "read_sensor_calibration",
    "reconstruct_photometric",
    "sdk_faithful",
    "write_dots",
    "write_height_map",
    "write_height_points",
    "write_sensor_calibration",
]
