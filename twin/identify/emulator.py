"""What the twin would find anywhere in the space of free fields, learned from its simulations.

A Gaussian process per figure: quadratic trend, anisotropic Matern 5/2 covariance, noise of the
simulations themselves (the camera's) in it. Its error is cross-validated in closed form (Rasmussen
and Williams, Gaussian Processes for Machine Learning, 2006, eqs 5.10 to 5.12) and its stated
uncertainty is widened where it was too small. Places are shares (0 to 1) of the free fields' axes.
"""

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import cho_solve, lstsq
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError

_LEAST_POINTS = 8
_RESTARTS = 2
_LENGTHS = (0.05, 30.0)
_NOISE = (1e-10, 1.0)


@dataclass(frozen=True, eq=False)
class Emulator:
    """An emulated figure.

    Attributes
    ----------
    columns : which free fields it depends on
    trend : (term,) coefficients of 1, x, x^2 and x y, in the figure's unit
    process : what the trend leaves over, in units of `spread`
    widening : factor on the process' own standard deviation, 1 or more
    missing : share of the simulations that gave no figure
    """

    columns: tuple[int, ...]
    trend: FloatArray
    process: GaussianProcessRegressor
    spread: float
    widening: float
    missing: float
    residuals: FloatArray

    @property
    def cross_validated_rmse(self) -> float:
        """RMS error at simulations that the emulator has not seen, in the figure's unit."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    def predict(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return mean and standard deviation (n,) of the figure at places (n, free field).

        The deviation is the emulator's own; the simulations' noise is not in it.
        """
        at = places[:, self.columns]
        left, sd = self._left_over(at)
        return _terms(at) @ self.trend + self.spread * left, self.spread * self.widening * sd

    def _left_over(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        signal, known = self.process.kernel_.k1, self.process.X_train_
        across = signal(at, known)
        solved = np.linalg.solve(self._lower, across.T)
        variance = signal.diag(at) - np.sum(solved**2, axis=0)
        mean: FloatArray = across @ self.process.alpha_
        return mean, np.sqrt(np.maximum(variance, 0.0))

    @cached_property
    def _lower(self) -> FloatArray:
        return np.asarray(self.process.L_)


def fit_emulator(places: FloatArray, figures: FloatArray, columns: tuple[int, ...]) -> Emulator:
    """Learn a figure from simulations.

    Parameters
    ----------
    places : (n, free field) float
        Shares of the axes, 0 to 1.
    figures : (n,) float
        What was simulated there; NaN where there was no such figure.
    columns : tuple of int
        The free fields that the figure can depend on.

    Raises
    ------
    InputError
        Fewer than eight simulations gave the figure.
    """
    found = np.isfinite(figures)
    if found.sum() < _LEAST_POINTS:
        raise InputError(
            f"found {found.sum()} of {found.size} simulations with this figure, needed "
            f"{_LEAST_POINTS}; raise design.count or narrow the free fields"
        )
    at, values = places[found][:, columns], figures[found]
    trend = lstsq(_terms(at), values)[0]
    left = values - _terms(at) @ trend
    spread = float(left.std()) or max(float(np.abs(values).max()), 1.0) * 1e-12
    process = _process(at, left / spread)
    residuals, own_sd = _left_out(process, left / spread)
    widening = max(1.0, float(np.sqrt(np.mean((residuals / own_sd) ** 2))))
    return Emulator(
        columns=columns,
        trend=trend,
        process=process,
        spread=spread,
        widening=widening,
        missing=float(1.0 - found.mean()),
        residuals=residuals * spread,
    )


def _terms(at: FloatArray) -> FloatArray:
    """Return (n, term): 1, x and, where there are points enough to tell, squares and products."""
    ones = np.ones((len(at), 1))
    i, j = np.triu_indices(at.shape[1])
    return np.concatenate((ones, at, at[:, i] * at[:, j]), axis=1)


def _process(at: FloatArray, left: FloatArray) -> GaussianProcessRegressor:
    signal = ConstantKernel(1.0, (1e-3, 1e4)) * Matern(np.ones(at.shape[1]), _LENGTHS, nu=2.5)
    process: Any = GaussianProcessRegressor(
        signal + WhiteKernel(1e-2, _NOISE),
        n_restarts_optimizer=_RESTARTS,
        random_state=0,
    )
    with warnings.catch_warnings():
        # A length at its bound is a field that does not matter, or no noise: both are answers.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return process.fit(at, left)


def _left_out(process: GaussianProcessRegressor, left: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the residual of each point predicted from all others, and its own deviation."""
    inverse = cho_solve((process.L_, True), np.eye(left.size))
    own = 1.0 / np.diag(inverse)
    return inverse @ left * own, np.sqrt(own)
