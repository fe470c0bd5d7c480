"""Posterior, evidence, profile and ridges against closed forms of the linear normal problem."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from reconstruction.arrays import FloatArray
from tests.identification.linear import Exact, linear_emulators, linear_problem
from twin.config.problem import SensorProblem
from twin.identification.findings import (
    interval_of,
    predict_rows,
    prior_shifts,
    ridges,
    undetermined,
    worth_of,
)
from twin.identification.posterior import (
    Likelihood,
    Posterior,
    likelihood_of,
    probabilities,
    profile,
    sample,
)

MATRIX = np.array([[1.0, 0.5], [-0.3, 2.0], [0.7, 0.7]])
VALUES, SDS = np.array([0.8, -1.1, 0.4]), np.array([0.5, 0.3, 1.0])


@pytest.fixture(scope="module")
def linear() -> tuple[SensorProblem, Posterior]:
    """Three rows on two normal fields, with a nuisance that shifts the first two together."""
    rows = {
        f"r{i}": {"value": VALUES[i], "sd": SDS[i], "nuisance": {"scale": s}}
        for i, s in enumerate((1.0, 2.0, 0.0))
    }
    problem = linear_problem(rows, nuisance={"scale": {"sd": 0.2}})
    likelihood = likelihood_of(problem, problem.rows, linear_emulators(MATRIX, list(rows)))
    return problem, sample(likelihood, seed=3)


def _covariance() -> FloatArray:
    shift = 0.2 * np.array([1.0, 2.0, 0.0])
    return np.asarray(np.diag(SDS**2) + np.outer(shift, shift))


def test_samples_have_the_closed_forms_mean_and_covariance(
    linear: tuple[SensorProblem, Posterior],
) -> None:
    precision = np.linalg.inv(_covariance())
    covariance = np.linalg.inv(np.eye(2) + MATRIX.T @ precision @ MATRIX)
    mean = covariance @ MATRIX.T @ precision @ VALUES
    samples = linear[1].values
    effective = len(samples) / 2
    error = 4 * np.sqrt(np.diag(covariance) / effective)
    assert (np.abs(samples.mean(axis=0) - mean) < error).all()
    assert np.allclose(np.cov(samples.T), covariance, atol=0.05 * np.trace(covariance))


def test_evidence_is_the_density_of_the_rows(linear: tuple[SensorProblem, Posterior]) -> None:
    whole = MATRIX @ MATRIX.T + _covariance()
    exact = multivariate_normal(np.zeros(3), whole).logpdf(VALUES)
    posterior = linear[1]
    assert posterior.log_evidence_sd < 0.05
    # The priors are cut at six standard deviations, which is negligible at this accuracy.
    assert abs(posterior.log_evidence - exact) < 4 * posterior.log_evidence_sd


def test_profile_is_a_parabola_of_the_other_fields_best(
    linear: tuple[SensorProblem, Posterior],
) -> None:
    shares, log_likelihood = profile(linear[1], 0)
    at = 12.0 * shares - 6.0
    precision = np.linalg.inv(_covariance())
    information = MATRIX.T @ precision @ MATRIX
    width = np.sqrt(np.linalg.inv(information)[0, 0])
    best = (np.linalg.inv(information) @ MATRIX.T @ precision @ VALUES)[0]
    assert np.allclose(log_likelihood, -0.5 * ((at - best) / width) ** 2, atol=0.02)


def test_a_held_out_row_is_predicted_with_its_remaining_uncertainty() -> None:
    rows = {
        "fit": {"value": 1.0, "sd": 0.1},
        "held": {"value": 5.0, "sd": 0.3, "held_out": True, "discrepancy": 0.4},
    }
    problem = linear_problem(rows, fields=1)
    emulators = linear_emulators(np.array([[1.0], [2.0]]), ["fit", "held"])
    posterior = sample(likelihood_of(problem, problem.fitted, emulators), seed=1)
    row = predict_rows(posterior, likelihood_of(problem, problem.rows, emulators), seed=2)[1]
    mean, sd = 2.0 / 1.01, float(np.hypot(2.0 * 0.1 / np.sqrt(1.01), 0.4))
    assert not row.fitted
    assert row.twin.mean == pytest.approx(mean, abs=0.05)
    assert row.twin.sd == pytest.approx(sd, rel=0.06)
    assert row.deviation == pytest.approx((5.0 - mean) / np.hypot(sd, 0.3), rel=0.06)


def test_scatter_over_realisations_adds_to_a_rows_uncertainty() -> None:
    # The scatter increases with the field: the posterior is compared with its quadrature.
    rows = {"r": {"value": 1.2, "sd": 0.1, "realisations": 4}}
    experiments = {"one": {"base": "none", "repeats": 2}}
    problem = linear_problem(rows, fields=1, experiments=experiments)
    scatters: dict[str, Any] = {"r": Exact(lambda v: np.exp(0.5 * v[:, 0]))}
    likelihood = likelihood_of(
        problem, problem.rows, linear_emulators(np.ones((1, 1)), ["r"]), scatters
    )
    posterior = sample(likelihood, seed=9)

    x = np.linspace(-6.0, 6.0, 20001)
    weight = norm.pdf(x) * norm.pdf(1.2, x, np.hypot(0.1, np.exp(0.5 * x) / 2))
    mean = np.sum(x * weight) / weight.sum()
    sd = np.sqrt(np.sum((x - mean) ** 2 * weight) / weight.sum())
    assert posterior.values.mean() == pytest.approx(mean, abs=0.04)
    assert posterior.values.std() == pytest.approx(sd, abs=0.04)
    assert posterior.log_evidence == pytest.approx(
        np.log(weight.sum() * (x[1] - x[0])), abs=4 * posterior.log_evidence_sd + 0.01
    )


def test_scatter_needs_repeats_and_a_mean() -> None:
    row = {"value": 1.0, "sd": 0.1, "realisations": 1}
    with pytest.raises(ValueError, match=r"realisations needs experiments\.one\.repeats of 2"):
        linear_problem({"r": row}, fields=1)
    with pytest.raises(ValueError, match="realisations: not allowed with statistic = 'sd'"):
        linear_problem({"r": row | {"statistic": "sd"}}, fields=1)
    for name, value in (("shared", 0.5), ("coat", "a")):
        with pytest.raises(ValueError, match=f"{name}: of a mean it needs realisations"):
            linear_problem({"r": {"value": 1.0, "sd": 0.1, name: value}}, fields=1)


def test_the_chains_keep_detailed_balance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Variance of seven fields when one row measures their sum: 1 - 1 / (7 + 0.25) each.

    420 chains of 20 correlation times have some 6000 independent samples of seven fields, which
    estimate it to 0.5 %; emcee's snooker move with a weight of 0.1 narrows it by 2 %.
    """
    monkeypatch.setattr("twin.identification.posterior._WALKERS_PER_FIELD", 60)
    problem = linear_problem({"sum": {"value": 1.0, "sd": 0.5}}, fields=7)
    likelihood = likelihood_of(problem, problem.rows, linear_emulators(np.ones((1, 7)), ["sum"]))
    variance = sample(likelihood, seed=1).z.var(axis=0).mean()
    assert variance == pytest.approx(1 - 1 / 7.25, rel=0.01)


