"""Draw the figures of a page in two processes, because Matplotlib uses only one core.

On platforms without fork (Windows), this process draws all figures.

The second process is a fork of this process. It has the data of the figures in memory and neither
reads nor computes data. Both processes take the next figure from one queue, a pipe of numbers. The
fork does not have the threads of this process. It must therefore not render, and it ends by
`os._exit`. It closes all files of this process, so that it does not keep the lock of a working
folder after this process has ended.
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
"""Time for which this process waits for the end of the second process before it kills it. A figure
takes less than 1 s."""

_NUMBER = struct.Struct("<H")


def draw_side_by_side(
    figures: Sequence[Figure],
    place: Callable[[Figure], Path],
    step: Callable[[], None],
    first_task: Callable[[], object] = lambda: None,
) -> None:
    """Draw figures in this and in a second process; with one core, in this process only.

    Parameters
    ----------
    place : function that returns the path of a figure's picture
    step : called once per figure, in this process
    first_task : function that this process calls first, while the second process draws
    """
    queue, left, parent = _queue(len(figures)), dict(enumerate(figures)), os.getpid()

    def draw_taken(step: Callable[[], None]) -> None:
        for number in _taken(queue):
            _draw(left.pop(number), place)
            step()

    def orphaned() -> None:
        if os.getppid() != parent:
            raise ChildProcessError(f"process {parent} has ended")

    with (
        os.fdopen(queue, "rb", buffering=0),
        _second_process(lambda: draw_taken(orphaned), queue) as has_drawn,
    ):
        first_task()
        draw_taken(step)
        is_drawn = has_drawn()
    for figure in left.values():
        if not is_drawn:  # a figure that failed there raises its error here
            _draw(figure, place)
        step()


def _draw(figure: Figure, place: Callable[[Figure], Path]) -> None:
    if figure.draw is not None:
        figure.draw(place(figure))


def _queue(count: int) -> int:
    """Return the read end of a pipe with the numbers below `count`.

    The process that reads a number draws the figure with this number.
    """
    queue, end = os.pipe()
    with os.fdopen(end, "wb") as numbers:
        numbers.write(b"".join(map(_NUMBER.pack, range(count))))
    return queue


def _taken(queue: int) -> Iterator[int]:
    while number := os.read(queue, _NUMBER.size):
        yield _NUMBER.unpack(number)[0]


@contextmanager
def _second_process(work: Callable[[], None], queue: int) -> Iterator[Callable[[], bool]]:
    """Run `work` in a fork; yield a function that waits for its end and returns True on success.

    If no fork is possible, `work` does not run and the function returns False.
    """
    if threads() < 2 or not hasattr(os, "fork"):
        yield lambda: False
        return
    alive, end = os.pipe()
    with os.fdopen(alive, "rb", buffering=0):
        try:
            child = _forked(work, (queue, end))
        except OSError:  # not enough memory or processes for a fork
            child = None
        finally:
            os.close(end)
        status: list[int] = []

        def has_ended_well() -> bool:
            # Only the fork has the write end, which the system closes when the fork ends.
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


def _forked(work: Callable[[], None], open_files: Sequence[int]) -> int:
    """Fork a child process that runs `work` and ends; return the child's process number.

    `open_files` are file descriptors that remain open in the child.
    """
    # Handlers would write into the pipe that ends this process (`working.end_within`).
    held = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
    try:
        # From Python 3.12 on, a fork of a process with threads warns; the child needs no thread.
        with warnings_ignored(DeprecationWarning):
            child = os.fork()
        if not child:
            _work_and_end(work, open_files, held)
        return child
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)


def _work_and_end(work: Callable[[], None], open_files: Sequence[int], mask: object) -> NoReturn:
    status = 1
    try:
        gc.disable()  # a collection would copy all shared memory
        signal.set_wakeup_fd(-1)
        for number in ENDING_SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)  # type: ignore[arg-type]
        first = 3
        for file in sorted(open_files):
            os.closerange(first, file)
            first = file + 1
        os.closerange(first, os.sysconf("SC_OPEN_MAX"))
        work()
        status = 0
    finally:
        os._exit(status)  # without unwinding the caller's frames a second time
