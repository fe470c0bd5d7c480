"""Run cases, print progress, and compare the results with the baselines."""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from benchmarks.regression.baselines import Baseline
from benchmarks.regression.figures import BenchmarkCase, GuardedFigure, MeanOfRuns
from benchmarks.regression.limits import judge, judge_target


@dataclass(frozen=True)
class CaseResults:
    """Results of cases.

    Attributes
    ----------
    estimates : by figure
    broken : by case, the error that ended it
    """

    estimates: dict[str, MeanOfRuns] = field(default_factory=dict)
    broken: dict[str, str] = field(default_factory=dict)


def run_cases(cases: tuple[BenchmarkCase, ...]) -> CaseResults:
    """Run the cases in turn; a case that fails does not stop the rest."""
    results = CaseResults()
    for number, case in enumerate(cases, start=1):
        print(f"[{number}/{len(cases)}] {case.name}: {case.conditions}", flush=True)
        start = time.perf_counter()
        try:
            estimates = estimates_of(case)
        # Any error is a result about the code under test.
        except Exception as error:
            results.broken[case.name] = f"{type(error).__name__}: {error}"
            print(f"  BROKEN: {results.broken[case.name]}", flush=True)
            continue
        results.estimates.update(estimates)
        for name, estimate in estimates.items():
            print(f"  {name} = {estimate.value:.6g} +- {estimate.standard_uncertainty:.2g}")
        print(f"  {time.perf_counter() - start:.0f} s", flush=True)
    return results


def estimates_of(case: BenchmarkCase) -> dict[str, MeanOfRuns]:
    """Measure a case.

    Raises
    ------
    ValueError
        The measured figures are not those of the registry.
    """
    values = case.measure()
    listed = [figure.name for figure in case.figures]
    if sorted(values) != sorted(listed):
        raise ValueError(f"found the figures {sorted(values)}, allowed {sorted(listed)}")
    return {name: MeanOfRuns.of(values[name]) for name in listed}


def again(case: BenchmarkCase, first: Mapping[str, MeanOfRuns]) -> dict[str, MeanOfRuns]:
    """Measure speeds again and return the better value of each figure.

    Other programs on the machine can only increase run times.
    """
    second = run_cases((case,)).estimates
    better = {}
    for figure in case.figures:
        pick = max if figure.higher_is_better else min
        both = [run[figure.name] for run in (first, second) if figure.name in run]
        better[figure.name] = pick(both, key=lambda estimate: estimate.value)
    return better


def failures(
    cases: Iterable[BenchmarkCase],
    estimates: Mapping[str, MeanOfRuns],
    baselines: Mapping[str, Baseline],
    accuracy_figures: int,
) -> dict[str, str]:
    """Return, by figure, its case and by how much it misses its target or baseline."""
    failed = {}
    for case in cases:
        for figure in case.figures:
            if figure.name not in estimates:
                continue
            estimate, known = estimates[figure.name], baselines.get(figure.name)
            if why := _misses(figure, estimate, known, accuracy_figures):
                failed[figure.name] = f"case {case.name}, found {estimate.value:.6g}, {why}"
    return failed


def _misses(
    figure: GuardedFigure, estimate: MeanOfRuns, known: Baseline | None, accuracy_figures: int
) -> str:
    """Return the limits that a figure misses; empty if none."""
    promised = judge_target(figure, estimate.value)
    missed = [] if promised.passed else [promised.text]
    if known is None:
        return "; ".join([*missed, "no baseline: ./run bench all --update"])
    stable = judge(figure, estimate, known.estimate, accuracy_figures)
    return "; ".join(missed if stable.passed else [*missed, f"against the baseline {stable.text}"])
