"""Means, intervals and digits against JCGM 101 and closed forms."""

import numpy as np
import pytest

from twin.propagation.distribution import distribution_of, tolerance_of

N = 400_000


def test_four_rectangular_inputs():
    """JCGM 101, 9.2.3: the sum of four rectangular inputs of u = 1: u = 2, interval +-3.88."""
    rng = np.random.default_rng(1)
    result = distribution_of(rng.uniform(-(3**0.5), 3**0.5, (N, 4)).sum(axis=1))
    assert result.mean == pytest.approx(0.0, abs=4 * 2 / N**0.5)
    assert result.standard_uncertainty == pytest.approx(2.0, abs=0.01)
    for interval in (result.symmetric, result.shortest):
        assert (interval.low, interval.high) == pytest.approx((-3.88, 3.88), abs=0.06)
    assert result.shortest.width <= result.symmetric.width


def test_one_dominant_rectangular_input():
    """JCGM 101, 9.2.4: one of the four has u = 10: u = 10.1, interval +-17.0."""
    rng = np.random.default_rng(2)
    values = rng.uniform(-(3**0.5), 3**0.5, (N, 4)) * [1.0, 1.0, 1.0, 10.0]
    result = distribution_of(values.sum(axis=1))
    assert result.standard_uncertainty == pytest.approx(10.1, abs=0.05)
    ends = (result.symmetric.low, result.symmetric.high)
    assert ends == pytest.approx((-17.0, 17.0), abs=0.1)


def test_mass_calibration():
    """JCGM 101, 9.3: u = 0.0754 mg, interval 1.0834 to 1.3825 mg; propagated linearly 0.0539."""
    rng = np.random.default_rng(3)
    reference, added = rng.normal(100_000.0, 0.05, N), rng.normal(1.234, 0.02, N)
    air, weight = rng.uniform(1.1, 1.3, N), rng.uniform(7000.0, 9000.0, N)
    steel = rng.uniform(7950.0, 8050.0, N)
    buoyancy = (air - 1.2) * (1.0 / weight - 1.0 / steel)
    result = distribution_of((reference + added) * (1.0 + buoyancy) - 100_000.0)
    assert result.mean == pytest.approx(1.234, abs=0.0005)
    assert result.standard_uncertainty == pytest.approx(0.0754, abs=0.0004)
    ends = (result.symmetric.low, result.symmetric.high)
    assert ends == pytest.approx((1.0834, 1.3825), abs=0.002)


def test_ranks_of_the_symmetric_interval():
    """JCGM 101, 7.7.2: of 1, 2, ..., 1000 the interval of 95 % is 25 to 975; of 100, 3 to 98."""
    result = distribution_of(np.random.default_rng(0).permutation(np.arange(1.0, 1001.0)))
    assert (result.symmetric.low, result.symmetric.high) == (25.0, 975.0)
    result = distribution_of(np.arange(1.0, 101.0))
    assert (result.symmetric.low, result.symmetric.high) == (3.0, 98.0)


def test_the_shortest_interval_of_a_skew_distribution():
    """Exponential: the shortest interval is 0 to -ln 0.05, the symmetric one has other ends."""
    result = distribution_of(np.random.default_rng(4).exponential(size=N))
    assert result.shortest.low == pytest.approx(0.0, abs=0.01)
    assert result.shortest.high == pytest.approx(-np.log(0.05), abs=0.05)
    assert result.symmetric.low == pytest.approx(-np.log(0.975), abs=0.002)


@pytest.mark.parametrize("n", [40, 100])
def test_coverage_of_known_truth(n):
    """The next trial is in the interval of n trials with probability q / (n + 1), q = 0.95 n.

    Over 4000 repetitions within 4 standard errors (Beta distribution of order statistics).
    """
    rng = np.random.default_rng(n)
    inside = 0
    for row in rng.normal(size=(4000, n)):
        interval = distribution_of_interval(row)
        inside += interval.low <= rng.normal() <= interval.high
    expected = 0.95 * n / (n + 1)
    assert abs(inside / 4000 - expected) < 4 * np.sqrt(expected * (1 - expected) / 4000)


def distribution_of_interval(values):
    from twin.propagation.distribution import symmetric_interval

    return symmetric_interval(values)


def test_too_few_trials_have_no_interval():
    values = np.random.default_rng(0).normal(size=39)
    assert distribution_of(values).symmetric is distribution_of(values).shortest is None
    assert distribution_of(np.append(values, 0.0)).symmetric is not None


def test_tolerances_of_the_guide():
    """JCGM 101, 7.9.2: of 0.000 35 in two digits 0.000 005, of 2 in one digit 0.5."""
    assert tolerance_of(0.00035, 2) == pytest.approx(0.000005)
    assert tolerance_of(2.0, 1) == pytest.approx(0.5)
    assert tolerance_of(0.0754, 2) == pytest.approx(0.0005)
    assert tolerance_of(0.0996, 1) == pytest.approx(0.05)  # 0.1 in one digit


def test_digits_grow_with_the_trials():
    """u = 0.25: one digit has a tolerance of 0.05, two of 0.005; errors scale as 1 / sqrt(n)."""
    rng = np.random.default_rng(5)
    few, some, many = (
        distribution_of(0.25 * rng.normal(size=n)).stability for n in (50, 3000, 120_000)
    )
    assert [stability.digits for stability in (few, some, many)] == [0, 1, 2]
    assert 100 < few.trials_for_one_digit < 3000
    mean_error = some.errors[0]
    assert mean_error == pytest.approx(2 * 0.25 / 3000**0.5, rel=0.1)


def test_values_that_do_not_differ_have_no_digits():
    result = distribution_of(np.full(50, 1.0))
    assert result.standard_uncertainty == 0.0
    assert result.stability is None


def test_a_single_value_is_no_distribution():
    with pytest.raises(ValueError, match="two values"):
        distribution_of([1.0])