def test_two_fields_of_which_a_row_has_the_sum_are_a_ridge() -> None:
    problem = linear_problem({"sum": {"value": 1.0, "sd": 0.01}}, fields=3)
    emulators = linear_emulators(np.array([[1.0, 1.0, 0.0]]), ["sum"])
    posterior = sample(likelihood_of(problem, problem.rows, emulators), seed=4)
    named = ridges(posterior)
    assert [set(ridge.share) for ridge in named] == [{"x0", "x1"}]
    # Across the ridge x0 + x1 has sd 0.01; along it each field has 50 % of the prior's variance.
    assert named[0].variance_ratio == pytest.approx(0.5e-4, rel=0.1)
    assert named[0].open_ratio == pytest.approx(0.5, rel=0.1)
    assert "x2" in undetermined(posterior)


def test_a_curved_trade_off_is_named_too() -> None:
    problem = linear_problem({"product": {"value": 1.0, "sd": 0.02}})
    product: Any = {"product": Exact(lambda v: np.exp(0.5 * v[:, 0]) + 0.6 * v[:, 1])}
    named = ridges(sample(likelihood_of(problem, problem.rows, product), seed=4))
    assert [set(ridge.share) for ridge in named] == [{"x0", "x1"}]
    assert np.prod(list(named[0].share.values())) > 0


