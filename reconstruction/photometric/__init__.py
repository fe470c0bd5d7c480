"""Photometric stereo: heights from the colours that lamps on three sides give a pressed gel.

Image frame: row 0 at the top, rows down, columns right; height is positive towards the camera, so
an indentation is positive; slopes are (2, row, col) mm/mm, along rows and along columns. Images
are 8-bit, red first.
"""

from reconstruction.arrays import PhotometricReason
from reconstruction.photometric.calibration_ball import BallPress, SampleOptions
from reconstruction.photometric.integrate import corrected, integrate, sdk_faithful
from reconstruction.photometric.press_files import (
    DescribedPresses,
    PhotometricResult,
    described_presses,
    read_height_map,
    reconstruct_photometric,
    write_height_map,
    write_height_points,
)
from reconstruction.photometric.sensor import (
    HeightMap,
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
    "HeightMap",
    "PhotometricDecoder",
    "PhotometricOptions",
    "PhotometricReason",
    "PhotometricResult",
    "SampleOptions",
    "SensorCalibration",
    "calibrate_sensor",
    "corrected",
    "described_presses",
    "integrate",
    "read_height_map",
    "read_sensor_calibration",
    "reconstruct_photometric",
    "sdk_faithful",
    "write_height_map",
    "write_height_points",
    "write_sensor_calibration",
]
