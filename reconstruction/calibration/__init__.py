"""Calibrate camera and projector from captures of a flat board in several poses.

Board frame: x right, y up, z out of the printed face, origin in the middle of the pattern, mm.
Camera and projector are modelled as pinholes with OpenCV's distortion; the projector is a camera
with light in the reverse direction. One least squares adjustment estimates both devices and all
poses, so that every parameter has an uncertainty.
"""

from reconstruction.calibration.adjustment import Adjustment, AdjustOptions, adjust
from reconstruction.calibration.boards import Board, CharucoBoard, Chessboard, DotBoard
from reconstruction.calibration.observation import (
    BoardCapture,
    Observation,
    observe,
    read_board_capture,
)
from reconstruction.calibration.parameters import Freedom
from reconstruction.calibration.pipeline import (
    Calibrated,
    calibrate,
    length_errors_mm,
    locate_features,
)

__all__ = [
    "AdjustOptions",
    "Adjustment",
    "Board",
    "BoardCapture",
    "Calibrated",
    "CharucoBoard",
    "Chessboard",
    "DotBoard",
    "Freedom",
    "Observation",
    "adjust",
    "calibrate",
    "length_errors_mm",
    "locate_features",
    "observe",
    "read_board_capture",
]
