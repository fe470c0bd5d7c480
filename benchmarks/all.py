"""Named accuracy cases and speed ratios against stated targets and committed baselines.

    ./run bench all             run every case, print the table
    ./run bench all --check     compare with targets and benchmarks/baselines.toml; writes no file
    ./run bench all --update    accept the results: write the baselines and both tables
    --quick                     leave out the slow cases
    --only CASE                 only this case, repeatable

Exit status 1 if a figure misses its target or its baseline's limit, has no baseline, or a case
raises an error; 2 for a wrong argument. Last line: {"figures": n, "failed": [...], "seconds": s}.
See docs/benchmarks.md.
"""

import argparse
import json
import os
import platform
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.regression import tables
from benchmarks.regression.baselines import Baselines, read_baselines, replace_text, write_baselines
from benchmarks.regression.figures import BenchmarkCase, MeanOfRuns
from benchmarks.regression.registry import ACCURACY_FIGURES, CASES, FIGURES
from benchmarks.regression.runs import CaseResults, again, failures, run_cases
from reconstruction.errors import InputError

README = Path(__file__).parents[1] / "README.md"
ALL_FIGURES = Path(__file__).parents[1] / "docs" / "benchmarks.md"
BASELINES = Path(__file__).with_name("baselines.toml")


def main(arguments: list[str] | None = None) -> int:
    """Run, then compare or accept; return the exit status."""
    chosen = parse(arguments)
    start = time.perf_counter()
    try:
        cases, baselines = chosen_cases(chosen.only, chosen.quick), read_baselines(BASELINES)
    except InputError as error:
        print(f"bench all: {error}", file=sys.stderr)
        return 2
    results = run_cases(cases)
    failed = dict(results.broken)
    if chosen.check:
        failed |= check(cases, results, baselines)
    if chosen.update:
        update(baselines, results.estimates)
    else:
        print(table_of(results, baselines))
    for name, reason in failed.items():
        print(f"FAILED {name}: {reason}")
    summary = {
        "figures": len(results.estimates),
        "failed": list(failed),
        "seconds": round(time.perf_counter() - start),
    }
    print(json.dumps(summary), flush=True)
    return 1 if failed else 0


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Parse the command line; argparse exits with status 2 if it is wrong."""
    parser = argparse.ArgumentParser(
        prog="bench all", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    act = parser.add_mutually_exclusive_group()
    act.add_argument("--check", action="store_true", help="compare with the baselines")
    act.add_argument("--update", action="store_true", help="write baselines and tables")
    parser.add_argument("--quick", action="store_true", help="leave out the slow cases")
    parser.add_argument("--only", action="append", default=[], metavar="CASE", help="repeatable")
    return parser.parse_args(arguments)


def chosen_cases(only: list[str], quick: bool) -> tuple[BenchmarkCase, ...]:
    """Return the requested cases; `--only` overrides `--quick`.

    Raises
    ------
    InputError
        A case of this name does not exist.
    """
    names = [case.name for case in CASES]
    for name in only:
        if name not in names:
            raise InputError(f"--only: found '{name}', allowed {', '.join(names)}")
    if only:
        return tuple(case for case in CASES if case.name in only)
    return tuple(case for case in CASES if case.quick or not quick)


def check(
    cases: tuple[BenchmarkCase, ...], results: CaseResults, baselines: Baselines
) -> dict[str, str]:
    """Return the failed figures; a speed that fails is measured a second time before."""
    known = baselines.figures
    failed = failures(cases, results.estimates, known, ACCURACY_FIGURES)
    for case in cases:
        slow = (figure.name for figure in case.figures if figure.kind != "accuracy")
        if any(name in failed and name in known for name in slow):
            print("slower than its limit: measured again")
            results.estimates.update(again(case, results.estimates))
    return failures(cases, results.estimates, known, ACCURACY_FIGURES)


def update(baselines: Baselines, estimates: dict[str, MeanOfRuns]) -> None:
    """Accept the results: write the baselines, then the two tables from them."""
    accepted = baselines.updated(estimates, datetime.now(UTC).date().isoformat(), machine())
    made = pages(accepted)
    write_baselines(accepted, FIGURES, BASELINES)
    for path, text in made.items():
        replace_text(path, text)
    print(f"{len(estimates)} baselines and the tables of README and docs/benchmarks.md written")


def pages(baselines: Baselines) -> dict[Path, str]:
    """Return README and docs/benchmarks.md with the tables of these baselines."""
    return {
        path: tables.with_table(
            path.read_text(encoding="utf-8"), tables.table(CASES, baselines, headlines)
        )
        for path, headlines in ((README, True), (ALL_FIGURES, False))
    }


def table_of(results: CaseResults, baselines: Baselines) -> str:
    """Return a line per figure: result, baseline, target."""
    lines = []
    for name, estimate in results.estimates.items():
        known, target = baselines.figures.get(name), FIGURES[name].target
        baseline = tables.shown(known.estimate) if known else "none"
        line = f"{name:42s} {tables.shown(estimate):>24s}   baseline {baseline}"
        lines.append(line if target is None else f"{line}, target {target}")
    return "\n".join(lines)


def machine() -> str:
    """Return processor and cores, as far as the system reports them."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.is_file() else []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    named = next(models, platform.machine())
    return f"{os.cpu_count()} cores of {named}, Python {platform.python_version()}"


if __name__ == "__main__":
    raise SystemExit(main())
