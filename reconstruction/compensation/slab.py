"""The object under a thick slab, from its coated far face: numbers of a known form.

A slab transmits waves much shorter than its thickness with amplitudes below any noise, so the free
form of an object cannot be measured. The few numbers of an object of known form can: of a ball its
diameter and place. They minimise the misfit between the layer's solution z(t) and the heights z,

    min  sum of ((z - z(t)) / sigma)^2  +  sum of ((t - known) / sigma_t)^2,

t: the object's numbers, the travel, and the uncertain values of layer, load and frame.
If the residuals are larger than sigma or correlated between neighbours, the weight of the heights
relative to the prior values is reduced accordingly. The covariance is that of the linearised
problem, (J^T W J)^-1; with the cells' own sigma, as of white noise, it is the Cramer-Rao bound.

Arrays over cells are (row, col); lengths mm, pressures kPa.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.compensation.presentation import PresentedObject
from reconstruction.compensation.relief import Relief, variance_and_area
from reconstruction.errors import FitError

# Relative change of the sum of squares, some ten thousand: 0.1 x a standard uncertainty. A contact
# of whole cells makes smaller steps undecidable.
_CONVERGED = 2e-7
_MOST_MODELS = 60
_MOST_TURNS = 5
_TOO_FAR = 10.0
# Distance from an end of the range, over the range, that counts as at the end.
_AT_THE_END = 1e-3
# Factor of variance within which residuals agree with independent ones of size sigma.
_AGREES = 1.3


@dataclass(frozen=True)
class FittedNumber:
    """A number that is fitted.

    Attributes
    ----------
    start, low, high : starting value and allowed range
    known, sigma : prior value and its standard uncertainty; infinite sigma: no prior
    """

    name: str
    start: float
    low: float
    high: float
    known: float = 0.0
    sigma: float = np.inf


@dataclass(frozen=True, eq=False)
class CoatSlopes:
    """Derivatives by each number: (n, row, col) of the heights, and (n,) of the force."""

    coat_mm: FloatArray
    force_n: FloatArray


@dataclass(frozen=True, eq=False)
class SlabCoat:
    """Coat and force of a layer's solution for one set of numbers.

    Attributes
    ----------
    coat_mm : (row, col) heights
    force_n : of the object, along z
    slopes : function that computes their derivatives
    theory_mm : fields (row, col), each one a standard uncertainty common to all heights, from the
        model
    """

    coat_mm: FloatArray
    force_n: float
    slopes: Callable[[], CoatSlopes]
    theory_mm: tuple[FloatArray, ...] = ()


SlabModel = Callable[[FloatArray], SlabCoat]
"""Numbers (n,) to the coat on the relief's cells; FitError if there is no such press."""


@dataclass(frozen=True)
class KnownForce:
    """Force of the object along z from a gauge, and its standard uncertainty."""

    force_n: float
    sigma_n: float


@dataclass(frozen=True, eq=False)
class FittedSlab:
    """The numbers of an object under a slab.

    Attributes
    ----------
    values, covariance : (n,) and (n, n), of the unknowns in their order
    bound : (n, n) covariance from the cells' own sigma only: the Cramer-Rao bound for independent
        points
    coat, slopes : at the fitted values
    misfit_mm : RMS of measured minus modelled heights
    chi_square : of the heights per degree of freedom
    shared_cells : number of cells over which errors are correlated
    """

    unknowns: tuple[FittedNumber, ...]
    values: FloatArray
    covariance: FloatArray
    bound: FloatArray
    coat: SlabCoat
    slopes: CoatSlopes
    misfit_mm: float
    chi_square: float
    shared_cells: float

    def value(self, name: str) -> float:
        """Return a number by its name."""
        return float(self.values[self._place(name)])

    def sigma(self, name: str) -> float:
        """Return a number's standard uncertainty."""
        place = self._place(name)
        return float(np.sqrt(self.covariance[place, place]))

    def bound_sigma(self, name: str) -> float:
        """Return the least standard deviation that white noise of the cells' sigma allows."""
        place = self._place(name)
        return float(np.sqrt(self.bound[place, place]))

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of the force, N, due to the fitted unknowns."""
        slope = self.slopes.force_n
        return float(np.sqrt(slope @ self.covariance @ slope))

    def _place(self, name: str) -> int:
        return [unknown.name for unknown in self.unknowns].index(name)


@dataclass(frozen=True, eq=False, repr=False)
class CompensatedSlab(PresentedObject):
    """The object under a slab and its contact; all (row, col) on the relief's cells.

    Attributes
    ----------
    relief : the measured coat
    contact : bool
    touched_mm : world z of the touched face; in contact that of the object
    fitted : the fitted numbers
    force_theory : relative error of the force from the linear model
    """

    relief: Relief
    contact: BoolArray
    pressure_kpa: FloatArray
    touched_mm: FloatArray
    fitted: FittedSlab
    force_theory: float

    @property
    def sure(self) -> BoolArray:
        """The contact, (row, col): its edge is given by the solution, without blur."""
        return self.contact

    @property
    def edge_sigma_mm(self) -> FloatArray:
        """Zero, (row, col): a slab does not bend over an edge."""
        return np.zeros(self.contact.shape)

    @property
    def normal(self) -> FloatArray:
        """Unit normals from the object towards the coat, (row, col, xyz): upwards."""
        return np.broadcast_to(np.array([0.0, 0.0, 1.0]), self.relief.points_mm.shape)

    @property
    def object_mm(self) -> FloatArray:
        """Points of the touched face, (row, col, xyz)."""
        x, y = np.meshgrid(self.relief.x_mm, self.relief.y_mm)
        return np.stack((x, y, self.touched_mm), axis=-1)

    @property
    def blur_mm(self) -> float:
        """Zero: the contact's edge is given by the solution, without blur."""
        return 0.0

    @property
    def area_mm2(self) -> float:
        """Area of the contact projected along z."""
        return float(self.contact.sum()) * self.relief.cell_area_mm2

    @property
    def force_n(self) -> float:
        """Force of the object along z."""
        return self.fitted.coat.force_n

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of the force, N, with the error of the linear model."""
        return float(np.hypot(self.fitted.force_sigma_n, self.force_theory * self.force_n))

    @property
    def layer_moves_mm(self) -> list[FloatArray]:
        """Empty: the covariance of the numbers includes the layer's uncertain values."""
        return []

    def theory_mm(self, _: float) -> float:
        """Return 0: the covariance of the numbers includes the model's error."""
        return 0.0


