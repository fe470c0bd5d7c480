"""Calibration figures computed by hand: blobs, centroids, lines, poses."""

from types import SimpleNamespace

import numpy as np
import pytest

from reconstruction.calibration import length_errors_mm
from reconstruction.calibration.boards import Chessboard, DotBoard
from reconstruction.calibration.features import find_dots, refine_centres
from reconstruction.calibration.observation import relative_brightness, white_print
from reconstruction.calibration.pipeline import (
    calibration_of,
    parameters_of,
    pose_residuals,
    pupil_diameter_mm,
)
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.epipolar import epipolar_residuals_px
from reconstruction.rig.pinhole import Pinhole

ROW, COL = np.mgrid[:120, :160].astype(float)


def disc(col, row, radius, stretch=1.0):
    """Return the share of ink of an ellipse, its columns stretched; edges one pixel wide."""
    distance = np.hypot((COL - col) / stretch, ROW - row)
    return np.clip(radius + 0.5 - distance, 0.0, 1.0)


def dots_of(ink):
    relative = (1.0 - 0.9 * np.clip(ink, 0.0, 1.0)).astype(np.float32)
    return relative, find_dots(relative, 0.55)


def discs_in(ink):
    return np.round(dots_of(ink)[1].centres_px).tolist()


def test_shapes_that_pass_for_a_dot():
    """A blob is an ellipse when 4 pi sqrt(det M) is its area to 12 %, its axes as 0.45 to 1.

    A ring of radii 3 and 10 has (100 + 9) / (100 - 9) = 1.198 of its area; of 2 and 10 1.083. A
    square has 4 pi / 12 = 1.047, and so passes for a dot: grid and neighbours decide.
    """
    assert discs_in(disc(40, 50, 10)) == [[40, 50]]
    assert discs_in(disc(40, 50, 10) - disc(40, 50, 2)) == [[40, 50]]
    assert discs_in(disc(40, 50, 10) - disc(40, 50, 3)) == []
    square = ((abs(COL - 60) <= 8) & (abs(ROW - 50) <= 8)).astype(float)
    assert discs_in(square) == [[60, 50]]
    assert discs_in(disc(60, 50, 10, 2.0)) == [[60, 50]]
    assert discs_in(disc(60, 50, 10, 2.4)) == []
    assert discs_in(disc(60, 50, 10, 0.4)) == []


def test_a_dot_needs_forty_pixels_and_lies_within_the_image():
    """Squares of 6 x 6 and 6 x 7 pixels; a disc touching the image's edge, and next to it."""
    small = ((abs(COL - 20.5) < 3) & (abs(ROW - 20.5) < 3)) * 1.0
    large = ((abs(COL - 20.5) < 3) & (abs(ROW - 20) < 4)) * 1.0
    assert (small.sum(), large.sum()) == (36, 42)
    assert (len(discs_in(small)), len(discs_in(large))) == (0, 1)
    assert (len(discs_in(disc(7, 50, 8))), len(discs_in(disc(8, 50, 8)))) == (0, 1)
    assert (len(discs_in(disc(152, 50, 8))), len(discs_in(disc(151, 50, 8)))) == (0, 1)
    assert (len(discs_in(disc(50, 112, 8))), len(discs_in(disc(50, 111, 8)))) == (0, 1)


def test_a_dirty_dot_is_drawn_away_from_its_dirt():
    """Of a dot of radius 10, pi 100 px, 9 px are bare, (5, -3) px from its middle.

    Ink is left of 314.16 - 9 px: the centroid moves by -9 / 305.16 of that, (-0.1475, 0.0885) px.
    """
    relative, dots = dots_of(disc(60.5, 50.5, 10))
    np.testing.assert_allclose(refine_centres(relative, dots)[0], [[60.5, 50.5]], atol=2e-3)
    speck = np.clip(2.0 - np.abs(COL - 65.5), 0, 1) * np.clip(2.0 - np.abs(ROW - 47.5), 0, 1)
    assert speck.sum() == pytest.approx(9.0)
    relative, dots = dots_of(disc(60.5, 50.5, 10) - speck)
    centre, result = refine_centres(relative, dots)
    assert result.all()
    np.testing.assert_allclose(centre, [[60.5 - 0.1475, 50.5 + 0.0885]], atol=3e-3)


