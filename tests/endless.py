"""A time limit for code that would wait for ever; the speed of the machine is not tested."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

_LIMIT_S = 60


@contextmanager
def not_for_ever() -> Iterator[None]:
    """Raise a TimeoutError in code that opened a pipe and waits for its writer."""

    def end(_number: int, _frame: FrameType | None) -> NoReturn:
        raise TimeoutError("waits for ever")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(_LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
