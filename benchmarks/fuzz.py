"""Fuzz the command line: damaged files, hostile arguments, damaged stores and results.

Each case is a seed (`benchmarks.fuzzing`). `--seed N` repeats one and shows what was done; bad
cases are printed as they are found. Last line: {"cases": n, "tracebacks": 0, "hangs": 0,
"crashes": 0, "partial_outputs": 0, "foreign_changes": 0, "not_told": 0, ...}.
"""

import argparse
import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from benchmarks.fuzz_stock import make_stock
from benchmarks.fuzzing import LIMIT_S, TARGETS, FuzzOutcome, run_case

ENDS = {
    "tracebacks": "traceback",
    "hangs": "hang",
    "crashes": "crash",
    "partial_outputs": "partial_output",
    "foreign_changes": "foreign_change",
    "not_told": "not_told",
    "other_exit_codes": "exit_code",
}


def command(arguments: list[str]) -> int:
    """Run a command line of the twin as its program does."""
    from twin.cli import run
    from twin.working import unwind_on_signals

    unwind_on_signals()
    return run(arguments)


def preload() -> None:
    """Import what the commands need, so that a forked case begins at once; starts no thread."""
    import h5netcdf  # noqa: F401
    import trimesh  # noqa: F401

    import twin.cli
    import twin.pipeline.captures
    import twin.pipeline.press
    import twin.report
    import twin.study.sweep  # noqa: F401


def main() -> int:
    """Run cases until the time or their number is used up."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="200 cases")
    parser.add_argument("--minutes", type=float, help="end after so long")
    parser.add_argument("--cases", type=int, default=5000)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seed", type=int, help="only this case, shown")
    parser.add_argument("--sound", help="only this target on its sound input: all, or its name")
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds until a case hangs")
    parser.add_argument("--stock", type=Path, help="sound inputs of an earlier run, or where to")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        stock = (chosen.stock or Path(scratch) / "stock").absolute()
        if not stock.exists():
            stock.mkdir(parents=True)
            make_stock(stock, Path(sys.executable).with_name("twin"))
        preload()
        if chosen.seed is not None:
            print(one(chosen.seed, stock, Path(scratch), chosen.limit))
            return 0
        if chosen.sound:
            return int(any(list(sound_cases(chosen.sound, stock, Path(scratch), chosen.limit))))
        count = 200 if chosen.quick else chosen.cases
        seeds = range(chosen.first, chosen.first + count)
        found = list(cases(seeds, stock, chosen.minutes, chosen.limit))
    print(json.dumps(summary(found)))
    return int(any(case.is_bad for case in found))


def one(seed: int, stock: Path, scratch: Path, limit_s: float) -> FuzzOutcome:
    """Run one case in a folder of its own."""
    folder = scratch / str(seed)
    folder.mkdir()
    found = run_case(seed, stock, folder, command, limit_s)
    shutil.rmtree(folder)
    return found


def sound_cases(named: str, stock: Path, scratch: Path, limit_s: float) -> Iterator[bool]:
    """Run targets on sound input; print each, and yield whether it was not taken."""
    for name in TARGETS if named == "all" else (named,):
        folder = scratch / name
        folder.mkdir()
        found = run_case(0, stock, folder, command, limit_s, sound=name)
        print(found, flush=True)
        refuses = "{refusing}" in TARGETS[name].arguments and "no earlier" in found.said
        yield found.end != "done" and not refuses


def cases(
    seeds: range, stock: Path, minutes: float | None, limit_s: float
) -> Iterator[FuzzOutcome]:
    """Run cases one after the other; tell the bad ones."""
    end = time.monotonic() + 60.0 * (minutes if minutes is not None else 1e6)
    with tempfile.TemporaryDirectory() as scratch:
        for seed in seeds:
            if time.monotonic() > end:
                return
            case = one(seed, stock, Path(scratch), limit_s)
            if case.is_bad:
                print(case, flush=True)
            yield case


def summary(found: list[FuzzOutcome]) -> dict[str, object]:
    """Count how the cases ended."""
    ends = Counter(case.end for case in found)
    return (
        {"cases": len(found)}
        | {name: ends[end] for name, end in ENDS.items()}
        | {"told": ends["told"], "done": ends["done"]}
        | {"slowest_s": round(max((case.seconds for case in found), default=0.0), 1)}
    )


if __name__ == "__main__":
    sys.exit(main())
