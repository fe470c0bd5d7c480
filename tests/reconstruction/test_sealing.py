"""Files for HDF5: ours by their seal, any other one through a child that may loop or crash."""

import subprocess

import h5netcdf
import h5py
import numpy as np
import pytest
import xarray

from reconstruction import native, sealing
from reconstruction.netcdf import LabelledArrays, read_arrays, write_arrays


@pytest.fixture
def dataset():
    """Texts in the heap, numbers in one run, and a compressed map."""
    names = np.array([f"frame {i}" for i in range(50)], dtype=object)
    return LabelledArrays(
        {
            "height_mm": ("x", np.linspace(0.0, 1.0, 50), {"units": "mm", "long_name": "height"}),
            "mask": (("row", "col"), np.eye(9, dtype=np.uint8), {}),
            "name": ("x", names, {}),
        },
        attrs={"frame": "world", "told": "größer"},
    )


@pytest.fixture
def no_child(monkeypatch):
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: pytest.fail("a child was asked"))


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(native, "LEAST_LIMIT_S", 1.0)


def test_our_files_are_read_without_a_child(tmp_path, dataset, no_child):
    write_arrays(tmp_path / "x.nc", dataset)
    xarray.testing.assert_identical(read_arrays(tmp_path / "x.nc").to_xarray(), dataset.to_xarray())


def test_the_seal_lies_where_other_readers_do_not_look(tmp_path, dataset):
    write_arrays(tmp_path / "x.nc", dataset)
    with h5py.File(tmp_path / "x.nc") as file:
        assert set(file) == {"height_mm", "mask", "name", "x", "row", "col"}
        np.testing.assert_array_equal(file["height_mm"], dataset.variables["height_mm"][1])


def test_the_seal_feels_every_byte_but_plain_numbers(tmp_path, dataset):
    path = tmp_path / "x.nc"
    write_arrays(path, dataset)
    whole = path.read_bytes()
    numbers = whole.index(dataset.variables["height_mm"][1].tobytes())
    inside = range(numbers, numbers + 50 * 8)
    for at in (*range(0, len(whole), 5), len(whole) - 1):
        damaged = bytearray(whole)
        damaged[at] ^= 16
        path.write_bytes(damaged)
        assert sealing.is_sealed(path) == (at in inside), at
    for size in (0, 1, 55, 56, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        assert not sealing.is_sealed(path)
    path.write_bytes(whole + b"x")
    assert not sealing.is_sealed(path)


@pytest.mark.parametrize(("first", "last"), [(16, 32), (32, 64), (16, 4096)])
def test_a_heap_of_zeros_does_not_take_the_reader_along(tmp_path, dataset, impatient, first, last):
    """HDF5 loops for ever over an object of size 0 in the heap of texts."""
    path = tmp_path / "x.nc"
    write_arrays(path, dataset)
    content = bytearray(path.read_bytes())
    heap = content.index(b"GCOL")
    content[heap + first : heap + last] = bytes(last - first)
    path.write_bytes(content)
    with pytest.raises(OSError, match="came to no end in 1 s of processor time") as caught:
        read_arrays(path)
    assert str(caught.value).startswith(f"{path}: is damaged")


def test_a_crash_raises_an_error(tmp_path, monkeypatch):
    child = tmp_path / "child.py"
    child.write_text("import os; os.kill(os.getpid(), 11)")
    monkeypatch.setattr(native, "_CHILD", child)
    path = tmp_path / "x.nc"
    path.write_bytes(b"x")
    with pytest.raises(OSError, match=r"x\.nc: is damaged \(HDF5 crashes on it, signal 11\)"):
        read_arrays(path)


def test_a_file_of_others_is_tried_once(tmp_path, monkeypatch):
    path = tmp_path / "x.nc"
    with h5netcdf.File(path, "w") as file:
        file.dimensions["x"] = 4
        file.create_variable("a", ("x",), "f8", data=np.arange(4.0)).attrs["units"] = "mm"
    requested, real = [], subprocess.run
    monkeypatch.setattr(subprocess, "run", lambda *a, **k: (requested.append(a), real(*a, **k))[1])
    for _ in range(3):
        assert read_arrays(path).variables["a"][2]["units"] == "mm"
    assert len(requested) == 1


def test_numbers_that_no_file_can_hold_are_rejected(tmp_path):
    path = tmp_path / "x.nc"
    with h5py.File(path, "w") as file:
        file.create_dataset("stack", (100_000, 10_000, 10_000), "f4", chunks=True)
    with pytest.raises(OSError, match="stack claims 40000000000000 bytes, the file holds 0"):
        read_arrays(path)


@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n", b"x" * 1000])
def test_a_file_that_is_no_netcdf_is_rejected_in_one_line(tmp_path, content):
    path = tmp_path / "x.nc"
    path.write_bytes(content)
    with pytest.raises(OSError, match=r"x\.nc: is damaged \(.+\)$") as caught:
        read_arrays(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_rejected(tmp_path, dataset, number):
    """A file with a seal, too: plain numbers are not in it."""
    path = tmp_path / "x.nc"
    write_arrays(path, dataset)
    content = bytearray(path.read_bytes())
    at = content.index(dataset.variables["height_mm"][1].tobytes())
    content[at : at + 8] = np.float64(number).tobytes()
    path.write_bytes(content)
    assert sealing.is_sealed(path)
    with pytest.raises(OSError, match="height_mm holds numbers that are not finite"):
        read_arrays(path)
