"""Fit the parameters of an object of known form under a thick slab to the slab's coated far face.

A slab transmits waves much shorter than its thickness with amplitudes below any noise, so an object
of unknown form cannot be measured. The few parameters of an object of known form can, for example
the diameter and position of a ball. They minimise the misfit between the layer's solution z(t) and
the measured heights z,

    min  sum of ((z - z(t)) / sigma)^2  +  sum of ((t - known) / sigma_t)^2,

where t are the parameters of the object, the travel, and the uncertain values of layer, load and
frame; `known` and sigma_t are their prior values and standard uncertainties.
If the residuals are larger than sigma or correlated between neighbours, the weight of the heights
relative to the prior values is reduced accordingly. The covariance is that of the linearised
problem, (J^T W J)^-1. For independent errors with the cells' sigma it is the Cramer-Rao bound.

Arrays over cells are (row, col); lengths are in mm, pressures in kPa.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from reconstruction.arrays import FloatArray
from reconstruction.compensation.fitted_slab import (
    FittedNumber,
    FittedSlab,
    KnownForce,
    SlabCoat,
    SlabModel,
)
from reconstruction.compensation.relief import Relief
from reconstruction.compensation.scatter import variance_and_area
from reconstruction.errors import FitError

# Relative change of the sum of squares (about 10,000) at which the fit ends: it corresponds to
# 0.1 standard uncertainties. The contact consists of whole cells, so smaller changes are noise.
_CONVERGED = 2e-7
_MOST_MODELS = 60
_MOST_TURNS = 5
_TOO_FAR = 10.0
# A value is at the end of its range if it is nearer to the end than this share of the range.
_AT_THE_END = 1e-3
# Factor within which two variance factors count as equal, so that the weights are not updated.
_AGREES = 1.3


def fit_under_slab(
    relief: Relief,
    models: Sequence[SlabModel],
    unknowns: Sequence[FittedNumber],
    force: KnownForce | None = None,
) -> FittedSlab:
    """Fit the unknowns for which the layer's solution is nearest to the measured heights.

    Parameters
    ----------
    models : solutions of the layer, from coarse to fine grids; each fit starts at the result of
        the previous one. The square of the difference between the last two results is added to
        the covariance
    unknowns : parameters to be fitted
    force : known force of the object; None: unknown

    Raises
    ------
    FitError : no press exists with unknowns in their ranges, the fit does not converge, or the
        heights do not separate the unknowns
    """
    values, before = np.array([unknown.start for unknown in unknowns]), None
    # A small weight of the heights at first: prior values keep the numbers near the start.
    widening = _Weighing(relief, models[0], tuple(unknowns), force, 1.0).widening(values)
    for model in models:
        before = values
        for _ in range(_MOST_TURNS):
            problem = _Weighing(relief, model, tuple(unknowns), force, widening)
            values = _settled(problem, values)
            updated = problem.widening(values)
            if widening / _AGREES <= updated <= _AGREES * widening:
                break
            widening = updated
    _check_inside(values, unknowns)
    fitted = problem.result(values)
    if len(models) < 2:
        return fitted
    moved = values - before
    return replace(fitted, covariance=fitted.covariance + np.outer(moved, moved))


def _check_inside(values: FloatArray, unknowns: Sequence[FittedNumber]) -> None:
    """Raise FitError if an unknown without a prior is at an end of its range."""
    for unknown, value in zip(unknowns, values.tolist(), strict=True):
        room = min(value - unknown.low, unknown.high - value)
        if np.isinf(unknown.sigma) and room < _AT_THE_END * (unknown.high - unknown.low):
            raise FitError(
                f"slab: {unknown.name} ran to {value:.4g}, allowed {unknown.low:.4g} to "
                f"{unknown.high:.4g}; "
                "start nearer to the object, or state the travel (press.depth_mm, sigma.depth_mm)"
            )


def bound_under_slab(
    relief: Relief,
    model: SlabModel,
    unknowns: Sequence[FittedNumber],
    force: KnownForce | None = None,
) -> FloatArray:
    """Return the Cramer-Rao bound of unknowns at their starting values: a covariance (n, n).

    Parameters
    ----------
    relief : gives the cells and their sigmas; its heights are not used. The errors of different
        cells are assumed independent
    force : known force of the object; None: unknown

    Raises
    ------
    FitError : no press exists at the starting values, or the heights do not separate the unknowns
    """
    slopes = _Weighing(relief, model, tuple(unknowns), force, 1.0).slopes(
        np.array([unknown.start for unknown in unknowns])
    )
    return _inverse(slopes.T @ slopes, tuple(unknowns))


def _settled(problem: "_Weighing", start: FloatArray) -> FloatArray:
    """Return the values (n,) of the unknowns with the least sum of squares, from a starting point.

    Raises
    ------
    FitError : the fit does not converge
    """
    low, high = (
        np.array([getattr(unknown, name) for unknown in problem.unknowns])
        for name in ("low", "high")
    )
    done = least_squares(
        problem.residuals,
        np.clip(start, low, high),
        problem.slopes,
        bounds=(low, high),
        x_scale="jac",
        ftol=_CONVERGED,
        xtol=_CONVERGED,
        gtol=None,
        max_nfev=_MOST_MODELS,
    )
    if not done.success:
        raise FitError(
            f"slab: not converged within {_MOST_MODELS} presses; state the travel "
            "(press.depth_mm, sigma.depth_mm), or start nearer to the object"
        )
    return np.asarray(done.x)


class _Weighing:
    """Residuals of the fit over their sigmas, and their derivatives by the unknowns.

    The residuals are those of the heights, of the prior values and, if known, of the force. The
    variance of the heights is multiplied by the factor `widening`, which reduces their weight.
    """

    def __init__(
        self,
        relief: Relief,
        model: SlabModel,
        unknowns: tuple[FittedNumber, ...],
        force: KnownForce | None,
        widening: float,
    ) -> None:
        self.relief, self.unknowns, self.force = relief, unknowns, force
        self._widening = widening
        self._model, self._at = model, np.full(len(unknowns), np.nan)
        self._coat: SlabCoat | None = None
        self._far: FloatArray | None = None
        self._weighted = relief.measured & (relief.sigma_mm > 0)
        if int(self._weighted.sum()) <= len(unknowns):
            raise FitError("slab: found fewer measured cells than numbers to fit")

    def residuals(self, values: FloatArray) -> FloatArray:
        """Return the (m,) residuals over sigma: heights, prior values, force.

        If no press exists with these values, all residuals are large, so that the fit reduces its
        step. At the first call FitError is raised instead.
        """
        try:
            coat = self._solved(values)
        except FitError:
            if self._far is None:
                raise
            return self._far  # no press exists with these values: the step was too large
        rows = [self._over_sigma(coat.coat_mm - self.relief.heights_mm)]
        rows.append((values - self._known) / self._sigma)
        if self.force is not None:
            rows.append(np.array([(coat.force_n - self.force.force_n) / self.force.sigma_n]))
        stacked = np.concatenate(rows)
        if self._far is None:
            self._far = np.full_like(stacked, _TOO_FAR * (1 + float(np.abs(stacked).max())))
        return stacked

    def slopes(self, values: FloatArray) -> FloatArray:
        """Return the derivatives of the residuals by the unknowns, (m, n)."""
        coat_slopes = self._solved(values).slopes()
        rows = [np.stack([self._over_sigma(slope) for slope in coat_slopes.coat_mm], axis=-1)]
        rows.append(np.diag(1 / self._sigma))
        if self.force is not None:
            rows.append(coat_slopes.force_n[None] / self.force.sigma_n)
        return np.concatenate(rows)

    def result(self, values: FloatArray) -> FittedSlab:
        """Return the result of the fit at the given values of the unknowns, with the covariance."""
        coat, slopes = self._solved(values), self.slopes(values)
        cells = int(self._weighted.sum())
        chi_square, shared = self._spread(values)
        heights, known = (part.T @ part for part in (slopes[:cells], slopes[cells:]))
        inverse = _inverse(heights + known, self.unknowns)
        # Covariance for the actual noise, of an estimate with the weights used in the fit.
        covariance = inverse @ (heights * chi_square * shared / self._widening + known) @ inverse
        for field in coat.theory_mm:
            shift = inverse @ slopes[:cells].T @ self._over_sigma(field)
            covariance = covariance + np.outer(shift, shift)
        misfit = (coat.coat_mm - self.relief.heights_mm)[self._weighted]
        return FittedSlab(
            unknowns=self.unknowns,
            values=values,
            covariance=covariance,
            bound=_inverse(heights * self._widening + known, self.unknowns),
            coat=coat,
            slopes=coat.slopes(),
            misfit_mm=float(np.sqrt(np.mean(misfit**2))),
            chi_square=chi_square,
            shared_cells=shared,
        )

    def widening(self, values: FloatArray) -> float:
        """Return the factor, at least 1, by which the variance of the heights is to be multiplied.

        It is chi-square per degree of freedom times the number of cells that share an error.
        """
        chi_square, shared = self._spread(values)
        return max(chi_square * shared, 1.0)

    def _spread(self, values: FloatArray) -> tuple[float, float]:
        """Return the heights' chi-square per degree of freedom, and the cells that share an error.

        The second value is the correlation area of the residuals as a number of cells.
        """
        rest = self._on_cells(self._solved(values).coat_mm - self.relief.heights_mm)
        variance, area = variance_and_area(rest, self._weighted, self.relief.cell_area_mm2)
        cells = int(self._weighted.sum())
        freedom = cells / max(cells - len(values), 1)
        return variance * freedom, area / self.relief.cell_area_mm2

    @cached_property
    def _known(self) -> FloatArray:
        return np.array([unknown.known for unknown in self.unknowns])

    @cached_property
    def _sigma(self) -> FloatArray:
        return np.array([unknown.sigma for unknown in self.unknowns])

    def _solved(self, values: FloatArray) -> SlabCoat:
        if self._coat is None or not np.array_equal(values, self._at):
            self._at, self._coat = values.copy(), self._model(values)
        return self._coat

    def _on_cells(self, heights_mm: FloatArray) -> FloatArray:
        sigma = np.where(self._weighted, self.relief.sigma_mm, 1.0)
        return np.where(self._weighted, heights_mm / sigma, 0.0)

    def _over_sigma(self, heights_mm: FloatArray) -> FloatArray:
        return np.asarray(self._on_cells(heights_mm)[self._weighted] / np.sqrt(self._widening))


def _inverse(normal: FloatArray, unknowns: tuple[FittedNumber, ...]) -> FloatArray:
    """Invert the normal matrix of unknowns with different units, (n, n).

    Raises
    ------
    FitError : the heights do not depend on an unknown, or do not separate the unknowns
    """
    scale = np.sqrt(np.diag(normal))
    if (scale == 0).any():
        blind = unknowns[int(np.argmin(scale))].name
        raise FitError(f"slab: the coat does not depend on {blind}; remove it from the fit")
    correlation = normal / np.outer(scale, scale)
    if np.linalg.cond(correlation) > 1e10:
        names = ", ".join(unknown.name for unknown in unknowns)
        raise FitError(f"slab: the coat does not separate {names}; fit fewer, or state the travel")
    return np.asarray(np.linalg.inv(correlation) / np.outer(scale, scale))
