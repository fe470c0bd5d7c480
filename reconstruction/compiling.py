"""Compile kernels and run them over bands of image rows on all cores.

Plain threads over kernels that release the interpreter lock: compiles in a fraction of the time
of automatic parallelisation and may be called from several threads at once.
"""

import hashlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

from reconstruction.machine import threads
from reconstruction.reading import is_regular

Function = TypeVar("Function", bound=Callable[..., Any])

# Fixed, not a share of the rows per core: kernels carry starting values from row to row within a
# band, so the last digit of a result must not depend on the number of cores.
BAND_ROWS = 16

# Every file whose code or constants end up in a kernel.
KERNEL_SOURCES = ("**/_[!_]*.py", "compiling.py", "arrays.py", "rig/pinhole.py", "rig/sensor.py")

# Division by zero gives inf as in numpy. Fused multiply-add is allowed, but not the fast arithmetic
# that assumes there are no NaNs: a damaged float stack must not pass a threshold.
# Kernels make no arrays, and references to arrays are the callers' to count: counted in every call,
# they take a tenth of the compile time.
OPTIONS: dict[str, Any] = {
    "nogil": True,
    "_nrt": False,
    "error_model": "numpy",
    "fastmath": {"contract"},
}
# What only other kernels call.
NESTED: dict[str, Any] = {"no_cpython_wrapper": True}


def digest_of_sources(folder: Path, patterns: tuple[str, ...]) -> str:
    """Return the digest of all files whose code or constants end up in some kernels."""
    files = sorted(file for pattern in patterns for file in folder.glob(pattern))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, KERNEL_SOURCES)


def compiled(function: Function) -> Function:
    """Compile `function` on first call and keep the result on disk."""
    return compile_and_keep(function, OPTIONS, SOURCE_DIGEST)


def nested(function: Function) -> Function:
    """Compile `function` for other kernels alone: Python cannot call it, and must not try.

    To take arguments from Python takes a tenth of the compile time.
    """
    return compile_and_keep(function, OPTIONS | NESTED, SOURCE_DIGEST)


def inlined(function: Function) -> Function:
    """Compile `function` into its callers, as `nested`: for what runs once per pixel."""
    return compile_and_keep(function, OPTIONS | NESTED | {"forceinline": True}, SOURCE_DIGEST)


def merged(function: Function) -> Function:
    """Copy `function` into its callers before types are found.

    For what runs once per image row: a compiled function is optimised anew in every function that
    calls it, so that each further level would cost its callers' compile time once more.
    """
    return cast(Function, numba.njit(inline="always", **OPTIONS)(function))


def compile_and_keep(function: Function, options: dict[str, Any], source_digest: str) -> Function:
    """Compile on first call; keep the result on disk for as long as the sources are the same."""
    options = {**options, "no_cfunc_wrapper": True}  # nobody calls a kernel from C
    try:
        kernel = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # there is no place to write: compile anew in every process
        return cast(Function, numba.njit(**options)(function))
    # The cache notices a change in a function's own file only, and would keep serving code into
    # which another file's old function or constant was inlined.
    stored = kernel._cache._cache_file
    stored._source_stamp = source_digest
    stored._load_index = partial(_load_index, stored)
    stored._load_data = partial(_load_data, stored)
    kernel._cache.save_overload = partial(_save, kernel._cache)
    return cast(Function, kernel)


@contextmanager
def telling_of_compiling(told: Callable[[], None]) -> Iterator[None]:
    """Call `told`, from the thread that compiles, whenever a kernel is compiled and not loaded."""
    with event.install_listener("numba:compile", _Listener(told)):
        yield


class _Listener(event.Listener):  # type: ignore[misc]  # numba has no type information
    def __init__(self, told: Callable[[], None]) -> None:
        self._told = told

    def on_start(self, event: Any) -> None:
        self._told()

    def on_end(self, event: Any) -> None:
        pass


def _load_index(stored: Any) -> Any:
    """Return the stored versions of a kernel by their argument types.

    The file names the types of the arguments; reading it fails where one is no longer there, before
    the digest could tell that the file is old. Opening what is no file, a pipe, may never end: the
    next compiled version takes its place.
    """
    try:
        found = is_regular(Path(stored._index_path))
        return type(stored)._load_index(stored) if found else {}
    except (AttributeError, ImportError):
        return {}


def _load_data(stored: Any, name: str) -> Any:
    """Return a stored version of a kernel; an OSError makes Numba compile it again."""
    if not is_regular(Path(stored._data_path(name))):
        raise FileNotFoundError(name)
    return type(stored)._load_data(stored, name)


def _save(cache: Any, signature: Any, compiled: Any) -> None:
    """Store a compiled kernel; a full or forbidden disk costs only the time of the next process."""
    with suppress(OSError):
        type(cache).save_overload(cache, signature, compiled)


def run_over_rows(
    kernel: Callable[..., None], rows: int, *arguments: object, band_rows: int = BAND_ROWS
) -> None:
    """Call `kernel(first_row, end_row, *arguments)` for bands that cover all rows once."""
    with ThreadPoolExecutor(threads()) as pool:
        calls = [
            pool.submit(kernel, first, min(first + band_rows, rows), *arguments)
            for first in range(0, rows, band_rows)
        ]
        for call in calls:
            call.result()
