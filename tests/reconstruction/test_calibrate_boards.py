"""Boards: the detected features are the printed ones."""

import numpy as np
import pytest

from reconstruction.calibration.boards import CharucoBoard, Chessboard, DotBoard
from reconstruction.calibration.features import find_corners
from reconstruction.errors import InputError

DOTS = DotBoard(9, 7, 2.0, 0.8, 1.2)
PX_PER_MM = 20.0


def printed(board, half_x_mm=12.0, half_y_mm=9.0):
    """Return the board's brightness seen flat, (row, col), 20 px per mm, middle at the middle."""
    x_mm = (np.arange(int(2 * half_x_mm * PX_PER_MM)) + 0.5) / PX_PER_MM - half_x_mm
    y_mm = half_y_mm - (np.arange(int(2 * half_y_mm * PX_PER_MM)) + 0.5) / PX_PER_MM
    ink = board.ink(x_mm, y_mm, 1.0 / PX_PER_MM)
    return (1.0 - 0.9 * ink).astype(np.float32)


def place_px(points_mm, half_x_mm=12.0, half_y_mm=9.0):
    x = (points_mm[:, 0] + half_x_mm) * PX_PER_MM - 0.5
    y = (half_y_mm - points_mm[:, 1]) * PX_PER_MM - 0.5
    return np.column_stack([x, y])


def test_first_dot_is_top_left_and_the_middle_is_the_origin():
    points = DOTS.points_mm
    np.testing.assert_allclose(points[0], [-8.0, 6.0, 0.0])
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-12)
    origin, right, upper = points[list(DOTS.fiducial_ids)]
    np.testing.assert_allclose(right - origin, [4.0, 0.0, 0.0])
    np.testing.assert_allclose(upper - origin, [0.0, 2.0, 0.0])


def test_printed_ink_has_the_area_of_the_dots():
    """Expected: sum of pi r^2; edges of one texel keep the area to second order."""
    ink = (1.0 - printed(DOTS)) / 0.9
    np.testing.assert_allclose(
        ink.sum() / PX_PER_MM**2, np.sum(np.pi * DOTS.radii_mm**2), rtol=2e-3
    )


@pytest.mark.parametrize(
    "board", [Chessboard(9, 6, 2.0), CharucoBoard(8, 6, 2.0, 1.3)], ids=["chess", "charuco"]
)
def test_corners_are_found_where_they_are_printed(board):
    """Setup: noise-free flat print. Expected: every corner, to 0.05 px, with the right identity."""
    ids, corners = find_corners(board, printed(board))
    assert len(ids) == board.columns * board.rows
    np.testing.assert_allclose(corners, place_px(board.points_mm[ids]), atol=0.05)


@pytest.mark.parametrize("board", [Chessboard(9, 6, 2.0), CharucoBoard(8, 6, 2.0, 1.3)])
def test_a_blank_sheet_is_no_board(board):
    with pytest.raises(InputError, match=r"recognised"):
        find_corners(board, np.ones((200, 300), np.float32))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((3, 7, 2.0, 0.8, 1.2), "columns"),
        ((9, 7, 0.0, 0.8, 1.2), "pitch_mm"),
        ((9, 7, 2.0, 0.8, 0.9), "fiducial_diameter_mm"),
        ((9, 7, 2.0, 0.8, 1.9), "fiducial_diameter_mm"),
    ],
)
def test_impossible_dot_boards_are_rejected(values, message):
    with pytest.raises(InputError, match=message):
        DotBoard(*values)
