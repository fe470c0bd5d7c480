"""Figures of a page drawn by two processes, while files are written: Matplotlib draws on one core.

Where the platform has no fork (Windows), this process draws all of them.

The second process is a copy of this one (fork) that has all it draws in its memory: it loads, reads
and scores nothing. Both take the next figure from one queue, a pipe of numbers. The copy lacks the
threads of this process, so that it must not render, and it ends without Python's own end. It keeps
no file of this process open: the lock of a working folder must not outlive its owner.
"""

import gc
import os
import select
import signal
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from reconstruction.machine import threads, warnings_ignored
from twin.report.page import Figure
from twin.working import ENDING_SIGNALS

PATIENCE_S = 60.0
"""A copy that has not ended so long after this process hangs: a figure takes less than a second."""

_NUMBER = struct.Struct("<H")


def draw_side_by_side(
    figures: Sequence[Figure],
    place: Callable[[Figure], Path],
    told: Callable[[], None],
    beside: Callable[[], object] = lambda: None,
) -> None:
    """Draw figures here and in a second process; here alone where there is one core.

    Parameters
    ----------
    place : where a figure's picture goes
    told : called once for each
    beside : done here first, while the second process draws already
    """
    queue, left, parent = _queue(len(figures)), dict(enumerate(figures)), os.getpid()

    def draw_taken(told: Callable[[], None]) -> None:
        for number in _taken(queue):
            _draw(left.pop(number), place)
            told()

    def orphaned() -> None:
        if os.getppid() != parent:
            raise ChildProcessError(f"process {parent} has ended")

    with (
        os.fdopen(queue, "rb", buffering=0),
        _second_process(lambda: draw_taken(orphaned), queue) as has_drawn,
    ):
        beside()
        draw_taken(told)
        is_drawn = has_drawn()
    for figure in left.values():
        if not is_drawn:  # what failed there fails here, and is told
            _draw(figure, place)
        told()


def _draw(figure: Figure, place: Callable[[Figure], Path]) -> None:
    if figure.draw is not None:
        figure.draw(place(figure))


def _queue(count: int) -> int:
    """Return a pipe with the numbers below `count`, each for the process that reads it first."""
    queue, end = os.pipe()
    with os.fdopen(end, "wb") as numbers:
        numbers.write(b"".join(map(_NUMBER.pack, range(count))))
    return queue


def _taken(queue: int) -> Iterator[int]:
    while number := os.read(queue, _NUMBER.size):
        yield _NUMBER.unpack(number)[0]


@contextmanager
def _second_process(work: Callable[[], None], queue: int) -> Iterator[Callable[[], bool]]:
    """Let a copy of this process work; yields what waits for it and tells whether it went well."""
    if threads() < 2 or not hasattr(os, "fork"):
        yield lambda: False
        return
    alive, end = os.pipe()
    with os.fdopen(alive, "rb", buffering=0):
        try:
            child = _forked(work, (queue, end))
        except OSError:  # no room for a copy
            child = None
        finally:
            os.close(end)
        status: list[int] = []

        def has_ended_well() -> bool:
            # Only the copy has the other end, which the system closes when it ends.
            if child is None or not select.select([alive], [], [], PATIENCE_S)[0]:
                return False
            status.append(os.waitpid(child, 0)[1])
            return status == [0]

        try:
            yield has_ended_well
        finally:
            if child is not None and not status:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)


def _forked(work: Callable[[], None], kept: Sequence[int]) -> int:
    """Start a copy that does some work and ends; `kept` are the files that it has of this one."""
    # Handlers would write into the pipe that ends this process (`working.end_within`).
    held = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    try:
        # Of threads that the copy lacks, from Python 3.12 on: it needs none of them.
        with warnings_ignored(DeprecationWarning):
            child = os.fork()
        if not child:
            _work_and_end(work, kept, held)
        return child
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def _work_and_end(work: Callable[[], None], kept: Sequence[int], mask: object) -> NoReturn:
    status = 1
    try:
        gc.disable()  # a collection would copy all memory that both share
        signal.set_wakeup_fd(-1)
        for number in ENDING_SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)  # type: ignore[arg-type]
        first = 3
        for file in sorted(kept):
            os.closerange(first, file)
            first = file + 1
        os.closerange(first, os.sysconf("SC_OPEN_MAX"))
        work()
        status = 0
    finally:
        os._exit(status)  # nothing of the caller's is unwound a second time
