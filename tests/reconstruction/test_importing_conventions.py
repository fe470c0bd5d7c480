"""Imported calibrations in other conventions: R and T, units, unknown names, damaged layouts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from reconstruction.calibration.correspondences import corresponding_points
from reconstruction.capture.folder import Capture, write_capture
from reconstruction.errors import CaptureError, InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.importing import Importing, import_calibration
from reconstruction.rig.named_numbers import parsed_keys
from reconstruction.rig.pose_conventions import POSES, in_convention
from reconstruction.rig.sensor import SensorNoise
from tests.corpus.calibrations import (
    LAYOUTS,
    of_colmap,
    of_kalibr,
    of_ros,
    of_scanner,
    of_scanner_sim,
    of_zivid,
    stored,
    written,
)
from tests.corpus.rigs import RIG, Rig, matrix

SIZES = Importing(camera_size=(640, 480), projector_size=(912, 1140))


def in_file(rig: Rig, pose: str) -> Rig:
    """Return R and T as a program with this convention stores them."""
    R, T = rig.rotation, rig.translation_mm
    turns = {"forward": (R, T), "inverse": (R.T, -R.T @ T), "transposed": (R.T, T)}
    rotation, translation = (turns | {"position": (R, -R.T @ T)})[pose]
    return replace(rig, rotation=rotation, translation_mm=translation)


def points_px(rig: Rig, noise_px: float = 0.3) -> np.ndarray:
    """Return corresponding pixels of random points in the volume that both devices see."""
    rng = np.random.default_rng(7)
    points = rng.uniform((-30, -25, 190), (30, 25, 230), (2000, 3))
    moved = points @ rig.rotation.T + rig.translation_mm
    pixels = np.column_stack((rig.camera.project(points), rig.projector.project(moved)))
    return pixels + rng.normal(0.0, noise_px, (2000, 4))


@pytest.mark.parametrize("pose", POSES)
def test_a_capture_confirms_or_finds_the_convention(pose: str, tmp_path: Path):
    files = of_scanner(tmp_path, in_file(RIG, pose))
    result = import_calibration(files, SIZES, points_px(RIG))
    assert result.pose.convention == pose
    assert 0.1 < result.pose.epipolar_px < 0.6
    np.testing.assert_allclose(result.calibration.T_proj_from_cam, RIG.motion, atol=1e-9)


@pytest.mark.parametrize("pose", POSES)
def test_a_stated_convention_is_used(pose: str, tmp_path: Path):
    files = of_scanner(tmp_path, in_file(RIG, pose))
    result = import_calibration(files, replace(SIZES, pose=pose))
    np.testing.assert_allclose(result.calibration.T_proj_from_cam, RIG.motion, atol=1e-9)


@pytest.mark.parametrize("pose", ["transposed", "position"])
def test_diverging_devices_are_one_line_with_the_remedy(pose: str, tmp_path: Path):
    files = of_scanner(tmp_path, in_file(RIG, pose))
    with pytest.raises(CaptureError, match=rf"diverge; they meet with .*--pose {pose}.*--check"):
        import_calibration(files, SIZES)


def test_a_capture_that_fits_no_convention_is_an_error(tmp_path: Path):
    """The projector's columns and rows are exchanged."""
    exchanged = points_px(RIG)[:, [0, 1, 3, 2]]
    with pytest.raises(CaptureError, match=r"contradicts the calibration: .*allowed up to 3 px"):
        import_calibration(of_scanner(tmp_path), SIZES, exchanged)


def test_a_capture_contradicts_a_wrong_stated_convention(tmp_path: Path):
    with pytest.raises(CaptureError, match=r"contradicts .*; use --pose forward"):
        import_calibration(
            of_scanner(tmp_path), replace(SIZES, pose="inverse"), points_px(RIG, 0.1)
        )


def test_poses_of_both_devices_are_combined(tmp_path: Path):
    """Rc, Tc and Rp, Tp map world coordinates to those of camera and projector."""
    world = RIG.rotation.T[::-1][:, ::-1], np.array([10.0, -20.0, 300.0])
    R, T = RIG.rotation @ world[0], RIG.rotation @ world[1] + RIG.translation_mm
    poses = {"Rc": world[0], "Tc": world[1], "Rp": R, "Tp": T}
    lenses = {
        "Kc": matrix(RIG.camera), "kc": np.array([RIG.camera.distortion]),
        "Kp": matrix(RIG.projector), "kp": np.array([RIG.projector.distortion]),
    }  # fmt: skip
    path = stored(tmp_path / "rig.yml", **lenses, **poses)
    result = import_calibration([path], SIZES)
    np.testing.assert_allclose(result.calibration.T_proj_from_cam, RIG.motion, atol=1e-9)


