"""A scan of measured patches: from folders of `twin reconstruct` to one height map."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from reconstruction.netcdf import read_arrays
from twin.cli import run

CAPTURE = Path(__file__).parents[2] / "docs" / "example_capture"
PLAN = '[stage]\nsigma_um = 20.0\n[[patch]]\nresult = "own"\n[[patch]]\nresult = "own"\n'


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scan")
    assert run(["reconstruct", str(CAPTURE), "-o", str(folder / "own")]) == 0
    (folder / "plan.toml").write_text(f'name = "copies"\n{PLAN}')
    assert run(["scan", str(folder / "plan.toml"), "-o", str(folder / "out")]) == 0
    return folder


def test_two_copies_of_a_patch_are_that_patch(scanned):
    """Expected: no seam, and the heights of the patch."""
    figures = json.loads((scanned / "out" / "result.json").read_text())["metrics"]
    assert figures["seam_rms_um"] == pytest.approx(0.0, abs=1e-6)
    fused, single = (_heights_mm(scanned / name / "height_map.nc") for name in ("out", "own"))
    quantiles = (0.1, 0.5, 0.9)
    np.testing.assert_allclose(
        np.quantile(fused, quantiles), np.quantile(single, quantiles), atol=2e-3
    )


def _heights_mm(path):
    stored = read_arrays(path)
    return stored["z_mm"][stored["valid"] != 0]


def test_the_common_motion_keeps_the_sigma_of_the_stage(scanned):
    """Expected: the mean of two stage positions, 20 um / sqrt 2: no overlap shows it."""
    figures = json.loads((scanned / "out" / "result.json").read_text())["metrics"]
    for name in ("pose_sigma_x_um", "pose_sigma_y_um"):
        assert figures[name] == pytest.approx(20.0 / np.sqrt(2.0), rel=0.02)


def test_an_error_leaves_no_folder(scanned, capsys):
    plan = scanned / "apart.toml"
    for patch in ("own", "missing"):
        plan.write_text(f"{PLAN}x_mm = 500.0\n".replace("own", patch))
        assert run(["scan", str(plan), "-o", str(scanned / "new" / "failed")]) == 2
    assert "no two patches overlap" in capsys.readouterr().err
    assert not (scanned / "new").exists()


def test_pages_and_arrays_are_written(scanned):
    names = {path.name for path in (scanned / "out").iterdir()}
    assert {"scan.nc", "scan.ply", "scan.png", "poses.csv", "report.html"} <= names


def test_the_page_is_drawn_again_from_the_stored_result(scanned):
    """Expected: the bytes of the first page, without the patches."""
    folder = scanned / "again"
    shutil.copytree(scanned / "out", folder)
    first = (folder / "report.html").read_bytes()
    (folder / "report.html").unlink()
    assert run(["report", str(folder)]) == 0
    assert (folder / "report.html").read_bytes() == first


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda result: result.pop("registration"), "run twin scan again"),
        (lambda result: result["registration"]["motion"].pop(), "found 1 motions and 2 sigmas"),
        (lambda result: result["plan"].update(name=""), "name"),
        (lambda result: result["metrics"].pop("pitch_mm"), "scan.nc: cannot be read"),
    ],
)
def test_a_damaged_result_is_named(scanned, tmp_path, capsys, change, message):
    shutil.copytree(scanned / "out", folder := tmp_path / "out")
    result = json.loads((folder / "result.json").read_text())
    change(result)
    (folder / "result.json").write_text(json.dumps(result))
    assert run(["report", str(folder)]) == 2
    assert message in capsys.readouterr().err
