"""The committed baselines: value, standard uncertainty, number of runs, date, versions, machine.

Stated rows are figures that need too much time, or a machine of their own, to be measured with the
other figures. They are written by hand, with date and command.
"""

import json
import os
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path
from typing import Any

from benchmarks.regression.figures import MeanOfRuns
from reconstruction.errors import InputError
from twin.output import versions

NAMED = ("fringe-twin", "mitsuba", "drjit", "numpy")
HEADER = """\
# Baselines of the regression benchmarks, written by `./run bench all --update`; docs/benchmarks.md.
# [[accepted]]: figures that were measured together, each [value, standard uncertainty, runs].
# [stated]: further rows, written by hand. Rows with headline = true are also in the README.
"""


@dataclass(frozen=True)
class Baseline:
    """Value of a figure when it was last accepted."""

    estimate: MeanOfRuns
    date: str
    versions: str
    machine: str


@dataclass(frozen=True)
class StatedRow:
    """A row that no case measures; a headline is also in the README's table."""

    name: str
    label: str
    target: str
    measured: str
    command: str
    date: str
    headline: bool = False


@dataclass(frozen=True)
class Baselines:
    """All baselines by name, and the stated rows."""

    figures: Mapping[str, Baseline]
    stated: tuple[StatedRow, ...] = ()

    def updated(self, estimates: Mapping[str, MeanOfRuns], date: str, machine: str) -> "Baselines":
        """Return these with new values of the measured figures."""
        named = named_versions()
        new = {name: Baseline(value, date, named, machine) for name, value in estimates.items()}
        return replace(self, figures={**self.figures, **new})


def named_versions() -> str:
    """Return the versions that can change a figure."""
    installed = versions()
    return ", ".join(f"{name} {installed[name]}" for name in NAMED)


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
        figures = dict(pair for group in content.get("accepted", ()) for pair in _pairs(group))
        stated = (StatedRow(name, **row) for name, row in content.get("stated", {}).items())
        return Baselines(figures, tuple(stated))
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: {type(error).__name__} {error}; take the committed file, or delete it and run"
            " ./run bench all --update"
        ) from None


def _pairs(group: Mapping[str, Any]) -> Iterable[tuple[str, Baseline]]:
    origin = [group[key] for key in ("date", "versions", "machine")]
    for name, (value, standard_uncertainty, n) in group["figures"].items():
        estimate = MeanOfRuns(float(value), float(standard_uncertainty), n)
        yield name, Baseline(estimate, *origin)


def write_baselines(baselines: Baselines, names: Iterable[str], path: Path) -> None:
    """Write the baselines of the named figures, all or nothing, in the order of the names."""
    groups: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for name in names:
        if known := baselines.figures.get(name):
            line = f"figures.{name} = {list(astuple(known.estimate))}"
            groups[known.date, known.versions, known.machine].append(line)
    lines = [HEADER]
    for origin, figures in groups.items():
        named = zip(("date", "versions", "machine"), map(json.dumps, origin), strict=True)
        lines += ["[[accepted]]", *(f"{key} = {text}" for key, text in named), *figures, ""]
    lines += ["[stated]", *map(_line, baselines.stated), ""]
    replace_text(path, "\n".join(lines))


def _line(row: StatedRow) -> str:
    named = (field.name for field in fields(row)[1:])
    parts = ", ".join(f"{name} = {json.dumps(getattr(row, name))}" for name in named)
    return f"{row.name} = {{ {parts} }}"


def replace_text(path: Path, text: str) -> None:
    """Write a text file, all or nothing."""
    part = path.with_name(f".{path.name}.part")
    with part.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
