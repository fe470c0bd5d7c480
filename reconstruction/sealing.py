"""Decide which netCDF-4 files HDF5 may open: those with a seal, those a child process has read.

HDF5 does not check its files: on a damaged file it may loop for ever or crash. Files of this
package therefore end with a seal. The seal follows the last byte that HDF5 records as part of the
file, so HDF5 readers ignore the seal. It consists of:

| bytes | content |
|---|---|
| 16 n | offset and size, uint64, of n byte ranges with array elements that HDF5 only copies |
| 32 | BLAKE2b digest of these offsets and sizes, and of all bytes outside the n ranges |
| 8 | n, uint64 |
| 16 | "fringe-twin seal" |

All integers are little-endian. A file with a valid seal is opened directly. A file without one, of
another program or damaged, is first read completely by a child process (`native`). The seal
detects accidental damage. It does not protect against a deliberate change.
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
    """Append a checksum, the seal, to a complete netCDF-4 file.

    The file must be open for reading and writing. The module docstring describes the seal.
    """
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
    """Return True if a file has a valid seal, so since sealing only array elements may differ."""
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
    """Return the BLAKE2b digest of the ranges `runs` and of the first `end` bytes outside them."""
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
    """Raise OSError unless HDF5 can read a file; a file without seal is read by a child process.

    Raises
    ------
    OSError : the file is not netCDF-4, or HDF5 fails, crashes or hangs; the message has the reason
    """
    state = path.stat()
    identity = (state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns)
    if identity in _tried or is_sealed(path):
        return
    read_in_child("HDF5", path)
    _tried.add(identity)