def test_the_matlab_text_of_slstudio_is_read(tmp_path: Path):
    """OpenCV prints a matrix over several lines in brackets."""
    values = {"Kc": matrix(RIG.camera), "kc": np.array([RIG.camera.distortion]).T}
    values |= {"Kp": matrix(RIG.projector), "kp": np.array([RIG.projector.distortion]).T}
    values |= {"Rp": RIG.rotation, "Tp": RIG.translation_mm[:, None]}
    lines = ["%%SLStudio calibration"]
    for name, array in values.items():
        rows = (", ".join(map(repr, row)) for row in array.tolist())
        lines.append(f"{name} = [" + ";\n ".join(rows) + "];")
    result = import_calibration([written(tmp_path / "cal.m", "\n".join(lines))], SIZES)
    assert result.calibration.camera.distortion == RIG.camera.distortion
    np.testing.assert_allclose(result.calibration.T_proj_from_cam, RIG.motion, atol=1e-9)


def test_conventions_are_those_of_their_equations():
    R, T, x = RIG.rotation, RIG.translation_mm, np.array([3.0, -5.0, 200.0])
    expected = {
        "forward": R @ x + T, "inverse": np.linalg.solve(R, x - T),
        "transposed": R.T @ x + T, "position": R @ (x - T),
    }  # fmt: skip
    for pose in POSES:
        motion = in_convention(RIG.motion, pose)
        np.testing.assert_allclose(motion[:3, :3] @ x + motion[:3, 3], expected[pose], atol=1e-9)


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "m"), (1e-3, None), (0.1, "cm")])
def test_another_unit_is_read_or_named(factor: float, unit: str | None, tmp_path: Path):
    files = of_scanner(tmp_path, replace(RIG, translation_mm=factor * RIG.translation_mm))
    if unit is None:
        with pytest.raises(CaptureError, match=r"baseline_mm is 0.1.*100.4 mm with --unit m\b"):
            import_calibration(files, SIZES)
        return
    result = import_calibration(files, replace(SIZES, unit=unit))
    np.testing.assert_allclose(result.calibration.T_proj_from_cam, RIG.motion, atol=1e-9)


def test_the_unit_of_a_format_can_be_replaced(tmp_path: Path):
    """Kalibr writes metres; a board in millimetres makes its metres millimetres."""
    files = of_kalibr(tmp_path, replace(RIG, translation_mm=1e3 * RIG.translation_mm))
    result = import_calibration(files, Importing(unit="mm"))
    np.testing.assert_allclose(result.calibration.T_proj_from_cam, RIG.motion, atol=1e-9)


STRANGE = {
    "Kamera": matrix(RIG.camera), "beamer_K": matrix(RIG.projector),
    "verzeichnung": np.array([RIG.camera.distortion]), "Drehung": RIG.rotation,
    "Ort": RIG.translation_mm[:, None],
}  # fmt: skip
KEYS = {
    "camera_matrix": "Kamera", "camera_distortion": "verzeichnung", "projector_matrix": "beamer_K",
    "projector_distortion": "none", "rotation": "Drehung", "translation": "Ort",
}  # fmt: skip


def test_unknown_names_are_stated_by_keys(tmp_path: Path):
    path = stored(tmp_path / "rig.yml", **STRANGE)
    keys = parsed_keys([f"{quantity}={name}" for quantity, name in KEYS.items()])
    result = import_calibration([path], replace(SIZES, keys=keys))
    assert result.calibration.camera.distortion == RIG.camera.distortion
    assert result.calibration.projector.distortion == (0.0,) * 5
    np.testing.assert_allclose(result.calibration.T_proj_from_cam, RIG.motion, atol=1e-9)
    assert set(result.used.values()) == set(KEYS.values())


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, r"no camera matrix of the camera.*size Drehung, Kamera, .*--key camera_matrix="),
        (
            KEYS | {"camera_matrix": "kamera"},
            r"camera_matrix=kamera: .*no number kamera; they ",
        ),
        (KEYS | {"rotation": "verzeichnung"}, r"rotation=verzeichnung: found 5 .* allowed 3 or 9"),
    ],
)
def test_missing_and_wrong_keys_are_one_line(keys: dict[str, str], message: str, tmp_path: Path):
    path = stored(tmp_path / "rig.yml", **STRANGE)
    with pytest.raises(CaptureError, match=message) as caught:
        import_calibration([path], replace(SIZES, keys=keys))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["camera_matrix", "camera_matrix=", "camera=K"])
def test_a_key_needs_a_known_quantity_and_a_name(text: str):
    with pytest.raises(InputError, match=r"write QUANTITY=NAME; quantities are camera_matrix, "):
        parsed_keys([text])


def edited(write, name: str, find: str, replacement: str):
    """Return a writer of files, one of which has a replaced text."""

    def write_edited(home: Path) -> list[Path]:
        files = write(home)
        path = home / name
        text = path.read_text("utf-8")
        assert find in text
        path.write_text(text.replace(find, replacement), encoding="utf-8")
        return files

    return write_edited


def text_of(name: str, text: str):
    return lambda home: [written(home / name, text)]


