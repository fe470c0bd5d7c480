"""Corners of chessboards and ChArUco boards, by OpenCV, to sub-pixels."""

import cv2
import numpy as np

from reconstruction.arrays import Doubles, FloatImage, Levels
from reconstruction.calibration.boards import CharucoBoard, Chessboard, Indices
from reconstruction.errors import InputError

SOFTEN_PX = 2.0
REFINE_TURNS, REFINE_STEP_PX = 60, 1e-4


def find_corners(board: Chessboard | CharucoBoard, relative: FloatImage) -> tuple[Indices, Doubles]:
    """Return ids (n,) and image positions (n, 2) px of the corners seen.

    Raises
    ------
    InputError : the board is not recognised
    """
    image = np.clip(relative * 220.0, 0, 255).astype(np.uint8)
    if isinstance(board, Chessboard):
        ids, corners = _chessboard(board, image)
    else:
        ids, corners = _charuco(board, image)
    return ids, _refined(image, corners, _clear_share(board))


def _chessboard(board: Chessboard, image: Levels) -> tuple[Indices, Doubles]:
    found, corners = cv2.findChessboardCorners(image, (board.columns, board.rows))
    if not found:
        raise InputError(
            f"no chessboard of {board.columns} x {board.rows} inner corners is recognised; show "
            "the whole board, tilt it less, or correct the board's data"
        )
    corners = corners.reshape(board.rows, board.columns, 2).astype(np.float64)
    across, down = corners[0, -1] - corners[0, 0], corners[-1, 0] - corners[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0.0:  # OpenCV may count a row backwards
        corners = corners[:, ::-1]
    return np.arange(board.columns * board.rows), corners.reshape(-1, 2)


def _charuco(board: CharucoBoard, image: Levels) -> tuple[Indices, Doubles]:
    detector = cv2.aruco.CharucoDetector(board.opencv())
    corners, ids = detector.detectBoard(image)[:2]
    if ids is None or len(ids) < 6:
        raise InputError(
            f"{0 if ids is None else len(ids)} ChArUco corners are recognised, needed are 6; show "
            "more of the board, in focus, unmirrored, or correct the board's data"
        )
    return ids.reshape(-1), corners.reshape(-1, 2).astype(np.float64)


def _clear_share(board: Chessboard | CharucoBoard) -> float:
    """Return the half window round a corner, in squares, that holds no other edge."""
    if isinstance(board, Chessboard):
        return 0.4
    return min(0.4, 0.4 * (1.0 - board.marker_mm / board.square_mm))


def _refined(image: Levels, corners: Doubles, share: float) -> Doubles:
    spacing = np.median(_nearest_distance(corners))
    half = int(np.clip(share * spacing, 2, 30))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, REFINE_TURNS, REFINE_STEP_PX)
    start = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    # Sharp edges alias: without this blur the corners are drawn 0.05 px towards pixel centres.
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), min(SOFTEN_PX, half / 3.0))
    refined = cv2.cornerSubPix(soft, start, (half, half), (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def _nearest_distance(corners: Doubles) -> Doubles:
    distance = np.linalg.norm(corners[:, np.newaxis] - corners, axis=-1)
    np.fill_diagonal(distance, np.inf)
    return np.asarray(distance.min(axis=1))
