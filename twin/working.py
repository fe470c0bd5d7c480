"""Working folders: where a command writes until its result is whole.

`.NAME.twin-XXXX.part/` with `lock`, which the process that writes there holds, and `new/`, the
result to be. The system lets go of the lock however that process ends, so a folder whose lock is
free is what a killed run left, and the next run on the same target removes it.
"""

import fcntl
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from twin.interruption import signals_held

_NAME = re.compile(r"\.(?P<target>.*)\.twin-[^.]+\.part", re.DOTALL)
_LOCK, _NEW = "lock", "new"
_MARK = b"working folder of fringe-twin\n"


@contextmanager
def working_folder(place: Path, target: str) -> Iterator[Path]:
    """Yield an empty folder inside a working folder in `place`, which is removed at the end.

    Parameters
    ----------
    place : existing folder on the file system of the target
    target : name of the target

    Raises
    ------
    OSError
        It cannot be made.
    """
    folder, lock = None, None
    try:
        with signals_held():
            folder = Path(tempfile.mkdtemp(prefix=f".{target}.twin-", suffix=".part", dir=place))
            lock = _locked(folder)
            (folder / _NEW).mkdir()
        yield folder / _NEW
    finally:
        with signals_held():
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
            if lock is not None:
                lock.close()


def is_working(folder: Path) -> bool:
    """Tell whether this is a working folder, of a living process or a dead one."""
    try:
        return _NAME.fullmatch(folder.name) is not None and (
            not any(folder.iterdir()) or (folder / _LOCK).read_bytes() == _MARK
        )
    except OSError:
        return False


def remove_leftovers(place: Path, target: str | None = None) -> None:
    """Remove the working folders in `place` (for one target) whose process has ended."""
    with suppress(OSError):
        for entry in list(place.iterdir()):
            named = _NAME.fullmatch(entry.name)
            if named and target in (None, named["target"]) and _is_abandoned(entry):
                shutil.rmtree(entry, ignore_errors=True)


def _locked(folder: Path) -> IO[bytes]:
    # Marked when it is locked: what has no mark yet is not taken for a leftover.
    lock = (folder / _LOCK).open("wb", buffering=0)
    try:
        with suppress(OSError):  # a file system without locks: leftovers stay
            fcntl.flock(lock, fcntl.LOCK_EX)
        lock.write(_MARK)
    except BaseException:
        lock.close()
        raise
    return lock


def _is_abandoned(folder: Path) -> bool:
    if folder.is_symlink():
        return False
    try:
        with (folder / _LOCK).open("r+b") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock.read(len(_MARK) + 1) == _MARK
    except OSError:
        return False
