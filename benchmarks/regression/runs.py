"""Run cases, tell progress, and compare with the baselines."""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from benchmarks.regression.baselines import Baseline
from benchmarks.regression.cases import BenchmarkCase
from benchmarks.regression.figures import GuardedFigure, MeanOfRuns
from benchmarks.regression.limits import judge, judge_target


@dataclass(frozen=True)
class Found:
    """What the runs gave.

    Attributes
    ----------
    estimates : by figure
    broken : by case, why it gave nothing
    """

    estimates: dict[str, MeanOfRuns] = field(default_factory=dict)
    broken: dict[str, str] = field(default_factory=dict)


def run_cases(cases: tuple[BenchmarkCase, ...]) -> Found:
    """Run one case after the other; one that fails does not stop the rest."""
    found = Found()
    for number, case in enumerate(cases, start=1):
        print(f"[{number}/{len(cases)}] {case.name}: {case.how}", flush=True)
        start = time.perf_counter()
        try:
            estimates = estimates_of(case)
        # Whatever a case dies of is a finding about the code under test.
        except Exception as error:
            found.broken[case.name] = f"{type(error).__name__}: {error}"
            print(f"  BROKEN: {found.broken[case.name]}", flush=True)
            continue
        found.estimates.update(estimates)
        for name, estimate in estimates.items():
            print(f"  {name} = {estimate.value:.6g} +- {estimate.standard_uncertainty:.2g}")
        print(f"  {time.perf_counter() - start:.0f} s", flush=True)
    return found


def estimates_of(case: BenchmarkCase) -> dict[str, MeanOfRuns]:
    """Measure a case.

    Raises
    ------
    ValueError
        It gave other figures than it lists.
    """
    values = case.measure()
    listed = [figure.name for figure in case.figures]
    if sorted(values) != sorted(listed):
        raise ValueError(f"found the figures {sorted(values)}, allowed {sorted(listed)}")
    return {name: MeanOfRuns.of(values[name]) for name in listed}


def again(case: BenchmarkCase, first: Mapping[str, MeanOfRuns]) -> dict[str, MeanOfRuns]:
    """Measure a speed once more and return the better of each figure.

    Other programs on the machine only ever make it slower.
    """
    second = run_cases((case,)).estimates
    better = {}
    for figure in case.figures:
        pick = max if figure.higher_is_better else min
        both = [one[figure.name] for one in (first, second) if figure.name in one]
        better[figure.name] = pick(both, key=lambda estimate: estimate.value)
    return better


def failures(
    cases: Iterable[BenchmarkCase],
    estimates: Mapping[str, MeanOfRuns],
    baselines: Mapping[str, Baseline],
    accuracy_figures: int,
) -> dict[str, str]:
    """Return, by figure, in which case it misses its target or baseline and by how much."""
    failed = {}
    for case in cases:
        for figure in case.figures:
            if figure.name not in estimates:
                continue
            found, known = estimates[figure.name], baselines.get(figure.name)
            if why := _misses(figure, found, known, accuracy_figures):
                failed[figure.name] = f"case {case.name}, found {found.value:.6g}, {why}"
    return failed


def _misses(
    figure: GuardedFigure, found: MeanOfRuns, known: Baseline | None, accuracy_figures: int
) -> str:
    """Return what a figure misses; empty: nothing."""
    promised = judge_target(figure, found.value)
    missed = [] if promised.passed else [promised.text]
    if known is None:
        return "; ".join([*missed, "no baseline: ./run bench all --update"])
    kept = judge(figure, found, known.estimate, accuracy_figures)
    return "; ".join(missed if kept.passed else [*missed, f"against the baseline {kept.text}"])
