"""Run native readers in a child process: on a damaged file they hang, crash or corrupt memory.

HDF5 loops for ever on some damaged files, and SciPy's reader of MATLAB files crashes on some. A
process cannot protect itself against either. The time limit is on the child's processor time, so
that other busy processes and slow disks do not matter. The child ends soon after its parent.

OpenEXR prints thousands of lines about one damaged file; `quiet` discards them.
"""

import io
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Literal

_CHILD = Path(__file__).with_name("native_child.py")
# The time limit, LEAST_LIMIT_S + file size / SLOWEST_BYTES_PER_S, is far above the time that
# reading an intact file takes.
LEAST_LIMIT_S, SLOWEST_BYTES_PER_S = 5.0, 20e6
# Ends the child after its processor time limit; Windows has no such signal: wall time counts.
_TIMER_SIGNAL: int = getattr(signal, "SIGPROF", 0)


def read_in_child(kind: Literal["HDF5", "MATLAB"], path: Path) -> bytes:
    """Read an existing file completely by a native reader in a child process.

    Returns
    -------
    bytes
        The standard output of the child (see `native_child`): the numeric arrays of a MATLAB file
        as an npz file, no bytes for HDF5.

    Raises
    ------
    OSError : the reader fails, crashes or exceeds the time limit
    """
    limit_s = LEAST_LIMIT_S + path.stat().st_size / SLOWEST_BYTES_PER_S
    try:
        child = subprocess.run(
            [sys.executable, "-P", str(_CHILD), kind, str(limit_s), str(path)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
            timeout=None if _TIMER_SIGNAL else limit_s,
        )
    except subprocess.TimeoutExpired:
        raise OSError(f"{path}: is damaged ({kind} came to no end in {limit_s:.0f} s)") from None
    if child.returncode:
        raise OSError(f"{path}: is damaged ({_reason(kind, child, limit_s)})")
    return child.stdout


def _reason(kind: str, child: "subprocess.CompletedProcess[bytes]", limit_s: float) -> str:
    if _TIMER_SIGNAL and child.returncode == -_TIMER_SIGNAL:
        return f"{kind} came to no end in {limit_s:.0f} s of processor time"
    if child.returncode < 0:
        return f"{kind} crashes on it, signal {-child.returncode}"
    return " ".join(child.stdout.decode("utf-8", "replace").split()) or "it cannot be read"


_talking = threading.Lock()
_quiet_threads: list[ExitStack] = []


@contextmanager
def quiet() -> Iterator[None]:
    """Discard everything that this process prints during a `with` block.

    Blocks of several threads may overlap. Used for a library that prints the same message as its
    exception contains.
    """
    with _talking:
        _quiet_threads.append(_silenced() if not _quiet_threads else ExitStack())
    try:
        yield
    finally:
        with _talking:
            # The first block's redirection remains until the last block ends.
            earlier = _quiet_threads.pop() if len(_quiet_threads) > 1 else None
            (earlier or _quiet_threads.pop()).close()


def _silenced() -> ExitStack:
    """Redirect stdout and stderr, of Python and native code, until the returned stack is closed."""
    stack = ExitStack()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        with suppress(OSError):  # a closed stream needs no redirection
            before = os.dup(number)
            os.dup2(nowhere, number)
            stack.callback(os.close, before)
            stack.callback(os.dup2, before, number)
    os.close(nowhere)
    stack.enter_context(redirect_stdout(io.StringIO()))
    return stack
