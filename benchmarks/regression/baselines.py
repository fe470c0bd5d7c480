"""The committed baselines: value, standard uncertainty, number of runs, date, versions, machine.

Beside them lie stated rows: figures that take too long, or a machine of its own, to be measured
with the others. They are written by hand, with date and command.
"""

import os
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import tomli_w

from benchmarks.regression.figures import GuardedFigure, MeanOfRuns
from reconstruction.errors import InputError
from twin.output import versions

NAMED = ("fringe-twin", "mitsuba", "drjit", "numpy")
HEADER = """\
# Baselines of the regression benchmarks. [figure] is written by `./run bench all --update`;
# [stated] are further rows, by hand; headline rows stand in the README. See docs/benchmarks.md.

"""


@dataclass(frozen=True)
class Baseline:
    """What a figure was when it was last accepted."""

    estimate: MeanOfRuns
    date: str
    versions: str
    machine: str


@dataclass(frozen=True)
class Stated:
    """A row that nothing here measures; a headline stands in the README's table, too."""

    name: str
    what: str
    target: str
    measured: str
    how: str
    date: str
    headline: bool = False


@dataclass(frozen=True)
class Baselines:
    """All baselines by name, and the stated rows."""

    figures: Mapping[str, Baseline]
    stated: tuple[Stated, ...] = ()

    def updated(self, found: Mapping[str, MeanOfRuns], date: str, machine: str) -> "Baselines":
        """Return these with new values of the figures found."""
        named = named_versions()
        new = {name: Baseline(value, date, named, machine) for name, value in found.items()}
        return replace(self, figures={**self.figures, **new})


def named_versions() -> str:
    """Return the versions that can change a figure."""
    found = versions()
    return ", ".join(f"{name} {found[name]}" for name in NAMED)


def read_baselines(path: Path) -> Baselines:
    """Read the baselines; an absent file has none.

    Raises
    ------
    InputError
        The file is damaged or lacks a key.
    """
    if not path.is_file():
        return Baselines({})
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        return Baselines(
            {name: _baseline(table) for name, table in content.get("figure", {}).items()},
            tuple(Stated(name, **table) for name, table in content.get("stated", {}).items()),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: {type(error).__name__} {error}; take the committed file, or delete it and run"
            " ./run bench all --update"
        ) from None


def write_baselines(
    baselines: Baselines, registry: Mapping[str, GuardedFigure], path: Path
) -> None:
    """Write the baselines whole or not at all, in the registry's order, others dropped."""
    content = {
        "figure": {
            name: _table(figure, baselines.figures[name])
            for name, figure in registry.items()
            if name in baselines.figures
        },
        "stated": {
            row.name: _fields(row, ("what", "target", "measured", "how", "date", "headline"))
            for row in baselines.stated
        },
    }
    replace_text(path, HEADER + tomli_w.dumps(content))


def replace_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    part = path.with_name(f".{path.name}.part")
    with part.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def _baseline(table: Mapping[str, Any]) -> Baseline:
    estimate = MeanOfRuns(float(table["value"]), float(table["standard_uncertainty"]), table["n"])
    return Baseline(estimate, table["date"], table["versions"], table["machine"])


def _table(figure: GuardedFigure, baseline: Baseline) -> dict[str, Any]:
    estimate = _fields(baseline.estimate, ("value", "standard_uncertainty", "n"))
    return {"what": figure.what} | estimate | _fields(baseline, ("date", "versions", "machine"))


def _fields(holder: object, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(holder, name) for name in names}
