"""`twin cloud`: organised point clouds, read by the rules of the PCD format."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from reconstruction.arrays import Reason
from reconstruction.organised import write_organised_pcd
from reconstruction.pipeline import read_reconstruction
from twin.cli import run

EXAMPLE = Path(__file__).parents[2] / "docs" / "example_capture"


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    out = tmp_path_factory.mktemp("cloud") / "out"
    assert run(["reconstruct", str(EXAMPLE), "-o", str(out)]) == 0
    return out


def read_pcd(path):
    """Return the header by key, and the fields (row, col) by name."""
    head, data = path.read_bytes().split(b"DATA binary\n", 1)
    header = dict(
        line.split(" ", 1) for line in head.decode().splitlines() if not line.startswith("#")
    )
    names, sizes, types = (header[key].split() for key in ("FIELDS", "SIZE", "TYPE"))
    kinds = {("F", "4"): "<f4", ("U", "1"): "u1"}
    layout = [(n, kinds[t, s]) for n, s, t in zip(names, sizes, types, strict=True)]
    shape = int(header["HEIGHT"]), int(header["WIDTH"])
    return header, np.frombuffer(data, layout).reshape(shape)


def test_every_pixel_has_a_place_in_the_cloud(result, tmp_path, capsys):
    assert run(["cloud", str(result), "-o", str(tmp_path / "points.pcd")]) == 0
    measured = read_reconstruction(result / "reconstruction.nc")
    points, valid = measured.point_map.points_world_mm, measured.point_map.valid
    header, cloud = read_pcd(tmp_path / "points.pcd")
    assert header["VERSION"] == "0.7"
    assert int(header["POINTS"]) == valid.size
    assert cloud.shape == valid.shape
    xyz = np.stack([cloud[name] for name in "xyz"], axis=-1)
    assert np.array_equal(xyz[valid], points[valid])
    normals = np.stack([cloud[f"normal_{name}"] for name in "xyz"], axis=-1)
    known = np.isfinite(normals[..., 0])
    assert known.sum() > 0.9 * valid.sum()
    assert np.linalg.norm(normals[known], axis=-1) == pytest.approx(1.0, abs=1e-5)
    assert np.array_equal(cloud["intensity"], measured.decoded.intensity_dn)
    assert f"{valid.sum()} of them valid" in capsys.readouterr().out


def test_a_file_is_not_overwritten_and_a_wrong_folder_is_named(result, tmp_path, capsys):
    target = tmp_path / "points.pcd"
    target.write_text("mine")
    assert run(["cloud", str(result), "-o", str(target)]) == 2
    assert target.read_text() == "mine"
    assert run(["cloud", str(tmp_path), "-o", str(tmp_path / "new.pcd")]) == 2
    assert "reconstruction.nc" in capsys.readouterr().err
    assert not (tmp_path / "new.pcd").exists()


def test_pixels_without_a_point_are_nan(result, tmp_path):
    """Setup: columns 10 to 19 masked. Expected: NaN there, and normals towards their border."""
    measured = read_reconstruction(result / "reconstruction.nc")
    reason = measured.point_map.mask_reason.copy()
    reason[:, 10:20] = Reason.SATURATED
    masked = replace(measured, point_map=replace(measured.point_map, mask_reason=reason))
    write_organised_pcd(tmp_path / "points.pcd", masked)
    _, cloud = read_pcd(tmp_path / "points.pcd")
    for name in ("x", "z", "normal_z"):
        assert np.isnan(cloud[name][:, 10:20]).all()
        assert np.isfinite(cloud[name][5:-5, 25:]).all()
    assert np.isfinite(cloud["intensity"]).all()
