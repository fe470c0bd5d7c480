"""Calibration on rendered boards: from the experiment to the rig's parameters, and from files."""

import csv
import json
import shutil

import cv2
import imageio.v3 as imageio
import numpy as np
import pytest
import trimesh

from reconstruction.calibration import length_errors_mm, locate_features, observe
from reconstruction.calibration.pipeline import parameters_of
from reconstruction.capture.description import read_manifest
from reconstruction.evaluate import flatness
from reconstruction.rig.calibration import read_calibration
from tests.pictures import is_drawn
from twin.cli import run
from twin.config import ConfigError, load_experiment
from twin.config.board import BoardPose, load_board
from twin.optics.rig import true_calibration
from twin.pipeline.calibration import record_board

# A quarter of the resolution, a third of the frames, five of the twelve poses.
SMALL = {"camera.binning": 4, "patterns.steps": 6}
EIGHT_BIT = SMALL | {"camera.bit_depth": 8}
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


# Inches; their contents: tests/report/test_calibration_figures.py.
PICTURES = {
    "residuals.png": (10.2, 4.2),
    "pose_residuals.png": (7.0, 3.4),
    "correlations.png": (7.2, 6.2),
}


@pytest.fixture(scope="module")
def board_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("board") / "small.toml"
    path.write_text(BOARD)
    return path


@pytest.fixture(scope="module")
def folder(mi, board_file, tmp_path_factory):
    """Result of `twin calibrate EXPERIMENT`, the captures kept as 8-bit images."""
    out = tmp_path_factory.mktemp("calibrate") / "rendered"
    settings = [part for k, v in EIGHT_BIT.items() for part in ("-s", f"{k}={v}")]
    line = [
        "calibrate",
        "examples/slab_balls",
        "-o",
        str(out),
        "--board",
        str(board_file),
        *settings,
    ]
    assert run([*line, "--as-images"]) == 0
    return out


def figures(folder):
    return json.loads((folder / "result.json").read_text())["metrics"]


def test_rendered_calibration_finds_the_true_rig(folder):
    """Setup: 5 poses, 484 x 366 px, default noise. Expected: 0.1 %, and inside U."""
    calibrated = figures(folder)
    for name in ("camera_fx_px", "projector_fx_px", "baseline_mm"):
        error, expanded = calibrated[f"{name}_error"], calibrated[f"{name}_expanded"]
        assert abs(error) < 1e-3 * calibrated[name]
        assert abs(error) < expanded
    assert calibrated["camera_reprojection_rms_px"] < 0.02
    assert calibrated["epipolar_rms_px"] < 0.002


def test_world_frame_is_the_first_board(folder):
    """The first pose is in the rig's own reference frame: transforms agree with the true ones."""
    calibration = read_calibration(folder / "calibration.yaml")
    true = true_calibration(load_experiment("examples/slab_balls", SMALL))
    np.testing.assert_allclose(
        calibration.T_world_from_cam[:3, 3], true.T_world_from_cam[:3, 3], atol=0.2
    )
    np.testing.assert_allclose(
        calibration.T_world_from_proj[:3, :3], true.T_world_from_proj[:3, :3], atol=1e-3
    )


