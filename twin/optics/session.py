"""Sessions of the renderer, in which only one thread uses Mitsuba.

Mitsuba's variant is global to the process: a thread that changes the variant also changes it for a
trace that another thread is recording. Dr.Jit computes in the background, and only the thread that
started a computation waits for it. Therefore a session holds a lock, activates the variant of this
machine's backend, waits at its end for all started computations, and restores the caller's variant.
Sessions of one thread may be nested. A program that uses Mitsuba directly in another thread has to
synchronise with the sessions itself.

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
    """Give this thread exclusive use of Mitsuba and Dr.Jit; a context manager or a decorator.

    The value of the context is the active backend. Modules that import Mitsuba must be imported
    within a session.

    Raises
    ------
    MissingBackend : no backend works on this machine
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
    """Activate the backend of this machine permanently, and return the backend.

    A further call has no effect if the variant of the backend is still active.

    Raises
    ------
    MissingBackend : no backend works on this machine
    """
    with _LOCK:
        backend = _backend_of_this_process()
        # Dr.Jit reads the path of LLVM's library from there when the variant is set.
        with environment_variable(LIBRARY_VARIABLE, backend.library):
            import mitsuba as mi

            if mi.variant() != backend.variant:
                mi.set_variant(backend.variant)
        return backend


@contextmanager
def renderer_threads(count: int) -> Iterator[None]:
    """Context in which Dr.Jit uses `count` threads, even if the environment sets a lower limit.

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
    """Return the caller's variant; None if Mitsuba is not loaded or has no variant."""
    if "mitsuba" not in sys.modules:
        return None
    import mitsuba as mi

    variant: str | None = mi.variant()
    return variant


def _finish(before: str | None) -> None:
    import drjit as dr
    import mitsuba as mi

    dr.sync_thread()
    # Mitsuba cannot unset its variant: then the session's variant remains.
    if before is not None and mi.variant() != before:
        mi.set_variant(before)