def test_separate_rows_have_no_ridge(linear: tuple[SensorProblem, Posterior]) -> None:
    rows = {f"r{i}": {"value": 0.3, "sd": 0.05} for i in range(2)}
    problem = linear_problem(rows)
    posterior = sample(
        likelihood_of(problem, problem.rows, linear_emulators(np.eye(2), list(rows))), seed=4
    )
    assert not ridges(posterior)


def test_both_of_two_basins_are_sampled() -> None:
    problem = linear_problem({"square": {"value": 4.0, "sd": 0.05}}, fields=1)
    square: Any = {"square": Exact(lambda v: v[:, 0] ** 2)}
    samples = sample(likelihood_of(problem, problem.rows, square), seed=5).values[:, 0]
    assert 0.35 < np.mean(samples > 0) < 0.65
    assert np.allclose(np.abs(samples), 2.0, atol=0.1)


def test_models_are_weighed_by_evidence_and_prior() -> None:
    rows = {"r": {"value": 3.0, "sd": 0.5}}
    problem = linear_problem(rows, fields=1)
    posteriors = [
        sample(
            likelihood_of(problem, problem.rows, linear_emulators(np.array([[g]]), ["r"])), seed=6
        )
        for g in (1.0, 3.0)
    ]
    exact = np.array(
        [0.7 * norm(0, np.hypot(1, 0.5)).pdf(3), 0.3 * norm(0, np.hypot(3, 0.5)).pdf(3)]
    )
    assert np.allclose(probabilities(posteriors, (0.7, 0.3)), exact / exact.sum(), atol=0.02)


