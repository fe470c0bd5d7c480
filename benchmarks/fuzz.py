"""Fuzz the command line: damaged files, hostile arguments, damaged stores and results.

Each case is a seed (`benchmarks.fuzzing`). `--seed N` repeats a case and prints it; bad cases are
printed at once. After every `CASES_PER_PAIR` cases an experiment with two keys at the ends of their
ranges is measured (`benchmarks.fuzz_ends`). Last line: {"cases": n, "tracebacks": 0, "hangs": 0,
"crashes": 0, "absurd": 0, "partial_outputs": 0, "foreign_changes": 0, "unreported": 0, ...}.
"""

import argparse
import json
import math
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path

from benchmarks._forked import command, preload
from benchmarks.fuzz_ends import outcomes_of
from benchmarks.fuzz_stock import make_stock
from benchmarks.fuzzing import LIMIT_S, TARGETS, FuzzOutcome, run_case

CASES_PER_PAIR = 20
ENDS = {
    "tracebacks": "traceback",
    "hangs": "hang",
    "crashes": "crash",
    "absurd": "absurd",
    "partial_outputs": "partial_output",
    "foreign_changes": "foreign_change",
    "unreported": "unreported",
    "other_exit_codes": "exit_code",
}


def main() -> int:
    """Run cases until the time or their number is used up."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="200 cases")
    parser.add_argument("--minutes", type=float, default=math.inf, help="time limit")
    parser.add_argument("--cases", type=int, default=5000)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seed", type=int, help="this case only, printed")
    parser.add_argument("--sound", help="a target on its sound input: its name, or all")
    parser.add_argument("--limit", type=float, default=LIMIT_S, help="seconds until a case hangs")
    parser.add_argument("--stock", type=Path, help="folder of the sound inputs; made if absent")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        stock = (chosen.stock or Path(scratch) / "stock").absolute()
        if not stock.exists():
            stock.mkdir(parents=True)
            make_stock(stock, Path(sys.executable).with_name("twin"))
        preload()
        run = partial(one_case, stock=stock, limit_s=chosen.limit)
        if chosen.seed is not None:
            print(run(chosen.seed))
            return 0
        if chosen.sound:
            names = TARGETS if chosen.sound == "all" else (chosen.sound,)
            accepted = [is_accepted(run(0, sound=name)) for name in names]
            return int(not all(accepted))
        count, end = 200 if chosen.quick else chosen.cases, time.monotonic() + 60 * chosen.minutes
        seeds = range(chosen.first, chosen.first + count)
        outcomes = list(until(end, with_pairs(seeds, run, 3 * chosen.limit)))
    print(json.dumps(summary(outcomes)))
    return int(any(outcome.is_bad for outcome in outcomes))


def with_pairs(
    seeds: range, run: Callable[[int], FuzzOutcome], limit_s: float
) -> Iterator[FuzzOutcome]:
    """Yield the outcomes of all cases, and of a pair of keys after every `CASES_PER_PAIR`."""
    pairs = outcomes_of([seed // CASES_PER_PAIR for seed in seeds[::CASES_PER_PAIR]], limit_s)
    for seed in seeds:
        yield run(seed)
        if seed % CASES_PER_PAIR == CASES_PER_PAIR - 1:
            yield from printed(pairs)


def printed(outcomes: Iterator[FuzzOutcome]) -> Iterator[FuzzOutcome]:
    """Yield the next outcome, if there is one; print it if it is bad."""
    for outcome in islice(outcomes, 1):
        if outcome.is_bad:
            print(outcome, flush=True)
        yield outcome


def one_case(seed: int, stock: Path, limit_s: float, sound: str = "") -> FuzzOutcome:
    """Run a case in a folder of its own; print it if it is bad or sound."""
    with tempfile.TemporaryDirectory() as folder:
        outcome = run_case(seed, stock, Path(folder), command, limit_s, sound=sound)
    if outcome.is_bad or sound:
        print(outcome, flush=True)
    return outcome


def is_accepted(outcome: FuzzOutcome) -> bool:
    """Return True if a sound input was accepted, or rejected for its output folder only."""
    refusing = "{refusing}" in TARGETS[outcome.target].command
    return outcome.end == "done" or (refusing and "no earlier" in outcome.message)


def until(end: float, outcomes: Iterator[FuzzOutcome]) -> Iterator[FuzzOutcome]:
    """Yield outcomes until a time of the monotonic clock."""
    while time.monotonic() < end and (outcome := next(outcomes, None)):
        yield outcome


def summary(outcomes: list[FuzzOutcome]) -> dict[str, object]:
    """Count how the cases ended."""
    ends = Counter(outcome.end for outcome in outcomes)
    slowest_s = max((outcome.seconds for outcome in outcomes), default=0.0)
    return (
        {"cases": len(outcomes)}
        | {name: ends[end] for name, end in ENDS.items()}
        | {"reported": ends["reported"], "done": ends["done"], "slowest_s": round(slowest_s, 1)}
    )


if __name__ == "__main__":
    sys.exit(main())
