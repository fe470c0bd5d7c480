"""Locks between processes: on a file, on a folder, or on one byte of a file.

No other module calls the system's lock functions.

| platform | file | folder | byte |
|---|---|---|---|
| POSIX (`fcntl`) | flock | flock | record lock, also between hosts of a shared file system |
| Windows (`msvcrt`) | byte beyond the end | none: OSError | byte lock |
| neither module | OSError | OSError | OSError |

If the file system does not support locks, locking raises OSError, too. The operating system
releases every lock when the process that has the lock ends, for any reason.

No library is used. Several hosts that share a store need locks of single bytes, which filelock and
portalocker do not have. On Windows portalocker also locks the content of the file, so that other
processes cannot read the file.
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


# Loaded by name: the type stubs of each module are empty on the platform that lacks the module.
_FCNTL, _MSVCRT = _module("fcntl"), _module("msvcrt")

# Record locks reach to 2^63; the C library of Windows reads the position as a signed 32-bit number.
_PLACES = 1 << (62 if _FCNTL else 30)
# Windows forbids others to read a locked byte, so it must not be one of the content.
_WHOLE_FILE = _PLACES + 1
_POLL_S = 0.02


def lock_file(handle: int, *, wait: bool = False) -> None:
    """Lock a file exclusively until its handle is closed.

    Parameters
    ----------
    handle : descriptor of a file that is open for writing
    wait : True: wait until another handle releases the lock; False: raise BlockingIOError

    Raises
    ------
    BlockingIOError : another handle has the lock, and `wait` is False
    OSError : the file system or the platform does not support locks of files
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
    place : the folder
    shared : True: other processes may have a shared lock at the same time. False: the lock is
        exclusive

    Raises
    ------
    BlockingIOError : another handle has a lock on the folder that excludes the requested lock
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
    """Lock one byte of a file; return False if another process has locked that byte.

    The byte may be beyond the end of the file. Record locks do not exclude the threads of one
    process from each other. If the process closes any handle of the file, all its locks on that
    file are released.

    Parameters
    ----------
    handle : descriptor of a file that is open for reading and writing
    number : position of the byte, non-negative; taken modulo the number of bytes that the platform
        can lock

    Raises
    ------
    OSError : the file system or the platform does not support locks of bytes
    """
    if not _FCNTL:
        return _try_byte(handle, number % _PLACES)
    try:
        _FCNTL.lockf(handle, _FCNTL.LOCK_EX | _FCNTL.LOCK_NB, 1, number % _PLACES)
    except (BlockingIOError, PermissionError):  # POSIX allows both
        return False
    return True


def unlock_byte(handle: int, number: int) -> None:
    """Release the lock of `lock_byte` on one byte of a file."""
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
    """Lock or unlock the byte at position `number` by `msvcrt`; restore the file's position."""
    before = os.lseek(handle, 0, os.SEEK_CUR)
    try:
        os.lseek(handle, number, os.SEEK_SET)
        _MSVCRT.locking(handle, how, 1)
    finally:
        os.lseek(handle, before, os.SEEK_SET)


def _no_locks() -> OSError:
    return OSError(errno.ENOTSUP, os.strerror(errno.ENOTSUP))
