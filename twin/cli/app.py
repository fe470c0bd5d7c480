"""The application: its options and exit codes, what a command is told and what it says.

Progress and failures go to stderr, figures and paths to stdout.
"""

import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, CycloptsError, Parameter

from reconstruction.errors import InputError
from reconstruction.machine import is_disk_full

if TYPE_CHECKING:
    from twin.config import Experiment
    from twin.pipeline.progress import ProgressCallback
    from twin.study.workers import Workers

BAD_INPUT, MISSING_BACKEND, FAILURE = 2, 3, 1
BY_SIGNAL = 128
"""Exit code of a command that a signal ended, less the number of the signal."""

app = App(
    name="twin",
    help="Digital twin of a contact fringe-projection sensor: press, render, reconstruct, score.",
    version=lambda: metadata.version("fringe-twin"),
    version_flags=["--version"],
    help_flags=["--help", "-h"],
    suppress_keyboard_interrupt=False,  # `guarded` tells which signal it was
)

Out = Annotated[Path, Parameter(name=["--out", "-o"], help="folder for the result")]
ExperimentFile = Annotated[
    Path,
    Parameter(help="TOML file, or the name of a shipped experiment such as paper/two_balls"),
]
Settings = Annotated[
    list[str] | None,
    Parameter(name=["--set", "-s"], help="KEY=VALUE by dotted path, for example camera.binning=2"),
]
Report = Annotated[bool, Parameter(help="draw pictures and report; twin report does so later")]
WorkerCount = Annotated[
    int | None,
    Parameter(
        name=["--workers", "-j"],
        help="processes on this machine; default: one per two cores, at least two of them",
    ),
]
Cluster = Annotated[
    str | None,
    Parameter(help="Dask scheduler, tcp://HOST:PORT, instead of processes on this machine"),
]
Retry = Annotated[
    bool, Parameter(help="also try again what failed for a reason that lies in the experiment")
]
DryRun = Annotated[
    bool,
    Parameter(
        help="only validate, and say what would be measured, how long it takes, and which cases "
        "cannot be measured, and why; exit code 2 when none can"
    ),
]


def guarded(run: Callable[[], Any]) -> int:
    """Run a command; turn expected failures into one line and an exit code."""
    try:
        return int(run() or 0)
    except InputError as error:
        sys.stderr.write(f"twin: {error}\n")
        return BAD_INPUT
    except CycloptsError as error:
        sys.stderr.write(f"twin: {' '.join(str(error).split())} See twin --help.\n")
        return BAD_INPUT
    except KeyboardInterrupt as error:
        number = getattr(error, "number", signal.SIGINT)
        name = signal.Signals(number).name
        sys.stderr.write(f"twin: ended by {name}; nothing is left half-written\n")
        return BY_SIGNAL + number
    except OSError as error:
        if not is_disk_full(error):
            raise
        where = error.filename or "writing"
        sys.stderr.write(
            f"twin: {where}: no room left ({error.strerror}); make room, or write to another disk\n"
        )
        return FAILURE
    except RuntimeError as error:
        if type(error).__name__ != "MissingBackend":
            raise
        sys.stderr.write(f"twin: {error}\n")
        return MISSING_BACKEND


def load(file: Path, settings: list[str] | None) -> "Experiment":
    """Load an experiment and lay KEY=VALUE settings over it."""
    from twin.config import load_experiment

    return load_experiment(str(file), settings_of(settings))


def settings_of(texts: list[str] | None) -> dict[str, Any]:
    """Return KEY=VALUE settings as values by dotted path."""
    return dict(_setting(text) for text in texts or [])


def _setting(text: str) -> tuple[str, Any]:
    """Split KEY=VALUE; the value is read as TOML, and as a plain string if it is none."""
    import tomllib

    key, found, value = text.partition("=")
    if not found or not key.strip():
        raise InputError(f"--set {text}: found no '='; write KEY=VALUE, e.g. camera.binning=2")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


def workers_of(count: int | None, cluster: str | None = None) -> "Workers":
    """Return who computes: a cluster, or so many processes on this machine."""
    from twin.study.workers import dask_workers, default_count, local_workers

    return dask_workers(cluster) if cluster else local_workers(count or default_count())


@contextmanager
def progress_bars() -> "Iterator[ProgressCallback]":
    """Show one bar per stage on stderr, and when it compiles; quiet when nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from reconstruction.compiling import telling_of_compiling

    name = TextColumn("{task.description:<12}", markup=False)
    columns = (name, BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bars: dict[str, Any] = {}

        def watch(stage: str, fraction: float) -> None:
            if stage not in bars:
                bars[stage] = progress.add_task(stage, total=1.0)
                if not console.is_terminal:
                    sys.stderr.write(f"{stage} ...\n")
            progress.update(bars[stage], completed=fraction)

        def tell() -> None:
            stage = next(reversed(bars), "")
            told = f"{stage} (compiling, once)"
            if stage and progress.tasks[bars[stage]].description != told:
                progress.update(bars[stage], description=told)
                if not console.is_terminal:
                    sys.stderr.write(f"{told} ...\n")

        with telling_of_compiling(tell):
            yield watch


def print_metrics(figures: dict[str, Any]) -> None:
    """Print figures as a table; a dash stands for one that does not exist."""
    print_table(
        ("figure", "value"),
        (
            (name, "\n".join(value) if isinstance(value, list) else cell(value, 6))
            for name, value in figures.items()
        ),
    )


def cell(value: Any, digits: int) -> str:
    """Write a value for a table's cell."""
    if value is None:
        return "-"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def print_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    styles: Mapping[str, str] | None = None,
    width: int | None = None,
) -> None:
    """Print a table on stdout, every cell as it is: names may hold what Rich takes for markup.

    Parameters
    ----------
    headings, rows : texts
    styles : Rich style of the cells in the first column, by their text; that column never wraps
    width : columns of the terminal; None: its own
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table()
    for number, heading in enumerate(headings):
        table.add_column(Text(heading), no_wrap=number == 0 and len(headings) > 2)
    for first, *rest in rows:
        table.add_row(Text(first, (styles or {}).get(first, "")), *map(Text, rest))
    Console(width=width).print(table)


def say(text: str) -> None:
    """Print a line on stdout."""
    sys.stdout.write(f"{text}\n")