def test_tables_and_pictures_are_written(folder):
    with (folder / "parameters.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {"parameter", "value", "sigma", "expanded", "truth", "error"} == set(rows[0])
    assert len(rows) == 25
    free = sum(float(row["expanded"]) > 0.0 for row in rows)
    for name, size in (PICTURES | {"parameters.png": (7.6, 1.0 + 0.24 * free)}).items():
        assert is_drawn(folder / name, *size), name
    assert load_experiment(folder / "experiment.toml").camera.binning == 4
    assert len((folder / "poses.csv").read_text().splitlines()) == 1 + 5


@pytest.fixture(scope="module")
def calibrated(folder, board_file, tmp_path_factory):
    """Result of `twin calibrate CAPTURES` on the image folders, as a rig owner runs it."""
    out = tmp_path_factory.mktemp("calibrate") / "calibrated"
    line = ["calibrate", str(folder / "captures"), "-o", str(out), "--board", str(board_file)]
    assert run(line) == 0
    return out


def test_captures_are_what_a_rig_owner_has(folder):
    """Expected: per pose one 8-bit PNG per frame and two descriptions, no calibration."""
    assert len(list((folder / "captures").iterdir())) == 5
    pose = folder / "captures" / "pose_03"
    images = sorted(pose.glob("*.png"))
    assert len(images) == len(read_manifest(pose).frames)
    assert {path.name for path in pose.iterdir()} - {path.name for path in images} == {
        "capture.toml",
        "patterns.toml",
    }
    image = imageio.imread(images[0])
    assert (image.shape, image.dtype) == ((366, 484), np.uint8)


def test_captures_give_the_same_calibration(folder, calibrated):
    """Expected: the same figures, but for rounding that depends on the memory layout of arrays.

    The adjustment ends when its steps are small next to the uncertainties. A parameter with a large
    uncertainty, such as k1, then differs by more than a relative rounding error.
    """
    rendered, real = figures(folder), figures(calibrated)
    with (calibrated / "parameters.csv").open() as file:
        expanded = {row["parameter"]: float(row["expanded"]) for row in csv.DictReader(file)}
    assert "baseline_mm_error" not in real  # the truth is not known
    absent = [name for name, value in real.items() if value is None]
    assert absent == ["camera_pupil_diameter_mm"]  # no blur is seen
    for name, value in real.items():
        expected = rendered[name]
        smallest = max(1e-9, 1e-3 * expanded.get(name, 0.0))
        close = expected if expected is None else pytest.approx(expected, rel=1e-5, abs=smallest)
        assert value == close, name


def test_calibration_of_folders_holds_the_true_rig(calibrated):
    """Expected: every parameter within twice its U: with 11 free ones, one is beyond U (k = 2)
    in every second calibration, and one beyond 2 U in 1500.
    """
    true = parameters_of(true_calibration(load_experiment("examples/slab_balls", SMALL)))
    with (calibrated / "parameters.csv").open() as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    assert "truth" not in rows["baseline_mm"]
    for name, row in rows.items():
        assert abs(float(row["value"]) - true[name]) <= 2.0 * float(row["expanded"]), name
    assert 0.0 < float(rows["baseline_mm"]["expanded"]) < 1e-3 * true["baseline_mm"]


def test_calibration_file_opens_in_opencv(calibrated):
    """Expected: nodes as OpenCV's functions take them; tables and pictures in the same folder."""
    calibration = read_calibration(calibrated / "calibration.yaml")
    storage = cv2.FileStorage(str(calibrated / "calibration.yaml"), cv2.FILE_STORAGE_READ)
    matrix = storage.getNode("camera").getNode("camera_matrix").mat()
    distortion = storage.getNode("projector").getNode("distortion_coefficients").mat()
    pose = storage.getNode("T_world_from_proj").mat()
    storage.release()
    projected = cv2.projectPoints(np.array([[0.0, 0.0, 1.0]]), *np.zeros((2, 3)), matrix, None)[0]
    np.testing.assert_allclose(
        projected.ravel(), [calibration.camera.cx_px, calibration.camera.cy_px]
    )
    assert distortion.shape == (1, 5)
    np.testing.assert_array_equal(pose, calibration.T_world_from_proj)
    for name, size in PICTURES.items():
        assert is_drawn(calibrated / name, *size), name
    assert not (calibrated / "parameters.png").exists()  # errors are not known


def test_capture_is_reconstructed_with_that_calibration(folder, calibrated, tmp_path):
    """Setup: the flat pose, its capture.toml pointed at the calibration found.

    Expected: it defines the world's z = 0: white print within 2 um RMS of that plane, in it to
    1 um and level to 0.1 mrad. The rims of dots, a quarter of the pixels after the phase filter,
    lean by up to 0.2 mm (mixed pixels) and are left out as outliers.
    """
    capture = tmp_path / "flat"
    shutil.copytree(folder / "captures" / "pose_00", capture)
    shutil.copy(calibrated / "calibration.yaml", capture)
    assert run(["reconstruct", str(capture), "-o", str(tmp_path / "out")]) == 0
    points_mm = np.asarray(trimesh.load(tmp_path / "out" / "points.ply").vertices)
    assert len(points_mm) > 0.8 * 484 * 366
    plane = flatness(points_mm)
    assert plane.inliers.mean() > 0.7
    assert plane.rms_mm < 2e-3
    assert abs(np.median(points_mm[plane.inliers, 2])) < 1e-3
    assert np.abs(plane.plane.normal[:2]).max() < 1e-4


def test_lengths_on_a_new_pose(folder, board_file, mi):
    """Setup: the calibration found, a pose that took no part. Expected: 11 mm within 5 um."""
    board = load_board(board_file)
    new = BoardPose(tilt_deg=10.0, azimuth_deg=60.0, spin_deg=15.0, z_mm=0.5)
    experiment = load_experiment("examples/slab_balls", EIGHT_BIT)
    observed = observe(record_board(experiment, board, new, 50), board.board())
    points = locate_features(read_calibration(folder / "calibration.yaml"), observed)
    assert np.abs(length_errors_mm(points, observed, 11.0)).max() < 5e-3


def test_errors_name_the_pose_and_leave_nothing_behind(folder, tmp_path, capsys):
    """Setup: the wrong board. Expected: one line, exit code 2, no result folder."""
    out = tmp_path / "out"
    line = ["calibrate", str(folder / "captures"), "-o", str(out), "--board", "boards/chessboard"]
    assert run(line) == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert "pose_00" in message
    assert "chessboard" in message
    assert not out.exists()
    (tmp_path / "none").mkdir()
    assert run(["calibrate", str(tmp_path / "none"), "-o", str(out)]) == 2
    assert "capture.toml" in capsys.readouterr().err


def missing_folder(captures):
    shutil.rmtree(captures)


def no_description(captures):
    (captures / "pose_01" / "capture.toml").unlink()


def missing_frame(captures):
    (captures / "pose_00" / "004_phase_column_04.png").unlink()


def no_board(captures):
    """Show the patterns on a blank plane, one camera pixel per projector pixel."""
    pose = captures / "pose_00"
    patterns = read_manifest(pose)
    for path, frame in zip(sorted(pose.glob("*.png")), patterns.frames, strict=True):
        imageio.imwrite(path, 20 + patterns.image(frame)[:366, :484] // 2)


def other_size(captures):
    for path in (captures / "pose_01").glob("*.png"):
        imageio.imwrite(path, imageio.imread(path)[:, :480])


MISTAKES = {
    missing_folder: ("captures: no such folder of captures", "one capture folder per board pose"),
    no_description: ("pose_01", "holds images but no capture.toml"),
    missing_frame: ("pose_00", "1 of 29 frames are missing: 004_phase_column_04.png"),
    no_board: ("pose_00", "board's grid is not recognised"),
    other_size: ("pose_01: 480 x 366 px", "pose_00: 484 x 366 px"),
}


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda function: function.__name__)
def test_mistakes_in_folders_are_one_line(folder, board_file, tmp_path, capsys, mistake):
    """Setup: copies of two pose folders, one mistake. Expected: file and mistake, exit code 2."""
    captures, out = tmp_path / "captures", tmp_path / "out"
    for name in ("pose_00", "pose_01"):
        shutil.copytree(folder / "captures" / name, captures / name)
    mistake(captures)
    assert run(["calibrate", str(captures), "-o", str(out), "--board", str(board_file)]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("twin: ")]
    assert len(lines) == 1
    for part in MISTAKES[mistake]:
        assert part in lines[0]
    assert not out.exists()


def test_one_bad_pose_does_not_stop_the_others(folder, board_file, tmp_path, capsys):
    """Setup: of five poses the first shows no board, another lacks a frame. Three are used."""
    captures, out = tmp_path / "captures", tmp_path / "out"
    shutil.copytree(folder / "captures", captures)
    no_board(captures)
    (captures / "pose_03" / "004_phase_column_04.png").unlink()
    assert run(["calibrate", str(captures), "-o", str(out), "--board", str(board_file)]) == 0
    result = figures(out)
    assert (result["poses"], result["poses_skipped"]) == (3, 2)
    assert [warning.partition("pose_0")[2][0] for warning in result["warnings"]] == ["0", "3"]
    assert "1 of 29 frames are missing" in result["warnings"][1]
    assert {path.name for path in out.glob("skipped_*")} == {"skipped_pose_00.png"}
    # It shows the pose's mean image: patterns of all kinds, in the mean brighter than dark.
    assert imageio.imread(out / "skipped_pose_00.png").mean() > 64
    assert "grid is not recognised" in result["warnings"][0]
    assert "left out: " in capsys.readouterr().out


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
