"""Limits, which bound a figure from one side, against closed forms."""

import numpy as np
import pytest
from scipy.stats import norm

from tests.identification.linear import Exact, linear_emulators, linear_problem
from twin.config.problem import SensorProblem
from twin.identification.findings import (
    limits_met,
)
from twin.identification.posterior import (
    Posterior,
    likelihood_of,
    sample,
)


def _limited(**side: float) -> tuple[SensorProblem, Posterior]:
    """One field with a limit and an uninformative row (standard deviation 100)."""
    limit = {"edge": {"experiment": "one", "metric": "edge", "sd": 0.4} | side}
    problem = linear_problem({"none": {"value": 0.0, "sd": 100.0}}, fields=1, limits=limit)
    emulators = linear_emulators(np.array([[1.0]]), ["none"])
    emulators["edge"] = Exact(lambda v: v[:, 0], sd=0.3)
    return problem, sample(likelihood_of(problem, problem.rows, emulators), seed=3)


def test_a_limit_gives_the_closed_forms_mean_and_evidence() -> None:
    """A standard normal times Phi((x - a) / s): skew normal of Azzalini 1985, extended."""
    posterior = _limited(at_least=0.8)[1]
    t = -0.8 / np.sqrt(1.0 + 0.4**2 + 0.3**2)
    mean = norm.pdf(t) / norm.cdf(t) / np.sqrt(1.0 + 0.4**2 + 0.3**2)
    assert posterior.values.mean() == pytest.approx(mean, abs=0.05)
    row = norm.logpdf(0.0, scale=np.hypot(100.0, 1.0))
    assert posterior.log_evidence == pytest.approx(norm.logcdf(t) + row, abs=0.1)


def test_a_limit_from_above_is_the_mirror_image() -> None:
    low, high = _limited(at_least=0.8)[1], _limited(at_most=-0.8)[1]
    assert high.values.mean() == pytest.approx(-low.values.mean(), abs=0.06)


def test_probability_of_a_limit_over_prior_and_posterior() -> None:
    (met,) = limits_met(_limited(at_least=0.8)[1], seed=1)
    width = np.sqrt(1.0 + 0.4**2 + 0.3**2)
    assert met.before == pytest.approx(norm.cdf(-0.8 / width), abs=0.02)
    assert met.before < met.probability < 1.0
    assert met.twin.mean > 0.8


@pytest.mark.parametrize("sides", [{}, {"at_least": 1.0, "at_most": 2.0}])
def test_a_limit_has_one_side(sides: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="exactly one"):
        _limited(**sides)


def test_a_limit_needs_a_name_and_an_experiment_of_its_own() -> None:
    limit = {"experiment": "one", "metric": "m", "at_least": 0.0, "sd": 1.0}
    with pytest.raises(ValueError, match="rows has this name"):
        linear_problem({"r": {"value": 0.0, "sd": 1.0}}, limits={"r": limit})
    with pytest.raises(ValueError, match=r"limits\.edge"):
        linear_problem(
            {"r": {"value": 0.0, "sd": 1.0}}, limits={"edge": limit | {"experiment": "two"}}
        )
