"""What a command says: progress on stderr, figures and paths on stdout; and what it is told."""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reconstruction.errors import InputError

if TYPE_CHECKING:
    from twin.config import Experiment
    from twin.pipeline.progress import ProgressCallback


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


@contextmanager
def progress_bars() -> "Iterator[ProgressCallback]":
    """Show one bar per stage on stderr; quiet when nobody watches."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

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
