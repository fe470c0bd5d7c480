import dataclasses

import numpy as np
import pytest
import trimesh
import xarray

from reconstruction.capture.folder import Capture
from reconstruction.colouring import UNKNOWN, Deviation, Intensity
from reconstruction.decoding.decode import DecodeOptions, Reason
from reconstruction.errors import CaptureError, InputError
from reconstruction.evaluate.surface import write_surface
from reconstruction.patterns import PatternSet
from reconstruction.pipeline import (
    ReconstructOptions,
    read_reconstruction,
    reconstruct,
    write_reconstruction,
)
from reconstruction.ply import write_ply, write_point_map_ply
from reconstruction.rig.sensor import SensorNoise
from reconstruction.triangulation.normals import surface_normals


@pytest.fixture(scope="module")
def reconstruction(calibration, surface, project, synthesise):
    """Return a capture reconstructed with a dark corner and one broken epipolar pixel."""
    patterns = PatternSet(1280, 720)
    observed = project(calibration, surface(calibration))
    observed[40, 50, 1] += 36.0
    stack = synthesise(
        patterns, observed[..., 0], observed[..., 1], mean_dn=1900.0, amplitude_dn=1500.0
    )
    stack[:, :10, :10] = 64.0
    sensor = SensorNoise(0.17, 6.2, 64.0, 4095.0)
    capture = Capture(np.rint(stack).astype(np.uint16), patterns, sensor, calibration, 12)
    return reconstruct(capture, ReconstructOptions(decode=DecodeOptions(filter_taps=0)))


def test_pipeline_finds_the_surface(reconstruction, calibration, surface):
    result = reconstruction.point_map
    assert np.all(result.mask_reason[:10, :10] == Reason.DARK)
    assert result.mask_reason[40, 50] == Reason.EPIPOLAR_MISMATCH
    assert result.valid.sum() == 90 * 120 - 101
    error_mm = (result.points_world_mm - surface(calibration))[result.valid]
    assert np.sqrt(np.mean(error_mm**2)) < 1e-4


def test_default_options_filter(calibration, surface, project, synthesise):
    """Expected: every point, to the borders, with a fifth of the noise of the single pixel."""
    patterns, sensor = PatternSet(1280, 720), SensorNoise(0.17, 6.2, 64.0, 4095.0)
    observed = project(calibration, surface(calibration))
    stack = synthesise(
        patterns, observed[..., 0], observed[..., 1], mean_dn=1900.0, amplitude_dn=1500.0
    )
    capture = Capture(np.rint(stack).astype(np.uint16), patterns, sensor, calibration, 12)
    result = reconstruct(capture).point_map
    single = reconstruct(capture, ReconstructOptions(decode=DecodeOptions(filter_taps=0))).point_map
    assert result.valid.all()
    ratio = np.median(result.sigma_z_mm / single.sigma_z_mm)
    assert 0.15 < ratio < 0.25


def test_netcdf_round_trip(reconstruction, tmp_path):
    path = tmp_path / "reconstruction.nc"
    write_reconstruction(path, reconstruction.decoded, reconstruction.point_map)
    result = read_reconstruction(path)
    for part in ("column", "row"):
        before, after = getattr(reconstruction.decoded, part), getattr(result.decoded, part)
        for field in dataclasses.fields(before):
            a, b = getattr(before, field.name), getattr(after, field.name)
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
    np.testing.assert_array_equal(result.decoded.mask_reason, reconstruction.decoded.mask_reason)
    for field in ("points_world_mm", "sigma_xyz_mm", "mask_reason", "T_world_from_cam"):
        np.testing.assert_array_equal(
            getattr(result.point_map, field), getattr(reconstruction.point_map, field)
        )


def test_netcdf_is_labelled(reconstruction, tmp_path):
    path = tmp_path / "reconstruction.nc"
    write_reconstruction(path, reconstruction.decoded, reconstruction.point_map)
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        units = {name: data[name].attrs["units"] for name in data.data_vars}
        assert data["z_mm"].dims == ("row", "col")
        meanings = data["mask_reason"].attrs["flag_meanings"].split()
    assert meanings[Reason.SATURATED] == "SATURATED"
    expected = {"z_mm": "mm", "sigma_z_mm": "mm", "column_px": "px", "phase_column_rad": "rad"}
    expected |= {"modulation_dn": "DN", "mean_dn": "DN", "order_column": "1", "mask_reason": "1"}
    assert expected.items() <= units.items()


def test_damaged_netcdf_is_explained(tmp_path):
    with pytest.raises(CaptureError, match="no complete netCDF-4"):
        read_reconstruction(tmp_path / "missing.nc")
    (tmp_path / "text.nc").write_text("text")
    with pytest.raises(CaptureError, match="no complete netCDF-4"):
        read_reconstruction(tmp_path / "text.nc")
    xarray.Dataset({"column_px": ("row", [1.0])}).to_netcdf(
        tmp_path / "other.nc", engine="h5netcdf"
    )
    with pytest.raises(CaptureError, match="is missing"):
        read_reconstruction(tmp_path / "other.nc")


