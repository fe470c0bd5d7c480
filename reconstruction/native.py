"""Native readers that loop for ever, crash or corrupt memory on damaged files: in a child.

HDF5 loops on some, SciPy's reader of MATLAB files crashes on some, and a process cannot guard
itself against that from within. The child's processor time is limited, so that neither busy
neighbours nor slow disks count, and nothing outlives its parent for long.

OpenEXR only talks too much: thousands of lines about one damaged file (`quiet`).
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
# Far more than a sound file takes.
LEAST_LIMIT_S, SLOWEST_BYTES_PER_S = 5.0, 20e6
# Ends the child after its share of processor time; Windows has none, there the clock limits it.
_TIMER_SIGNAL: int = getattr(signal, "SIGPROF", 0)


def read_in_child(kind: Literal["HDF5", "MATLAB"], path: Path) -> bytes:
    """Read an existing file whole by a native reader, in a process of its own.

    Returns
    -------
    bytes
        What the child tells of the file, see there.

    Raises
    ------
    OSError : the reader fails, crashes or comes to no end
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
    """Let what this process prints in the block go nowhere; blocks of several threads may overlap.

    For a library that prints about a file what its error says, too.
    """
    with _talking:
        _quiet_threads.append(_silenced() if not _quiet_threads else ExitStack())
    try:
        yield
    finally:
        with _talking:
            # The first block's silence goes on until the last one ends.
            held = _quiet_threads.pop() if len(_quiet_threads) > 1 else None
            (held or _quiet_threads.pop()).close()


def _silenced() -> ExitStack:
    """Send both streams away, of Python and of native code, until the stack is closed."""
    stack = ExitStack()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        with suppress(OSError):  # a stream that is closed is silent as it is
            before = os.dup(number)
            os.dup2(nowhere, number)
            stack.callback(os.close, before)
            stack.callback(os.dup2, before, number)
    os.close(nowhere)
    stack.enter_context(redirect_stdout(io.StringIO()))
    return stack
