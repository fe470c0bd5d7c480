"""Locks on the cases of a store: one byte range of one file each.

They are the system's record locks: they vanish with their process, however it ends, and work across
the hosts of a shared file system that has them (NFS 4, Lustre, local).
"""

import fcntl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from reconstruction.errors import InputError

# Record locks reach to 2^63: one byte each for names of 64 bits, less the sign.
_LOCK_BITS = 62

# Opened once per process: closing any handle of a file would drop all locks on it.
_open_files: dict[Path, IO[bytes]] = {}
# Record locks do not keep the threads of one process apart.
_held: set[tuple[Path, str]] = set()
_holding = threading.Lock()


@contextmanager
def claimed(file: Path, digest: str) -> Iterator[bool]:
    """Hold a case; yields False when another process or thread holds it.

    Raises
    ------
    InputError
        The file system has no record locks.
    """
    mine = _claim(file, digest)
    try:
        yield mine
    finally:
        if mine:
            _release(file, digest)


def _claim(file: Path, digest: str) -> bool:
    with _holding:
        if (file, digest) in _held:
            return False
        try:
            fcntl.lockf(_opened(file), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, _place(digest))
        except (BlockingIOError, PermissionError):  # POSIX allows both
            return False
        except OSError as error:
            raise InputError(
                f"{file}: cannot be locked ({error.strerror}); choose an -o DIR on a file system "
                "that has record locks"
            ) from None
        _held.add((file, digest))
        return True


def _release(file: Path, digest: str) -> None:
    with _holding:
        fcntl.lockf(_opened(file), fcntl.LOCK_UN, 1, _place(digest))
        _held.remove((file, digest))


def _opened(file: Path) -> IO[bytes]:
    if file not in _open_files:
        _open_files[file] = file.open("r+b")
    return _open_files[file]


def _place(digest: str) -> int:
    return int(digest, 16) % (1 << _LOCK_BITS)
