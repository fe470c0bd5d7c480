"""Which netCDF-4 files HDF5 may be given: those with a seal, and those that a child has read.

HDF5 trusts its files: on a damaged one it may loop for ever or crash. So what this package writes
ends with a seal, behind the end that HDF5 knows of, where no reader of HDF5 looks:

| bytes | content |
|---|---|
| 16 n | runs of plain numbers, of which HDF5 interprets nothing: offset and size, uint64 |
| 32 | BLAKE2b of these runs and of all bytes before the seal that are in none |
| 8 | n, uint64 |
| 16 | "fringe-twin seal" |

Numbers are little-endian. A file whose seal holds is opened as it is. Any other one, of another
program or damaged, is first read whole by a child (`native`). A seal tells of damage; it is no
signature.
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
            offset = node.id.get_offset()  # None for what lies in pieces
            runs.extend([] if offset is None else [(offset, node.id.get_storage_size())])

    with h5py.File(file, "r") as found:
        found.visititems(note)
    runs.sort()
    end = file.seek(0, os.SEEK_END)
    foot = _FOOT.pack(_digest(file, end, runs), len(runs), _MARK)
    file.seek(end)
    file.write(b"".join(_RUN.pack(*run) for run in runs) + foot)


def is_sealed(path: Path) -> bool:
    """Tell whether a file has a seal and is, but for its plain numbers, as it was sealed."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _FOOT.size))
        found = file.read()
        if len(found) < _FOOT.size or not found.endswith(_MARK):
            return False
        digest, count, _ = _FOOT.unpack(found)
        end = size - _FOOT.size - min(count, _MOST_RUNS) * _RUN.size
        if end < 0:
            return False
        file.seek(end)
        runs = list(_RUN.iter_unpack(file.read(size - _FOOT.size - end)))
        return bool(len(runs) == count and _digest(file, end, runs) == digest)


def _digest(file: IO[bytes], end: int, runs: Runs) -> bytes:
    """Return the digest of the runs and of the first `end` bytes without them."""
    digest, at = hashlib.blake2b(digest_size=32), 0
    for run in runs:
        digest.update(_RUN.pack(*run))
    for offset, size in (*runs, (end, 0)):
        file.seek(at)
        left = max(0, min(offset, end) - at)
        while left and (piece := file.read(min(left, _PIECE_BYTES))):
            digest.update(piece)
            left -= len(piece)
        at = max(at, min(offset + size, end))
    return digest.digest()


def require_readable(path: Path) -> None:
    """Refuse an existing file that is no netCDF-4, or on which HDF5 fails, crashes or never ends.

    Raises
    ------
    OSError : with the reason
    """
    state = path.stat()
    known = (state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns)
    if known in _tried or is_sealed(path):
        return
    read_in_child("HDF5", path)
    _tried.add(known)
