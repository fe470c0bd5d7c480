"""The command line application: common options, exit codes, and the input and output of commands.

Progress and failures go to stderr, figures and paths to stdout.
"""

import errno
import os
import signal
import sys
import traceback
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, CycloptsError, Parameter

from reconstruction.errors import InputError
from reconstruction.machine import is_disk_full
from reconstruction.reading import parse_toml, shown
from twin.cli.talk import OPTIONS, verbose
from twin.cli.talk import progress_bars as progress_bars
from twin.working import BY_SIGNAL, end_by_signal

if TYPE_CHECKING:
    from twin.config import Experiment
    from twin.study.workers import Workers

BAD_INPUT, MISSING_BACKEND, FAILURE = 2, 3, 1
# The operating system raises these errors for any access to a file name that it does not accept,
# even for a test whether the file exists.
_NO_SUCH_NAME = (errno.ENAMETOOLONG, errno.ELOOP)
app = App(
    name="twin",
    help="Digital twin of a contact fringe-projection sensor: press, render, reconstruct, score.",
    help_epilogue=OPTIONS,
    version=lambda: metadata.version("fringe-twin"),
    version_flags=["--version"],
    help_flags=["--help", "-h"],
    suppress_keyboard_interrupt=False,  # `guarded` reports the number of the signal
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
    bool, Parameter(help="also run cases again that failed because of their experiment")
]
DryRun = Annotated[
    bool,
    Parameter(
        help="only validate; print the number of cases, the estimated run time, and the cases that "
        "cannot be measured with the reason; exit code 2 if no case can be measured"
    ),
]


def guarded(run: Callable[[], Any], words: Sequence[str] = ()) -> int:
    """Run a command and return its exit code; report an expected failure in one line on stderr.

    Line breaks and other control characters in `words`, the command line, are printed as escapes.
    """
    try:
        return int(run() or 0)
    except KeyboardInterrupt as error:
        return end_by_signal(error)
    except BrokenPipeError:
        # The reader of the output has closed it; Python would report that again when it flushes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BY_SIGNAL + signal.SIGPIPE
    except Exception as error:
        failure = _failure_message(error)
        if failure is None:
            raise
        if verbose():
            traceback.print_exc()
    message, code = failure
    for word in words:
        for name in (word, str(Path(word))):
            message = message.replace(name, shown(name)) if _has_control(name) else message
    sys.stderr.write(f"twin: {message}\n")
    return code


def _has_control(name: str) -> bool:
    return any(unicodedata.category(sign) in ("Cc", "Cs", "Zl", "Zp") for sign in name)


def _failure_message(error: Exception) -> tuple[str, int] | None:
    """Return message and exit code of an expected failure; None for any other exception."""
    match error:
        case InputError():
            return str(error), BAD_INPUT
        case CycloptsError():
            return f"{' '.join(str(error).split())} See twin --help.", BAD_INPUT
        case MemoryError():
            message = "not enough memory; use coarser grids, camera.binning or fewer frames"
            return message, FAILURE
        case OSError():
            return _of_the_system(error)
        case RuntimeError() if type(error).__name__ == "MissingBackend":
            return str(error), MISSING_BACKEND
    return None


def _of_the_system(error: OSError) -> tuple[str, int] | None:
    if error.errno in _NO_SUCH_NAME:
        name = shown(str(error.filename))
        return f"{name}: {error.strerror}; give a name that a file can have", BAD_INPUT
    if is_disk_full(error):
        where = error.filename or "writing"
        message = f"{where}: no room left ({error.strerror}); make room, or write to another disk"
        return message, FAILURE
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{error.strerror}; raise the limit with: ulimit -n 256", FAILURE
    return None


def load(file: Path, settings: list[str] | None, *, warn: bool = True) -> "Experiment":
    """Load an experiment file and apply KEY=VALUE settings to it.

    If `warn` is True, a warning is printed for each value outside the range of its source.
    """
    from twin.config import load_experiment
    from twin.config.quantities import outside_sources

    experiment = load_experiment(str(file), settings_of(settings))
    for line in outside_sources(experiment) if warn else ():
        sys.stderr.write(f"twin: warning: {line}\n")
    return experiment


def settings_of(texts: list[str] | None) -> dict[str, Any]:
    """Return KEY=VALUE texts as a mapping from dotted path to value."""
    return dict(_setting(text) for text in texts or [])


def _setting(text: str) -> tuple[str, Any]:
    """Split KEY=VALUE; read the value as TOML, or take it as a string if it is not valid TOML."""
    key, separator, value = text.partition("=")
    if not separator or not key.strip():
        raise InputError(f"--set {text}: found no '='; write KEY=VALUE, e.g. camera.binning=2")
    try:
        return key.strip(), parse_toml(f"value = {value}", f"--set {key}")["value"]
    except InputError:
        return key.strip(), value.strip()


def workers_of(count: int | None, cluster: str | None = None) -> "Workers":
    """Return the workers: of the Dask scheduler `cluster`, or `count` processes on this machine."""
    from twin.study.workers import dask_workers, default_count, local_workers

    return dask_workers(cluster) if cluster else local_workers(count or default_count())


def print_metrics(figures: dict[str, Any]) -> None:
    """Print figures as a table of name and value; a dash marks a figure without a value."""
    print_table(
        ("figure", "value"),
        (
            (name, "\n".join(value) or "none" if isinstance(value, list) else cell(value, 6))
            for name, value in figures.items()
        ),
    )


def cell(value: Any, digits: int) -> str:
    """Return a value as the text of a table cell; floats have `digits` significant digits."""
    if value is None:
        return "-"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def print_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    styles: Mapping[str, str] | None = None,
    width: int | None = None,
) -> None:
    """Print a table on stdout, without interpretation of Rich markup in the cells.

    Parameters
    ----------
    headings, rows : texts of the heading and of the cells
    styles : Rich style of the cells in the first column, by their text; that column never wraps
    width : width of the table in characters; None: the width of the terminal
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table()
    for number, heading in enumerate(headings):
        whole = number == 0 and len(headings) > 2
        table.add_column(Text(heading), no_wrap=whole, overflow="fold")
    for first, *rest in rows:
        table.add_row(Text(first, (styles or {}).get(first, "")), *map(Text, rest))
    Console(width=width).print(table)


def say(text: str) -> None:
    """Print one line of text on stdout."""
    sys.stdout.write(f"{text}\n")
