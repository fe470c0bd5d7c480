"""When a figure differs from its baseline."""

import math

import numpy as np
import pytest

from benchmarks.all import BASELINES
from benchmarks.regression.baselines import read_baselines
from benchmarks.regression.figures import GuardedFigure, MeanOfRuns, Target
from benchmarks.regression.limits import (
    FALSE_ALARMS_PER_RUN,
    coverage_factor,
    degrees_of_freedom,
    judge,
    judge_target,
)
from benchmarks.regression.registry import FIGURES

ACCURACY = GuardedFigure("z_um", "height")
SURE, UNSURE = MeanOfRuns(1.0, 0.001, 5), MeanOfRuns(1.0, 0.01, 5)


def moved(estimate, by):
    return MeanOfRuns(estimate.value + by, estimate.standard_uncertainty, estimate.n)


def test_the_same_number_passes():
    assert judge(ACCURACY, SURE, SURE, 30).passed
    exact = MeanOfRuns(1.0)
    assert judge(ACCURACY, exact, exact, 30).passed
    assert not judge(ACCURACY, MeanOfRuns(1.0 + 1e-12), exact, 30).passed


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_outside_the_combined_uncertainty_fails_either_way(direction):
    limit = judge(ACCURACY, SURE, SURE, 30).limit
    assert judge(ACCURACY, moved(SURE, 0.99 * direction * limit), SURE, 30).passed
    assert not judge(ACCURACY, moved(SURE, 1.01 * direction * limit), SURE, 30).passed


def test_both_uncertainties_count():
    """Setup: off by 0.02. Expected: outside for two sure values, inside when either is unsure."""
    assert not judge(ACCURACY, moved(SURE, 0.02), SURE, 30).passed
    assert judge(ACCURACY, moved(UNSURE, 0.02), SURE, 30).passed
    assert judge(ACCURACY, moved(SURE, 0.02), UNSURE, 30).passed


def test_the_floor_is_for_what_seeds_do_not_vary():
    absolute, relative = GuardedFigure("a", "", floor=0.01), GuardedFigure("b", "", floor_rel=0.01)
    two, off = MeanOfRuns(2.0), MeanOfRuns(2.06)
    assert not judge(ACCURACY, off, two, 30).passed
    assert not judge(absolute, off, two, 30).passed
    assert judge(relative, off, two, 30).passed


def test_effective_degrees_of_freedom():
    """Equal uncertainties: their sum; a single one: its own; a dominant floor: infinitely many."""
    assert degrees_of_freedom(SURE, SURE, 0.0) == pytest.approx(8.0)
    assert degrees_of_freedom(SURE, MeanOfRuns(1.0), 0.0) == pytest.approx(4.0)
    assert degrees_of_freedom(SURE, SURE, 1.0) > 1e9
    assert math.isinf(degrees_of_freedom(MeanOfRuns(1.0), MeanOfRuns(1.0), 0.1))
    assert coverage_factor(MeanOfRuns(1.0), MeanOfRuns(1.0), 0.1, 1) == pytest.approx(
        2.5758, abs=1e-4
    )


def test_one_run_in_a_hundred_raises_a_false_alarm():
    """Setup: 20 figures of 5 seeds, same distribution on both sides, 600 runs.

    Expected: about 6 runs with an alarm (Welch is a little cautious), more than 15 in one of 2000
    repetitions of this test. A plain k = 3 raises one in 175 runs.
    """
    rng, runs, figures = np.random.default_rng(5), 600, 20
    drawn = rng.normal(size=(runs, figures, 2, 5))
    plain = alarms = 0
    for run in drawn:
        pairs = [(MeanOfRuns.of(measured), MeanOfRuns.of(base)) for measured, base in run.tolist()]
        alarms += not all(judge(ACCURACY, *pair, figures).passed for pair in pairs)
        plain += any(
            abs(a.value - b.value) > 3 * math.hypot(a.standard_uncertainty, b.standard_uncertainty)
            for a, b in pairs
        )
    assert FALSE_ALARMS_PER_RUN == 0.01
    assert alarms <= 15
    assert plain > 100


