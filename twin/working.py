"""Working folders for unfinished results of commands; clean-up when a signal ends a command.

A working folder `.NAME.twin-XXXX.part/` contains a file `lock` and the folder `new/`, the future
result. The process that writes there has locked the file `lock`. The operating system releases the
lock when the process ends, for any reason. A working folder with a free lock is therefore a
leftover of a killed run, and the next run on the same target removes it.

The file `lock` contains a mark. While a working folder is created, its parent folder has a shared
lock. A working folder without the mark is thus a leftover only if its parent is not locked.

A signal ends a command as an error does: working folders are removed and worker processes ended.
SIGINT, SIGTERM and SIGHUP, as far as the platform has them, raise `Interrupted` in the main thread.
A signal that this process was started to ignore (nohup) remains ignored.

Python runs a signal handler in the main thread after the current call has returned. A call into a
renderer or a solver may last a minute. `end_within` therefore starts a thread that does the same
clean-up if the main thread has not ended in a given time. That thread waits for the end of an
atomic step (`signals_held`).
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

BY_SIGNAL = 128
"""The exit code of a command that a signal ended is this number plus the number of the signal."""


class Interrupted(KeyboardInterrupt):
    """Exception that a signal raises to end the process; `number` is the number of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class _Hold:
    depth = 0
    waiting: int | None = None
    #: lock of the thread that does an atomic step on files, or that ends the process
    gate = threading.Lock()
    #: working folders of this process that are not removed yet
    working: ClassVar[set[Path]] = set()
    said = threading.Lock()


def unwind_on_signals() -> None:
    """Let the signals that end a process raise `Interrupted`; call this in the main thread only."""
    for number in ENDING_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


@contextmanager
def signals_held() -> Iterator[None]:
    """Delay the effect of signals to the end of the `with` block, which is an atomic step.

    Call this in the main thread; in any other thread there is no effect.

    Raises
    ------
    Interrupted : at the end of the block, if a signal arrived during the block
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # handlers run in the main thread only
        return
    _Hold.depth += 1
    if _Hold.depth == 1:
        _Hold.gate.acquire()
    try:
        yield
    finally:
        # The lock is released first: at depth 0 a signal would raise `Interrupted` in this block.
        if _Hold.depth == 1:
            _Hold.gate.release()
        _Hold.depth -= 1
        if _Hold.waiting is not None and not _Hold.depth:
            number, _Hold.waiting = _Hold.waiting, None
            raise Interrupted(number)


def _interrupt(number: int, _: FrameType | None) -> None:
    if not _Hold.depth:
        raise Interrupted(number)
    _Hold.waiting = number


def end_within(seconds: float) -> None:
    """End the process at most `seconds` after a signal, even if the main thread does not return.

    Only the process of a command may call this, because the calling process is ended.
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
    """End the process of a finished command with exit status `code`.

    Exit handlers are run, but Python's destruction of all objects in memory is skipped, which takes
    0.5 s after a measurement. If the output was closed, the process ends by `sys.exit`, which
    reports that.
    """
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:
        sys.exit(code)
    atexit._run_exitfuncs()
    os._exit(code)


def _end_now(number: int) -> None:
    """Clean up and end the process, also if a step of the clean-up fails.

    The main thread may be anywhere, for example in the import of a module that is needed here.
    """
    try:
        for step in (_end_children, _remove_working, _free_semaphores):
            with suppress(Exception):
                step()
        write_end_message(number)
        if sys.stderr.isatty():
            sys.stderr.write("\x1b[?25h")  # a progress bar hides the cursor
        sys.stderr.flush()
    finally:
        os._exit(BY_SIGNAL + number)


def _end_children() -> None:
    # The module is already imported if there are child processes; importing here might wait for
    # the main thread.
    processes = sys.modules.get("multiprocessing")
    for child in processes.active_children() if processes else ():
        child.kill()  # SIGTERM has no effect on a stopped process


def _remove_working() -> None:
    for folder in list(_Hold.working):
        _remove(folder)


def _free_semaphores() -> None:
    # Python does this at its normal end, which is not reached here. Without it, Python's resource
    # tracker warns of leaked semaphores.
    util = sys.modules.get("multiprocessing.util")
    if util is not None:
        util._run_finalizers(0)


