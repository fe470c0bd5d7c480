"""Smooth field of the displacement between printed dots, with its uncertainty.

The field is an affine function plus a Gaussian process with a squared exponential covariance
(Rasmussen, Williams 2006, Gaussian Processes for Machine Learning, chapter 2). Length and standard
deviation of the process are those with the largest likelihood of the measured displacements. Its
sigma therefore contains the errors of the dots and the unknown displacement between them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import KDTree

from reconstruction.arrays import FloatArray
from reconstruction.errors import FitError

_FEWEST = 6
# Lengths that are tried, in spacings of the dots; deviations, relative to that of the
# displacements from the affine function.
_LENGTHS = 1.0 * 1.5 ** np.arange(6)
_DEVIATIONS = 0.6 * 2.0 ** np.arange(4)
_LEAST_MM = 1e-5


@dataclass(frozen=True, eq=False)
class MotionField:
    """Displacement field; `at` evaluates it.

    Attributes
    ----------
    places_mm : (dot, xy) places of the dots
    length_mm : correlation length of the process
    """

    places_mm: FloatArray
    length_mm: float
    _parts: "tuple[_Component, _Component]"

    @classmethod
    def of(cls, places_mm: FloatArray, moved_mm: FloatArray, sigma_mm: FloatArray) -> "MotionField":
        """Return the field of displacements (dot, xy) with standard uncertainties (dot, xy).

        Raises
        ------
        FitError : there are fewer than six dots
        """
        if len(places_mm) < _FEWEST:
            raise FitError(f"found {len(places_mm)} dots, needed at least {_FEWEST} for a field")
        spacing_mm = float(np.median(KDTree(places_mm).query(places_mm, k=2)[0][:, 1]))
        basis = _basis(places_mm, places_mm)
        off = moved_mm - basis @ np.linalg.lstsq(basis, moved_mm)[0]
        spread = np.maximum(off.std(axis=0), _LEAST_MM)
        tried = [
            tuple(
                _Component.of(
                    places_mm, moved_mm[:, k], sigma_mm[:, k], spacing_mm * a, b * spread[k]
                )
                for k in (0, 1)
            )
            for a in _LENGTHS
            for b in _DEVIATIONS
        ]
        x, y = max(tried, key=lambda two: two[0].log_likelihood + two[1].log_likelihood)
        return cls(places_mm, x.length_mm, (x, y))

    def at(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return displacements and their standard uncertainties, both (point, xy) mm."""
        both = [part.at(self.places_mm, points_mm) for part in self._parts]
        moved, sigma = (np.column_stack([part[k] for part in both]) for k in (0, 1))
        return moved, sigma


@dataclass(frozen=True, eq=False)
class _Component:
    """One component of the field: coefficients of the affine function and of the process."""

    length_mm: float
    deviation_mm: float
    log_likelihood: float
    affine: FloatArray
    weights: FloatArray
    inverse: FloatArray
    affine_covariance: FloatArray

    @classmethod
    def of(
        cls,
        places: FloatArray,
        moved: FloatArray,
        sigma: FloatArray,
        length: float,
        deviation: float,
    ) -> "_Component":
        covariance = _covariance(places, places, length, deviation) + np.diag(sigma**2)
        covariance += np.eye(len(places)) * (1e-6 * deviation) ** 2
        factor = cho_factor(covariance, lower=True)
        basis = _basis(places, places)
        inverse = cho_solve(factor, np.eye(len(places)))
        of_affine = np.linalg.inv(basis.T @ inverse @ basis)
        affine = of_affine @ (basis.T @ (inverse @ moved))
        off = moved - basis @ affine
        weights = inverse @ off
        log_determinant = 2.0 * np.sum(np.log(np.diag(factor[0])))
        marginal = np.linalg.slogdet(of_affine)[1]
        likelihood = -0.5 * (float(off @ weights) + log_determinant - marginal)
        return cls(length, deviation, float(likelihood), affine, weights, inverse, of_affine)

    def at(self, places: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        between = _covariance(points, places, self.length_mm, self.deviation_mm)
        here, there = _basis(points, places), _basis(places, places)
        value = here @ self.affine + between @ self.weights
        gain = between @ self.inverse
        rest = here - gain @ there
        variance = self.deviation_mm**2 - np.sum(gain * between, axis=1)
        variance += np.sum((rest @ self.affine_covariance) * rest, axis=1)
        return np.asarray(value), np.sqrt(np.maximum(variance, 0.0))


def _basis(points: FloatArray, places: FloatArray) -> FloatArray:
    """Return the terms of an affine function about the middle of the dots, (point, 3)."""
    return np.column_stack([np.ones(len(points)), points - places.mean(axis=0)])


def _covariance(one: FloatArray, other: FloatArray, length: float, deviation: float) -> FloatArray:
    squared = np.sum((one[:, None] - other[None]) ** 2, axis=2)
    return np.asarray(deviation**2 * np.exp(-0.5 * squared / length**2))
