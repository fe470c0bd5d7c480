"""End on a signal as on an error: working folders are removed and worker processes ended.

SIGINT, SIGTERM and SIGHUP raise `Interrupted` in the main thread. A signal that this process was
started to ignore (nohup) stays ignored.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(KeyboardInterrupt):
    """A signal ends the process; `number` says which."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class _Hold:
    depth = 0
    waiting: int | None = None


def unwind_on_signals() -> None:
    """Turn the signals that end a process into `Interrupted`; in the main thread only."""
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


@contextmanager
def signals_held() -> Iterator[None]:
    """Put off what would interrupt the block until its end: it must not be done by half."""
    if threading.current_thread() is not threading.main_thread():
        yield  # handlers run in the main thread only
        return
    _Hold.depth += 1
    try:
        yield
    finally:
        _Hold.depth -= 1
        if _Hold.waiting is not None and not _Hold.depth:
            number, _Hold.waiting = _Hold.waiting, None
            raise Interrupted(number)


def _interrupt(number: int, _: FrameType | None) -> None:
    if not _Hold.depth:
        raise Interrupted(number)
    _Hold.waiting = number