DAMAGED = [
    (edited(of_kalibr, "camchain.yaml", "radtan", "equidistant"), "cam0: distortion_model is equi"),
    (edited(of_kalibr, "camchain.yaml", "cam1:", "cam2:"), "cam1 is missing; a rig needs cam0"),
    (edited(of_kalibr, "camchain.yaml", "pinhole", "omni"), "camera_model is omni, allowed pin"),
    (edited(of_ros, "left.yaml", "plumb_bob", "equidistant"), "equidistant, allowed plumb_bob or"),
    (edited(of_ros, "right.yaml", "projection_matrix", "other"), "no rotation R and translation T"),
    (edited(of_zivid, "camera_intrinsics.yml", "K3", "K9"), "K3 is missing in CameraIntrinsics"),
    (edited(of_colmap, "cameras.txt", "7 FULL", "# FULL"), "found 1 camera, allowed 2"),
    (edited(of_colmap, "cameras.txt", "FULL_OPENCV", "FOV"), "camera 7: model is FOV, allowed"),
    (edited(of_colmap, "cameras.txt", "640 480", "640"), "allowed ID MODEL WIDTH HEIGHT"),
    (edited(of_colmap, "images.txt", " 7 view", " view"), "images.txt: found '1 .*CAMERA_ID NAME"),
    (edited(of_scanner_sim, "camera_geometry.json", '"dist"', '"d"'), "dist: found shape none"),
    (lambda home: of_scanner_sim(home)[:1], "of the projector .*; give the projector's file"),
    (edited(of_colmap, "cameras.txt", "1800.0", "nan"), "camera/matrix is .*allowed are finite"),
    (text_of("rig.txt", "1" * 900 + "x\n"), "found no name with numbers"),
    (text_of("rig.txt", "only words\nand more words\n"), "found no name with numbers"),
    (text_of("rig.json", "{ 1"), "rig.json: cannot be read"),
    (text_of("rig.yaml", "a: [1, 2"), "rig.yaml: line [12]: is no YAML"),
    (text_of("rig.npz", "no archive"), "is no complete npz file"),
]  # fmt: skip


@pytest.mark.parametrize(("write", "message"), DAMAGED)
def test_damaged_files_of_each_layout_are_one_line(write, message: str, tmp_path: Path):
    with pytest.raises(CaptureError, match=message) as caught:
        import_calibration(write(tmp_path), SIZES)
    assert "\n" not in str(caught.value)


def test_more_than_two_files_with_a_matrix_are_rejected(tmp_path: Path):
    paths = [stored(tmp_path / f"{name}.yml", camera_matrix=np.eye(3)) for name in "abc"]
    with pytest.raises(CaptureError, match="3 files with a camera matrix, allowed one of"):
        import_calibration(paths, SIZES)


def test_the_size_of_a_file_is_that_of_its_device(tmp_path: Path):
    """If the names of the files contain no device, the first file is of the camera."""
    files = LAYOUTS["two calibrations"].write(tmp_path, RIG)
    projector, camera = (
        files[i].rename(tmp_path / f"{letter}.xml") for i, letter in enumerate("ab")
    )
    result = import_calibration([camera, projector, files[2]])
    assert result.calibration.camera.width_px == RIG.camera.width_px


@pytest.fixture(scope="module")
def capture_folder(calibration, surface, project, synthesise, tmp_path_factory) -> Path:
    observed = project(calibration, surface(calibration))
    patterns = PatternSet(1280, 720)
    frames = np.rint(64.0 + 15.0 * synthesise(patterns, observed[..., 0], observed[..., 1]))
    folder = tmp_path_factory.mktemp("capture")
    sensor = SensorNoise(0.17, 6.2, 64, 4095.0)
    write_capture(folder, Capture(frames.astype(np.uint16), patterns, sensor, calibration, 12))
    return folder


def test_decoded_points_are_those_of_the_surface(capture_folder, calibration, surface, project):
    points = corresponding_points(capture_folder)
    assert points.shape == (120 * 90, 4)
    expected = project(calibration, surface(calibration))
    cols, rows = points[:, :2].astype(int).T
    assert np.median(np.abs(points[:, 2:] - expected[rows, cols])) < 0.1


def test_the_command_reads_the_inverse_pose_by_a_capture(
    capture_folder, calibration, tmp_path: Path, capsys
):
    from reconstruction.rig.calibration import read_calibration
    from twin.cli import run

    motion = calibration.T_proj_from_cam
    rig = Rig(calibration.camera, calibration.projector, motion[:3, :3], motion[:3, 3])
    files = [str(path) for path in LAYOUTS["xml"].write(tmp_path, in_file(rig, "inverse"))]
    out = tmp_path / "out"
    assert run(["import-calibration", *files, "--check", str(capture_folder), "-o", str(out)]) == 0
    assert "R and T: inverse (median distance from the epipolar lines" in capsys.readouterr().out
    again = read_calibration(out / "calibration.yaml")
    np.testing.assert_allclose(again.T_proj_from_cam, motion, atol=1e-6)
