"""Progress of a command, reported to a callback, and the time of its stages."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol


class ProgressCallback(Protocol):
    """Progress callback: receives the finished fraction of a stage."""

    def __call__(self, stage: str, fraction: float, /) -> None:
        """Report the finished fraction of a stage."""


def no_progress(stage: str, fraction: float, /) -> None:
    """Do without a progress callback."""


@dataclass
class Stopwatch:
    """Wall-clock seconds per stage, and the calls of the progress callback."""

    watch: ProgressCallback = no_progress
    seconds: dict[str, float] = field(default_factory=dict)
    frames_per_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[float], None]]:
        """Measure the run time of a stage in a `with` block.

        Yields the function by which the stage reports its finished fraction, 0 to 1.
        """
        self.watch(name, 0.0)
        start = time.perf_counter()
        yield lambda fraction: self.watch(name, fraction)
        self.seconds[name] = time.perf_counter() - start
        self.watch(name, 1.0)

    def count_frames(self, stage: str, frames: int) -> None:
        """Note how many frames a stage made, if this watch timed it."""
        if stage in self.seconds:
            self.frames_per_s[stage] = frames / self.seconds[stage]
