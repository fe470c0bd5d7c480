"""Measurements that decide between choices, against closed forms of normal distributions."""

import numpy as np
import pytest
from scipy.stats import norm

from reconstruction.arrays import FloatArray
from tests.identification.linear import linear_emulators, linear_problem
from twin.identification.decisions import Decision, ExpectedFigure, decisions_of
from twin.identification.known import Identified, SensorModel
from twin.identification.posterior import likelihood_of, sample


def _decided(figures: list[FloatArray], weights: list[float], choices: str, sd: float) -> Decision:
    """Return the expected result for one alternative, with one letter per model as its choice."""
    models = [
        ExpectedFigure({"kind": choice}, weight, samples)
        for choice, weight, samples in zip(choices, weights, figures, strict=True)
    ]
    (decision,) = decisions_of("row", models, sd, seed=1)
    return decision


@pytest.mark.parametrize("sd", [0.05, 1.0, 4.0])
@pytest.mark.parametrize("distance", [0.0, 2.0, 5.0])
def test_two_normals_of_equal_weight_are_separated_as_their_distance_allows(
    distance: float, sd: float
) -> None:
    """The best guess is right with the probability Phi(d / 2 / SD of the measured value)."""
    rng = np.random.default_rng(5)
    figures = [shift + rng.standard_normal(8000) for shift in (0.0, distance)]
    exact = norm.cdf(0.5 * distance / np.hypot(1.0, sd))
    assert _decided(figures, [0.5, 0.5], "ab", sd).after == pytest.approx(exact, abs=0.025)


def test_an_uninformative_measurement_leaves_the_present_probability() -> None:
    figures = [np.random.default_rng(seed).standard_normal(8000) for seed in (1, 2, 3)]
    decision = _decided(figures, [0.7, 0.2, 0.1], "abc", 1.0)
    assert decision.before == pytest.approx(0.7)
    assert decision.after == pytest.approx(0.7, abs=0.01)


def test_models_of_one_choice_count_together() -> None:
    """Choice b is two models; the one far from choice a has three quarters of its weight."""
    rng = np.random.default_rng(6)
    near, far = rng.standard_normal(8000), 20.0 + rng.standard_normal(2000)
    decision = _decided([near, near, far], [0.6, 0.1, 0.3], "abb", 0.5)
    # Near 0 the best guess is a, which is right with 0.6 of 0.7; near 20 it is always right.
    assert decision.before == pytest.approx(0.6)
    assert decision.after == pytest.approx(0.6 + 0.3, abs=0.01)


def test_a_choice_without_probability_takes_no_part() -> None:
    samples = np.random.default_rng(8).standard_normal(8000)
    assert _decided([samples, samples], [1.0, 0.0], "ab", 1.0).after == pytest.approx(1.0)


def test_an_identification_ranks_the_deciding_measurement_first() -> None:
    """Figure `apart` is x under one choice and x + 3 under the other; `alike` is x under both."""
    measured = {"experiment": "one", "value": 0.0, "sd": 0.5}
    choices = {"low": {}, "high": {}}
    problem = linear_problem(
        {"r": {"value": 0.0, "sd": 1.0}},
        fields=1,
        worth={"alike": measured | {"metric": "m"}, "apart": measured | {"metric": "n"}},
        alternatives={"kind": {"choices": choices}},
    )
    emulators = linear_emulators(np.ones((3, 1)), ["r", "alike", "apart"])
    shifted = dict(emulators)
    shifted["apart"] = type(emulators["apart"])(lambda values: values[:, 0] + 3.0)
    posterior = sample(likelihood_of(problem, problem.rows, emulators), seed=10)
    models = tuple(
        SensorModel({"kind": choice}, 0.5, 0.5, known, {}, posterior, (), {})
        for choice, known in (("low", emulators), ("high", shifted))
    )
    apart, alike = Identified(problem, models, seed=11).decisions
    assert (apart.row, alike.row) == ("apart", "alike")
    # The fitted row halves the variance of x.
    exact = norm.cdf(1.5 / np.hypot(np.sqrt(0.5), 0.5))
    assert apart.after == pytest.approx(exact, abs=0.02)
    assert alike.after == pytest.approx(0.5, abs=0.03)
