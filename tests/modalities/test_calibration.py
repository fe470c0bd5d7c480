"""Calibration on rendered boards: from the experiment to the rig's parameters, and from files."""

import csv
import json

import numpy as np
import pytest

from reconstruction.calibrating import length_errors_mm, locate_features, observe
from reconstruction.calibration import read_calibration
from twin.cli import run
from twin.config import ConfigError, load_experiment
from twin.config.board import BoardPose, load_board
from twin.modalities.calibration import record_board
from twin.optics.board import albedo_image, board_pose
from twin.optics.rig import true_calibration

# A quarter of the resolution, a third of the frames, five of the twelve poses.
SMALL = {"camera.binning": 4, "patterns.steps": 6}
BOARD = """
[pattern]
kind = "dots"
columns = 13
rows = 9
pitch_mm = 2.2
dot_diameter_mm = 0.9
fiducial_diameter_mm = 1.4
[plate]
width_mm = 40.0
height_mm = 32.0
white_albedo = 0.8
ink_albedo = 0.07
[[poses]]
[[poses]]
tilt_deg = 20.0
azimuth_deg = 20.0
z_mm = 1.0
[[poses]]
tilt_deg = 20.0
azimuth_deg = 110.0
spin_deg = 30.0
[[poses]]
tilt_deg = 20.0
azimuth_deg = -160.0
spin_deg = -20.0
z_mm = -1.0
[[poses]]
tilt_deg = 20.0
azimuth_deg = -70.0
spin_deg = 10.0
"""


@pytest.fixture(scope="module")
def board_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("board") / "small.toml"
    path.write_text(BOARD)
    return path


@pytest.fixture(scope="module")
def folder(mi, board_file, tmp_path_factory):
    """Result of `twin calibrate EXPERIMENT` with the captures kept."""
    out = tmp_path_factory.mktemp("calibrate") / "rendered"
    settings = [part for k, v in SMALL.items() for part in ("-s", f"{k}={v}")]
    line = ["calibrate", "paper/two_balls", "-o", str(out), "--board", str(board_file), *settings]
    assert run([*line, "--keep-captures"]) == 0
    return out


def figures(folder):
    return json.loads((folder / "result.json").read_text())["metrics"]


def test_rendered_calibration_finds_the_true_rig(folder):
    """Setup: 5 poses, 484 x 366 px, default noise. Expected: 0.1 %, and inside U."""
    found = figures(folder)
    for name in ("camera_fx_px", "projector_fx_px", "baseline_mm"):
        error, expanded = found[f"{name}_error"], found[f"{name}_expanded"]
        assert abs(error) < 1e-3 * found[name]
        assert abs(error) < expanded
    assert found["camera_reprojection_rms_px"] < 0.02
    assert found["epipolar_rms_px"] < 0.002


def test_world_frame_is_the_first_board(folder):
    """The first pose lies in the rig's own reference frame: transforms agree with the true ones."""
    found = read_calibration(folder / "calibration.yaml")
    true = true_calibration(load_experiment("paper/two_balls", SMALL))
    np.testing.assert_allclose(
        found.T_world_from_cam[:3, 3], true.T_world_from_cam[:3, 3], atol=0.2
    )
    np.testing.assert_allclose(
        found.T_world_from_proj[:3, :3], true.T_world_from_proj[:3, :3], atol=1e-3
    )


