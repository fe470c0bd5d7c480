"""Working folders: where a command writes until its result is whole; and how a signal ends it.

`.NAME.twin-XXXX.part/` with `lock`, which the process that writes there holds, and `new/`, the
result to be. The system lets go of the lock however that process ends, so a folder whose lock is
free is what a killed run left, and the next run on the same target removes it.

A signal ends a command as an error does: working folders are removed and worker processes ended.
SIGINT, SIGTERM and SIGHUP raise `Interrupted` in the main thread. A signal that this process was
started to ignore (nohup) stays ignored.

Python tells the main thread of a signal when the call that it is in returns, and a call into a
renderer or a solver may last a minute. `end_within` starts a thread that does the same clean-up by
itself when the main thread has not ended by then. It waits for what must not be done by half.
"""

import fcntl
import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO, ClassVar

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(KeyboardInterrupt):
    """A signal ends the process; `number` says which."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class _Hold:
    depth = 0
    waiting: int | None = None
    #: held by whoever changes files that must not be left half-changed, or ends the process
    gate = threading.Lock()
    #: folders that the process has not finished
    working: ClassVar[set[Path]] = set()
    said = threading.Lock()


def unwind_on_signals() -> None:
    """Turn the signals that end a process into `Interrupted`; in the main thread only."""
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


@contextmanager
def signals_held() -> Iterator[None]:
    """Put off what would interrupt the block until its end: it must not be done by half."""
    if threading.current_thread() is not threading.main_thread():
        yield  # handlers run in the main thread only
        return
    _Hold.depth += 1
    if _Hold.depth == 1:
        _Hold.gate.acquire()
    try:
        yield
    finally:
        _Hold.depth -= 1
        if not _Hold.depth:
            _Hold.gate.release()
        if _Hold.waiting is not None and not _Hold.depth:
            number, _Hold.waiting = _Hold.waiting, None
            raise Interrupted(number)


def _interrupt(number: int, _: FrameType | None) -> None:
    if not _Hold.depth:
        raise Interrupted(number)
    _Hold.waiting = number


def end_within(seconds: float) -> None:
    """End the process so long after a signal at the latest, whatever the main thread is in.

    Only for a process that is a command: in any other one this would end it, too.
    """
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    threading.Thread(target=_guard, args=(read, seconds), name="signals", daemon=True).start()


def _guard(read: int, seconds: float) -> None:
    for number in iter(lambda: os.read(read, 1)[0], None):
        if number in _SIGNALS and signal.getsignal(number) is _interrupt:
            time.sleep(seconds)
            with _Hold.gate:
                _end_now(number)


def _end_now(number: int) -> None:
    # Who has children has imported it; to import it here might wait for the main thread.
    processes = sys.modules.get("multiprocessing")
    for child in processes.active_children() if processes else ():
        child.terminate()
    for folder in list(_Hold.working):
        shutil.rmtree(folder, ignore_errors=True)
    says_the_end(number)
    if sys.stderr.isatty():
        sys.stderr.write("\x1b[?25h")  # a progress bar hides the cursor
    sys.stderr.flush()
    os._exit(128 + number)


def says_the_end(number: int) -> None:
    """Say once that a signal has ended the command."""
    if _Hold.said.acquire(blocking=False):
        name = signal.Signals(number).name
        sys.stderr.write(f"twin: ended by {name}; nothing is left half-written\n")


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
    OSError : it cannot be made
    """
    folder, lock = None, None
    try:
        with signals_held():
            folder = Path(tempfile.mkdtemp(prefix=f".{target}.twin-", suffix=".part", dir=place))
            _Hold.working.add(folder)
            lock = _locked(folder)
            (folder / _NEW).mkdir()
        yield folder / _NEW
    finally:
        with signals_held():
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
                _Hold.working.discard(folder)
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


def is_second(folder: Path) -> bool:
    """Tell whether another living process began on the same target before this working folder.

    Parameters
    ----------
    folder : as `working_folder` yields it
    """
    mine = folder.parent
    target = _target(mine)
    with suppress(OSError):
        others = [one for one in mine.parent.iterdir() if one != mine and _target(one) == target]
        return any(_is_held(one) and _age(one) < _age(mine) for one in others)
    return False


def _target(folder: Path) -> str:
    named = _NAME.fullmatch(folder.name)
    return named["target"] if named else ""


def _age(folder: Path) -> tuple[int, str]:
    """Return what orders working folders by their beginning."""
    return (folder / _LOCK).stat().st_mtime_ns, folder.name


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


def _is_held(folder: Path) -> bool:
    try:
        with (folder / _LOCK).open("r+b") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _is_abandoned(folder: Path) -> bool:
    if folder.is_symlink():
        return False
    try:
        with (folder / _LOCK).open("r+b") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock.read(len(_MARK) + 1) == _MARK
    except OSError:
        return False
