"""When a figure differs from its baseline, or misses its target.

Accuracy: |value - baseline| > k u_c with u_c^2 = u^2 + u0^2 + b^2, where u and u0 are the type-A
standard uncertainties of run and baseline, s / sqrt(n) over seeds, and b is the type-B uncertainty
from rounding on another processor or by another compiler, which seeds do not vary. k is Student's
quantile with the effective degrees of freedom of Welch and Satterthwaite (GUM:2008 G.4.1), b with
infinitely many. With k = 3 and 5 seeds on either side, 1.7 % of the comparisons would raise a false
alarm, so every second run of 40 figures. Here the rate is 1 % for a whole run (Sidak:
1 - (1 - 0.01)^(1/m) for each of m figures; dependent figures only lower it). A better value outside
the limit fails too: accept it with `--update`.

Speed: a ratio within one run fails if it is worse than the baseline by a stated factor.

Target: a figure outside its target fails for any baseline. Seconds vary by a factor of two with the
load of the machine: they fail beyond twice their target.
"""

import math
from dataclasses import dataclass

from scipy.special import stdtrit

from benchmarks.regression.figures import GuardedFigure, MeanOfRuns

FALSE_ALARMS_PER_RUN = 0.01
BUSY_MACHINE = 2.0


@dataclass(frozen=True)
class Judgement:
    """Result of a comparison; `limit` is the largest allowed deviation, or the worst value."""

    passed: bool
    limit: float
    text: str


def judge(
    figure: GuardedFigure, result: MeanOfRuns, baseline: MeanOfRuns, accuracy_figures: int
) -> Judgement:
    """Compare a figure with its baseline; `accuracy_figures` share the false-alarm rate."""
    if figure.kind == "absolute":
        return Judgement(True, math.inf, "judged by its target only")
    if figure.kind == "speed":
        return _judge_speed(figure, result.value, baseline.value)
    floor = figure.floor_of(baseline.value)
    combined = combined_uncertainty(result, baseline, floor)
    limit = coverage_factor(result, baseline, floor, accuracy_figures) * combined
    off = abs(result.value - baseline.value)
    # Without any uncertainty only the identical number passes.
    return Judgement(off <= limit, limit, f"off by {off:.2g}, allowed {limit:.2g}")


def judge_target(figure: GuardedFigure, value: float) -> Judgement:
    """Compare a figure with its target; without one it passes."""
    if figure.target is None:
        return Judgement(True, math.inf, "no target")
    low, high, slack, text = figure.target.low, figure.target.high, 1.0, f"target {figure.target}"
    if figure.kind == "absolute":
        slack, text = BUSY_MACHINE, f"{text}, by {BUSY_MACHINE:g} off on a busy machine"
    passed = low / slack <= value <= high * slack
    return Judgement(passed, low / slack if math.isinf(high) else high * slack, text)


def combined_uncertainty(result: MeanOfRuns, baseline: MeanOfRuns, floor: float) -> float:
    """Return the standard uncertainty of the difference."""
    return math.hypot(result.standard_uncertainty, baseline.standard_uncertainty, floor)


def coverage_factor(result: MeanOfRuns, baseline: MeanOfRuns, floor: float, figures: int) -> float:
    """Return Student's two-sided quantile for one of several figures."""
    share = -math.expm1(math.log1p(-FALSE_ALARMS_PER_RUN) / figures)
    dof = degrees_of_freedom(result, baseline, floor)
    # Student's quantile; the inverse of its lower tail keeps the digits of a small share.
    return -float(stdtrit(dof, share / 2.0))


def degrees_of_freedom(result: MeanOfRuns, baseline: MeanOfRuns, floor: float) -> float:
    """Return the effective degrees of freedom by Welch and Satterthwaite."""
    parts = [run.standard_uncertainty**4 / (run.n - 1) for run in (result, baseline) if run.n > 1]
    combined = combined_uncertainty(result, baseline, floor)
    return combined**4 / sum(parts) if sum(parts) else math.inf


def _judge_speed(figure: GuardedFigure, value: float, baseline: float) -> Judgement:
    if figure.higher_is_better:
        limit = baseline / figure.factor
        return Judgement(value >= limit, limit, f"at least {limit:.3g}")
    limit = baseline * figure.factor
    return Judgement(value <= limit, limit, f"at most {limit:.3g}")
