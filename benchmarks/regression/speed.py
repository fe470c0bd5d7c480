"""Speed: the existing benchmarks as processes of their own, read by the last line they print.

Seconds differ by a factor of two with what else the machine does, and from machine to machine;
ratios of two things timed in turns inside one process much less. Only such ratios (and memory) are
judged. Processor seconds of the press are taken over those of a Fourier transform of the same size.
"""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.regression.figures import Values
from reconstruction.errors import InputError

FOLDER = Path(__file__).parents[1]
Result = dict[str, Any]


def child(script: str, *arguments: str) -> Result:
    """Run a benchmark, hand its lines on, and return the JSON object of the last one.

    Raises
    ------
    InputError
        It failed, or its last line is no JSON object.
    """
    command = [sys.executable, "-u", str(FOLDER / f"{script}.py"), *arguments]
    last = ""
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
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
        found = json.loads(line)
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise InputError(f"benchmark {script}: found last line '{line}', allowed a JSON object")
    return found


def reader(
    script: str, arguments: tuple[str, ...], names: dict[str, Callable[[Result], float]]
) -> Callable[[], Values]:
    """Return a measurement that runs a benchmark and takes figures from its result."""

    def measure() -> Values:
        result = child(script, *arguments)
        return {name: [float(take(result))] for name, take in names.items()}

    return measure


def field(key: str) -> Callable[[Result], float]:
    """Take one number of a result."""
    return lambda result: result[key]


def over(key: str, reference: str) -> Callable[[Result], float]:
    """Take a number of a result over another one."""
    return lambda result: result[key] / result[reference]
