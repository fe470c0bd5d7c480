"""Height maps and meshes, read back by standard tools."""

import json

import imageio.v3 as imageio
import numpy as np
import pytest
import trimesh
import xarray

from reconstruction.arrays import Reason
from reconstruction.errors import InputError
from reconstruction.evaluate.surface import (
    height_map,
    surface_mesh,
    write_height_exr,
    write_height_netcdf,
    write_height_png,
    write_mesh_ply,
)
from reconstruction.triangulation import PointMap


def point_map(z_of, rows=120, cols=160, pitch=0.05):
    """Points on a regular grid seen from above: columns along +x, rows along -y; a hole in it."""
    x = (np.arange(cols) - cols / 2) * pitch
    y = (rows / 2 - np.arange(rows)) * pitch
    x_mm, y_mm = np.meshgrid(x, y)
    points = np.stack([x_mm, y_mm, z_of(x_mm, y_mm)], axis=-1).astype(np.float32)
    reason = np.full((rows, cols), int(Reason.VALID), np.uint8)
    reason[40:50, 60:80] = int(Reason.DARK)
    points[reason != int(Reason.VALID)] = 0.0
    return PointMap(points, np.ones_like(points), reason, np.eye(4))


@pytest.fixture
def wave():
    return point_map(lambda x, y: 0.3 * np.sin(x) + 0.1 * y)


def test_heights_are_those_of_the_points(wave):
    result = height_map(wave, 0.1)
    x, y = np.meshgrid(result.x_mm, result.y_mm)
    true = 0.3 * np.sin(x) + 0.1 * y
    error = (result.z_mm - true)[result.valid]
    assert np.abs(error).max() < 0.06  # half a cell of slope 0.3 each way, off-centre points
    assert abs(error.mean()) < 0.02
    assert not result.valid.all()
    assert np.all(np.diff(result.x_mm) > 0)
    assert np.all(np.diff(result.y_mm) < 0)


def test_files_hold_the_same_heights(wave, tmp_path):
    import OpenEXR

    result = height_map(wave)
    write_height_netcdf(tmp_path / "h.nc", result)
    write_height_png(tmp_path / "h.png", result)
    write_height_exr(tmp_path / "h.exr", result)
    with xarray.open_dataset(tmp_path / "h.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal(data.z_mm.values, result.z_mm)
        assert data.x.attrs["units"] == "mm"
    level = imageio.imread(tmp_path / "h.png")
    scale = json.loads((tmp_path / "h.png.json").read_text())
    z = scale["first_z_mm"] + scale["step_z_mm"] * (level.astype(float) - 1)
    assert np.array_equal(level > 0, result.valid)
    np.testing.assert_allclose(z[result.valid], result.z_mm[result.valid], atol=scale["step_z_mm"])
    channels = OpenEXR.File(str(tmp_path / "h.exr")).channels()
    np.testing.assert_array_equal(channels["Z"].pixels, result.z_mm)


def test_mesh_faces_the_camera_and_keeps_the_hole_open(wave, tmp_path):
    mesh = surface_mesh(wave)
    write_mesh_ply(tmp_path / "m.ply", mesh)
    loaded = trimesh.load(tmp_path / "m.ply", process=False)
    assert len(loaded.faces) == len(mesh.triangles)
    assert np.all(loaded.face_normals[:, 2] > 0)
    hole = 11 * 21 * 0.05**2  # cells that touch a missing point
    flat = surface_mesh(point_map(lambda x, _: 0.0 * x))
    area = trimesh.Trimesh(flat.vertices_mm, flat.triangles, process=False).area
    assert area == pytest.approx(119 * 159 * 0.05**2 - hole, abs=3 * 0.05**2)


def test_a_jump_is_cut():
    step = surface_mesh(point_map(lambda x, _: np.where(x > 0, 2.0, 0.0)))
    corners = step.vertices_mm[step.triangles]
    assert np.ptp(corners[..., 2], axis=1).max() == 0.0


def test_a_capture_without_points_is_rejected(wave):
    empty = PointMap(
        wave.points_world_mm,
        wave.sigma_xyz_mm,
        np.full_like(wave.mask_reason, int(Reason.DARK)),
        np.eye(4),
    )
    with pytest.raises(InputError, match="no valid point"):
        height_map(empty)
    with pytest.raises(InputError, match="no three"):
        surface_mesh(empty)
