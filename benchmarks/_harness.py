"""Common parts of the benchmarks: the command line, the last line as JSON, clocks and memory."""

import argparse
import json
import resource
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def quick_parser(doc: str, quick: str) -> argparse.ArgumentParser:
    """Return a parser with the option `--quick`."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help=quick)
    return parser


def print_figures(figures: Mapping[str, Any], digits: int = 4) -> None:
    """Print the last line of a benchmark: floats to so many significant digits."""
    rounded = {
        name: float(f"{value:.{digits}g}") if isinstance(value, float) else value
        for name, value in figures.items()
    }
    print(json.dumps(rounded), flush=True)


def seconds(call: Callable[[], object]) -> float:
    """Return the wall-clock time of a call."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def in_turns(actions: Mapping[str, Callable[[], object]], rounds: int) -> list[dict[str, float]]:
    """Return the wall-clock times of actions per round; in turns, all have the same machine."""
    return [{name: seconds(action) for name, action in actions.items()} for _ in range(rounds)]


def processor_s(who: int = resource.RUSAGE_CHILDREN) -> float:
    """Return the processor time so far, by default of all ended child processes."""
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def resident_bytes(field: str) -> int:
    """Return a memory figure of this process, `VmRSS` or its peak `VmHWM`; see proc(5).

    `ru_maxrss` is used on other systems only: on Linux it starts at the peak of the parent process.
    """
    status = Path("/proc/self/status")
    if not status.is_file():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    lines = status.read_text(encoding="ascii").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(field))