def test_tables_and_pictures_are_written(folder):
    with (folder / "parameters.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {"parameter", "value", "sigma", "expanded", "truth", "error"} == set(rows[0])
    assert len(rows) == 25
    pictures = ("residuals.png", "pose_residuals.png", "correlations.png", "parameters.png")
    for name in (*pictures, "experiment.toml"):
        assert (folder / name).stat().st_size > 1000
    assert len((folder / "poses.csv").read_text().splitlines()) == 1 + 5


def test_captures_give_the_same_calibration(folder, board_file, tmp_path):
    """Setup: the kept captures, without their calibration file, which a new rig does not have.

    Expected: the same figures, but for rounding that depends on how arrays lie in memory.
    """
    for path in (folder / "captures").glob("*/calibration.yaml"):
        path.unlink()
    out = tmp_path / "out"
    assert (
        run(["calibrate", str(folder / "captures"), "-o", str(out), "--board", str(board_file)])
        == 0
    )
    rendered, real = figures(folder), figures(out)
    assert "baseline_mm_error" not in real  # the truth is not known
    for name, value in real.items():
        assert value == pytest.approx(rendered[name], rel=1e-5, abs=1e-9), name


def test_lengths_on_a_new_pose(folder, board_file, mi):
    """Setup: the calibration found, a pose that took no part. Expected: 11 mm within 5 um."""
    board = load_board(board_file)
    new = BoardPose(tilt_deg=10.0, azimuth_deg=60.0, spin_deg=15.0, z_mm=0.5)
    experiment = load_experiment("paper/two_balls", SMALL)
    seen = observe(record_board(experiment, board, new, 50), board.board())
    points = locate_features(read_calibration(folder / "calibration.yaml"), seen)
    assert np.abs(length_errors_mm(points, seen, 11.0)).max() < 5e-3


@pytest.mark.parametrize("name", ["boards/charuco", "boards/chessboard"])
def test_corner_boards_are_observed(mi, name):
    """Setup: one tilted pose, default noise. Expected: every corner to 0.05 px in the camera.

    The projector coordinate belongs to the place seen, so its error beyond the camera's share is
    that of the phase alone: 5e-3 px.
    """
    board, experiment = load_board(name), load_experiment("paper/two_balls", SMALL)
    pose = BoardPose(tilt_deg=12.0, azimuth_deg=40.0)
    seen = observe(record_board(experiment, board, pose), board.board())
    assert len(seen.ids) >= 50
    rig, T = true_calibration(experiment), board_pose(pose)
    points = seen.points_mm @ T[:3, :3].T + T[:3, 3]
    misses = [
        found - device.project(into(np.linalg.inv(frame), points))
        for found, device, frame in (
            (seen.camera_px, rig.camera, rig.T_world_from_cam),
            (seen.projector_px, rig.projector, rig.T_world_from_proj),
        )
    ]
    assert np.sqrt(np.mean(misses[0] ** 2)) < 0.05
    beyond = misses[1] - np.einsum("nij,nj->ni", seen.slopes, misses[0])
    assert np.sqrt(np.mean(beyond**2)) < 5e-3


def into(T, points):
    return points @ T[:3, :3].T + T[:3, 3]


def test_errors_name_the_pose_and_leave_nothing_behind(folder, tmp_path, capsys):
    """Setup: the wrong board. Expected: one line, exit code 2, no result folder."""
    out = tmp_path / "out"
    line = ["calibrate", str(folder / "captures"), "-o", str(out), "--board", "boards/chessboard"]
    assert run(line) == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert "pose_00" in message
    assert "chessboard" in message
    assert not out.exists()
    assert run(["calibrate", str(tmp_path), "-o", str(out)]) == 2
    assert "capture.toml" in capsys.readouterr().err


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
    """Expected: the normal has the stated tilt and azimuth whatever the spin."""
    T = board_pose(BoardPose(tilt_deg=20.0, azimuth_deg=50.0, spin_deg=33.0, x_mm=1.0))
    tilt, azimuth = np.radians([20.0, 50.0])
    normal = [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)]
    np.testing.assert_allclose(T[:3, 2], normal, atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [1.0, 0.0, 0.0])
    untilted = board_pose(BoardPose(azimuth_deg=50.0, spin_deg=33.0))
    np.testing.assert_allclose(untilted[:2, 0], [np.cos(np.radians(33)), np.sin(np.radians(33))])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("pitch_mm = 2.2", "pitch_mm = -1"), "pitch_mm"),
        (("columns = 13", "colums = 13"), "colums"),
        (("tilt_deg = 20.0", "tilt_deg = 80.0"), "tilt_deg"),
        (("[plate]", "[plate"), "TOML"),
    ],
)
def test_bad_board_files_are_explained(tmp_path, change, message):
    path = tmp_path / "bad.toml"
    path.write_text(BOARD.replace(*change, 1))
    with pytest.raises(ConfigError, match=message):
        load_board(path)
