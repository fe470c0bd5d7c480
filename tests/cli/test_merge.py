"""`twin merge`: captures of several cameras with one projector."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from reconstruction.pipeline import read_maps, read_reconstruction
from reconstruction.rig.calibration import read_calibration, write_calibration
from twin.cli import run

EXAMPLE = Path(__file__).parents[2] / "docs" / "example_capture"


@pytest.fixture(scope="module")
def merged(tmp_path_factory):
    """The example twice; the second calibration has another world: turned, and moved by 7 mm."""
    folder = tmp_path_factory.mktemp("merge")
    shutil.copytree(EXAMPLE, folder / "second")
    rig = read_calibration(EXAMPLE / "calibration.yaml")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.1, -0.2, 0.4]).as_matrix()
    T[:3, 3] = 2.0, 3.0, 6.0
    moved = replace(
        rig, T_world_from_cam=T @ rig.T_world_from_cam, T_world_from_proj=T @ rig.T_world_from_proj
    )
    write_calibration(folder / "second" / "calibration.yaml", moved)
    out = folder / "out"
    assert run(["merge", str(EXAMPLE), str(folder / "second"), "-o", str(out)]) == 0
    assert run(["reconstruct", str(EXAMPLE), "-o", str(folder / "alone")]) == 0
    return out


def test_files_contain_every_place_once(merged):
    """The same images in another world: the points of one capture, none of the other."""
    figures = json.loads((merged / "result.json").read_text())["metrics"]
    alone = json.loads((merged.parent / "alone" / "result.json").read_text())["metrics"]
    assert figures["points"] == pytest.approx(alone["points"], rel=0.02)
    assert figures["offset_median_um"] < 0.1
    assert figures["birge_ratio"] == 1.0
    cloud = trimesh.load(merged / "points.ply")
    assert len(cloud.vertices) == figures["points"]
    maps = read_reconstruction(merged / "camera_1.nc")
    expected = read_reconstruction(merged.parent / "alone" / "reconstruction.nc")
    assert maps.point_map.points_world_mm == pytest.approx(
        expected.point_map.points_world_mm, abs=2e-4
    )
    repeated = read_maps(merged / "camera_2.nc")["is_repeated"]
    assert repeated.sum() == pytest.approx(alone["points"], rel=0.02)
    for name in ("merged.png", "height_map.nc", "height_map.exr", "experiment.toml"):
        assert (merged / name).stat().st_size > 0


def test_a_single_capture_is_an_error(tmp_path, capsys):
    assert run(["merge", str(EXAMPLE), "-o", str(tmp_path / "out")]) == 2
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert "found 1 capture; give two or more, one per camera" in line
    assert not (tmp_path / "out").exists()


def test_calibrations_that_differ_are_named(merged, tmp_path, capsys):
    """The projector of the second rig is turned by 0.02 degrees, 0.09 mm at 250 mm."""
    second = tmp_path / "second"
    shutil.copytree(EXAMPLE, second)
    rig = read_calibration(EXAMPLE / "calibration.yaml")
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.0, np.deg2rad(0.02), 0.0]).as_matrix()
    wrong = replace(rig, T_world_from_proj=rig.T_world_from_proj @ turn)
    write_calibration(second / "calibration.yaml", wrong)
    assert run(["merge", str(EXAMPLE), str(second), "-o", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().err
    assert "times their noise: calibrate all cameras on the same board poses" in printed
    figures = json.loads((tmp_path / "out" / "result.json").read_text())["metrics"]
    assert figures["birge_ratio"] > 3.0
