"""twin calibrate on real captures by a projector with columns counted in steps of 0.5.

The captures are public ones of jakobwilm/slstudio, reduced in size; they are not part of this
repository, so that these tests run only where a folder holds them.
"""

import json
from pathlib import Path

import pytest

from twin.cli import run

CASE = Path(__file__).parents[3] / "shared" / "cases" / "06_lightcrafter_912x1140"
pytestmark = pytest.mark.skipif(not CASE.is_dir(), reason="no folder of real captures")
# The fewest that determine the rig; all five poses take four times as long.
POSES = "pose_1", "pose_4", "pose_6"


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lightcrafter")
    for name in POSES:
        (folder / name).symlink_to(CASE / "captures" / name)
    return folder


def calibrated(captures, out, *options):
    board = str(CASE / "board.toml")
    return run(["calibrate", str(captures), "--board", board, "-o", str(out), *options])


def test_columns_counted_by_halves_end_with_the_pixel_ratio(captures, tmp_path, capsys):
    """912 x 1140 mirrors of a diamond chip, taken for square: one line names 2, exit code 2."""
    out = tmp_path / "out"
    assert calibrated(captures, out) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("twin: ")]
    assert len(lines) == 1
    assert "the projector's pixels are 2.01 times as wide as high" in lines[0]
    assert "give --projector-pixel-ratio 2" in lines[0]
    assert "of square pixels it is 1824 x 1140" in lines[0]
    assert not out.exists()


def test_a_stated_pixel_ratio_gives_the_rig_and_is_kept(captures, tmp_path, capsys):
    """Expected: camera fx 1096 px, projector fx 1312 px, as on the grid of 1824 columns.

    Three poses without the blur term; with it the aperture would be 0.1 m, of a lens of 10 mm.
    """
    out = tmp_path / "out"
    assert calibrated(captures, out, "--projector-pixel-ratio", "2") == 0
    metrics = json.loads((out / "result.json").read_text())["metrics"]
    assert metrics["projector_pixel_ratio"] == 2.0
    assert metrics["camera_pixel_ratio"] == 1.0
    assert metrics["camera_fx_px"] == pytest.approx(1096.0, rel=0.01)
    assert metrics["projector_fx_px"] == pytest.approx(1312.0, rel=0.01)
    assert metrics["projector_fy_px"] == 2.0 * metrics["projector_fx_px"]
    assert metrics["projector_reprojection_rms_px"] < 0.35
    assert metrics["camera_pupil_diameter_mm"] is None or metrics["camera_pupil_diameter_mm"] < 40
