"""Emulators of figures: their error, and cross-validation with omitted simulations."""

import numpy as np
import pytest
from scipy.stats import qmc

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.config.rows import LearnedAs
from twin.identification.emulator import _left_out, fit_emulator


def _simulated(noise: float) -> tuple[FloatArray, FloatArray]:
    places = qmc.Sobol(3, rng=np.random.default_rng(0)).random_base2(6)
    figures = _figure(places) + noise * np.random.default_rng(1).standard_normal(64)
    return places, figures


def _figure(places: FloatArray) -> FloatArray:
    return np.asarray(4.0 + np.sin(3.0 * places[:, 0]) * (1.0 + places[:, 1]))


def test_an_emulators_deviation_matches_its_error() -> None:
    places, figures = _simulated(noise=0.02)
    emulator = fit_emulator(places, figures, (0, 1, 2))
    unseen = np.random.default_rng(2).random((4000, 3))
    mean, sd = emulator.predict(unseen)
    error = mean - _figure(unseen)
    assert error.std() < 0.02  # below the simulations' own noise
    assert 0.6 < np.sqrt(np.mean((error / sd) ** 2)) < 1.5
    assert 0.015 < emulator.cross_validated_rmse < 0.035  # that of a noisy simulation


def test_an_emulator_is_not_moved_by_failed_simulations() -> None:
    places, figures = _simulated(noise=0.0)
    figures[::4] = np.nan
    emulator = fit_emulator(places, figures, (0, 1))
    assert emulator.missing == 0.25
    mean, sd = emulator.predict(places)
    known = np.isfinite(figures)
    assert np.abs(mean - _figure(places))[known].max() < 1e-6
    assert (np.abs(mean - _figure(places))[~known] < 4 * sd[~known] + 1e-3).all()


def test_too_few_figures_are_an_error_of_one_line() -> None:
    places, figures = _simulated(noise=0.0)
    figures[7:] = np.nan
    with pytest.raises(InputError, match="found 7 of 64 simulations with this figure, needed 8"):
        fit_emulator(places, figures, (0,))


def test_predictions_are_those_of_the_covariance_of_all_figures() -> None:
    """A vague prior on the trend's coefficients, and conditioning on all figures at once."""
    places, figures = _simulated(noise=0.02)
    emulator = fit_emulator(places, figures, (0, 1))
    unseen = np.random.default_rng(3).random((5, 3))
    whole = np.concatenate((places, unseen))[:, :2]
    i, j = np.triu_indices(2)
    terms = np.concatenate((np.ones((69, 1)), whole, whole[:, i] * whole[:, j]), axis=1)
    covariance = emulator.covariance(whole) + 1e6 * terms @ terms.T
    noisy = covariance[:64, :64] + emulator.noise * np.eye(64)
    inside = np.linalg.solve(noisy, covariance[:64, 64:])
    mean, sd = emulator.predict(unseen)
    assert np.allclose(inside.T @ figures, mean, atol=1e-4)
    variance = np.diag(covariance[64:, 64:] - covariance[64:, :64] @ inside)
    assert np.allclose(emulator.spread * emulator.widening * np.sqrt(variance), sd, rtol=1e-2)


@pytest.mark.parametrize(("count", "terms"), [(20, 10), (14, 7), (8, 4)])
def test_few_figures_have_a_simpler_trend(count: int, terms: int) -> None:
    """Two simulations per term: all terms, without products, linear. Any fits a plane exactly."""
    places = np.random.default_rng(2).random((count, 3))
    emulator = fit_emulator(places, places @ [1.0, -2.0, 0.5] + 3.0, (0, 1, 2))
    assert emulator.trend.size == terms
    assert emulator.predict(np.full((1, 3), 0.4))[0] == pytest.approx(2.8, abs=1e-6)


@pytest.mark.parametrize("learned_as", ["log", "reciprocal"])
def test_a_figure_is_fitted_as_its_logarithm_or_reciprocal(learned_as: LearnedAs) -> None:
    """A radius that increases to 50 mm with decreasing curvature; an exponential of two fields."""
    places = np.random.default_rng(3).random((40, 2))
    made = {
        "reciprocal": lambda at: 1.0 / (0.25 - 0.23 * at[:, 0] * at[:, 1]),
        "log": lambda at: np.exp(4.0 * at[:, 0] - 3.0 * at[:, 1]),
    }[learned_as]
    at = np.random.default_rng(4).random((50, 2))
    emulator = fit_emulator(places, made(places), (0, 1), learned_as)
    plain = fit_emulator(places, made(places), (0, 1))
    np.testing.assert_allclose(emulator.predict(at)[0], made(at), rtol=1e-5)
    assert emulator.cross_validated_rmse < 0.1 * plain.cross_validated_rmse


def test_figures_of_one_simulation_are_left_out_together() -> None:
    """Universal kriging from the others, written out, against the closed form for blocks."""
    rng = np.random.default_rng(6)
    places, simulation = rng.random((12, 2)), np.repeat(np.arange(4), 3)
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    covariance = np.exp(-(distance**2)) + 0.1 * np.eye(12)
    terms, figures = np.column_stack([np.ones(12), places]), rng.normal(size=12)
    inverse = np.linalg.inv(covariance)
    fitted = inverse @ terms @ np.linalg.inv(terms.T @ inverse @ terms) @ terms.T @ inverse
    left_out, _ = _left_out(inverse - fitted, (inverse - fitted) @ figures, simulation)
    for number in range(4):
        ours, others = simulation == number, simulation != number
        known = np.linalg.inv(covariance[np.ix_(others, others)])
        trend = np.linalg.solve(
            terms[others].T @ known @ terms[others], terms[others].T @ known @ figures[others]
        )
        left = known @ (figures[others] - terms[others] @ trend)
        predicted = terms[ours] @ trend + covariance[np.ix_(ours, others)] @ left
        np.testing.assert_allclose(left_out[ours], figures[ours] - predicted, atol=1e-10)
