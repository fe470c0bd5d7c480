"""Corresponding points of camera and projector in a capture of any object, to check a rig."""

from pathlib import Path

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.capture.folder import read_uncalibrated
from reconstruction.decoding.decode import decode
from reconstruction.errors import CaptureError
from reconstruction.patterns import AXES

MOST_POINTS = 20_000
LEAST_POINTS = 100


def corresponding_points(folder: Path | str) -> FloatArray:
    """Return decoded points (n, 4) of a capture: camera x, y, projector column, row; px.

    At most 20 000 valid pixels, evenly distributed. The capture's calibration file need not exist.

    Raises
    ------
    CaptureError : the capture cannot be read, has patterns along one axis only, or fewer than 100
        pixels are decoded
    """
    capture = read_uncalibrated(folder)
    if capture.patterns.axes != AXES:
        raise CaptureError(
            f"{folder}: has fringes along {' and '.join(capture.patterns.axes)} only; a check of "
            "the pose needs both axes"
        )
    frames, scale, response = capture.stack, capture.scale, capture.response
    decoded = decode(frames, capture.patterns, capture.sensor, scale=scale, response=response)
    rows, cols = np.nonzero(decoded.valid)
    if len(rows) < LEAST_POINTS:
        raise CaptureError(
            f"{folder}: found {len(rows)} decoded pixels, a check of the pose needs {LEAST_POINTS}"
        )
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), MOST_POINTS)).astype(np.intp)
    rows, cols = rows[chosen], cols[chosen]
    column_px, row_px = decoded.column.coordinate_px, decoded.row.coordinate_px
    return np.column_stack((cols, rows, column_px[rows, cols], row_px[rows, cols])).astype(float)
