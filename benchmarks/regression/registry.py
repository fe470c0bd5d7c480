"""All cases and figures of `figures.toml`.

A case with a `command` runs that benchmark in a process of its own and reads the JSON object of its
last line; the other cases call the function of the same name in `accuracy`.
"""

import json
import subprocess
import sys
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.regression import accuracy
from benchmarks.regression.figures import BenchmarkCase, GuardedFigure, Target, Values
from reconstruction.errors import InputError

FOLDER = Path(__file__).parents[1]
FILE = Path(__file__).with_name("figures.toml")
Result = dict[str, Any]


def read_cases(path: Path) -> tuple[BenchmarkCase, ...]:
    """Return the cases of a file, in its order."""
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    return tuple(_case(name, table) for name, table in tables.items())


def _case(name: str, table: Result) -> BenchmarkCase:
    figures = tuple(_figure(key, fields) for key, fields in table["figure"].items())
    command = table.get("command", [])
    measure: Callable[[], Values] = partial(measure_by_command, command, figures)
    if not command:
        measure = getattr(accuracy, name)
    conditions = table.get("conditions", f"`./run bench {' '.join(command)}`")
    return BenchmarkCase(name, conditions, figures, measure, table.get("quick", True))


def _figure(name: str, fields: Result) -> GuardedFigure:
    ends = {key: fields.pop(key) for key in ("low", "high") if key in fields}
    return GuardedFigure(name, target=Target(**ends) if ends else None, **fields)


def measure_by_command(command: list[str], figures: tuple[GuardedFigure, ...]) -> Values:
    """Run a benchmark and read the figures from its result."""
    result = child(*command)
    return {figure.name: [value_of(result, figure.field)] for figure in figures}


def value_of(result: Result, field: str) -> float:
    """Return a number of a result, or the ratio of two."""
    numerator, _, denominator = field.partition(" / ")
    return float(result[numerator]) / (float(result[denominator]) if denominator else 1.0)


def child(script: str, *arguments: str) -> Result:
    """Run a benchmark, print its lines, and return the JSON object of the last line.

    Raises
    ------
    InputError
        The benchmark failed, or its last line is no JSON object.
    """
    command = [sys.executable, "-u", str(FOLDER / f"{script}.py"), *arguments]
    streams: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    last = ""
    with subprocess.Popen(command, **streams) as process:
        for line in process.stdout or ():
            print(f"  {line}", end="", flush=True)
            last = line.strip() or last
    if process.returncode:
        raise InputError(f"benchmark {script}: status {process.returncode}, {last}")
    return last_object(script, last)


def last_object(script: str, line: str) -> Result:
    """Return the JSON object in a benchmark's last line.

    Raises
    ------
    InputError
        There is none.
    """
    try:
        figures = json.loads(line)
    except ValueError:
        figures = None
    if not isinstance(figures, dict):
        raise InputError(f"benchmark {script}: found last line '{line}', allowed a JSON object")
    return figures


CASES = read_cases(FILE)
FIGURES = {figure.name: figure for case in CASES for figure in case.figures}
ACCURACY_FIGURES = sum(figure.kind == "accuracy" for figure in FIGURES.values())