def test_shading_across_a_dot_is_divided_out():
    """White decreases linearly by 1/3 across the dot's window: the centre is right to 0.01 px."""
    relative, dots = dots_of(disc(60.5, 50.5, 10))
    shade = (1.0 - (COL - 60.0) / 100.0 + (ROW - 50.0) / 300.0).astype(np.float32)
    centre, _ = refine_centres(relative * shade, dots)
    np.testing.assert_allclose(centre, [[60.5, 50.5]], atol=0.01)


def test_where_no_white_is_near_brightness_counts_from_a_twentieth():
    """Left 1000 DN, right 10: there 10 / (0.05 * 1000) = 0.2 of white; left 1."""
    image = np.where(COL < 40, 1000.0, 10.0).astype(np.float32)
    result = relative_brightness(image)
    assert result[60, 150] == pytest.approx(0.2, rel=1e-6)
    assert result[60, 5] == pytest.approx(1.0, rel=1e-6)


def test_white_keeps_a_margin_from_ink():
    """Ink at (5, 5), a margin of 2: the 5 x 5 pixels round it are no white; image borders are."""
    relative = np.ones((12, 14), np.float32)
    relative[5, 5] = 0.5
    white = white_print(relative, 0.5, 2)
    rows, cols = np.nonzero(~white)
    assert (rows.min(), rows.max(), cols.min(), cols.max()) == (3, 7, 3, 7)
    assert white.sum() == 12 * 14 - 25


def motion(rotation=None, shift=(0.0, 0.0, 0.0)):
    T = np.eye(4)
    T[:3, :3] = np.eye(3) if rotation is None else rotation
    T[:3, 3] = shift
    return T


CAMERA = Pinhole(200, 100, 50.0, 50.0, 99.5, 49.5)
PROJECTOR = Pinhole(400, 300, 100.0, 100.0, 199.5, 149.5)
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def test_the_world_is_the_first_board():
    """Camera 10 mm before the board, turned a quarter; projector (3, 0, 4) mm from the camera.

    The camera's centre in the board's frame is -R^T t = (0, 0, -10); the projector is where
    R x + t = 0 in its own frame, at -(3, 0, 4) in the camera's: turned back (0, 3, -4), and so at
    (0, 3, -14) in the world.
    """
    boards = np.stack([motion(QUARTER, (0.0, 0.0, 10.0)), np.eye(4)])
    rig = SimpleNamespace(
        camera=CAMERA, projector=PROJECTOR, T_cam_from_board=boards,
        T_proj_from_cam=motion(shift=(3.0, 0.0, 4.0)),
    )  # fmt: skip
    result = calibration_of(SimpleNamespace(rig=rig))
    assert (result.camera, result.projector) == (CAMERA, PROJECTOR)
    np.testing.assert_allclose(result.T_world_from_cam[:3, 3], [0.0, 0.0, -10.0])
    np.testing.assert_allclose(result.T_world_from_cam[:3, :3], QUARTER.T)
    np.testing.assert_allclose(result.T_world_from_proj[:3, 3], [0.0, 3.0, -14.0])
    assert parameters_of(result)["baseline_mm"] == pytest.approx(5.0)
    np.testing.assert_allclose(result.T_proj_from_cam, rig.T_proj_from_cam, atol=1e-12)


