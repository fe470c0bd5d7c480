"""Compiled kernels on disk: Numba's cache, with a checksum in every file.

Numba's cache checks a function's own source file only, and it executes whatever its files contain.
Here the files also depend on the sources of all kernels, and a damaged file is compiled again: a
truncated one, one with changed bytes, a folder or a pipe in its place.
"""

import hashlib
import io
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from reconstruction.reading import is_regular

_DIGEST_BYTES = 16


def protect(kernel: Any, source_digest: str) -> None:
    """Let a cached kernel load only intact files that were compiled from the given sources.

    Parameters
    ----------
    kernel : function compiled by `numba.njit(cache=True)`
    source_digest : digest of all sources; stored code with another digest is compiled again
    """
    stored = kernel._cache._cache_file
    stored._source_stamp = source_digest
    stored._open_for_write = partial(_open_for_write, stored)
    stored._load_index = partial(_load_index, stored)
    stored._load_data = partial(_load_data, stored)
    kernel._cache.save_overload = partial(_save, kernel._cache)


@contextmanager
def _open_for_write(stored: Any, path: str) -> Iterator[io.BytesIO]:
    """Write a file with a checksum at its end, which Numba's reader ignores."""
    content = io.BytesIO()
    yield content
    with type(stored)._open_for_write(stored, path) as file:
        file.write(content.getvalue() + _digest(content.getvalue()))


def _digest(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).digest()


def _is_intact(path: Path) -> bool:
    """Return True for a regular file with its checksum; a pipe is not opened."""
    if not is_regular(path):
        return False
    content = path.read_bytes()
    return _digest(content[:-_DIGEST_BYTES]) == content[-_DIGEST_BYTES:]


def _load_index(stored: Any) -> Any:
    """Return the stored versions of a kernel by the types of their arguments.

    The result is empty, so that the kernel is compiled again, if the file is not intact or names a
    type that no longer exists.
    """
    try:
        intact = _is_intact(Path(stored._index_path))
        return type(stored)._load_index(stored) if intact else {}
    except (AttributeError, ImportError, OSError):
        return {}


def _load_data(stored: Any, name: str) -> Any:
    """Return a stored version of a kernel, or raise OSError, which makes Numba compile it again."""
    if not _is_intact(Path(stored._data_path(name))):
        raise FileNotFoundError(name)
    return type(stored)._load_data(stored, name)


def _save(cache: Any, signature: Any, compiled: Any) -> None:
    """Store a compiled kernel; if the disk is full or read-only, the next process compiles it."""
    with suppress(OSError):
        type(cache).save_overload(cache, signature, compiled)
