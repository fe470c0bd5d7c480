"""Calibrations of other programs: each layout gives back the rig that it was written from."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.reality_calibrations import CASES, public_rigs
from reconstruction.errors import CaptureError
from reconstruction.rig.calibration import Calibration
from reconstruction.rig.imported_lens import MOST_REFIT_PX
from reconstruction.rig.importing import Importing, import_calibration
from tests.corpus.calibrations import LAYOUTS, of_opencv, of_scanner, stored
from tests.corpus.rigs import RIG, matrix, misread

CAMERA, PROJECTOR, ROTATION, TRANSLATION_MM = (
    RIG.camera,
    RIG.projector,
    RIG.rotation,
    RIG.translation_mm,
)
SIZES = Importing(camera_size=(640, 480), projector_size=(912, 1140))


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_layout_gives_back_the_rig(name: str, tmp_path: Path):
    layout = LAYOUTS[name]
    result = import_calibration(layout.write(tmp_path, RIG), layout.content.options(RIG))
    assert result.refit_px == (0.0, 0.0)
    assert misread(result, layout.content, RIG) == []


def test_a_misread_quantity_is_reported(tmp_path: Path):
    """The oracle of the layouts can fail: each changed quantity is named."""
    result = import_calibration(of_scanner(tmp_path), SIZES)
    other = replace(CAMERA, height_px=481, cx_px=322.0)
    changed = replace(RIG, camera=other, translation_mm=1.001 * TRANSLATION_MM)
    assert misread(result, LAYOUTS["scan3d"].content, changed) == [
        "camera size",
        "camera matrix",
        "translation",
    ]


def test_public_files_are_read_right():
    public = list(public_rigs(CASES))
    if not public:
        pytest.skip("needs ../shared/cases")
    for files, rig, content in public:
        assert misread(import_calibration(files, content.options(rig)), content, rig) == []


def test_the_world_lies_where_the_axes_come_nearest(tmp_path: Path):
    """No other point of the camera's axis is nearer to the projector's."""
    rig = import_calibration(of_scanner(tmp_path), SIZES).calibration
    np.testing.assert_allclose(rig.T_world_from_cam[:3, :3], np.diag([1.0, -1.0, -1.0]))
    centre, axis = rig.T_world_from_proj[:3, 3], rig.T_world_from_proj[:3, 2]

    def apart_mm(z_mm: float) -> float:
        return float(np.linalg.norm(np.cross(np.array([0.0, 0.0, z_mm]) - centre, axis)))

    assert rig.T_world_from_cam[2, 3] > 100
    assert apart_mm(0.0) < min(apart_mm(-1.0), apart_mm(1.0))


def test_the_angle_is_that_between_two_known_places():
    """The camera above the origin, the projector 45 degrees aside."""
    above, aside = np.eye(4), np.eye(4)
    above[:3, 3], aside[:3, 3] = (0.0, 0.0, 200.0), (150.0, 0.0, 150.0)
    rig = Calibration(CAMERA, PROJECTOR, above, aside)
    assert rig.triangulation_angle_deg == pytest.approx(45.0)


def test_units_and_order_are_the_stated_ones(tmp_path: Path):
    """With the devices swapped and lengths in cm the rig is the same with both exchanged."""
    plain = import_calibration(of_scanner(tmp_path), SIZES).calibration
    swapped = Importing((912, 1140), (640, 480), "cm", projector_first=True, standoff_mm=200.0)
    turned = import_calibration(of_scanner(tmp_path), swapped).calibration
    assert turned.camera.fx_px == PROJECTOR.fx_px
    back = np.linalg.inv(plain.T_proj_from_cam)
    np.testing.assert_allclose(turned.T_proj_from_cam[:3, :3], back[:3, :3], atol=1e-9)
    np.testing.assert_allclose(turned.T_proj_from_cam[:3, 3], 10.0 * back[:3, 3], atol=1e-6)
    assert turned.T_world_from_cam[2, 3] == 200.0


def test_an_implausible_rig_is_rejected(tmp_path: Path):
    """98 mm read as metres; the focal length of a lens in mm in the place of pixels."""
    with pytest.raises(CaptureError, match=r"baseline_mm is .*, plausible 1 to 2e\+04.*--unit"):
        import_calibration(of_scanner(tmp_path), replace(SIZES, unit="m"))
    short = replace(CAMERA, fx_px=12.0, fy_px=12.0)
    with pytest.raises(CaptureError, match="camera_field_of_view_deg is 17"):
        import_calibration(of_scanner(tmp_path, replace(RIG, camera=short)), SIZES)


@pytest.mark.parametrize("skew", [0.0, 0.02])
def test_other_lenses_are_refitted_and_their_pixels_agree(tmp_path: Path, skew: float):
    """A rational lens of eight coefficients; a skew of a hundredth of a pixel."""
    eight = np.array([[-0.11, 0.07, 4e-4, -3e-4, 0.02, 2e-3, 1e-3, 0.0]])
    path = stored(
        tmp_path / "rational.yml", K1=matrix(CAMERA, skew), D1=eight, K2=matrix(PROJECTOR),
        D2=np.array([PROJECTOR.distortion]), R=ROTATION, T=TRANSLATION_MM[:, None],
    )  # fmt: skip
    result = import_calibration([path], SIZES)
    assert 0.0 < result.refit_px[0] <= MOST_REFIT_PX
    assert result.refit_px[1] == 0.0
    points = np.random.default_rng(4).uniform((-35, -26, 199), (35, 26, 201), (200, 3))
    expected = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix(CAMERA), eight)[0][:, 0]
    expected[:, 0] += skew * (points[:, 1] / points[:, 2])  # to first order: the lens bends little
    missed = result.calibration.camera.project(points) - expected
    assert np.abs(missed).max() < MOST_REFIT_PX


def test_a_lens_that_cannot_be_followed_is_rejected(tmp_path: Path):
    path = stored(
        tmp_path / "skewed.yml", K1=matrix(CAMERA, 30.0), D1=np.array([CAMERA.distortion]),
        K2=matrix(PROJECTOR), D2=np.array([PROJECTOR.distortion]), R=ROTATION,
        T=TRANSLATION_MM[:, None],
    )  # fmt: skip
    with pytest.raises(CaptureError, match=r"skew 30.*allowed 0.05"):
        import_calibration([path], SIZES)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"R": np.diag([1.0, 1.0, 1.2])}, "R is no rotation"),
        ({"R": np.eye(3)}, "parallel.*--standoff-mm"),
        ({"D1": np.zeros((1, 3))}, r"no distortion of the camera .*4, 5, 8"),
        ({"T": np.zeros((2, 1))}, "no rotation R and translation T"),
        ({"M1": np.zeros((2, 2))}, "no camera matrix of the camera"),
    ],
)
def test_inconsistent_parts_are_one_line(tmp_path: Path, change, message: str):
    values = {
        "M1": matrix(CAMERA), "D1": np.array([CAMERA.distortion]), "M2": matrix(PROJECTOR),
        "D2": np.array([PROJECTOR.distortion]), "R": ROTATION, "T": TRANSLATION_MM[:, None],
    }  # fmt: skip
    path = stored(tmp_path / "x.yml", **(values | change))
    with pytest.raises(CaptureError, match=message) as caught:
        import_calibration([path], SIZES)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("x.yml: ")


def test_sizes_must_come_from_somewhere(tmp_path: Path):
    with pytest.raises(CaptureError, match=r"camera's image size .*--camera-size"):
        import_calibration(of_scanner(tmp_path))


@pytest.mark.parametrize("content", [b"", b"MATLAB 5.0 MAT-file, damaged" + bytes(200), b"\x89HDF"])
def test_damaged_matlab_files_raise_an_error(tmp_path: Path, content: bytes):
    path = tmp_path / "x.mat"
    path.write_bytes(content)
    with pytest.raises(CaptureError, match=r"x\.mat: "):
        import_calibration([path], SIZES)


def test_the_command_writes_a_calibration_that_a_capture_takes(tmp_path: Path, capsys):
    from reconstruction.rig.calibration import read_calibration
    from twin.cli import run

    sizes = ["--camera-size", "640", "480", "--projector-size", "912", "1140"]
    files = [str(path) for path in of_opencv(tmp_path)]
    assert run(["import-calibration", *files, *sizes, "-o", str(tmp_path / "out")]) == 0
    output = capsys.readouterr().out
    assert f"wrote {tmp_path / 'out' / 'calibration.yaml'}" in output
    assert "camera cameramatrix: M1" in output
    again = read_calibration(tmp_path / "out" / "calibration.yaml")
    assert again.projector.fy_px == pytest.approx(PROJECTOR.fy_px)
    assert run(["import-calibration", *files, "-o", str(tmp_path / "other")]) == 2
    assert not (tmp_path / "other").exists()


def test_an_unknown_format_is_an_error_that_lists_the_known_ones(tmp_path: Path):
    path = tmp_path / "rig.docx"
    path.write_text("{}"[::-1])
    with pytest.raises(CaptureError, match=r"rig\.docx: .*matlab: .*\.mat.*; opencv: .*%YAML"):
        import_calibration([path], SIZES)
    with pytest.raises(CaptureError, match=r"missing\.yml: cannot be read"):
        import_calibration([tmp_path / "missing.yml"], SIZES)
