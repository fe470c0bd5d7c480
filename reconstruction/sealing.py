"""Which netCDF-4 files HDF5 may open: those with a seal, and those that a child process has read.

HDF5 does not check its files: on a damaged one it may loop for ever or crash. Files of this package
therefore end with a seal. It follows the end of file that HDF5 records, so no HDF5 reader reads it:

| bytes | content |
|---|---|
| 16 n | ranges of plain numbers, which HDF5 does not interpret: offset and size, uint64 |
| 32 | BLAKE2b of these ranges and of all bytes before the seal outside of them |
| 8 | n, uint64 |
| 16 | "fringe-twin seal" |

Numbers are little-endian. A file with a valid seal is opened directly. Any other file, from another
program or damaged, is first read completely by a child process (`native`). A seal detects damage;
it is no signature.
"""

import hashlib
import os
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from reconstruction.native import read_in_child

_MARK = b"fringe-twin seal"
_RUN, _FOOT = struct.Struct("<QQ"), struct.Struct("<32sQ16s")
_MOST_RUNS = 10_000
_PIECE_BYTES = 2**20

Runs = Sequence[tuple[int, int]]

_tried: set[tuple[int, ...]] = set()


def seal(file: IO[bytes]) -> None:
    """Append the seal to a complete netCDF-4 file, open for reading and writing."""
    import h5py

    runs: list[tuple[int, int]] = []

    def note(_: str, node: object) -> None:
        if isinstance(node, h5py.Dataset) and node.dtype.kind in "biufc":
            offset = node.id.get_offset()  # None for chunked data
            runs.extend([] if offset is None else [(offset, node.id.get_storage_size())])

    with h5py.File(file, "r") as content:
        content.visititems(note)
    runs.sort()
    end = file.seek(0, os.SEEK_END)
    foot = _FOOT.pack(_digest(file, end, runs), len(runs), _MARK)
    file.seek(end)
    file.write(b"".join(_RUN.pack(*run) for run in runs) + foot)


def is_sealed(path: Path) -> bool:
    """Return True if a file has a valid seal: unchanged since sealing except for plain numbers."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _FOOT.size))
        foot = file.read()
        if len(foot) < _FOOT.size or not foot.endswith(_MARK):
            return False
        digest, count, _ = _FOOT.unpack(foot)
        end = size - _FOOT.size - min(count, _MOST_RUNS) * _RUN.size
        if end < 0:
            return False
        file.seek(end)
        runs = list(_RUN.iter_unpack(file.read(size - _FOOT.size - end)))
        return bool(len(runs) == count and _digest(file, end, runs) == digest)


def _digest(file: IO[bytes], end: int, runs: Runs) -> bytes:
    """Return the digest of the ranges and of the first `end` bytes outside of them."""
    digest, at = hashlib.blake2b(digest_size=32), 0
    for run in runs:
        digest.update(_RUN.pack(*run))
    for offset, size in (*runs, (end, 0)):
        file.seek(at)
        remaining = max(0, min(offset, end) - at)
        while remaining and (piece := file.read(min(remaining, _PIECE_BYTES))):
            digest.update(piece)
            remaining -= len(piece)
        at = max(at, min(offset + size, end))
    return digest.digest()


def require_readable(path: Path) -> None:
    """Raise OSError for a file that is not netCDF-4, or on which HDF5 fails, crashes or hangs.

    Raises
    ------
    OSError : the message gives the reason
    """
    state = path.stat()
    identity = (state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns)
    if identity in _tried or is_sealed(path):
        return
    read_in_child("HDF5", path)
    _tried.add(identity)