def test_ply_loads_in_trimesh(reconstruction, tmp_path):
    path = tmp_path / "points.ply"
    write_point_map_ply(path, reconstruction.point_map)
    cloud = trimesh.load(path)
    valid = reconstruction.point_map.valid
    np.testing.assert_array_equal(cloud.vertices, reconstruction.point_map.points_world_mm[valid])
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(
        raw["sigma_z_mm"].ravel(), reconstruction.point_map.sigma_z_mm[valid]
    )
    row, col = np.nonzero(valid)
    np.testing.assert_array_equal(raw["row"].ravel(), row)
    np.testing.assert_array_equal(raw["col"].ravel(), col)


def test_ply_carries_deviation_as_colour(reconstruction, tmp_path):
    """Blue below, white at 0, red above the truth, grey where it is not known; the mesh alike."""
    points = reconstruction.point_map
    um = np.zeros(points.valid.shape)
    um[:, ::3], um[:, 1::3] = -2.0, 2.0
    known = np.ones(points.valid.shape, dtype=bool)
    known[::2] = False
    deviation = Deviation(um, known)
    assert deviation.limit_um == 2.0
    write_surface(tmp_path, points, deviation)
    cloud, mesh = (trimesh.load(tmp_path / name) for name in ("points.ply", "surface.ply"))
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    row, col = np.nonzero(points.valid)
    np.testing.assert_array_equal(raw["deviation_um"].ravel(), np.where(known, um, 0)[row, col])
    assert "sigma_z_mm" in raw.dtype.names
    levels = {-2.0: (0, 0, 255), 2.0: (255, 0, 0), 0.0: (255, 255, 255)}
    for value, rgb in levels.items():
        chosen = known[row, col] & (um[row, col] == value)
        assert (cloud.colors[chosen, :3] == rgb).all()
        assert (mesh.visual.vertex_colors[chosen, :3] == rgb).all()
    assert (cloud.colors[~known[row, col], :3] == UNKNOWN).all()
    header = (tmp_path / "points.ply").read_bytes()[:400]
    assert b"colour is deviation_um: blue -2 um, white 0, red +2 um" in header


def test_ply_has_normals_and_intensity(reconstruction, tmp_path):
    """Expected: the intensity as grey level, and as normals those of reconstruction.nc."""
    points, decoded = reconstruction.point_map, reconstruction.decoded
    intensity = Intensity(decoded.intensity_dn, points.valid)
    write_surface(tmp_path, points, intensity=intensity)
    cloud, mesh = (trimesh.load(tmp_path / name) for name in ("points.ply", "surface.ply"))
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    dn = decoded.column.mean_dn[points.valid]
    np.testing.assert_array_equal(raw["intensity_dn"].ravel(), dn)
    grey = np.rint(np.minimum(255.0 * dn / np.percentile(dn, 99.0), 255.0))
    for colours in (cloud.colors, mesh.visual.vertex_colors):
        np.testing.assert_allclose(colours[:, :3], np.repeat(grey[:, np.newaxis], 3, 1), atol=1)
    assert b"white 19" in (tmp_path / "points.ply").read_bytes()[:400]
    stored = reconstruction.to_xarray()
    for name in "xyz":
        expected = stored[f"normal_{name}"].values[points.valid]
        np.testing.assert_array_equal(raw[f"n{name}"].ravel(), expected)


def test_normals_of_a_ball_and_of_a_step():
    """Expected: radial on the ball; across a jump from the pixels of the same level only."""
    y, x = 0.05 * np.mgrid[60:-61:-1, -150:151]
    z = np.sqrt(20.0**2 - x**2 - y**2)
    valid = np.ones(z.shape, bool)
    valid[5, 7] = valid[::2, 200] = valid[40, 99] = valid[40, 101] = False
    ball = surface_normals(np.stack((x, y, z), axis=-1), valid)
    assert not ball[5, 7].any()
    assert not ball[40, 100].any()
    known = ball.any(axis=-1)
    assert (known == valid)[:, :199].sum() == known[:, :199].size - 1
    cosine = np.einsum("rci,rci->rc", ball, np.stack((x, y, z), axis=-1) / 20.0)
    assert np.degrees(np.arccos(np.minimum(cosine[known], 1.0))).max() < 0.15
    step = np.stack((x, y, 0.1 * x + np.where(x > 0.01, 2.0, 0.0)), axis=-1)
    expected = np.array((-0.1, 0.0, 1.0)) / np.hypot(1.0, 0.1)
    level = surface_normals(step, np.ones(z.shape, bool))
    np.testing.assert_allclose(level, np.broadcast_to(expected, level.shape), atol=1e-4)


def test_wrong_arrays_are_rejected(tmp_path):
    with pytest.raises(InputError, match="shape"):
        write_ply(tmp_path / "a.ply", np.zeros((3, 2)))
    with pytest.raises(InputError, match="PLY property quality"):
        write_ply(tmp_path / "a.ply", np.zeros((3, 3)), {"quality": np.zeros(2, np.float32)})
    with pytest.raises(InputError, match="PLY property quality"):
        write_ply(tmp_path / "a.ply", np.zeros((3, 3)), {"quality": np.zeros(3, np.int64)})
    assert not (tmp_path / "a.ply").exists()
