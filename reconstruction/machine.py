"""Use of the machine's resources: processor cores, memory, and a disk that may be full.

Programs that share a machine limit their threads by an environment variable (`VARIABLE`). A full
disk raises an ordinary OSError (see `writing`).

Warning filters, environment variables and the thread count of BLAS are global to the process. The
functions here change them inside a `with` block and restore the caller's values at its end, also
if several threads run such blocks.
"""

import ctypes
import errno
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError

VARIABLE = "NUMBA_NUM_THREADS"
"""Environment variable that limits the threads of this process, as it limits Numba's."""


def usable_cores() -> int:
    """Return the number of processor cores that the system lets this process use."""
    limited = hasattr(os, "sched_getaffinity")  # of Linux
    return len(os.sched_getaffinity(0)) if limited else os.cpu_count() or 1


def threads() -> int:
    """Return the number of threads to start: the usable cores, at most the limit in `VARIABLE`."""
    cores, limit = usable_cores(), os.environ.get(VARIABLE, "")
    return max(1, min(cores, int(limit) if limit.isdecimal() else cores))


def run_side_by_side(jobs: Sequence[Callable[[], object]]) -> None:
    """Run jobs in parallel threads; raise the exception of the first job in `jobs` that failed.

    Jobs gain time only where they run outside of Python: array arithmetic, compression, files.
    """
    with ThreadPoolExecutor(threads()) as pool:
        for job in [pool.submit(job) for job in jobs]:
            job.result()


_PROCESS_WIDE = threading.RLock()


@contextmanager
def warnings_ignored(category: type[Warning] = Warning) -> Iterator[None]:
    """Ignore warnings of a category inside a `with` block, for one thread at a time.

    If two threads were in `warnings.catch_warnings` at the same time, the filters of one thread
    could remain set in the process.
    """
    with _PROCESS_WIDE, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


@contextmanager
def environment_variable(name: str, value: str | None) -> Iterator[None]:
    """Set an environment variable inside a `with` block, for one thread at a time.

    With value None the variable keeps its value. At the end the former value is restored.
    """
    with _PROCESS_WIDE:
        before = os.environ.get(name)
        if value is not None:
            os.environ[name] = value
        try:
            yield
        finally:
            if before is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = before


class _Blas:
    users = 0
    limits: Any = None


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS and OpenMP to one thread inside a `with` block; blocks of threads may overlap.

    The number of BLAS threads is restored at the end of the last block.
    """
    with _PROCESS_WIDE:
        libraries = _thread_pools(len(sys.modules))
        if not _Blas.users:
            _Blas.limits = libraries.limit(limits=1, user_api="blas")
        _Blas.users += 1
    try:
        # OpenMP counts in each thread separately.
        with libraries.limit(limits=1, user_api="openmp"):
            yield
    finally:
        with _PROCESS_WIDE:
            _Blas.users -= 1
            if not _Blas.users:
                _Blas.limits.restore_original_limits()


@lru_cache(maxsize=1)
def _thread_pools(modules: int) -> Any:
    """Return the loaded libraries that have threads; a search for them takes 0.5 ms.

    `modules` is the number of imported modules: another number may mean another library.
    """
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


_MALLOPT = {
    "M_MMAP_THRESHOLD": (-3, 2**30),
    "M_TRIM_THRESHOLD": (-1, 2**31 - 1),
    "M_ARENA_MAX": (-8, 1),
}
"""Options of `mallopt` in the GNU C library (malloc.h): number and largest useful value of each."""


def keep_freed_memory() -> None:
    """Let this process reuse its freed memory instead of returning it to the system.

    Every operation on images frees one array and allocates another. The system fills each new
    array with zeros, which takes more time than the arithmetic. Only programs should call this
    function, not libraries, because the setting applies to the whole process. Without the GNU C
    library the function has no effect.
    """
    try:
        library = ctypes.CDLL(None)
        set_option = library.mallopt
    except (OSError, TypeError, AttributeError):
        return
    for number, value in _MALLOPT.values():
        set_option(number, value)


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def is_disk_full(error: BaseException) -> bool:
    """Return True if an error reports a full disk, or an exceeded quota or file size limit."""
    return isinstance(error, OSError) and error.errno in _FULL


def unwritable(
    path: Path | str, error: OSError, kind: type[InputError] = InputError
) -> OSError | InputError:
    """Return the exception to raise for a file that cannot be written.

    For a full disk it is an OSError that names the file, because the input is valid. For any other
    cause (no permission, a file in the place of a folder) it is an InputError of class `kind`.
    """
    if is_disk_full(error):
        return OSError(error.errno, error.strerror, str(path))
    return kind(f"{path}: cannot be written ({error.strerror or error})")
