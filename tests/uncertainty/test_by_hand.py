"""Figures of a study of trials computed by hand: cut-off draws, choices, digits, a budget."""

import numpy as np
import pytest

from twin.config.inputs import Input
from twin.paper.budget import budget_table
from twin.paper.trials import Trial
from twin.propagation.budget import Part, calibration_part, noise_left, noise_part, shares
from twin.propagation.distribution import distribution_of, stability_of, tolerance_of
from twin.propagation.sensitivity import correlation_of
from twin.study.trials import Choice, deviation_of, standard_uncertainty


def travel(**more):
    plain = {"group": "press", "key": "press.depth_mm", "distribution": "normal", "spread": 0.1}
    return Input.model_validate(plain | more)


def test_a_normal_is_cut_off_about_its_nominal_value():
    """Nominal 3, sigma 0.1, at most 3.1: one sigma above. Mean -0.1 phi(1) / Phi(1) = -0.028760.

    At least 2.9 as well: the mean is 0, the variance 0.01 (1 - 2 phi(1) / 0.682689).
    """
    assert deviation_of(travel(at_most=3.1), 3.0).mean() == pytest.approx(-0.0287600, abs=1e-6)
    assert deviation_of(travel(at_least=2.9), 3.0).mean() == pytest.approx(0.0287600, abs=1e-6)
    both = travel(at_least=2.9, at_most=3.1)
    assert deviation_of(both, 3.0).mean() == pytest.approx(0.0, abs=1e-9)
    assert standard_uncertainty(both, 3.0) == pytest.approx(0.1 * 0.2911251**0.5, rel=1e-6)


def test_spreads_by_distribution():
    """Half width 0.6: uniform over the root of 3, triangular of 6, arcsine of 2; t of 6: 1.5."""

    def u(name, **more):
        return standard_uncertainty(travel(distribution=name, spread=0.6, **more), -2.0)

    assert u("uniform") == pytest.approx(0.6 / 3**0.5)
    assert u("triangular") == pytest.approx(0.6 / 6**0.5)
    assert u("arcsine") == pytest.approx(0.6 / 2**0.5)
    assert u("student_t", degrees_of_freedom=6) == pytest.approx(0.6 * 1.5**0.5)
    assert u("normal", relative=True) == pytest.approx(1.2)


def test_a_choice_by_its_cumulated_shares():
    """Ten shares of 0.1 sum up to less than 1: a probability of 1 still gives the last value."""
    ten = Choice(tuple(range(10)), (0.1,) * 10)
    assert ten.ppf([0.0, 0.05, 0.1, 0.11, 0.95, 1.0]).tolist() == [0, 0, 0, 1, 9, 9]
    assert Choice((1.0, 5.0), (0.75, 0.25)).std() == pytest.approx(3.0**0.5)


def test_two_values_have_a_standard_deviation():
    """0 and 2: the root of 2, with one degree of freedom."""
    two = np.array([0.0, 2.0])
    assert noise_part(two).u == pytest.approx(2.0**0.5)
    assert calibration_part(two).u == pytest.approx(2.0**0.5)
    assert noise_left(two, [Part("focus", "optics", "", 1.0)]).u == pytest.approx(1.0)
    assert noise_left(two[:1], []) is None


def test_values_that_differ_by_rounding_have_no_digits():
    """A micrometre in a thousand kilometres is 1e-12 of the value: less is rounding."""
    values = 1e6 + np.array([-1.0, 1.0] * 20) * 1e-7
    assert stability_of(values) is None
    assert stability_of(1.0 + (values - 1e6)) is not None


def test_errors_of_interval_ends_from_blocks():
    """Twenty blocks of 500: the 13th and the 488th smallest are the ends of 95 %.

    The 13th is alternately 12.5 and 13.5: its standard deviation is 0.5 sqrt(20 / 19) = 0.51299,
    the error two of these over the root of 20. The 488th is equal in all blocks.
    """
    rng, blocks = np.random.default_rng(2), []
    for number in range(20):
        block = np.arange(1.0, 501.0)
        block[12] += 0.5 if number % 2 else -0.5
        blocks.append(rng.permutation(block))
    stability = distribution_of(np.concatenate(blocks)).stability
    assert stability.errors[2] == pytest.approx(2 / 20**0.5 * 0.5 * (20 / 19) ** 0.5)
    assert stability.errors[3] == 0.0
    # The mean moves by 1 / 500 between blocks.
    assert stability.errors[0] == pytest.approx(2 / 20**0.5 * 0.001 * (20 / 19) ** 0.5)


def test_digits_need_errors_within_the_tolerance():
    """u = 144.3 has a tolerance of 50 in one digit and of 5 in two."""
    assert tolerance_of(144.3, 1) == pytest.approx(50.0)
    assert tolerance_of(144.3, 2) == pytest.approx(5.0)
    stability = distribution_of(np.tile(np.arange(1.0, 501.0), 20)).stability
    assert (stability.digits, stability.tolerance) == (2, pytest.approx(5.0))
    assert max(stability.errors) < 1e-9


def test_shares_of_a_budget_table():
    """Parts of 3, 4 and 12 um: 13 together; 5.33, 9.47 and 85.21 % of 169 um^2.

    Four trials, and trial 0, which no part includes: the optics' 3 um are subtracted once from 5.
    """
    away = np.array([-1.5, -0.5, 0.5, 1.5])
    along, across = away / away.std(ddof=1), np.array([1.0, -1.0, -1.0, 1.0])
    across /= across.std(ddof=1)
    trials = [Trial(0, {f"{k}sphere_1_radius_mm": 7.0 for k in ("", "true_rig_")})]
    for n in range(4):
        face = 4.0 + 0.001 * n
        rig = face + 5.0 * along[n]
        figures = {"sphere_1_true_face_radius_mm": face, "true_rig_sphere_1_radius_mm": rig}
        trials.append(Trial(n + 1, figures | {"sphere_1_radius_mm": rig + 12.0 * across[n]}))
    table = budget_table("two_balls", [Part("focus", "optics", "k", 3.0)], trials)
    rows = table.rows
    names = ["calibration", "noise and decoding", "focus", "all, in quadrature"]
    assert [row["input"] for row in rows[:4]] == names
    assert [row["u"] for row in rows[:4]] == pytest.approx([12.0, 4.0, 3.0, 13.0])
    percent = [row["share"] for row in rows[:4]]
    assert percent == pytest.approx([85.2071, 9.4675, 5.3254, 100.0], abs=1e-4)
    assert rows[4]["input"] == "all, Monte Carlo, 4 trials"
    assert sum(shares([Part("a", "", "", 3.0), Part("b", "", "", 4.0)])) == pytest.approx(1.0)


def test_three_trials_have_a_correlation():
    """(0, 1), (1, 2), (2, 4): 3 / sqrt(2 * 14 / 3) = 0.98198, in the same order; of two none."""
    correlation = correlation_of("x", [0.0, 1.0, 2.0], [1.0, 2.0, 4.0])
    assert (correlation.linear, correlation.rank) == (pytest.approx(0.9819805), pytest.approx(1.0))
    assert correlation_of("x", [0.0, 1.0], [1.0, 2.0]) is None
