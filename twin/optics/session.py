"""Sessions of the renderer: one thread at a time, and the caller's settings again at their end.

Mitsuba's variant belongs to the process: `mi.Float` is a name of the current variant in all
threads, and a thread that changes the variant changes it for a trace that another one is recording.
Dr.Jit computes in the background, and only the thread that began a computation waits for it. So a
session holds a lock, makes the variant of this machine's backend current, waits at its end for all
that was begun, and restores the caller's variant. Sessions of one thread may be nested. A program
that uses Mitsuba itself in another thread at the same time has to take turns by its own means.

Dr.Jit's flags and number of threads, Mitsuba's log level and the environment are not changed.
"""

import functools
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from reconstruction.machine import environment_variable
from twin.optics.backend import LIBRARY_VARIABLE, Backend, find_backend

_LOCK = threading.RLock()


class _Nesting:
    depth = 0


@contextmanager
def renderer_session() -> Iterator[Backend]:
    """Let this thread alone use Mitsuba and Dr.Jit in a block, or in a function as a decorator.

    Modules that import Mitsuba are imported within a session.

    Raises
    ------
    MissingBackend : if no backend works here
    """
    with _LOCK:
        before = _variant()
        backend = activate()
        _Nesting.depth += 1
        try:
            yield backend
        finally:
            _Nesting.depth -= 1
            if not _Nesting.depth:
                _finish(before)


def activate() -> Backend:
    """Make the backend of this machine the current one for good; any number of calls.

    Raises
    ------
    MissingBackend : if no backend works here
    """
    with _LOCK:
        backend = _backend_of_this_process()
        # Dr.Jit looks for LLVM's library there when the variant is set.
        with environment_variable(LIBRARY_VARIABLE, backend.library):
            import mitsuba as mi

            if mi.variant() != backend.variant:
                mi.set_variant(backend.variant)
        return backend


@contextmanager
def renderer_threads(count: int) -> Iterator[None]:
    """Let Dr.Jit use `count` threads in a block; it does not look at the environment.

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    """
    with renderer_session():
        import drjit as dr

        before = dr.thread_count()
        dr.set_thread_count(count)
    try:
        yield
    finally:
        with renderer_session():
            dr.set_thread_count(before)


@functools.cache
def _backend_of_this_process() -> Backend:
    return find_backend()


def _variant() -> str | None:
    """Return the caller's variant; None where Mitsuba is not loaded or has none yet."""
    if "mitsuba" not in sys.modules:
        return None
    import mitsuba as mi

    variant: str | None = mi.variant()
    return variant


def _finish(before: str | None) -> None:
    import drjit as dr
    import mitsuba as mi

    dr.sync_thread()
    # Mitsuba cannot go back to having no variant: then ours stays.
    if before is not None and mi.variant() != before:
        mi.set_variant(before)
