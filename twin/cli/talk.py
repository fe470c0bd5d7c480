"""Verbosity of a command (quiet, usual or verbose) and its progress on stderr.

Results are printed to stdout at any verbosity.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.pipeline.progress import ProgressCallback

OPTIONS = (
    "Every command takes -q, --quiet: no progress; and -v, --verbose: versions, the time of each "
    "stage, and where a failure came from; and --plugin FILE, repeatable: a Python file that adds "
    "kinds of coatings, materials and other parts. Ctrl-C ends a command within two seconds."
)


COMPILING = "(compiling, once)"


class Loudness(IntEnum):
    """Verbosity of a command: which messages it writes to stderr."""

    QUIET = 0
    USUAL = 1
    VERBOSE = 2


_LEVEL_OF = {
    "-q": Loudness.QUIET,
    "--quiet": Loudness.QUIET,
    "-v": Loudness.VERBOSE,
    "--verbose": Loudness.VERBOSE,
}


class _Chosen:
    level = Loudness.USUAL


def choose_level(words: Sequence[str]) -> list[str]:
    """Set the verbosity by the last -q or -v of a command line; return all other words.

    Words after `--` are returned unchanged.
    """
    other_words: list[str] = []
    _Chosen.level = Loudness.USUAL
    for number, word in enumerate(words):
        if word == "--":
            return [*other_words, *words[number:]]
        if word in _LEVEL_OF:
            _Chosen.level = _LEVEL_OF[word]
        else:
            other_words.append(word)
    return other_words


def verbose() -> bool:
    """Return True if the command line has -v."""
    return _Chosen.level == Loudness.VERBOSE


def introduce() -> None:
    """Write the versions of the twin and of Python to stderr if the command is verbose."""
    if verbose():
        import platform
        from importlib import metadata

        version = metadata.version("fringe-twin")
        note(f"fringe-twin {version}, Python {platform.python_version()}, {sys.prefix}")


def note(line: str) -> None:
    """Write a line to stderr unless the command is quiet."""
    if _Chosen.level > Loudness.QUIET:
        sys.stderr.write(f"{line}\n")


@contextmanager
def progress_bars() -> "Iterator[ProgressCallback]":
    """Yield a progress callback that shows one bar per stage on stderr.

    A bar shows percent, elapsed and remaining time. A stage that waits for the compilation of a
    kernel is marked. If stderr is not a terminal, the start of each stage is written as a line; if
    the command is verbose, also its end.
    """
    from rich.console import Console

    from reconstruction.compiling import telling_of_compiling

    console = Console(stderr=True)
    if _Chosen.level == Loudness.QUIET:
        yield lambda stage, fraction, /: None
    elif console.is_terminal:
        with _bars(console) as (watch, tell), telling_of_compiling(tell):
            yield watch
    else:
        watch, tell = _lines()
        with telling_of_compiling(tell):
            yield watch


@contextmanager
def _bars(console: Any) -> "Iterator[tuple[ProgressCallback, Callable[[], None]]]":
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description:<12}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left", style="dim"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        bars: dict[str, Any] = {}

        def watch(stage: str, fraction: float, /) -> None:
            if stage not in bars:
                # Without a total until the first progress: the bar then only indicates activity.
                bars[stage] = progress.add_task(stage, total=None)
            if fraction > 0.0:
                progress.update(bars[stage], total=1.0, completed=fraction)

        def tell() -> None:
            stage = next(reversed(bars), "")
            if stage:
                progress.update(bars[stage], description=f"{stage} {COMPILING}")

        yield watch, tell


def _lines() -> "tuple[ProgressCallback, Callable[[], None]]":
    import time

    begun: dict[str, float] = {}
    compiling: set[str] = set()

    def watch(stage: str, fraction: float, /) -> None:
        if stage not in begun:
            begun[stage] = time.perf_counter()
            sys.stderr.write(f"{stage} ...\n")
        elif fraction >= 1.0 and verbose():
            sys.stderr.write(f"{stage} took {time.perf_counter() - begun[stage]:.2f} s\n")

    def tell() -> None:
        stage = next(reversed(begun), "")
        if stage and stage not in compiling:
            compiling.add(stage)
            sys.stderr.write(f"{stage} {COMPILING} ...\n")

    return watch, tell
