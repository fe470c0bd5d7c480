"""Two rendered cameras with one projector, merged, against the true surface."""

import json

import numpy as np
import pytest

from benchmarks.reality_two_cameras import compared, measured_by_both
from reconstruction.capture.folder import write_capture
from reconstruction.pipeline import read_reconstruction
from twin.cli import run


@pytest.fixture(scope="module")
def measured():
    return measured_by_both(binning=4)


def test_merged_points_are_better_and_have_fewer_shadows(measured):
    """Expected: error 1/sqrt(2) of that of one camera for independent errors; 0.80 measured."""
    figures = compared(measured)
    assert figures["merged_over_alone"] < 0.9
    assert figures["shadow_ratio"] < 0.5
    assert 0.7 < figures["merged_error_over_sigma"] < 1.4


def test_the_command_triangulates_between_the_cameras(measured, tmp_path):
    folders = []
    for done, name in zip(measured, ("left", "right"), strict=True):
        (tmp_path / name).mkdir()
        write_capture(tmp_path / name, done.images.capture)
        folders.append(str(tmp_path / name))
    out = tmp_path / "out"
    assert run(["merge", *folders, "--baseline", "cameras", "-o", str(out)]) == 0
    points = read_reconstruction(out / "reconstruction.nc").point_map
    truth = measured[0].truth
    where = points.valid & truth.measured
    error_mm = np.linalg.norm((points.points_world_mm - truth.points_world_mm)[where], axis=-1)
    sigma_mm = np.linalg.norm(points.sigma_xyz_mm[where], axis=-1)
    assert where.sum() > 0.5 * truth.measured.sum()
    assert 0.5 < 1.4826 * np.median(error_mm / sigma_mm) < 1.5
    figures = json.loads((out / "result.json").read_text())["metrics"]
    assert figures["projector_offset_median_um"] < 2.0
