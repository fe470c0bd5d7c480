"""Dots in an image: sub-pixel centres, identities, and images to reject."""

import numpy as np
import pytest

from reconstruction.calibration.boards import DotBoard
from reconstruction.calibration.features import find_dots, label_dots, refine_centres
from reconstruction.calibration.observation import (
    ink_threshold,
    observe,
    relative_brightness,
    white_print,
)
from reconstruction.calibration.plane_images import (
    apply_homography,
    centre_bias_px,
    ellipse_centres,
    fit_homography,
)
from reconstruction.capture.folder import UncalibratedCapture
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.pinhole import Pinhole

BOARD = DotBoard(9, 7, 2.0, 0.8, 1.2)
CAMERA = Pinhole(360, 280, 2800.0, 2800.0, 179.5, 139.5)
FINE = 3
HIERARCHICAL = {"code": "hierarchical", "further_periods_px": (600.0, 90.0)}


def motion(tilt_deg=0.0, spin_deg=0.0, distance_mm=180.0):
    """Return T_cam_from_board: the camera looks at the printed face, board y up."""
    tilt, spin = np.radians([tilt_deg, spin_deg])
    ct, st, cs, ss = np.cos(tilt), np.sin(tilt), np.cos(spin), np.sin(spin)
    about_y = np.array([[ct, 0, st], [0, 1, 0], [-st, 0, ct]])
    about_z = np.array([[cs, -ss, 0], [ss, cs, 0], [0, 0, 1]])
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ about_y @ about_z
    T[2, 3] = distance_mm
    return T


def photograph(T):
    """Return the brightness of every pixel, white 1 and ink 0.1.

    FINE x FINE samples per pixel; edges are one sample wide, so that the dots' areas are exact.
    """
    sub = (np.arange(FINE) + 0.5) / FINE - 0.5
    x = (np.arange(CAMERA.width_px)[:, None] + sub).ravel()
    y = (np.arange(CAMERA.height_px)[:, None] + sub).ravel()
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    rays = np.column_stack([CAMERA.unproject(pixels), np.ones(len(pixels))])
    normal = T[:3, 2]
    points = rays * (normal @ T[:3, 3] / (rays @ normal))[:, None]
    on_board = (points - T[:3, 3]) @ T[:3, :2]
    column = np.clip(np.rint(on_board[:, 0] / BOARD.pitch_mm) + 4, 0, 8).astype(int)
    row = np.clip(3 - np.rint(on_board[:, 1] / BOARD.pitch_mm), 0, 6).astype(int)
    ids = row * 9 + column
    distance = np.linalg.norm(on_board - BOARD.points_mm[ids, :2], axis=1)
    sample_mm = T[2, 3] / CAMERA.fx_px / FINE
    inside = np.clip(0.5 + (BOARD.radii_mm[ids] - distance) / sample_mm, 0.0, 1.0)
    shape = (CAMERA.height_px, FINE, CAMERA.width_px, FINE)
    return (1.0 - 0.9 * inside.reshape(shape).mean(axis=(1, 3))).astype(np.float32)


def detect(image):
    relative = relative_brightness(image)
    dots = find_dots(relative, ink_threshold(relative))
    ids, members = label_dots(BOARD, dots)
    centres, result = refine_centres(relative, dots.chosen(np.array(members)))
    return np.array(ids)[result], centres[result]


def imaged_centres(T, ids):
    """Return the centres of the dots' image ellipses, px: closed form of `conics`."""
    inside = BOARD.points_mm[ids] @ T[:3, :3].T + T[:3, 3]
    flat = ellipse_centres(inside, BOARD.radii_mm[ids], T[:3, :3])
    return flat * [CAMERA.fx_px, CAMERA.fy_px] + [CAMERA.cx_px, CAMERA.cy_px]


@pytest.mark.parametrize(("tilt_deg", "spin_deg"), [(0.0, 0.0), (25.0, 15.0), (35.0, 195.0)])
def test_every_dot_is_named_and_centred(tilt_deg, spin_deg):
    """Expected: all 63 identities, ellipse centres to 0.01 px RMS (sampling of the test image)."""
    T = motion(tilt_deg, spin_deg)
    ids, centres = detect(photograph(T))
    assert sorted(ids) == list(range(63))
    error = centres - imaged_centres(T, ids)
    assert np.sqrt(np.mean(error**2)) < 0.01
    assert np.abs(error).max() < 0.03


def test_shading_does_not_move_the_dots():
    """Setup: brightness decreases to 50 % across. Expected: centres as without it, 0.005 px."""
    image = photograph(motion(20.0, 10.0))
    shade = np.linspace(1.0, 0.5, image.shape[1], dtype=np.float32)
    ids, centres = detect(image)
    shaded_ids, shaded = detect(image * shade)
    np.testing.assert_array_equal(ids, shaded_ids)
    np.testing.assert_allclose(shaded, centres, atol=0.005)


