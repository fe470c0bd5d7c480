"""Native readers that loop for ever, crash or corrupt memory on damaged files: in a child.

HDF5 loops on some, SciPy's reader of MATLAB files crashes on some, and a process cannot guard
itself against that from within. The child's processor time is limited, so that neither busy
neighbours nor slow disks count, and nothing outlives its parent for long.
"""

import signal
import subprocess
import sys
from pathlib import Path
from typing import Literal

_CHILD = Path(__file__).with_name("native_child.py")
# Far more than a sound file takes.
LEAST_LIMIT_S, SLOWEST_BYTES_PER_S = 5.0, 20e6


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
    child = subprocess.run(
        [sys.executable, "-P", str(_CHILD), kind, str(limit_s), str(path)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
    )
    if child.returncode:
        raise OSError(f"{path}: is damaged ({_reason(kind, child, limit_s)})")
    return child.stdout


def _reason(kind: str, child: "subprocess.CompletedProcess[bytes]", limit_s: float) -> str:
    if child.returncode == -signal.SIGPROF:
        return f"{kind} came to no end in {limit_s:.0f} s of processor time"
    if child.returncode < 0:
        return f"{kind} crashes on it, signal {-child.returncode}"
    return " ".join(child.stdout.decode("utf-8", "replace").split()) or "it cannot be read"