def end_by_signal(error: KeyboardInterrupt) -> int:
    """Report the signal that raised an exception, and return the exit code of the process."""
    number = getattr(error, "number", signal.SIGINT)
    write_end_message(number)
    return BY_SIGNAL + number


def write_end_message(number: int) -> None:
    """Write to standard error, only once per process, that a signal has ended the command."""
    if _Hold.said.acquire(blocking=False):
        name = signal.Signals(number).name
        sys.stderr.write(f"twin: ended by {name}; no incomplete files remain\n")


_NAME = re.compile(r"\.(?P<target>.*)\.twin-[^.]+\.part", re.DOTALL)
_LOCK, _NEW = "lock", "new"
PLAN = "plan.json"
"""A working folder that contains this file is not removed: its exchange is incomplete."""
_MARK = b"working folder of fringe-twin\n"
_TRIES, _POLL_S = 20, 0.01


@contextmanager
def working_folder(place: Path, target: str) -> Iterator[Path]:
    """Yield an empty folder in a new working folder in `place`; remove both at the end.

    Parameters
    ----------
    place : existing folder on the file system of the target
    target : name of the output folder or file, which becomes part of the name of the working
        folder

    Raises
    ------
    OSError : the working folder cannot be created
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
    """Return True if `folder` is a working folder, of a running or of an ended process."""
    try:
        return _NAME.fullmatch(folder.name) is not None and (
            _is_unmarked(folder) or read_bytes(folder / _LOCK) == _MARK
        )
    except (OSError, InputError):
        return False


def is_second(folder: Path) -> bool:
    """Return True if a running process has an older working folder for the same target.

    Parameters
    ----------
    folder : the folder that `working_folder` yields
    """
    mine = folder.parent
    target = _target(mine)
    with suppress(OSError):
        others = [
            entry for entry in mine.parent.iterdir() if entry != mine and _target(entry) == target
        ]
        return any(_is_held(entry) and _age(entry) < _age(mine) for entry in others)
    return False


def _target(folder: Path) -> str:
    named = _NAME.fullmatch(folder.name)
    return named["target"] if named else ""


def _age(folder: Path) -> tuple[int, str]:
    """Return a sort key by which older working folders come first: time of the lock in ns, name."""
    return (folder / _LOCK).stat().st_mtime_ns, folder.name


def leftovers(place: Path, target: str | None = None) -> Iterator[Path]:
    """Yield the unfinished results in `place` that ended processes left in their working folders.

    Each working folder is locked while the caller uses the yielded folder, so that no second
    process uses it. It is removed afterwards.

    Parameters
    ----------
    place : folder that contains the working folders
    target : yield only results of this output; None: of all outputs
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
    """Remove the working folders of ended processes in `place`: all, or those of one target."""
    for _ in leftovers(place, target):
        pass
    with suppress(OSError), locked_folder(place, shared=False):
        for entry in list(place.iterdir()):
            named = _NAME.fullmatch(entry.name)
            if named and target in (None, named["target"]) and _is_unmarked(entry):
                (entry / _LOCK).unlink(missing_ok=True)
                entry.rmdir()


def _remove(folder: Path) -> None:
    """Remove a working folder, its lock file last, so that the folder is recognised until then."""
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
    """Return True if a working folder is empty, or if its lock file has no mark yet."""
    if folder.is_symlink() or not folder.is_dir():
        return False
    entries = list(folder.iterdir())
    return not entries or (entries == [folder / _LOCK] and not entries[0].lstat().st_size)


@contextmanager
def _begun(place: Path) -> Iterator[None]:
    """Give `place` a shared lock, so that a folder without mark there is not taken for a leftover.

    No lock is set if another process has locked that folder, for example `flock out twin ... -o
    out/a`.
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
    # The mark is written after the file is locked: a folder without mark is not taken for a
    # leftover.
    lock = (folder / _LOCK).open("wb", buffering=0)
    try:
        with suppress(OSError):  # a file system without locks: leftovers remain
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
    """Lock the working folder of an ended process; yield False if `folder` is not such a folder."""
    with ExitStack() as stack:
        is_abandoned = False
        with suppress(OSError):
            if not folder.is_symlink():
                lock = stack.enter_context((folder / _LOCK).open("r+b"))
                lock_file(lock.fileno())
                is_abandoned = lock.read(len(_MARK) + 1) == _MARK
        yield is_abandoned
