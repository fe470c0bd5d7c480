"""Calibrate camera and projector from captures of a flat board in several poses.

Board frame: x right, y up, z out of the printed face, origin in the middle of the pattern, mm.
The camera is an OpenCV pinhole, the projector an inverse one; both and all poses are adjusted
together, so that every parameter has an uncertainty.
"""

from reconstruction.calibration.adjustment import Adjustment, AdjustOptions, adjust
from reconstruction.calibration.boards import Board, CharucoBoard, Chessboard, DotBoard
from reconstruction.calibration.captures import BoardCapture, read_board_capture
from reconstruction.calibration.freedom import Freedom
from reconstruction.calibration.locate import length_errors_mm, locate_features
from reconstruction.calibration.observation import Observation, observe
from reconstruction.calibration.pipeline import Calibrated, calibrate

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
