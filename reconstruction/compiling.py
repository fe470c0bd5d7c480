"""Compile functions with Numba ("kernels") and run them over bands of image rows on all cores.

The kernels release Python's interpreter lock and run in ordinary threads. They compile in a
fraction of the time that Numba's automatic parallelisation needs, and several threads may call
them at the same time.
"""

import hashlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

from reconstruction.kernel_cache import protect
from reconstruction.machine import threads

Function = TypeVar("Function", bound=Callable[..., Any])

# Fixed, not a share of the rows per core: kernels carry starting values from row to row within a
# band, so the last digit of a result must not depend on the number of cores.
BAND_ROWS = 16

# Patterns of all files that contribute code or constants to a kernel.
KERNEL_SOURCES = ("**/_[!_]*.py", "compiling.py", "arrays.py", "rig/pinhole.py", "rig/sensor.py")

# Division by zero gives inf as in numpy. Fused multiply-add is allowed, but not the fast arithmetic
# that assumes there are no NaNs: a damaged float stack must not pass a threshold.
# Kernels allocate no arrays and the callers count references to arrays: counting them in every
# call takes 10 % of the compile time.
OPTIONS: dict[str, Any] = {
    "nogil": True,
    "_nrt": False,
    "error_model": "numpy",
    "fastmath": {"contract"},
}
# Options of functions that are called from kernels only.
NESTED: dict[str, Any] = {"no_cpython_wrapper": True}


def digest_of_sources(folder: Path, patterns: tuple[str, ...]) -> str:
    """Return the SHA-256 digest (hexadecimal) of the files in `folder` that match the patterns."""
    files = sorted(file for pattern in patterns for file in folder.glob(pattern))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, KERNEL_SOURCES)


def compiled(function: Function) -> Function:
    """Compile `function` on its first call and store the compiled code on disk."""
    return compile_and_keep(function, OPTIONS, SOURCE_DIGEST)


def nested(function: Function) -> Function:
    """Compile `function` for calls from kernels; Python code must not call it.

    A wrapper that converts arguments from Python takes 10 % of the compile time.
    """
    return compile_and_keep(function, OPTIONS | NESTED, SOURCE_DIGEST)


def inlined(function: Function) -> Function:
    """Compile `function` as `nested` and inline it into its callers: for code run on each pixel."""
    return compile_and_keep(function, OPTIONS | NESTED | {"forceinline": True}, SOURCE_DIGEST)


def merged(function: Function) -> Function:
    """Copy `function` into its callers before type inference.

    Used for code that runs once per image row. The compiler would optimise a compiled function
    again in each function that calls it, so every further level of calls adds compile time.
    """
    return cast(Function, numba.njit(inline="always", **OPTIONS)(function))


def compile_and_keep(function: Function, options: dict[str, Any], source_digest: str) -> Function:
    """Compile `function` on its first call, and store the compiled code on disk.

    Parameters
    ----------
    options : options of `numba.njit`
    source_digest : digest of all sources; stored code with another digest is compiled again
    """
    if numba.config.DISABLE_JIT:  # to run the kernels in a debugger
        return function
    options = {**options, "no_cfunc_wrapper": True}  # no kernel is called from C
    try:
        kernel = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no writable cache folder: every process compiles
        return cast(Function, numba.njit(**options)(function))
    protect(kernel, source_digest)
    return cast(Function, kernel)


@contextmanager
def telling_of_compiling(callback: Callable[[], None]) -> Iterator[None]:
    """Call `callback` whenever a kernel is compiled during a `with` block, not loaded from disk.

    The call is made in the thread that compiles.
    """
    with event.install_listener("numba:compile", _Listener(callback)):
        yield


class _Listener(event.Listener):  # type: ignore[misc]  # numba has no type information
    def __init__(self, callback: Callable[[], None]) -> None:
        self._callback = callback

    def on_start(self, event: Any) -> None:
        self._callback()

    def on_end(self, event: Any) -> None:
        pass


def run_over_rows(
    kernel: Callable[..., None], rows: int, *arguments: object, band_rows: int = BAND_ROWS
) -> None:
    """Call `kernel(first_row, end_row, *arguments)` in threads, for bands of `band_rows` rows.

    The bands cover rows 0 to `rows` - 1, each exactly once.
    """
    with ThreadPoolExecutor(threads()) as pool:
        calls = [
            pool.submit(kernel, first, min(first + band_rows, rows), *arguments)
            for first in range(0, rows, band_rows)
        ]
        for call in calls:
            call.result()
