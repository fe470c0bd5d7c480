"""The worked example of docs/real_rig.md, as a rig owner would run it."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reconstruction.calibration.observation import read_board_capture
from reconstruction.capture.folder import read_capture
from reconstruction.errors import CaptureError
from reconstruction.pipeline import read_maps, read_reconstruction, reconstruct
from reconstruction.rig.calibration import read_calibration, write_calibration
from twin.cli import run

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLE = DOCS / "example_capture"
# The places and the radius, mm, of docs/make_example_capture.py.
PLACES_MM = {"crest_z_mm": (-4.0, 0.0), "flat_z_mm": (0.0, -6.0)}
RADIUS_MM = 0.3
WITHOUT_RENDERER = """
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"twin", "mitsuba", "drjit"}:
            raise ImportError("a real capture must not need " + name)
sys.meta_path.insert(0, Block())
import numpy as np
from reconstruction.capture.folder import read_capture
from reconstruction.pipeline import read_maps, read_reconstruction, reconstruct
from reconstruction.pipeline import reconstruct
points = reconstruct(read_capture(sys.argv[1])).point_map
np.save(sys.argv[2], np.where(points.valid[..., None], points.points_world_mm, np.nan))
"""


def test_heights_of_the_example_without_renderer(tmp_path):
    """Expected: mean heights as in the truth to 2 um: 80 pixels of sigma 0.5 um, and the filter
    (sigma 1.5 px = 0.09 mm), which lowers a crest of radius R by sigma^2 / R: 2 um for the ball of
    4 mm, less for the flatter coat over it.
    """
    out = tmp_path / "points.npy"
    command = [sys.executable, "-c", WITHOUT_RENDERER, str(EXAMPLE), str(out)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=DOCS.parent)
    assert done.returncode == 0, done.stderr
    points_mm = np.load(out)
    truth = json.loads((EXAMPLE / "truth.json").read_text())
    for name, (x_mm, y_mm) in PLACES_MM.items():
        near = np.hypot(points_mm[..., 0] - x_mm, points_mm[..., 1] - y_mm) < RADIUS_MM
        assert near.sum() > 50
        assert np.mean(points_mm[near][:, 2]) == pytest.approx(truth[name], abs=2e-3)
        # The document shows the same truth.
        assert f"{truth[name]:.4f}" in (DOCS / "real_rig.md").read_text()


def test_command_of_the_document(tmp_path, capsys):
    out = tmp_path / "out"
    assert run(["reconstruct", str(EXAMPLE), "-o", str(out)]) == 0
    figures = json.loads((out / "result.json").read_text())["metrics"]
    assert figures["points"] > 70_000
    assert figures["sigma_z_median_um"] < 1.0
    for name in ("points.ply", "reconstruction.nc", "experiment.toml"):
        assert (out / name).is_file()
    assert "points" in capsys.readouterr().out


def test_description_in_the_document_is_that_of_the_example():
    text = (DOCS / "real_rig.md").read_text()
    for line in (EXAMPLE / "capture.toml").read_text().splitlines():
        assert line in text


def test_example_is_small_and_its_files_are_the_frames_projected():
    assert sum(path.stat().st_size for path in EXAMPLE.iterdir()) < 3e6
    capture = read_capture(EXAMPLE)
    assert capture.stack.dtype == np.uint8
    assert len(list(EXAMPLE.glob("*.png"))) == len(capture.patterns.frames)


def test_exchanged_images_give_one_line_and_no_files(tmp_path, capsys):
    """Setup: two camera images of the example change their names."""
    folder, out = tmp_path / "capture", tmp_path / "out"
    shutil.copytree(EXAMPLE, folder)
    first, second = folder / "003_phase_column_03.png", folder / "004_phase_column_04.png"
    held = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(held)
    assert run(["reconstruct", str(folder), "-o", str(out)]) == 2
    error = capsys.readouterr().err.strip().splitlines()
    assert "frames 3 (phase_column_03) and 4 (phase_column_04) look exchanged" in error[-1]
    assert not out.exists()


def listed_example(tmp_path):
    """Return the example with the list of frames that the document shows, and no other file."""
    text = (DOCS / "real_rig.md").read_text()
    folder = tmp_path / "my_capture"
    folder.mkdir()
    for path in [*EXAMPLE.glob("*_column_*.png"), EXAMPLE / "calibration.yaml"]:
        shutil.copy(path, folder)
    (folder / "capture.toml").write_text(text.partition("```toml\n")[2].partition("```")[0])
    return folder


@pytest.mark.parametrize(
    ("stated", "explained"),
    [
        ({"period_px = 18.0": "period_px = 16.0"}, "period_px = 18 along column and row"),
        ({}, ""),
    ],
)
def test_without_points_the_period_is_searched(both_axes, tmp_path, capsys, stated, explained):
    """Setup: all frames, with a wrong period that needs as many bits; or with the right one.

    Expected: one line that names the period with which all pixels give points, and no result.
    """
    out, file = tmp_path / "out", both_axes / "capture.toml"
    text = file.read_text()
    for old, new in stated.items():
        text = text.replace(old, new)
    file.write_text(text)
    code = run(["reconstruct", str(both_axes), "-o", str(out)])
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert code == (2 if explained else 0)
    assert out.exists() == (not explained)
    if explained:
        assert f"with {explained} (stated 16) 100% of the lit pixels give points" in line


def test_another_rigs_calibration_is_named_if_no_period_fits(both_axes, tmp_path, capsys):
    """Setup: the projector of the calibration is turned by 30 degrees about its axis."""
    calibration = read_calibration(both_axes / "calibration.yaml")
    turn = Rotation.from_euler("z", 30.0, degrees=True).as_matrix()
    pose = calibration.T_world_from_proj.copy()
    pose[:3, :3] = pose[:3, :3] @ turn
    (both_axes / "calibration.yaml").unlink()
    write_calibration(both_axes / "calibration.yaml", replace(calibration, T_world_from_proj=pose))
    assert run(["reconstruct", str(both_axes), "-o", str(tmp_path / "out")]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert (
        "tried without result: exchanged axes, and period_px up to 2.5 times larger or smaller"
        in line
    )


def test_bits_in_the_opposite_order_are_named(both_axes, tmp_path, capsys):
    file = both_axes / "capture.toml"
    text = file.read_text().replace('kind = "gray"', 'kind = "gray"\nbits = "fine_first"')
    file.write_text(text)
    assert run(["decode", str(both_axes), "-o", str(tmp_path / "out")]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert "the Gray frames along column and row look recorded in the opposite order" in line


def test_a_number_of_bits_names_the_periods_that_it_suits(both_axes, tmp_path, capsys):
    """8 bits number 256 words on 1280 px: 5 px wide, or half-periods of fringes below 20 px."""
    file = both_axes / "capture.toml"
    file.write_text(file.read_text().replace("period_px = 18.0", "period_px = 27.0"))
    assert run(["decode", str(both_axes), "-o", str(tmp_path / "out")]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert "8 frames number fringes of 5 to 20 px on 1280 px" in line


@pytest.fixture
def both_axes(tmp_path):
    """Return the example, listed as in the document but with the frames along both axes."""
    folder = listed_example(tmp_path)
    for path in EXAMPLE.glob("*_row_*.png"):
        shutil.copy(path, folder)
    head, _, rest = (folder / "capture.toml").read_text().partition("[[frames]]")
    groups, _, sensor = rest.partition("[sensor]")
    columns = f"[[frames]]{groups}"
    text = f"{head}{columns}{columns.replace('column', 'row')}[sensor]{sensor}"
    (folder / "capture.toml").write_text(text)
    return folder


def test_a_board_needs_both_axes(tmp_path):
    with pytest.raises(CaptureError, match="a board needs fringes along both axes"):
        read_board_capture(listed_example(tmp_path))


def test_listed_columns_only_give_the_heights_of_the_example(tmp_path):
    """Expected: the points that all frames give, as the epipolar test moves none; and their
    coordinates, exactly: the other axis has no part in them.
    """
    folder = listed_example(tmp_path)
    out, decoded = tmp_path / "out", tmp_path / "decoded"
    assert run(["reconstruct", str(folder), "-o", str(out)]) == 0
    assert run(["decode", str(folder), "-o", str(decoded)]) == 0
    alone, whole = (
        read_reconstruction(out / "reconstruction.nc"),
        reconstruct(read_capture(EXAMPLE)),
    )
    assert alone.decoded.axes == ("column",)
    both = alone.point_map.valid & whole.point_map.valid
    assert both.mean() > 0.99
    apart_mm = (alone.point_map.points_world_mm - whole.point_map.points_world_mm)[both]
    assert np.max(np.abs(apart_mm)) < 1e-5
    column_px = np.asarray(read_maps(decoded / "decoded.nc")["column_px"])
    np.testing.assert_array_equal(column_px[both], whole.decoded.column.coordinate_px[both])
    maps = read_maps(out / "reconstruction.nc")
    assert "row_px" not in maps
