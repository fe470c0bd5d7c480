"""Emulators: interpolate a simulated figure over the free fields, with a standard deviation.

An emulator is a Gaussian process (universal kriging) of one figure. It has a quadratic trend, an
anisotropic Matern 5/2 covariance, and noise, which represents the camera noise in the simulations
(Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), eqs 2.41 and 2.42). The
error is cross-validated in closed form (Dubrule, Mathematical Geology 15, 687-699, 1983). If that
error exceeds the predicted standard deviation, the standard deviation is enlarged. If there are
few simulations, the trend has no product terms, or neither products nor squares.

A place is a point in the space of the free fields; its coordinates are shares (0 to 1) of the
fields' axes. Instead of a figure itself, its logarithm or its reciprocal may be emulated.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import lstsq, solve_triangular
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import InputError
from reconstruction.machine import warnings_ignored
from twin.config.rows import LearnedAs

_LEAST_POINTS = 8
_RESTARTS = 2
# Correlation lengths in shares of an axis; a variation over less than the shortest length is taken
# as camera noise.
_LENGTHS = (0.2, 30.0)
_NOISE = (1e-10, 1.0)
_JITTER = 1e-12
_NEGLIGIBLE = 0.01
# Largest number of points from which the correlation lengths are estimated; more points do not
# improve the lengths.
_MOST_FOR_LENGTHS = 400


@dataclass(frozen=True, eq=False)
class Emulator:
    """Gaussian process that predicts one figure at any place of the free fields.

    Attributes
    ----------
    columns : indices of the free fields on which the figure depends
    known : (point, column) places of the simulations that gave the figure
    learned : (point,) the figure at `known`, or its logarithm or reciprocal, see `learned_as`
    covariance, noise : covariance function of the figure without noise, and variance of the noise;
        both in units of `spread` squared
    directions : (direction, point) whitened eigenvectors of the covariance, with noise, of the
        simulations; the omitted eigenvectors together reduce the variance of a prediction by less
        than 1 %
    trend, trend_lower : (term,) coefficients of 1, x, x^2 and x y, and the Cholesky factor of the
        inverse of their covariance, in units of `spread`
    trend_weights : (term, point) the trend's terms at the simulations times inverse covariance
    residual_weights : (point,) inverse covariance times the residuals of the trend
    left_out : (point,) error at each simulation when it is predicted from all others, in units of
        `spread`
    spread : RMS residual of the trend, in the unit of `learned`
    widening : factor on the standard deviation that the Gaussian process predicts, 1 or more
    missing : share of the simulations that gave no figure
    learned_as : the function of the figure that is emulated: "value", "log" or "reciprocal"
    """

    columns: tuple[int, ...]
    known: FloatArray
    learned: FloatArray
    covariance: Any
    noise: float
    directions: FloatArray
    trend: FloatArray
    trend_lower: FloatArray
    trend_weights: FloatArray
    residual_weights: FloatArray
    left_out: FloatArray
    spread: float
    widening: float
    missing: float
    learned_as: LearnedAs

    @property
    def cross_validated_rmse(self) -> float:
        """RMS error at the simulations, each predicted from all others, in the figure's unit."""
        figures = _figure(self.learned, self.learned_as)
        missed = self.spread * self.left_out * _slope(figures, self.learned_as)
        return float(np.sqrt(np.mean(missed**2)))

    def predict(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation (n,) of the figure at places (n, free field).

        The standard deviation is that of the interpolation only; the noise of a simulation is not
        included.
        """
        at = places[:, self.columns]
        across, terms = self._about(at)
        residual_terms = terms.T - self.trend_weights @ across.T
        open_trend = solve_triangular(self.trend_lower, residual_terms, lower=True)
        variance = self.covariance.diag(at) - np.sum((self.directions @ across.T) ** 2, axis=0)
        variance = np.maximum(variance, 0.0) + np.sum(open_trend**2, axis=0)
        figure = self._mean(across, terms)
        deviation = self.spread * self.widening * np.sqrt(variance)
        return figure, deviation * _slope(figure, self.learned_as)

    def mean(self, places: FloatArray) -> FloatArray:
        """Return the predicted figure (n,) at places (n, free field), faster than `predict`."""
        return self._mean(*self._about(places[:, self.columns]))

    def _about(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the covariance (n, point) with the simulations and the trend's terms (n, term)."""
        return self.covariance(at, self.known), _terms(at)[:, : self.trend.size]

    def _mean(self, across: FloatArray, terms: FloatArray) -> FloatArray:
        learned = self.spread * (terms @ self.trend + across @ self.residual_weights)
        return _figure(np.clip(learned, *self._sane), self.learned_as)

    @property
    def _sane(self) -> tuple[float, float]:
        """Bounds of the emulated function of the figure; they keep a reciprocal away from 0."""
        low = float(self.learned.min())
        return (0.2 * low if self.learned_as == "reciprocal" else -np.inf), np.inf


def fit_emulator(
    places: FloatArray,
    figures: FloatArray,
    columns: tuple[int, ...],
    learned_as: LearnedAs = "value",
    simulation: IntArray | None = None,
) -> Emulator:
    """Fit the emulator of a figure to simulations.

    Parameters
    ----------
    places : (n, free field) float
        Shares of the axes, 0 to 1.
    figures : (n,) float
        Simulated figure at each place; NaN if a simulation did not give the figure.
    columns : tuple of int
        The free fields that the figure can depend on.
    learned_as : "value", "log" or "reciprocal"
        Function of the figure that is emulated. For "log" and "reciprocal", figures of 0 or less
        count as missing.
    simulation : (n,) int, optional
        Number of the simulation that gave each figure, needed if one simulation gave several
        figures. In the cross-validation all figures of one simulation are left out together.
        Default: each figure is from another simulation.

    Raises
    ------
    InputError
        Too few simulations gave the figure: fewer than 8, or fewer than twice the number of terms
        of the linear trend.
    """
    valid = np.isfinite(figures)
    if learned_as != "value":
        valid &= np.where(valid, figures, 0.0) > 0.0
    at, values = places[valid][:, columns], _learn(figures[valid], learned_as)
    of = np.arange(figures.size) if simulation is None else simulation
    terms = _trend(at, np.unique(of[valid]).size, np.unique(of).size)
    left = values - terms @ lstsq(terms, values)[0]
    # Residuals of 0, where the trend is exact, cannot scale the figures.
    spread = max(float(left.std()), _JITTER * max(1.0, float(np.abs(values).max())))
    parts = _universal(at, terms, values / spread, _kernel(at, left / spread), of[valid])
    return Emulator(
        columns=columns,
        known=at,
        learned=values,
        spread=spread,
        missing=float(1.0 - valid.mean()),
        learned_as=learned_as,
        **parts,
    )


def _trend(at: FloatArray, count: int, simulated: int) -> FloatArray:
    """Return the terms (n, term) of the largest trend that has at most `count` / 2 terms.

    `count` is the number of simulations that gave the figure, out of `simulated` simulations.
    InputError if `count` is too small for the linear trend.
    """
    every, fields = _terms(at), at.shape[1]
    for terms in (every.shape[1], 1 + 2 * fields, 1 + fields):
        if count >= max(_LEAST_POINTS, 2 * terms):
            return every[:, :terms]
    raise InputError(
        f"found {count} of {simulated} simulations with this figure, needed "
        f"{max(_LEAST_POINTS, 2 * (1 + fields))}; raise design.count or narrow the free fields"
    )


def _learn(figures: FloatArray, learned_as: LearnedAs) -> FloatArray:
    if learned_as == "value":
        return figures
    return np.asarray(np.log(figures) if learned_as == "log" else 1.0 / figures)


def _figure(learned: FloatArray, learned_as: LearnedAs) -> FloatArray:
    if learned_as == "value":
        return learned
    return np.asarray(np.exp(learned) if learned_as == "log" else 1.0 / learned)


def _slope(figures: FloatArray, learned_as: LearnedAs) -> FloatArray:
    """Return the derivative of the figure with respect to its emulated function, at the figures."""
    if learned_as == "value":
        return np.ones_like(figures)
    return figures if learned_as == "log" else np.asarray(figures**2)


def _universal(
    at: FloatArray, trend_terms: FloatArray, scaled: FloatArray, kernel: Any, simulation: IntArray
) -> dict[str, Any]:
    """Return the computed attributes of an `Emulator` for a figure in units of its spread.

    The trend is fitted, too, and its uncertainty is included.
    """
    noise = float(kernel.k2.noise_level) + _JITTER
    signal, axes = np.linalg.eigh(kernel.k1(at))
    signal = np.maximum(signal, 0.0)
    white = (axes / np.sqrt(signal + noise)).T
    terms, figures = white @ trend_terms, white @ scaled
    trend = lstsq(terms, figures)[0]
    basis = np.linalg.qr(terms)[0]
    # Inverse covariance, projected on the complement of the fitted trend.
    free = white.T @ (white - basis @ (basis.T @ white))
    left_out, surprise = _left_out(free, free @ scaled, simulation)
    return {
        "covariance": kernel.k1,
        "noise": noise,
        "directions": white[_narrowing(signal, noise) :],
        "trend": trend,
        "trend_weights": terms.T @ white,
        "trend_lower": np.linalg.cholesky(terms.T @ terms),
        "residual_weights": white.T @ (figures - terms @ trend),
        "widening": max(1.0, float(np.sqrt(surprise / scaled.size))),
        "left_out": left_out,
    }


def _narrowing(signal: FloatArray, noise: float) -> int:
    """Return the index of the first eigenvector that matters to the variance of a prediction.

    The variances s of the eigenvectors ascend; n is the variance of the noise. In the mean over the
    simulated places, the simulations reduce the variance s by s^2 / (s + n), and s n / (s + n)
    remains.
    """
    narrowed = np.cumsum(signal**2 / (signal + noise))
    left = np.sum(signal * noise / (signal + noise))
    return int(np.searchsorted(narrowed, _NEGLIGIBLE * left))


def _left_out(
    free: FloatArray, weighted: FloatArray, simulation: IntArray
) -> tuple[FloatArray, float]:
    """Return the error (n,) of each figure when it is predicted from all other simulations.

    The second value is the sum of the squares of these errors over their predicted covariance. Its
    expected value is n if the predicted covariance is right.
    """
    left_out, surprise = np.zeros(len(free)), 0.0
    for number in np.unique(simulation):
        ours = np.flatnonzero(simulation == number)
        left_out[ours] = np.linalg.solve(free[np.ix_(ours, ours)], weighted[ours])
        surprise += float(left_out[ours] @ weighted[ours])
    return left_out, surprise


def _terms(at: FloatArray) -> FloatArray:
    """Return the terms (n, term) of the quadratic trend: 1, x, the squares, the products."""
    i, j = _pairs(at.shape[1])
    return np.concatenate((np.ones((len(at), 1)), at, at**2, at[:, i] * at[:, j]), axis=1)


@lru_cache(maxsize=32)
def _pairs(fields: int) -> tuple[IntArray, IntArray]:
    return np.triu_indices(fields, 1)


def _kernel(at: FloatArray, left: FloatArray) -> Any:
    """Return the most likely covariance function of the trend's residuals, of unit spread."""
    if len(at) > _MOST_FOR_LENGTHS:
        some = np.random.default_rng(0).choice(len(at), _MOST_FOR_LENGTHS, replace=False)
        at, left = at[some], left[some]
    signal = ConstantKernel(1.0, (1e-3, 1e4)) * Matern(np.ones(at.shape[1]), _LENGTHS, nu=2.5)
    process = GaussianProcessRegressor(
        signal + WhiteKernel(0.1, _NOISE), n_restarts_optimizer=_RESTARTS, random_state=0
    )
    # A parameter at its bound is valid: a length, if the field has no influence; the noise, if
    # there is none.
    with warnings_ignored(ConvergenceWarning):
        return process.fit(at, left).kernel_
