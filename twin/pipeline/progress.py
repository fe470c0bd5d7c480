"""Report the progress of a command to a callback, and measure the run time of its stages."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol


class ProgressCallback(Protocol):
    """Function that receives the progress of a command, for example to display it."""

    def __call__(self, stage: str, fraction: float, /) -> None:
        """Receive the name of the running stage and its finished fraction, 0 to 1."""


def no_progress(stage: str, fraction: float, /) -> None:
    """Ignore the progress; the default progress callback."""


@dataclass
class Stopwatch:
    """Measures the run time of stages and calls the progress callback.

    Attributes
    ----------
    watch : progress callback
    seconds : wall-clock time of each finished stage by name
    frames_per_s : frames per second of stages with counted frames, by name
    """

    watch: ProgressCallback = no_progress
    seconds: dict[str, float] = field(default_factory=dict)
    frames_per_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[float], None]]:
        """Measure the run time of a stage, in a `with` block.

        The block receives a function that it calls with the finished fraction of the stage, 0 to 1.
        """
        self.watch(name, 0.0)
        start = time.perf_counter()
        yield lambda fraction: self.watch(name, fraction)
        self.seconds[name] = time.perf_counter() - start
        self.watch(name, 1.0)

    def count_frames(self, stage: str, frames: int) -> None:
        """Record the number of frames that a stage made; ignored for a stage without a run time."""
        if stage in self.seconds:
            self.frames_per_s[stage] = frames / self.seconds[stage]