def fit_under_slab(
    relief: Relief,
    models: Sequence[SlabModel],
    unknowns: Sequence[FittedNumber],
    force: KnownForce | None = None,
) -> FittedSlab:
    """Fit the numbers for which the layer's solution is nearest to the measured heights.

    Parameters
    ----------
    models : from coarse to fine grids; each fit starts at the result of the previous one. The
        difference between the last two results is added to the covariance

    Raises
    ------
    FitError : no press with numbers in their ranges, or numbers that the heights do not separate
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
    """Raise FitError if a number without a prior is at an end of its range."""
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
    """Return the Cramer-Rao bound of numbers at their starting values: a covariance (n, n).

    Parameters
    ----------
    relief : its sigmas are of independent points; its heights are not used

    Raises
    ------
    FitError : no such press, or numbers that the heights do not separate
    """
    slopes = _Weighing(relief, model, tuple(unknowns), force, 1.0).slopes(
        np.array([unknown.start for unknown in unknowns])
    )
    return _inverse(slopes.T @ slopes, tuple(unknowns))


def _settled(problem: "_Weighing", start: FloatArray) -> FloatArray:
    """Return the numbers with the least sum of squares, near a start."""
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
    """Residuals over their sigmas, and their derivatives: heights, prior values, force."""

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
        """Return (m,) residuals over sigma."""
        try:
            coat = self._solved(values)
        except FitError:
            if self._far is None:
                raise
            return self._far  # no such press: the step was too large
        rows = [self._over_sigma(coat.coat_mm - self.relief.heights_mm)]
        rows.append((values - self._known) / self._sigma)
        if self.force is not None:
            rows.append(np.array([(coat.force_n - self.force.force_n) / self.force.sigma_n]))
        stacked = np.concatenate(rows)
        if self._far is None:
            self._far = np.full_like(stacked, _TOO_FAR * (1 + float(np.abs(stacked).max())))
        return stacked

    def slopes(self, values: FloatArray) -> FloatArray:
        """Return the residuals' derivatives, (m, n)."""
        coat_slopes = self._solved(values).slopes()
        rows = [np.stack([self._over_sigma(slope) for slope in coat_slopes.coat_mm], axis=-1)]
        rows.append(np.diag(1 / self._sigma))
        if self.force is not None:
            rows.append(coat_slopes.force_n[None] / self.force.sigma_n)
        return np.concatenate(rows)

    def result(self, values: FloatArray) -> FittedSlab:
        """Return the fit at given values, with its covariance."""
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
        """Return the variance factor by which the heights' weight is reduced, at least 1."""
        chi_square, shared = self._spread(values)
        return max(chi_square * shared, 1.0)

    def _spread(self, values: FloatArray) -> tuple[float, float]:
        """Return chi-square per degree of freedom, and the number of cells that share an error."""
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
    """Invert a normal matrix of numbers with different units."""
    scale = np.sqrt(np.diag(normal))
    if (scale == 0).any():
        blind = unknowns[int(np.argmin(scale))].name
        raise FitError(f"slab: the coat does not depend on {blind}; remove it from the fit")
    correlation = normal / np.outer(scale, scale)
    if np.linalg.cond(correlation) > 1e10:
        names = ", ".join(unknown.name for unknown in unknowns)
        raise FitError(f"slab: the coat does not separate {names}; fit fewer, or state the travel")
    return np.asarray(np.linalg.inv(correlation) / np.outer(scale, scale))
