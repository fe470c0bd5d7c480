"""Locks between processes: on a file, on a folder, or on one byte of a file.

No other module calls the system's lock functions.

| platform | file | folder | byte |
|---|---|---|---|
| POSIX (`fcntl`) | flock | flock | record lock, also between hosts of a shared file system |
| Windows (`msvcrt`) | byte beyond the end | none: OSError | byte lock |
| neither module | OSError | OSError | OSError |

A file system without locks raises OSError, too. The system releases every lock when its process
ends for any reason.

No library is used: filelock and portalocker have no locks of single bytes, which several hosts need
to share a store, and on Windows portalocker locks the content, which other processes then cannot
read.
"""

import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any


def _module(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        return None


# Loaded by name: the type stubs of either module are empty on the other platform.
_FCNTL, _MSVCRT = _module("fcntl"), _module("msvcrt")

# Record locks reach to 2^63; the C library of Windows reads the position as a signed 32-bit number.
_PLACES = 1 << (62 if _FCNTL else 30)
# Windows forbids others to read a locked byte, so it must not be one of the content.
_WHOLE_FILE = _PLACES + 1
_POLL_S = 0.02


def lock_file(handle: int, *, wait: bool = False) -> None:
    """Lock a file, exclusively, until its handle is closed.

    Parameters
    ----------
    handle : of a file that is open for writing
    wait : until the present holder releases it

    Raises
    ------
    BlockingIOError : another handle has the lock, and `wait` is False
    OSError : the file system, or the platform, has no such locks
    """
    if _FCNTL:
        _FCNTL.flock(handle, _FCNTL.LOCK_EX | (0 if wait else _FCNTL.LOCK_NB))
        return
    while not _try_byte(handle, _WHOLE_FILE):
        if not wait:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        time.sleep(_POLL_S)


@contextmanager
def locked_folder(place: Path, *, shared: bool) -> Iterator[None]:
    """Lock an existing folder during a `with` block; raise an error instead of waiting.

    Parameters
    ----------
    shared : True: other processes may have a shared lock at the same time; False: no other lock

    Raises
    ------
    BlockingIOError : another handle has a lock that excludes this one
    OSError : the file system or the platform does not support locks of folders
    """
    if not _FCNTL:
        raise _no_locks()
    handle = os.open(place, os.O_RDONLY | os.O_DIRECTORY)  # a pipe would wait for its writer
    try:
        _FCNTL.flock(handle, (_FCNTL.LOCK_SH if shared else _FCNTL.LOCK_EX) | _FCNTL.LOCK_NB)
        yield
    finally:
        os.close(handle)


def lock_byte(handle: int, number: int) -> bool:
    """Lock one byte of a file, which need not exist; False if another process has it locked.

    Record locks do not exclude the threads of one process from each other, and closing any handle
    of the file releases all locks of the process on it.

    Parameters
    ----------
    handle : of a file that is open for reading and writing
    number : non-negative; taken modulo the number of bytes that the platform can lock

    Raises
    ------
    OSError : the file system, or the platform, has no such locks
    """
    if not _FCNTL:
        return _try_byte(handle, number % _PLACES)
    try:
        _FCNTL.lockf(handle, _FCNTL.LOCK_EX | _FCNTL.LOCK_NB, 1, number % _PLACES)
    except (BlockingIOError, PermissionError):  # POSIX allows both
        return False
    return True


def unlock_byte(handle: int, number: int) -> None:
    """Release a byte that `lock_byte` has locked."""
    if _FCNTL:
        _FCNTL.lockf(handle, _FCNTL.LOCK_UN, 1, number % _PLACES)
    else:
        _at(handle, number % _PLACES, _MSVCRT.LK_UNLCK)


def _try_byte(handle: int, number: int) -> bool:
    if _MSVCRT is None:
        raise _no_locks()
    try:
        _at(handle, number, _MSVCRT.LK_NBLCK)
    except PermissionError:
        return False
    return True


def _at(handle: int, number: int, how: int) -> None:
    """Lock or unlock a byte by `msvcrt`, which takes the byte at the file's position."""
    before = os.lseek(handle, 0, os.SEEK_CUR)
    try:
        os.lseek(handle, number, os.SEEK_SET)
        _MSVCRT.locking(handle, how, 1)
    finally:
        os.lseek(handle, before, os.SEEK_SET)


def _no_locks() -> OSError:
    return OSError(errno.ENOTSUP, os.strerror(errno.ENOTSUP))
