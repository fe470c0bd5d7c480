import dataclasses

import cv2
import numpy as np
import pytest

from reconstruction.errors import CaptureError, InputError
from reconstruction.rig.calibration import Calibration, read_calibration, write_calibration


def test_file_holds_every_digit(tmp_path, calibration):
    write_calibration(tmp_path / "calibration.yaml", calibration)
    result = read_calibration(tmp_path / "calibration.yaml")
    assert result.camera == calibration.camera
    assert result.projector == calibration.projector
    np.testing.assert_array_equal(result.T_world_from_cam, calibration.T_world_from_cam)
    np.testing.assert_array_equal(result.T_world_from_proj, calibration.T_world_from_proj)


def test_file_is_read_by_opencv(tmp_path, calibration):
    write_calibration(tmp_path / "calibration.yaml", calibration)
    storage = cv2.FileStorage(str(tmp_path / "calibration.yaml"), cv2.FileStorage_READ)
    matrix = storage.getNode("projector").getNode("camera_matrix").mat()
    storage.release()
    assert matrix[1, 2] == 1096.0


def test_transforms_compose(calibration):
    product = calibration.T_world_from_proj @ calibration.T_proj_from_cam
    np.testing.assert_allclose(product, calibration.T_world_from_cam, atol=1e-12)


@pytest.mark.parametrize(
    ("find", "replace", "message"),
    [
        ("T_world_from_cam", "T_world_from_camera", "key T_world_from_cam is missing"),
        ("projector:", "beamer:", "key projector is missing"),
        ("camera_matrix:", "K:", "camera/camera_matrix is missing"),
        ("image_width:", "width:", "camera/image_width is missing"),
        ("image_width: 120", "image_width: 120.5", "camera/image_width"),
        ("image_width: 120", "image_width: -4", "width_px"),
        ("cols: 5", "cols: 4", "line 6: a matrix of 3 rows and 4 cols holds 9 numbers|cols holds"),
        ("%YAML", "calibration", "first line"),
        ("[ 900., 0.,", "[ 1e300, 0.,", "fx_px is 1e[+]300; give a number of at least 0.001"),
        ("[ 900., 0.,", "[ 1e-300, 0.,", "fx_px is 1e-300; give a number of at least 0.001"),
        ("dt: d", "dt: u", "line 6: a matrix is of dt: u; write d, its numbers are reals"),
        ("dt: d", "dt: 3d", "line 6: a matrix of 3 rows and 3 cols of dt 3d holds 9 numbers"),
    ],
)
def test_damaged_files_are_explained(tmp_path, calibration, find, replace, message):
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibration)
    text = path.read_text()
    assert find in text
    path.write_text(text.replace(find, replace))
    with pytest.raises(CaptureError, match=message) as caught:
        read_calibration(path)
    assert "\n" not in str(caught.value)


def test_truncated_binary_and_missing_files_are_explained(tmp_path, calibration):
    path = tmp_path / "calibration.yaml"
    with pytest.raises(CaptureError, match="cannot be read"):
        read_calibration(path)
    write_calibration(path, calibration)
    text = path.read_text()
    for size in range(0, len(text), 97):
        path.write_text(text[:size])
        with pytest.raises(CaptureError) as caught:
            read_calibration(path)
        assert "\n" not in str(caught.value)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CaptureError, match="cannot be read"):
        read_calibration(path)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(3), "shape"),
        (2.0 * np.eye(4), "no rotation"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "no rotation"),
        (np.eye(4) + np.eye(4)[::-1] * 1e-3, "no rotation"),
        (np.eye(4) * np.nan, "finite"),
        (np.eye(4) + np.eye(4, k=-3), "last row"),
    ],
)
def test_only_rigid_motions_are_taken(calibration, matrix, message):
    with pytest.raises(InputError, match=message):
        Calibration(calibration.camera, calibration.projector, matrix, np.eye(4))


def test_devices_at_one_place_are_rejected(calibration):
    """Without a baseline there is no depth."""
    at = calibration.T_world_from_cam
    with pytest.raises(InputError, match=r"camera and projector are 0 mm apart; allowed 0\.001"):
        Calibration(calibration.camera, calibration.projector, at, at)


def test_a_motion_beyond_the_laboratory_is_rejected(calibration):
    far = np.array(calibration.T_world_from_cam)
    far[0, 3] = 1e300
    with pytest.raises(InputError, match=r"T_world_from_cam moves by .* allowed up to 1e[+]06 mm"):
        Calibration(calibration.camera, calibration.projector, far, np.eye(4))


def test_skew_is_rejected(tmp_path, calibration):
    path = tmp_path / "calibration.yaml"
    write_calibration(path, calibration)
    text = path.read_text().replace("[ 900., 0.,", "[ 900., 0.5,", 1)
    path.write_text(text)
    with pytest.raises(CaptureError, match="skew"):
        read_calibration(path)


def test_transforms_cannot_be_changed_afterwards(calibration):
    with pytest.raises(ValueError, match="read-only"):
        calibration.T_world_from_cam[0, 3] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        calibration.camera = None