def test_a_true_change_of_eight_spreads_is_found():
    rng = np.random.default_rng(6)
    measured, base = (MeanOfRuns.of(rng.normal(mean, 1.0, 5).tolist()) for mean in (8.0, 0.0))
    assert not judge(ACCURACY, measured, base, 30).passed


def test_speed_fails_when_worse_by_the_factor():
    slow = GuardedFigure("s", "", kind="speed", factor=1.5)
    fast = GuardedFigure("f", "", kind="speed", factor=1.5, higher_is_better=True)
    at = MeanOfRuns(2.0)
    assert judge(slow, MeanOfRuns(2.99), at, 30).passed
    assert judge(slow, MeanOfRuns(0.1), at, 30).passed
    assert not judge(slow, MeanOfRuns(3.01), at, 30).passed
    assert judge(fast, MeanOfRuns(1.34), at, 30).passed
    assert judge(fast, MeanOfRuns(40.0), at, 30).passed
    assert not judge(fast, MeanOfRuns(1.32), at, 30).passed


@pytest.mark.parametrize(
    ("target", "text", "met", "missed"),
    [
        (Target(high=2.0), "at most 2", [2.0, -1.0], [2.001]),
        (Target(low=5.0), "at least 5", [5.0, 60.0], [4.999]),
        (Target(0.85, 1.15), "0.85 to 1.15", [0.85, 1.15], [0.849, 1.151]),
        (Target(0, 0), "0", [0.0], [1.0, -1.0]),
    ],
)
def test_a_target_is_met_up_to_its_ends(target, text, met, missed):
    assert str(target) == text
    for kind in ("accuracy", "speed"):
        figure = GuardedFigure("f", "", kind=kind, target=target)
        assert all(judge_target(figure, value).passed for value in met)
        assert not any(judge_target(figure, value).passed for value in missed)
        assert judge_target(figure, missed[0]).text == f"target {text}"
    assert judge_target(GuardedFigure("f", ""), 1e9).passed


def test_absolute_figures_fail_beyond_twice_their_target_only():
    seconds = GuardedFigure("t_s", "", kind="absolute", target=Target(high=1.0))
    pace = GuardedFigure("per_hour", "", kind="absolute", target=Target(low=5000.0))
    assert judge(seconds, MeanOfRuns(100.0), MeanOfRuns(1.0), 30).passed
    assert judge_target(seconds, 2.0).passed
    assert not judge_target(seconds, 2.01).passed
    assert judge_target(pace, 2500.0).passed
    assert not judge_target(pace, 2499.0).passed


def test_mean_and_standard_uncertainty():
    measured = MeanOfRuns.of([1.0, 2.0, 3.0])
    assert measured == MeanOfRuns(2.0, pytest.approx(1.0 / math.sqrt(3.0)), 3)
    assert MeanOfRuns.of([4.0]) == MeanOfRuns(4.0, 0.0, 1)
    for bad in ([], [math.nan], [1.0, math.inf]):
        with pytest.raises(ValueError, match="finite"):
            MeanOfRuns.of(bad)


def test_no_figure_is_blind():
    """A limit larger than the figure detects no change, unless the target ends there as well."""
    known = read_baselines(BASELINES).figures
    guarded = [
        figure for figure in FIGURES.values() if figure.kind == "accuracy" and figure.name in known
    ]
    assert len(guarded) > 30
    blind = []
    for figure in guarded:
        baseline = known[figure.name].estimate
        limit = judge(figure, baseline, baseline, len(guarded)).limit
        most = figure.target.high - baseline.value if figure.target else math.inf
        if limit > abs(baseline.value) and most > 1.1 * limit:
            blind.append((figure.name, limit / abs(baseline.value)))
    assert blind == []
