"""Working folders: where a command writes until its result is whole; and how a signal ends it.

`.NAME.twin-XXXX.part/` with `lock`, which the process that writes there holds, and `new/`, the
result to be. The system lets go of the lock however that process ends, so a folder whose lock is
free is what a killed run left, and the next run on the same target removes it. While it begins, the
folder around is locked (shared): what has no mark yet and nobody begins is a leftover, too.

A signal ends a command as an error does: working folders are removed and worker processes ended.
SIGINT, SIGTERM and SIGHUP, as far as the platform has them, raise `Interrupted` in the main thread.
A signal that this process was started to ignore (nohup) stays ignored.

Python tells the main thread of a signal when the call that it is in returns, and a call into a
renderer or a solver may last a minute. `end_within` starts a thread that does the same clean-up by
itself when the main thread has not ended by then. It waits for what must not be done by half.
"""

import atexit
import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import IO, ClassVar, NoReturn

from reconstruction.errors import InputError
from reconstruction.reading import read_bytes
from twin.locks import lock_file, locked_folder

ENDING_SIGNALS: tuple[signal.Signals, ...] = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that end a command, as far as the platform has them: Windows has no SIGHUP."""


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
    for number in ENDING_SIGNALS:
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
    if hasattr(os, "set_blocking"):  # on Windows from Python 3.12 on, and not required there
        os.set_blocking(write, False)
    signal.set_wakeup_fd(write, warn_on_full_buffer=False)
    threading.Thread(target=_guard, args=(read, seconds), name="signals", daemon=True).start()


def _guard(read: int, seconds: float) -> None:
    for number in iter(lambda: os.read(read, 1)[0], None):
        if number in ENDING_SIGNALS and signal.getsignal(number) is _interrupt:
            time.sleep(seconds)
            with _Hold.gate:
                _end_now(number)


def end_process(code: int) -> NoReturn:
    """End a command that has done everything, and its process with it.

    Python would first take apart what is in memory, object by object: half a second after a
    measurement. What was registered for the end of the process is done; who has closed our output
    is told of it in Python's own way.
    """
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:
        sys.exit(code)
    atexit._run_exitfuncs()
    os._exit(code)


def _end_now(number: int) -> None:
    # Who has children has imported it; to import it here might wait for the main thread.
    processes = sys.modules.get("multiprocessing")
    for child in processes.active_children() if processes else ():
        child.terminate()
    for folder in list(_Hold.working):
        _remove(folder)
    _free_semaphores()
    says_the_end(number)
    if sys.stderr.isatty():
        sys.stderr.write("\x1b[?25h")  # a progress bar hides the cursor
    sys.stderr.flush()
    os._exit(128 + number)


def _free_semaphores() -> None:
    # What Python does at its end, which is not reached: else its tracker warns of leaked ones.
    util = sys.modules.get("multiprocessing.util")
    if util is not None:
        util._run_finalizers(0)


def says_the_end(number: int) -> None:
    """Say once that a signal has ended the command."""
    if _Hold.said.acquire(blocking=False):
        name = signal.Signals(number).name
        sys.stderr.write(f"twin: ended by {name}; nothing is left half-written\n")


_NAME = re.compile(r"\.(?P<target>.*)\.twin-[^.]+\.part", re.DOTALL)
_LOCK, _NEW = "lock", "new"
PLAN = "plan.json"
"""A working folder that contains this is not removed: its files are exchanged in part."""
_MARK = b"working folder of fringe-twin\n"
_TRIES, _POLL_S = 20, 0.01


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
            with _begun(place):
                made = tempfile.mkdtemp(prefix=f".{target}.twin-", suffix=".part", dir=place)
                folder = Path(made)
                _Hold.working.add(folder)
                lock = _locked(folder)
            (folder / _NEW).mkdir()
        yield folder / _NEW
    finally:
        with signals_held():
            if folder is not None:
                _remove(folder)
                _Hold.working.discard(folder)
            if lock is not None:
                lock.close()
                if folder is not None and folder.exists():
                    _remove(folder)  # Windows does not delete a file that is open


def is_working(folder: Path) -> bool:
    """Tell whether this is a working folder, of a living process or a dead one."""
    try:
        return _NAME.fullmatch(folder.name) is not None and (
            _is_unmarked(folder) or read_bytes(folder / _LOCK) == _MARK
        )
    except (OSError, InputError):
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


def leftovers(place: Path, target: str | None = None) -> Iterator[Path]:
    """Yield what dead processes left in `place` (for one target), as `working_folder` yields it.

    Each is locked while it is looked at, so that two processes do not take up the same one, and
    removed then.
    """
    with suppress(OSError):
        for entry in list(place.iterdir()):
            named = _NAME.fullmatch(entry.name)
            if named and target in (None, named["target"]):
                with _seized(entry) as is_abandoned:
                    if is_abandoned:
                        yield entry / _NEW
                        _remove(entry)


def remove_leftovers(place: Path, target: str | None = None) -> None:
    """Remove the working folders in `place` (for one target) whose process has ended."""
    for _ in leftovers(place, target):
        pass
    with suppress(OSError), locked_folder(place, shared=False):
        for entry in list(place.iterdir()):
            named = _NAME.fullmatch(entry.name)
            if named and target in (None, named["target"]) and _is_unmarked(entry):
                (entry / _LOCK).unlink(missing_ok=True)
                entry.rmdir()


def _remove(folder: Path) -> None:
    """Remove a working folder; its lock goes last, so that it is known as one until then."""
    with suppress(OSError):
        if (folder / PLAN).exists():
            return
        for entry in list(folder.iterdir()):
            if entry.is_dir():
                shutil.rmtree(entry, ignore_errors=True)
            elif entry.name != _LOCK:
                entry.unlink(missing_ok=True)
        if list(folder.iterdir()) == [folder / _LOCK]:
            (folder / _LOCK).unlink()
        folder.rmdir()


def _is_unmarked(folder: Path) -> bool:
    """Tell whether a working folder is at its beginning: without the mark in its lock."""
    if folder.is_symlink() or not folder.is_dir():
        return False
    found = list(folder.iterdir())
    return not found or (found == [folder / _LOCK] and not found[0].lstat().st_size)


@contextmanager
def _begun(place: Path) -> Iterator[None]:
    """Tell others that a folder without mark in `place` belongs to somebody who lives.

    Does without where somebody else holds that folder, for instance `flock out twin ... -o out/a`.
    """
    with ExitStack() as stack:
        for _ in range(_TRIES):
            try:
                stack.enter_context(locked_folder(place, shared=True))
                break
            except BlockingIOError:
                time.sleep(_POLL_S)
            except OSError:  # a file system without locks
                break
        yield


def _locked(folder: Path) -> IO[bytes]:
    # Marked when it is locked: what has no mark yet is not taken for a leftover.
    lock = (folder / _LOCK).open("wb", buffering=0)
    try:
        with suppress(OSError):  # a file system without locks: leftovers stay
            lock_file(lock.fileno(), wait=True)
        lock.write(_MARK)
    except BaseException:
        lock.close()
        raise
    return lock


def _is_held(folder: Path) -> bool:
    try:
        with (folder / _LOCK).open("r+b") as lock:
            lock_file(lock.fileno())
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


@contextmanager
def _seized(folder: Path) -> Iterator[bool]:
    """Hold the lock of a dead process' working folder; yields False where it is none."""
    with ExitStack() as stack:
        is_abandoned = False
        with suppress(OSError):
            if not folder.is_symlink():
                lock = stack.enter_context((folder / _LOCK).open("r+b"))
                lock_file(lock.fileno())
                is_abandoned = lock.read(len(_MARK) + 1) == _MARK
        yield is_abandoned
