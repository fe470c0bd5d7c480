"""The joint adjustment: exact on exact data, correct sigma, messages on missing data."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from reconstruction.calibration import (
    AdjustOptions,
    DotBoard,
    Freedom,
    Observation,
    calibrate,
    length_errors_mm,
    locate_features,
)
from reconstruction.calibration.pipeline import parameters_of
from reconstruction.calibration.plane_images import centre_bias_px
from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration, read_calibration, write_calibration
from reconstruction.rig.epipolar import epipolar_residuals_px
from reconstruction.rig.pinhole import Pinhole

BOARD = DotBoard(9, 7, 3.0, 1.2, 1.8)
CAMERA = Pinhole(1936, 1464, 14500.0, 14500.0, 985.0, 720.0, (-0.8, 0.0, 0.0, 0.0, 0.0))
# The principal point is 200 px below the image, where OpenCV accepts no guess.
PROJECTOR = Pinhole(1280, 720, 1536.0, 1536.0, 632.0, 920.0)


@pytest.fixture(scope="module")
def rig(aim):
    """Return a narrow-field camera above the board and an off-axis projector 25 degrees aside."""
    return Calibration(
        CAMERA, PROJECTOR, aim([0.0, 0.0, 214.0], [0.0, 0.0, 0.0]), aim_projector(aim)
    )


def aim_projector(aim):
    # The middle of the image, not the optical axis, shows the board.
    T = aim([106.0, -83.0, 215.0], [0.0, -83.0, 0.0])
    return np.asarray(T)


def board_poses(count=8, tilt_deg=20.0):
    poses = [np.eye(4)]
    for k in range(1, count):
        T = np.eye(4)
        azimuth, spin = 137.5 * k, 40.0 * k
        tilts = (azimuth, tilt_deg - 6.0 * (k % 2), spin - azimuth)
        T[:3, :3] = Rotation.from_euler("ZYZ", tilts, degrees=True).as_matrix()
        T[:3, 3] = (k % 3 - 1.0, 0.7 * (k % 2), 0.8 * (k % 5 - 2))
        poses.append(T)
    return poses


def observations(rig, poses, noise_px=(0.0, 0.0), seed=0):
    """Return the dots of an ideal detector, with perspective bias and noise.

    The projector coordinate is that of the dot's centre in the camera image.
    """
    rng = np.random.default_rng(seed)
    return [_observation(rig, T, f"pose_{k}", noise_px, rng) for k, T in enumerate(poses)]


def _observation(rig, T_world_from_board, name, noise_px, rng):
    into_cam = np.linalg.inv(rig.T_world_from_cam) @ T_world_from_board
    into_proj = rig.T_proj_from_cam @ into_cam
    camera = rig.camera.project(moved(into_cam, BOARD.points_mm))
    projector = rig.projector.project(moved(into_proj, BOARD.points_mm))
    slopes = local_slopes(rig, into_cam, into_proj)
    inside = moved(into_cam, BOARD.points_mm)
    shift = centre_bias_px(rig.camera, inside, BOARD.radii_mm, into_cam[:3, :3])
    shift = shift + noise_px[0] * rng.standard_normal(shift.shape)
    along = np.einsum("nij,nj->ni", slopes, shift)
    along = along + noise_px[1] * rng.standard_normal(shift.shape)
    return Observation(
        name,
        BOARD.points_mm,
        BOARD.radii_mm,
        camera + shift,
        projector + along,
        slopes,
        np.arange(len(BOARD.points_mm)),
        (1936, 1464),
        (1280, 720),
    )


def moved(T, points):
    return points @ T[:3, :3].T + T[:3, 3]


def local_slopes(rig, into_cam, into_proj):
    """Return d(projector) / d(camera) on the board by central differences."""
    step = 1e-3
    by_camera, by_projector = [], []
    for axis in range(2):
        ends = [BOARD.points_mm + side * step * np.eye(3)[axis] for side in (-1, 1)]
        for result, device, T in (
            (by_camera, rig.camera, into_cam),
            (by_projector, rig.projector, into_proj),
        ):
            low, high = (device.project(moved(T, points)) for points in ends)
            result.append((high - low) / (2 * step))
    return np.stack(by_projector, axis=-1) @ np.linalg.inv(np.stack(by_camera, axis=-1))


@pytest.fixture(scope="module")
def exact(rig):
    observed = observations(rig, board_poses())
    return observed, calibrate(observed)


def test_exact_correspondences_give_the_exact_rig(rig, exact):
    """Setup: distorted camera, principal point of the projector 200 px below its image.

    Expected: every parameter to 1e-6 of its size (1e-6 mm, px, rad where it is 0).
    """
    _, result = exact
    for name, true in parameters_of(rig).items():
        value = next(p.value for p in result.parameters if p.name == name)
        assert value == pytest.approx(true, rel=1e-6, abs=1e-6), name


def test_world_is_the_first_board(rig, exact, tmp_path):
    """The first pose is the world here as well: transforms agree, and survive the file."""
    _, result = exact
    write_calibration(tmp_path / "calibration.yaml", result.calibration)
    read = read_calibration(tmp_path / "calibration.yaml")
    np.testing.assert_allclose(read.T_world_from_cam, rig.T_world_from_cam, atol=1e-6)
    np.testing.assert_allclose(read.T_world_from_proj, rig.T_world_from_proj, atol=1e-6)


def test_epipolar_miss_is_the_distance_from_the_line(rig, exact):
    """Expected: 0 for exact points and for points moved along their line, 1 px across it."""
    measured = exact[1].adjustment.measured_px[3]
    assert np.abs(epipolar_residuals_px(rig, measured)).max() < 1e-6
    rays = np.column_stack([rig.camera.unproject(measured[:, :2]), np.ones(len(measured))])
    near, far = (rig.projector.project(moved(rig.T_proj_from_cam, z * rays)) for z in (200, 230))
    along = (far - near) / np.linalg.norm(far - near, axis=1, keepdims=True)
    across = along[:, ::-1] * [-1.0, 1.0]
    for step, expected in ((along, 0.0), (across, 1.0)):
        nudged = np.hstack([measured[:, :2], measured[:, 2:] + step])
        np.testing.assert_allclose(np.abs(epipolar_residuals_px(rig, nudged)), expected, atol=1e-6)


def test_located_dots_keep_their_distances(rig, exact):
    observed, _ = exact
    points = locate_features(rig, observed[4])
    np.testing.assert_allclose(points, moved(board_poses()[4], BOARD.points_mm), atol=1e-6)
    errors = length_errors_mm(points, observed[4], 15.0)
    assert len(errors) > 60  # 5 columns, 5 rows, and 3-4-5 triangles
    assert np.abs(errors).max() < 1e-6


def test_stated_covariance_is_the_actual_scatter(rig):
    """Setup: 6 noisy draws. Expected: Mahalanobis distances of the rig's parameters are chi^2.

    The errors are independent. Correlated ones: `test_calibrate_intervals`.
    The covariance must hold as a whole, since focal length and distance err together. Bounds leave
    one false alarm in 1000.
    """
    poses = board_poses(7)
    truth = np.array(list(parameters_of(rig).values())[:-1])
    free = [0, 2, 3, 4, 9, 11, 12, *range(18, 24)]
    total, draws = 0.0, 6
    for seed in range(draws):
        noise = (0.02, 0.003)
        result = calibrate(observations(rig, poses, noise, seed)).adjustment
        miss = result.vector[free] - truth[free]
        stated = result.independent_covariance[np.ix_(free, free)]
        total += miss @ np.linalg.solve(stated, miss)
    low, high = chi2.ppf([0.0005, 0.9995], draws * len(free))
    assert low < total < high
    np.testing.assert_allclose(result.spread_px, noise, rtol=0.1)


def test_neglected_dot_bias_moves_the_tilted_boards(rig, exact):
    """Setup: 1.2 mm dots, tilt t = 20 degrees, distance z = 214 mm, no noise.

    Expected: with the correction the poses are exact; without it each tilted board appears
    shifted by the dots' mean bias, r^2 sin(t) cos(t) / z = 0.57 um (the rig hardly feels it: all
    dots of a board move alike).
    """
    observed, corrected = exact
    neglected = calibrate(observed, AdjustOptions(correct_dot_bias=False))
    tilt = np.radians(20.0)
    first_order_mm = np.mean(BOARD.radii_mm**2) * np.sin(tilt) * np.cos(tilt) / 214.0
    true = [np.linalg.inv(rig.T_world_from_cam) @ T for T in board_poses()]
    for result, expected in ((corrected, 0.0), (neglected, first_order_mm)):
        shifts = result.adjustment.rig.T_cam_from_board[:, :2, 3] - np.stack(true)[:, :2, 3]
        # Against the first board, which is not tilted: a common shift is the principal point's.
        size = np.linalg.norm(shifts[2] - shifts[0])
        np.testing.assert_allclose(size, expected, rtol=0.1, atol=1e-7)


def test_a_moved_dot_is_left_out(rig):
    observed = observations(rig, board_poses(), (0.01, 0.002))
    observed[2].camera_px[5] += 3.0
    result = calibrate(observed)
    assert not result.adjustment.used[2][5]
    assert result.poses[2].left_out >= 1
    assert result.adjustment.spread_px[0] < 0.012


def test_boards_that_all_face_the_camera_are_rejected(rig):
    """Parallel boards do not distinguish focal length and distance."""
    poses = [np.eye(4) for _ in range(6)]
    for k, T in enumerate(poses):
        T[:2, 3] = 0.5 * k, -0.3 * k
    with pytest.raises(InputError, match="tilt the board"):
        calibrate(observations(rig, poses, (0.01, 0.002)))


def test_too_few_or_unequal_poses_are_rejected(rig):
    observed = observations(rig, board_poses(3))
    with pytest.raises(InputError, match="2 board poses"):
        calibrate(observed[:2])
    with pytest.raises(InputError, match="different image sizes"):
        calibrate([*observed, replace(observed[0], camera_size_px=(968, 732))])


def test_unknown_coefficients_are_rejected():
    with pytest.raises(InputError, match="k9"):
        Freedom(camera_distortion=("k9",))
    with pytest.raises(InputError, match="are k1, k1; name each once"):
        Freedom(camera_distortion=("k1", "k1"))


def test_more_coefficients_can_be_requested(exact):
    """Setup: projector k1 free as well. Expected: found as 0, with an uncertainty."""
    observed, _ = exact
    free = Freedom(
        projector_distortion=("k1",), camera_pixel_ratio=None, projector_pixel_ratio=None
    )
    result = calibrate(observed, AdjustOptions(free))
    k1 = next(p for p in result.parameters if p.name == "projector_k1")
    assert abs(k1.value) < 1e-6
    assert k1.sigma > 0.0
