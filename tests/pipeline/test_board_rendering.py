"""Boards as they are rendered: print, pose, corners and the effect of defocus."""

import numpy as np
import pytest

from reconstruction.calibration import observe
from reconstruction.calibration.plane_images import defocus_slopes_px
from twin.config import load_experiment
from twin.config.board import BoardPose, load_board
from twin.optics.board import albedo_image, board_pose
from twin.optics.rig import true_calibration
from twin.pipeline.calibration import record_board

# A quarter of the resolution, a third of the frames.
SMALL = {"camera.binning": 4, "patterns.steps": 6}


def test_tilted_board_out_of_focus_is_displaced_as_predicted(mi):
    """Setup: f/8 lens, 20 degrees, 4 mm above and below the focus, no noise; true poses.

    Expected: the projector coordinates at the dots, beyond the errors by the camera's dots, are
    off by the closed form of `defocus` in the mean over the board. Half the difference of both
    heights omits effects of the size of the blur only: the phase leans towards where
    the board is brighter. To 10 %: the phase is a fit over a window, not at one point.
    """
    above, below = (
        defocus_misses(BoardPose(tilt_deg=20.0, azimuth_deg=80.0, z_mm=z_mm))
        for z_mm in (4.0, -4.0)
    )
    off, predicted = (above - below) / 2.0
    assert np.linalg.norm(predicted) > 4e-4
    assert np.linalg.norm(off - predicted) < 0.1 * np.linalg.norm(predicted)


def defocus_misses(pose):
    """Return the mean projector misses of a rendered board, and those predicted, (2, 2) px."""
    lens = {"camera.depth_of_field": True, "camera.noise": False, "render.samples": 16}
    lens |= {"camera.width_px": 1200, "camera.height_px": 900}
    experiment, board = (
        load_experiment("examples/slab_balls", SMALL | lens),
        load_board("boards/paper_dots"),
    )
    observed = observe(record_board(experiment, board, pose), board.board())
    rig = true_calibration(experiment)
    T = np.linalg.inv(rig.T_world_from_cam) @ board_pose(pose)
    points = into(T, observed.points_mm)
    misses = observed.camera_px - rig.camera.project(points)
    shown = rig.projector.project(into(rig.T_proj_from_cam, points))
    off = observed.projector_px - shown - np.einsum("nij,nj->ni", observed.slopes, misses)
    focus_mm, pupil_mm2 = experiment.camera.pose.standoff_mm, (50.0 / 8.0 / 4.0) ** 2
    # Z_m is the depth in focus: then the second coefficient is 0.
    slopes = defocus_slopes_px(rig.camera, points, T[:3, 2], focus_mm)
    predicted = np.einsum("nij,nj->ni", observed.slopes, slopes[..., 0] * pupil_mm2)
    return np.stack([off.mean(axis=0), predicted.mean(axis=0)])


@pytest.mark.parametrize("name", ["boards/charuco", "boards/chessboard"])
def test_corner_boards_are_observed(mi, name):
    """Setup: one tilted pose, default noise. Expected: every corner to 0.05 px in the camera.

    The projector coordinate belongs to the place seen, so its error beyond the camera's share is
    that of the phase only: 5e-3 px.
    """
    board, experiment = load_board(name), load_experiment("examples/slab_balls", SMALL)
    pose = BoardPose(tilt_deg=12.0, azimuth_deg=40.0)
    observed = observe(record_board(experiment, board, pose), board.board())
    assert len(observed.ids) >= 50
    rig, T = true_calibration(experiment), board_pose(pose)
    points = observed.points_mm @ T[:3, :3].T + T[:3, 3]
    misses = [
        located - device.project(into(np.linalg.inv(frame), points))
        for located, device, frame in (
            (observed.camera_px, rig.camera, rig.T_world_from_cam),
            (observed.projector_px, rig.projector, rig.T_world_from_proj),
        )
    ]
    assert np.sqrt(np.mean(misses[0] ** 2)) < 0.05
    beyond = misses[1] - np.einsum("nij,nj->ni", observed.slopes, misses[0])
    assert np.sqrt(np.mean(beyond**2)) < 5e-3


def into(T, points):
    return points @ T[:3, :3].T + T[:3, 3]


@pytest.mark.parametrize("name", ["boards/paper_dots", "boards/charuco", "boards/chessboard"])
def test_shipped_boards_load_and_print(name):
    file = load_board(name)
    albedo = albedo_image(file.board(), file.plate, 0.1)
    assert albedo.min() == pytest.approx(file.plate.ink_albedo)
    assert albedo.max() == pytest.approx(file.plate.white_albedo)
    assert all("x_mm" in pose.model_dump() for pose in file.poses)


def test_paper_board_has_twelve_poses():
    assert len(load_board("boards/paper_dots").poses) == 12


def test_pose_leans_towards_its_azimuth():
    """Expected: the normal has the stated tilt and azimuth for any spin."""
    T = board_pose(BoardPose(tilt_deg=20.0, azimuth_deg=50.0, spin_deg=33.0, x_mm=1.0))
    tilt, azimuth = np.radians([20.0, 50.0])
    normal = [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)]
    np.testing.assert_allclose(T[:3, 2], normal, atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [1.0, 0.0, 0.0])
    untilted = board_pose(BoardPose(azimuth_deg=50.0, spin_deg=33.0))
    np.testing.assert_allclose(untilted[:2, 0], [np.cos(np.radians(33)), np.sin(np.radians(33))])
