"""A written press is read back unchanged, and foreign files are rejected in one line."""

import resource
import signal
from dataclasses import fields, replace
from pathlib import Path

import h5netcdf
import numpy as np
import pytest
import trimesh

from reconstruction.netcdf import LabelledArrays, write_arrays
from twin.mechanics import (
    PressedElastomer,
    PressError,
    face_mesh,
    read_press,
    write_mesh,
    write_press,
)
from twin.mechanics.arrays import press_arrays

NORMAL = ("nx", "ny", "nz")


def test_a_press_comes_back_whole(reference_press: PressedElastomer, tmp_path: Path) -> None:
    warned = replace(
        reference_press, validity=replace(reference_press.validity, warnings=("one", "two"))
    )
    write_press(tmp_path / "press.nc", warned)
    back = read_press(tmp_path / "press.nc")
    for field in fields(PressedElastomer):
        stored, result = getattr(warned, field.name), getattr(back, field.name)
        assert type(result) is type(stored)
        if isinstance(stored, np.ndarray):
            np.testing.assert_array_equal(result, stored, strict=True)
        else:
            assert result == stored
    assert [path.name for path in tmp_path.iterdir()] == ["press.nc"]


def test_a_file_of_the_first_schema_is_still_read(
    reference_press: PressedElastomer, tmp_path: Path
) -> None:
    path = tmp_path / "press.nc"
    write_press(path, reference_press)
    with h5netcdf.File(path, "a") as file:
        file.attrs["schema"] = "fringe-twin press 1"
        group = file.create_group("validity")
        for name in [name for name in file.attrs if name.startswith("validity_")]:
            group.attrs[name.removeprefix("validity_")] = file.attrs[name]
            del file.attrs[name]
    back = read_press(path)
    assert back.validity == reference_press.validity
    np.testing.assert_array_equal(back.face_z_mm, reference_press.face_z_mm)


def test_a_file_without_coordinates_is_still_read(
    reference_press: PressedElastomer, tmp_path: Path
) -> None:
    """The second schema had x_mm over a dimension x where there is now a coordinate x."""
    path = tmp_path / "press.nc"
    axes = {"x": "x_mm", "y": "y_mm", "face_x": "face_x_mm", "face_y": "face_y_mm"}
    now = press_arrays(reference_press)
    before = {axes[name]: values for name, values in now.coords.items()}
    attributes = {**now.attrs, "schema": "fringe-twin press 2"}
    write_arrays(path, LabelledArrays({**now.variables, **before}, attrs=attributes))
    back = read_press(path)
    np.testing.assert_array_equal(back.face_x_mm, reference_press.face_x_mm)
    np.testing.assert_array_equal(back.face_z_mm, reference_press.face_z_mm)


def test_no_warnings_come_back_as_none(reference_press: PressedElastomer, tmp_path: Path) -> None:
    write_press(tmp_path / "press.nc", reference_press)
    assert read_press(tmp_path / "press.nc").validity == reference_press.validity


def test_every_variable_says_its_unit(reference_press: PressedElastomer, tmp_path: Path) -> None:
    write_press(tmp_path / "press.nc", reference_press)
    with h5netcdf.File(tmp_path / "press.nc", "r") as file:
        assert file.attrs["Conventions"].startswith("CF-")
        units = {name: variable.attrs["units"] for name, variable in file.variables.items()}
        assert file["face_z_mm"].dimensions == ("face_y", "face_x")
    assert units["pressure_kpa"] == "kPa"
    assert units["force_n"] == "N"
    assert units["face_z_mm"] == "mm"


def test_a_mesh_comes_back_with_its_normals(
    reference_press: PressedElastomer, tmp_path: Path
) -> None:
    mesh = face_mesh(reference_press)
    write_mesh(tmp_path / "face.ply", mesh)
    back = trimesh.load_mesh(tmp_path / "face.ply", process=False)
    # PLY stores single precision.
    np.testing.assert_allclose(back.vertices, mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    # trimesh recomputes normals after loading: read those in the file.
    stored = np.column_stack([back.metadata["_ply_raw"]["vertex"]["data"][n] for n in NORMAL])
    np.testing.assert_allclose(stored, mesh.vertex_normals, atol=1e-6)


def test_a_mesh_is_written_as_stl_too(reference_press: PressedElastomer, tmp_path: Path) -> None:
    mesh = face_mesh(reference_press)
    write_mesh(tmp_path / "face.stl", mesh)
    back = trimesh.load_mesh(tmp_path / "face.stl", process=False)
    np.testing.assert_allclose(back.triangles, mesh.triangles, atol=1e-6)
    with pytest.raises(PressError, match=r"found '.obj', allowed for a mesh: .ply, .stl"):
        write_mesh(tmp_path / "face.obj", mesh)


@pytest.mark.parametrize("content", [None, b"not netCDF", b"\x89HDF\r\n\x1a\n"])
def test_foreign_files_are_refused(content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "press.nc"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PressError, match=r"press\.nc: ") as caught:
        read_press(path)
    assert "\n" not in str(caught.value)


def test_truncated_and_other_netcdf_files_are_refused(
    reference_press: PressedElastomer, tmp_path: Path
) -> None:
    write_press(tmp_path / "whole.nc", reference_press)
    (tmp_path / "cut.nc").write_bytes((tmp_path / "whole.nc").read_bytes()[:20_000])
    with h5netcdf.File(tmp_path / "other.nc", "w") as file:
        file.dimensions = {"x": 2}
    for name in ("cut.nc", "other.nc"):
        with pytest.raises(PressError, match=name):
            read_press(tmp_path / name)


def test_a_full_disk_is_an_ordinary_error_and_leaves_nothing(
    reference_press: PressedElastomer, tmp_path: Path
) -> None:
    """No file may be longer than 4 kB: HDF5 gets no failed write, and the failure is raised."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with pytest.raises(OSError, match=r"File too large: .*press\.nc"):
            write_press(tmp_path / "press.nc", reference_press)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_refused(reference_press: PressedElastomer, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(PressError, match="cannot be written"):
        write_press(tmp_path / "file" / "press.nc", reference_press)
    with pytest.raises(PressError, match="cannot be written"):
        write_mesh(tmp_path / "missing" / "face.ply", face_mesh(reference_press))
