"""Counts from normal numbers have the Poisson probabilities, computed and counted."""

import numpy as np
import pytest
from scipy import stats

from twin.camera import FROM_NORMAL, photon_counts, poisson_of_normal


@pytest.mark.parametrize(("mean", "limit"), [(FROM_NORMAL, 2e-5), (1000.0, 1e-6), (40000.0, 1e-7)])
def test_all_probabilities_are_the_poisson_ones(mean, limit):
    """Setup: the normal number at which each count begins, by bisection in float64.

    Expected: total variation from the Poisson law below the limit; the counts never fall.
    """
    low, high = (int(stats.poisson.ppf(share, mean)) for share in (1e-12, 1.0 - 1e-12))
    count = np.arange(low, high)
    left, right = np.full(count.shape, -9.0), np.full(count.shape, 9.0)
    for _ in range(60):
        middle = (left + right) / 2
        above = poisson_of_normal(np.full(count.shape, mean), middle) > count
        left, right = np.where(above, left, middle), np.where(above, middle, right)
    found = np.diff(stats.norm.cdf(left))
    assert (np.diff(left) > 0).all()
    assert 0.5 * np.abs(found - stats.poisson.pmf(count[1:], mean)).sum() < limit


def test_single_precision_moves_few_counts():
    """float32 rounds a mean of 40000 to 0.004: about as many counts fall on another number."""
    normal = np.random.default_rng(3).standard_normal(100_000)
    exact = poisson_of_normal(np.full(normal.shape, 40000.0), normal)
    single = poisson_of_normal(
        np.full(normal.shape, 40000.0, np.float32), normal.astype(np.float32)
    )
    assert np.abs(single - exact).max() <= 1
    assert (single != exact).mean() < 0.01


@pytest.mark.parametrize("mean", [0.0, 0.3, 20.0, 99.0, 101.0, 5000.0])
def test_drawn_counts_follow_the_poisson_law(mean):
    """Chi-square over twenty classes of equal probability, at a fixed seed."""
    drawn = photon_counts(np.full(200_000, mean, np.float32), np.random.default_rng(5))
    assert (drawn == np.rint(drawn)).all()
    if mean == 0.0:
        assert not drawn.any()
        return
    ends = np.unique(stats.poisson.ppf(np.linspace(0.05, 0.95, 19), mean))
    expected = np.diff(np.r_[0.0, stats.poisson.cdf(ends, mean), 1.0]) * drawn.size
    found = np.diff(np.r_[0, np.searchsorted(np.sort(drawn), ends, side="right"), drawn.size])
    assert stats.chisquare(found, expected).pvalue > 1e-3


def test_both_regimes_live_in_one_frame():
    mean = np.array([[0.0, 5.0], [99.9, 1e5]], np.float32)
    rng = np.random.default_rng(1)
    drawn = np.stack([photon_counts(mean, rng) for _ in range(4000)])
    assert drawn.mean(axis=0) == pytest.approx(mean, rel=0.02)
    assert drawn.var(axis=0) == pytest.approx(mean, rel=0.1)
