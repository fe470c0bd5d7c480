"""Every file is encoded in memory and copied to the disk by Python: whole, or as it was before."""

import errno
import os
import re
import resource
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from reconstruction.evaluate.surface import SurfaceMesh, write_mesh_ply
from reconstruction.netcdf import LabelledArrays, write_arrays
from reconstruction.ply import write_ply
from reconstruction.writing import (
    write_bytes,
    write_exr_channels,
    write_npz,
    write_parts,
    write_png,
    write_text,
)

ROOT = Path(__file__).parents[2]
RNG = np.random.default_rng(5)
LEVELS = RNG.integers(0, 4096, (40, 50)).astype(np.uint16)
MAP = RNG.random((40, 50), np.float32)
POINTS = RNG.random((300, 3))
NAMES = np.array([f"frame {number}" for number in range(53)], dtype=object)
ARRAYS = LabelledArrays({"map": (("row", "col"), MAP, {}), "name": ("frame", NAMES, {})})
MESH = SurfaceMesh(POINTS.astype(np.float32), np.arange(300, dtype=np.int32).reshape(100, 3))

WRITERS = {
    "maps.nc": lambda path: write_arrays(path, ARRAYS),
    "map.exr": lambda path: write_exr_channels(path, {"Z": MAP}),
    "image.png": lambda path: write_png(path, LEVELS),
    "table.npz": lambda path: write_npz(path, {"map": MAP}),
    "points.ply": lambda path: write_ply(path, POINTS),
    "mesh.ply": lambda path: write_mesh_ply(path, MESH),
    "text.toml": lambda path: write_text(path, "value = 1\n" * 300),
}

# HDF5 writes zeros for names, reads them back, and uses the result as earlier names. If the
# zeros were dropped it read memory with the names of the file before.
WRITES_AFTER_READING = """
import os, resource
import numpy as np
from reconstruction.netcdf import LabelledArrays, read_arrays, write_arrays

names = np.array([f"frame {number}" for number in range(53)], dtype=object)
arrays = LabelledArrays({"map": ("n", np.ones(2000), {}), "name": ("frame", names, {})})
write_arrays("whole.nc", arrays)
read_arrays("whole.nc")
for share in (0.0, 0.3, 0.6, 0.9):
    child = os.fork()
    if not child:
        size = int(share * os.stat("whole.nc").st_size)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        try:
            write_arrays("new.nc", arrays)
        except OSError as error:
            os._exit(error.errno)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@contextmanager
def no_file_longer_than(size):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def test_a_full_disk_does_not_end_the_process_in_hdf5(tmp_path):
    """It ended in a segmentation fault wherever a file with as many names was read before."""
    command, environment = [sys.executable, "-c", WRITES_AFTER_READING], {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=tmp_path, env=os.environ | environment, capture_output=True, check=True
    )
    assert {int(code) for code in done.stdout.split()} == {errno.EFBIG}
    assert [path.name for path in tmp_path.iterdir()] == ["whole.nc"]


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("there", [False, True], ids=["new", "earlier"])
def test_a_file_is_whole_or_as_it_was(tmp_path, name, there):
    path, write = tmp_path / "folder" / name, WRITERS[name]
    write(tmp_path / name)
    size = (tmp_path / name).stat().st_size
    path.parent.mkdir()
    if there:
        path.write_bytes(b"earlier")
    for limit in (0, 1, size // 2, size - 1):
        with no_file_longer_than(limit), pytest.raises(OSError, match="File too large") as raised:
            write(path)
        assert raised.value.filename == str(path)
        assert [(file.name, file.read_bytes()) for file in path.parent.iterdir()] == (
            [(name, b"earlier")] if there else []
        )
    with no_file_longer_than(size):
        write(path)
    assert path.read_bytes() == (tmp_path / name).read_bytes()


def test_a_device_remains_a_device(tmp_path):
    with pytest.raises(OSError, match=r"No space left on device: '/dev/full'"):
        write_bytes("/dev/full", b"1")
    assert Path("/dev/full").is_char_device()


def test_a_link_remains_a_link(tmp_path):
    """Also one that leads to a file that is not there yet."""
    (tmp_path / "link").symlink_to("file")
    for text in ("first", "second"):
        write_text(tmp_path / "link", text)
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "file").read_text() == text


def test_parts_follow_one_another(tmp_path):
    parts = (b"head", memoryview(np.arange(3, dtype=np.int32)), memoryview(np.zeros((0, 3))), b"")
    write_bytes(tmp_path / "file", *parts, durable=True)
    assert (tmp_path / "file").read_bytes() == b"head" + np.arange(3, dtype=np.int32).tobytes()


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").touch()
    for place, kind in (("missing/a", FileNotFoundError), ("file/a", NotADirectoryError)):
        with pytest.raises(kind) as raised:
            write_bytes(tmp_path / place, b"1")
        assert raised.value.filename == str(tmp_path / place)


def test_too_little_memory_is_an_error_before_hdf5_begins(tmp_path, monkeypatch):
    """HDF5 would end in a segmentation fault."""

    def refused(*_):
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr("mmap.mmap", refused)
    with pytest.raises(MemoryError, match="to encode a file"):
        write_arrays(tmp_path / "a.nc", ARRAYS)
    assert not list(tmp_path.iterdir())


# Called with a path, these write by themselves. In children only: their files are temporary.
WRITING = r"\.(imwrite|savez|savez_compressed|write_bitmap|write_text|write_bytes)\("
CHILDREN = {"tetrahedra.py", "tetwild_child.py", "native_child.py"}


def test_no_library_is_given_a_path():
    """All writing uses `reconstruction.writing`."""
    files = (*ROOT.glob("twin/**/*.py"), *ROOT.glob("reconstruction/**/*.py"))
    result = {file for file in files if re.search(WRITING, file.read_text())}
    assert {file.name for file in result} - CHILDREN == {"writing.py"}


def test_parts_are_requested_one_after_another(tmp_path) -> None:
    """Expected: a part is on the disk before the next is requested; a failure changes nothing."""
    path, sizes = tmp_path / "whole.bin", []

    def parts(most: int):
        for number in range(4):
            sizes.append(sum(file.stat().st_size for file in tmp_path.iterdir()))
            if number == most:
                raise OSError(errno.EIO, "broken")
            yield bytes([number]) * 10

    write_parts(path, parts(4))
    assert sizes == [0, 10, 20, 30]
    assert path.read_bytes() == b"".join(bytes([number]) * 10 for number in range(4))
    with pytest.raises(OSError, match="broken") as failure:
        write_parts(path, parts(2))
    assert failure.value.filename == str(path)
    assert [file.name for file in tmp_path.iterdir()] == ["whole.bin"]
    assert len(path.read_bytes()) == 40
