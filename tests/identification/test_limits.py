"""Limits, which bound a figure from one side, against closed forms."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from tests.identification.linear import Exact, linear_emulators, linear_problem
from twin.config.problem import SensorProblem
from twin.identification.findings import (
    limits_met,
)
from twin.identification.known import SensorModel
from twin.identification.posterior import (
    Posterior,
    likelihood_of,
    sample,
)
from twin.identification.run import _at_bound, _bounds


def _limited(**side: Any) -> tuple[SensorProblem, Posterior]:
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


@pytest.mark.parametrize("stated", [0.8, 0.2])
def test_other_bounds_give_the_posterior_of_a_problem_with_that_bound(stated: float) -> None:
    """Without the limit the standard normal prior remains; 0.8 as in a problem that states 0.8."""
    problem, posterior = _limited(at_least=stated, compare_at=(0.8,))
    known = SensorModel({}, 1.0, 1.0, {}, {}, posterior, (), {})
    compared = [_at_bound(problem, known, 2000, bound) for bound in _bounds(problem)]
    assert [c.bound for c in compared] == [None, *sorted({stated, 0.8})]
    assert compared[0].fields["x0"].mean == pytest.approx(0.0, abs=0.08)
    assert compared[0].fields["x0"].sd == pytest.approx(1.0, abs=0.06)
    t = -0.8 / np.sqrt(1.0 + 0.4**2 + 0.3**2)
    mean = norm.pdf(t) / norm.cdf(t) / np.sqrt(1.0 + 0.4**2 + 0.3**2)
    assert compared[-1].fields["x0"].mean == pytest.approx(mean, abs=0.06)
    assert compared[-1].log_evidence - compared[0].log_evidence == pytest.approx(
        norm.logcdf(t), abs=0.1
    )


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