def test_worth_is_the_remaining_variance_after_the_measurement() -> None:
    problem = linear_problem(
        {"sum": {"value": 0.0, "sd": 0.01}},
        worth={
            "first": {"experiment": "one", "metric": "m", "value": 0.0, "sd": 0.1},
            "sum_again": {"experiment": "one", "metric": "m", "value": 0.0, "sd": 0.1},
        },
    )
    matrix = np.array([[1.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    emulators = linear_emulators(matrix, ["sum", "first", "sum_again"])
    posterior = sample(likelihood_of(problem, problem.rows, emulators), seed=7)
    ranked = worth_of(posterior, likelihood_of(problem, problem.worth, emulators), seed=8)
    assert [worth.row for worth in ranked] == ["first", "sum_again"]
    # Given x0 + x1 = 0: var x0 = 1/2, and after the reading 1 / (2 + 100).
    assert ranked[0].shrink["x0"] == pytest.approx(1 / 51, abs=0.01)
    assert ranked[1].shrink["x0"] > 0.95


def test_intervals_are_those_of_a_normal() -> None:
    interval = interval_of(norm.ppf((np.arange(20001) + 0.5) / 20001))
    assert interval.high_68 == pytest.approx(1.0, abs=0.01)
    assert interval.low_95 == pytest.approx(-1.96, abs=0.01)


def test_the_same_seed_gives_the_same_samples() -> None:
    problem = linear_problem({"r": {"value": 1.0, "sd": 0.5}}, fields=1)
    emulators = linear_emulators(np.array([[1.0]]), ["r"])
    likelihood: Likelihood = likelihood_of(problem, problem.rows, emulators)
    assert sample(likelihood, 9).z.tobytes() == sample(likelihood, 9).z.tobytes()


def test_tilted_priors_move_only_undetermined_fields() -> None:
    """Mean of the larger of two standard normal draws is 1 / sqrt pi: 2 Phi(z) phi(z)."""
    rows = {"a": {"value": 0.3, "sd": 0.001}, "b": {"value": 0.0, "sd": 1.0, "held_out": True}}
    problem = linear_problem(rows)
    emulators = linear_emulators(np.eye(2), list(rows))
    posterior = sample(likelihood_of(problem, problem.fitted, emulators), seed=4)
    every = likelihood_of(problem, problem.rows, emulators)
    shifts = prior_shifts([posterior, posterior], [0.7, 0.3], every, seed=4)
    by_tilt = {(shift.field, shift.towards): shift for shift in shifts}
    open_high, open_low = by_tilt["x1", "high"], by_tilt["x1", "low"]
    assert open_high.mean == pytest.approx(1 / np.sqrt(np.pi), abs=0.08)
    assert open_low.mean == pytest.approx(-1 / np.sqrt(np.pi), abs=0.08)
    assert (open_high.row, open_low.row) == ("b", "b")
    assert open_high.row_steps == pytest.approx(1 / np.sqrt(np.pi), abs=0.08)
    # Mean of w is 1, of w^2 4/3: 75 % of the samples count.
    assert open_high.effective_share == pytest.approx(0.75, abs=0.04)
    known = by_tilt["x0", "high"]
    assert known.mean - known.mean_before == pytest.approx(0.0, abs=1e-4)
    assert known.effective_share == pytest.approx(1.0, abs=1e-3)
    assert all(shift.probability == pytest.approx(0.7, abs=1e-12) for shift in shifts)


def test_a_tilted_prior_changes_the_evidence_of_choices() -> None:
    """Fields known to be 1 and -1: weights 2 Phi(1) = 1.683 and 2 Phi(-1) = 0.317."""
    posteriors = []
    for value in (1.0, -1.0):
        problem = linear_problem({"a": {"value": value, "sd": 0.001}}, fields=1)
        emulators = linear_emulators(np.eye(1), ["a"])
        likelihood = likelihood_of(problem, problem.rows, emulators)
        posteriors.append(sample(likelihood, seed=5))
    towards = {s.towards: s for s in prior_shifts(posteriors, [0.5, 0.5], likelihood, 0)}
    assert towards["high"].probability == pytest.approx(norm.cdf(1.0), abs=1e-3)
    assert towards["low"].probability == pytest.approx(norm.cdf(-1.0), abs=1e-3)


def test_predicted_rows_share_coat_scale_and_emulator_error_with_the_fitted_rows() -> None:
    """Field, coat and scale are independent normals: the closed form of their joint density.

    75 % of a coat's variance is common to its trials: `again` has the coat of the fitted row
    `mean`, `other` has another coat. The deviation over the trials is the remaining 25 %.
    """
    coat = {"realisations": 1, "shared": 0.75, "nuisance": {"scale": 2.0}}
    rows = {
        "mean": {"value": 1.5, "sd": 0.2, "coat": "a", **coat},
        "again": {"value": 9.0, "sd": 0.3, "coat": "a", "held_out": True, **coat},
        "other": {"value": 9.0, "sd": 0.3, "coat": "b", "held_out": True, **coat},
        "scatter": {"value": 1.0, "sd": 0.1, "statistic": "sd", "shared": 0.75, "held_out": True},
    }
    experiments = {"one": {"base": "none", "repeats": 2}}
    problem = linear_problem(
        rows, fields=1, experiments=experiments, nuisance={"scale": {"sd": 0.1}}
    )
    figure, scatter = Exact(lambda v: v[:, 0], sd=0.5), Exact(lambda v: np.full(len(v), 0.8))
    emulators: dict[str, Any] = {**dict.fromkeys(rows, figure), "scatter": scatter}
    scatters: dict[str, Any] = dict.fromkeys(("mean", "again", "other"), scatter)
    fitted = likelihood_of(problem, problem.fitted, emulators, scatters)
    every = likelihood_of(problem, problem.rows, emulators, scatters)
    predictions = {r.row: r for r in predict_rows(sample(fitted, seed=9), every, seed=2)}

    coats, common = 0.75 * 0.8**2, 1.0 + 0.5**2 + (2.0 * 0.1) ** 2  # field, emulator, scale
    whole = common + coats
    for name, shared in (("mean", whole), ("again", whole), ("other", common)):
        gain = shared / (whole + 0.2**2)
        assert predictions[name].twin.mean == pytest.approx(1.5 * gain, abs=0.06)
        assert predictions[name].twin.sd == pytest.approx(np.sqrt(whole - gain * shared), rel=0.08)
    assert predictions["scatter"].twin.mean == pytest.approx(0.8 * np.sqrt(0.25))
    # With another coat and emulator error the fitted row has an effect through the field only.
    field = 1.0 / (whole + 0.2**2)
    assert predictions["mean"].any_coat.mean == pytest.approx(1.5 * field, abs=0.06)
    assert predictions["mean"].any_coat.sd == pytest.approx(np.sqrt(whole - field), rel=0.08)