def test_epipolar_lines_of_devices_side_by_side_are_rows():
    """Both look the same way: a camera row is a projector row, at twice the focal length.

    The camera's row 59.5, 10 px below its middle, is 20 px below the projector's: 169.5. Points at
    that row have error 0, 3 px below error 3 px, in any column.
    """
    rig = Calibration(CAMERA, PROJECTOR, np.eye(4), motion(shift=(7.0, 0.0, 0.0)))
    measured = np.array([[30.0, 59.5, 10.0, 169.5], [30.0, 59.5, 350.0, 172.5]])
    result = np.abs(epipolar_residuals_px(rig, measured))
    np.testing.assert_allclose(result, [0.0, 3.0], atol=1e-9)


def test_epipolar_distances_are_pixels_of_wide_pixels_too():
    """Pixels twice as wide as high, fx = 50, fy = 100: 3 px below the line are 3 px."""
    wide = Pinhole(200, 300, 50.0, 100.0, 99.5, 149.5)
    rig = Calibration(CAMERA, wide, np.eye(4), motion(shift=(7.0, 0.0, 0.0)))
    result = np.abs(epipolar_residuals_px(rig, np.array([[30.0, 59.5, 50.0, 172.5]])))
    np.testing.assert_allclose(result, 3.0, atol=1e-9)


def test_residuals_of_a_pose_exclude_unused_points():
    """Used residuals (3, 4) and (0, 0): RMS over four numbers 2.5; the projector's half of it."""
    rig = Calibration(CAMERA, PROJECTOR, np.eye(4), motion(shift=(7.0, 0.0, 0.0)))
    adjustment = SimpleNamespace(
        rig=rig,
        used=[np.array([True, False, True])],
        residuals_px=[np.array([[3.0, 4.0, 1.5, 2.0], [9.0] * 4, [0.0] * 4])],
        measured_px=[np.array([[30.0, 59.5, 10.0, 172.5], [0.0] * 4, [30.0, 59.5, 10.0, 169.5]])],
    )
    (result,) = pose_residuals(adjustment, [SimpleNamespace(name="flat")])
    assert (result.name, result.features, result.left_out) == ("flat", 2, 1)
    assert (result.camera_px, result.projector_px) == (2.5, 1.25)
    assert result.epipolar_px == pytest.approx(3.0 / 2.0**0.5)


def test_a_pupil_is_four_times_the_root_of_its_mean_square():
    """A disc of diameter D has the mean square D^2 / 16; below three sigmas it is not seen."""
    assert pupil_diameter_mm(SimpleNamespace(pupil_mm2=4.0, pupil_sigma_mm2=1.0)) == 8.0
    assert pupil_diameter_mm(SimpleNamespace(pupil_mm2=2.9, pupil_sigma_mm2=1.0)) == 0.0


def test_lengths_of_a_stretched_board():
    """A board of 4 x 4 dots of 3 mm pitch, 1 % too large: 24 lengths of 3 mm, 0.03 mm off."""
    points = DotBoard(4, 4, 3.0, 1.0, 1.5).points_mm
    errors = length_errors_mm(1.01 * points, SimpleNamespace(points_mm=points), 3.0)
    assert len(errors) == 24
    np.testing.assert_allclose(errors, 0.03)


def test_squares_of_a_chessboard():
    """3 x 3 inner corners of 2 mm squares: the plate is 8 mm wide, corners count from (-2, 2).

    Ink and white take turns at every corner; ink where the steps right and down have one sign.
    """
    board = Chessboard(3, 3, 2.0)
    assert board.points_mm[0].tolist() == [-2.0, 2.0, 0.0]
    assert board.points_mm[-1].tolist() == [2.0, -2.0, 0.0]
    at = np.array([-5.0, -3.0, -1.0, 1.0, 3.0, 5.0])
    ink = board.ink(at, at[::-1], 0.1)
    assert ink[:, 0].sum() + ink[:, -1].sum() + ink[0].sum() + ink[-1].sum() == 0.0
    assert ink[1:5, 1:5].tolist() == [[1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 1.0]] * 2
