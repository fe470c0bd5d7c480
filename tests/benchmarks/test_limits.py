"""When a figure counts as having left its baseline."""

import math

import numpy as np
import pytest

from benchmarks.regression.figures import Estimate, Figure
from benchmarks.regression.limits import (
    FALSE_ALARMS_PER_RUN,
    coverage_factor,
    degrees_of_freedom,
    judge,
)

ACCURACY = Figure("z_um", "height")
SURE, UNSURE = Estimate(1.0, 0.001, 5), Estimate(1.0, 0.01, 5)


def moved(estimate, by):
    return Estimate(estimate.value + by, estimate.standard_uncertainty, estimate.n)


def test_the_same_number_passes():
    assert judge(ACCURACY, SURE, SURE, 30).passed
    exact = Estimate(1.0)
    assert judge(ACCURACY, exact, exact, 30).passed
    assert not judge(ACCURACY, Estimate(1.0 + 1e-12), exact, 30).passed


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
    absolute, relative = Figure("a", "", floor=0.01), Figure("b", "", floor_rel=0.01)
    two, off = Estimate(2.0), Estimate(2.06)
    assert not judge(ACCURACY, off, two, 30).passed
    assert not judge(absolute, off, two, 30).passed
    assert judge(relative, off, two, 30).passed


def test_effective_degrees_of_freedom():
    """Equal uncertainties: their sum; one alone: its own; a floor above all: infinitely many."""
    assert degrees_of_freedom(SURE, SURE, 0.0) == pytest.approx(8.0)
    assert degrees_of_freedom(SURE, Estimate(1.0), 0.0) == pytest.approx(4.0)
    assert degrees_of_freedom(SURE, SURE, 1.0) > 1e9
    assert math.isinf(degrees_of_freedom(Estimate(1.0), Estimate(1.0), 0.1))
    assert coverage_factor(Estimate(1.0), Estimate(1.0), 0.1, 1) == pytest.approx(2.5758, abs=1e-4)


def test_one_run_in_a_hundred_raises_a_false_alarm():
    """Setup: 20 figures of 5 seeds, same distribution on both sides, 600 runs.

    Expected: about 6 runs with an alarm (Welch is a little cautious), more than 15 in one of 2000
    repetitions of this test. A plain k = 3 raises one in 175 runs.
    """
    rng, runs, figures = np.random.default_rng(5), 600, 20
    drawn = rng.normal(size=(runs, figures, 2, 5))
    plain = alarms = 0
    for run in drawn:
        pairs = [(Estimate.of(found), Estimate.of(base)) for found, base in run.tolist()]
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
    found, base = (Estimate.of(rng.normal(mean, 1.0, 5).tolist()) for mean in (8.0, 0.0))
    assert not judge(ACCURACY, found, base, 30).passed


def test_speed_fails_when_worse_by_the_factor():
    slow = Figure("s", "", kind="speed", factor=1.5)
    fast = Figure("f", "", kind="speed", factor=1.5, higher_is_better=True)
    at = Estimate(2.0)
    assert judge(slow, Estimate(2.99), at, 30).passed
    assert judge(slow, Estimate(0.1), at, 30).passed
    assert not judge(slow, Estimate(3.01), at, 30).passed
    assert judge(fast, Estimate(1.34), at, 30).passed
    assert judge(fast, Estimate(40.0), at, 30).passed
    assert not judge(fast, Estimate(1.32), at, 30).passed


def test_absolute_seconds_are_told_only():
    assert judge(Figure("t_s", "", kind="told"), Estimate(100.0), Estimate(1.0), 30).passed


def test_mean_and_standard_uncertainty():
    found = Estimate.of([1.0, 2.0, 3.0])
    assert found == Estimate(2.0, pytest.approx(1.0 / math.sqrt(3.0)), 3)
    assert Estimate.of([4.0]) == Estimate(4.0, 0.0, 1)
    for bad in ([], [math.nan], [1.0, math.inf]):
        with pytest.raises(ValueError, match="finite"):
            Estimate.of(bad)