def test_a_mirrored_image_is_rejected():
    with pytest.raises(InputError, match="unmirrored"):
        detect(np.ascontiguousarray(photograph(motion(15.0, 10.0))[:, ::-1]))


def test_hidden_fiducial_is_explained():
    T = motion()
    image = photograph(T)
    x, y = imaged_centres(T, np.array(BOARD.fiducial_ids))[1].astype(int)
    image[y - 15 : y + 16, x - 15 : x + 16] = 1.0
    with pytest.raises(InputError, match="larger dots found"):
        detect(image)


def test_dirt_and_a_cut_board_are_survived():
    """Setup: a scratch, a blot and the left third of the board outside. Expected: right names."""
    T = motion(10.0, 5.0)
    T[0, 3] = -7.0
    image = photograph(T)
    image[20:24, 200:330] = 0.1
    image[250:262, 250:257] = 0.1
    ids, centres = detect(image)
    assert 30 <= len(ids) < 63
    np.testing.assert_allclose(centres, imaged_centres(T, ids), atol=0.05)


def test_black_image_is_explained():
    with pytest.raises(InputError, match="black"):
        relative_brightness(np.zeros((20, 20), np.float32))


def test_white_print_keeps_away_from_ink():
    relative = np.ones((9, 9), np.float32)
    relative[4, 4] = 0.1
    assert white_print(relative, 0.5, 2).sum() == 81 - 25


def test_centre_of_a_circles_image_in_closed_form():
    """Setup: a circle tilted by 40 degrees near the camera.

    Expected: the centre of its image is the mean of the two extreme points of every chord through
    it; for a tilt about y the horizontal axis of the ellipse ends at X(0) and X(pi); their mean
    is the centre's x. The bias has the first-order size r^2 sin(t) cos(t) / z^2.
    """
    T = motion(40.0, 0.0, distance_mm=60.0)
    radius = 3.0
    inside = T[:3, 3][None]
    centre = ellipse_centres(inside, np.array([radius]), T[:3, :3])[0]
    ends = inside + radius * np.array([[1.0], [-1.0]]) * T[:3, 0]
    middle = np.mean(ends[:, :2] / ends[:, 2:], axis=0)
    np.testing.assert_allclose(centre, middle, atol=1e-14)
    bias = centre_bias_px(CAMERA, inside, np.array([radius]), T[:3, :3])[0]
    tilt = np.radians(40.0)
    first_order = CAMERA.fx_px * radius**2 * np.sin(tilt) * np.cos(tilt) / 60.0**2
    np.testing.assert_allclose(abs(bias[0]), first_order, rtol=radius**2 / 60.0**2)
    assert abs(bias[1]) < 1e-9


def test_a_circle_facing_the_camera_has_no_bias():
    inside = np.array([[2.0, -1.0, 100.0]])
    bias = centre_bias_px(CAMERA, inside, np.array([0.5]), np.eye(3))
    np.testing.assert_allclose(bias, 0.0, atol=1e-12)


def test_homography_is_recovered_and_needs_four_points():
    H = np.array([[1.1, 0.1, 5.0], [-0.2, 0.9, 3.0], [1e-4, -2e-4, 1.0]])
    points = np.random.default_rng(0).uniform(0, 1000, (50, 2))
    result = fit_homography(points, apply_homography(H, points))
    np.testing.assert_allclose(result, H, rtol=1e-6)
    with pytest.raises(InputError, match="4 points"):
        fit_homography(points[:3], points[:3])
    with pytest.raises(InputError, match="line"):
        fit_homography(points[:, :1] * [1.0, 2.0], points)


@pytest.mark.parametrize("code", [{}, HIERARCHICAL])
def test_a_board_needs_no_white_and_no_black(quiet_sensor, synthesise, code):
    """Setup: phase frames and their numbering only. Expected: the pixels that the frames show.

    Why: the mean of the phase frames is the image of the board.
    """
    to_projector = np.array([[0.9, 0.03, 80.0], [-0.02, 0.85, 60.0], [2e-5, -3e-5, 1.0]])
    image = photograph(motion(20.0, 10.0))
    pixels = np.stack(np.meshgrid(*map(np.arange, image.shape[::-1])), axis=-1).reshape(-1, 2)
    there = apply_homography(to_projector, pixels.astype(float)).reshape(*image.shape, 2)
    patterns = PatternSet(560, 420, steps=4, uniform=False, **code)
    stack = synthesise(patterns, there[..., 0], there[..., 1]) * image
    capture = UncalibratedCapture(stack.astype(np.float32), patterns, quiet_sensor)
    seen = observe(capture, BOARD)
    assert len(seen.ids) > 40
    centres = imaged_centres(motion(20.0, 10.0), seen.ids)
    assert np.sqrt(np.mean((seen.camera_px - centres) ** 2)) < 0.01
    expected = apply_homography(to_projector, seen.camera_px)
    np.testing.assert_allclose(seen.projector_px, expected, atol=2e-3)
