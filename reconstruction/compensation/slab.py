"""The object under a thick slab, coated on its far face, from the coat: its numbers, no free form.

What a slab shows of waves much shorter than its thickness is under any noise, so no free form can
be had. What can is the few numbers of an object whose form is known: of a ball its diameter and
place. They are those with which the layer's own solution comes nearest to the measured heights z,

    min  sum of ((z - z(t)) / sigma)^2  +  sum of ((t - known) / sigma_t)^2,

t: the object's numbers, the travel, and what of layer, load and frame is known with an uncertainty.
Where the residuals are larger than their sigma, or shared between neighbours, heights weigh that
much less beside what is known. The covariance is that of the linearised problem, (J^T W J)^-1; with
the cells' own sigma, as of white noise, it is the Cramer-Rao bound.

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

# Of the sum of squares, some ten thousand: a tenth of a standard uncertainty. A contact that counts
# whole cells leaves steps as small as that undecided.
_CONVERGED = 2e-7
_MOST_MODELS = 60
_MOST_TURNS = 5
_TOO_FAR = 10.0
# Of a number's range: so near to an end is at the end.
_AT_THE_END = 1e-3
# Residuals that are as large as their sigma and independent, to this factor of variance.
_AGREES = 1.3


@dataclass(frozen=True)
class FittedNumber:
    """A number that is fitted.

    Attributes
    ----------
    start, low, high : where to begin, and what is allowed
    known, sigma : what is known of it beforehand and how well; sigma infinite: nothing
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
    """What a layer's solution says of the coat for one set of numbers.

    Attributes
    ----------
    coat_mm : (row, col) heights
    force_n : of the object, along z
    slopes : their derivatives, found when asked for
    theory_mm : fields (row, col), each a standard uncertainty of all heights together that the
        solution's own theory has
    """

    coat_mm: FloatArray
    force_n: float
    slopes: Callable[[], CoatSlopes]
    theory_mm: tuple[FloatArray, ...] = ()


SlabModel = Callable[[FloatArray], SlabCoat]
"""Numbers (n,) to the coat on the relief's cells; FitError where there is no such press."""


@dataclass(frozen=True)
class KnownForce:
    """Force of the object along z that a gauge told, and its standard uncertainty."""

    force_n: float
    sigma_n: float


@dataclass(frozen=True, eq=False)
class FittedSlab:
    """The numbers of an object under a slab.

    Attributes
    ----------
    values, covariance : (n,) and (n, n), of the unknowns in their order
    bound : (n, n) covariance by the cells' own sigma alone: the Cramer-Rao bound, if points are
        independent
    coat, slopes : by the values found
    misfit_mm : RMS of measured less modelled heights
    chi_square : of the heights per degree of freedom
    shared_cells : over how many cells neighbours share one error
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
        """Standard uncertainty of the force by the unknowns."""
        slope = self.slopes.force_n
        return float(np.sqrt(slope @ self.covariance @ slope))

    def _place(self, name: str) -> int:
        return [one.name for one in self.unknowns].index(name)


@dataclass(frozen=True, eq=False, repr=False)
class CompensatedSlab(PresentedObject):
    """The object under a slab and its contact; all (row, col) on the relief's cells.

    Attributes
    ----------
    relief : the measured coat
    contact : bool
    touched_mm : world z of the touched face: of the object where it touches
    fitted : the numbers that it was found by
    force_theory : share of the force that the linear slab may be wrong by
    """

    relief: Relief
    contact: BoolArray
    pressure_kpa: FloatArray
    touched_mm: FloatArray
    fitted: FittedSlab
    force_theory: float

    @property
    def sure(self) -> BoolArray:
        """The contact, (row, col): its edge is the solution's own."""
        return self.contact

    @property
    def edge_sigma_mm(self) -> FloatArray:
        """No sheet is bent over an edge: 0, (row, col)."""
        return np.zeros(self.contact.shape)

    @property
    def normal(self) -> FloatArray:
        """Unit normals along which the object lies behind the coat, (row, col, xyz): upwards."""
        return np.broadcast_to(np.array([0.0, 0.0, 1.0]), self.relief.points_mm.shape)

    @property
    def object_mm(self) -> FloatArray:
        """Points of the touched face, (row, col, xyz)."""
        x, y = np.meshgrid(self.relief.x_mm, self.relief.y_mm)
        return np.stack((x, y, self.touched_mm), axis=-1)

    @property
    def blur_mm(self) -> float:
        """How far the contact's edge is blurred: it is the solution's own."""
        return 0.0

    @property
    def area_mm2(self) -> float:
        """Area of the contact seen along z."""
        return float(self.contact.sum()) * self.relief.cell_area_mm2

    @property
    def force_n(self) -> float:
        """Force of the object along z."""
        return self.fitted.coat.force_n

    @property
    def force_sigma_n(self) -> float:
        """Standard uncertainty of the force."""
        return float(np.hypot(self.fitted.force_sigma_n, self.force_theory * self.force_n))

    @property
    def layer_moves_mm(self) -> list[FloatArray]:
        """What of the layer is uncertain is in the numbers' covariance."""
        return []

    def theory_mm(self, _: float) -> float:
        """Return what the theory leaves out of a radius: it is in the numbers' covariance."""
        return 0.0


def fit_under_slab(
    relief: Relief,
    models: Sequence[SlabModel],
    unknowns: Sequence[FittedNumber],
    force: KnownForce | None = None,
) -> FittedSlab:
    """Find the numbers with which the layer's solution is nearest to the measured heights.

    Parameters
    ----------
    models : from coarse to fine grids, each begun where the one before it ended; by what the last
        one finds elsewhere than that it counts as uncertain itself

    Raises
    ------
    FitError : no press with numbers in their ranges, or numbers that the heights cannot tell apart
    """
    values, before = np.array([one.start for one in unknowns]), None
    # The heights weigh little at first, so that what is known keeps the start from running away.
    shared = _Weighing(relief, models[0], tuple(unknowns), force, 1.0).apart(values)
    for model in models:
        before = values
        for _ in range(_MOST_TURNS):
            problem = _Weighing(relief, model, tuple(unknowns), force, shared)
            values = _settled(problem, values)
            found_apart = problem.apart(values)
            if shared / _AGREES <= found_apart <= _AGREES * shared:
                break
            shared = found_apart
    _check_inside(values, unknowns)
    found = problem.told(values)
    if len(models) < 2:
        return found
    moved = values - before
    return replace(found, covariance=found.covariance + np.outer(moved, moved))


def _check_inside(values: FloatArray, unknowns: Sequence[FittedNumber]) -> None:
    """Refuse a number of which nothing was known and that ran as far as it may."""
    for one, value in zip(unknowns, values.tolist(), strict=True):
        room = min(value - one.low, one.high - value)
        if np.isinf(one.sigma) and room < _AT_THE_END * (one.high - one.low):
            raise FitError(
                f"slab: {one.name} ran to {value:.4g}, allowed {one.low:.4g} to {one.high:.4g}; "
                "begin nearer to the object, or tell the travel (press.depth_mm, sigma.depth_mm)"
            )


def bound_under_slab(
    relief: Relief,
    model: SlabModel,
    unknowns: Sequence[FittedNumber],
    force: KnownForce | None = None,
) -> FloatArray:
    """Return the Cramer-Rao bound of numbers that are where they begin: a covariance (n, n).

    Parameters
    ----------
    relief : its sigmas are of independent points; its heights are not looked at

    Raises
    ------
    FitError : no such press, or numbers that the heights cannot tell apart
    """
    slopes = _Weighing(relief, model, tuple(unknowns), force, 1.0).slopes(
        np.array([one.start for one in unknowns])
    )
    return _inverse(slopes.T @ slopes, tuple(unknowns))


def _settled(problem: "_Weighing", start: FloatArray) -> FloatArray:
    """Return the numbers with the least sum of squares, near a start."""
    low, high = (
        np.array([getattr(one, name) for one in problem.unknowns]) for name in ("low", "high")
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
            f"slab: not settled within {_MOST_MODELS} presses; tell the travel "
            "(press.depth_mm, sigma.depth_mm), or begin nearer to the object"
        )
    return np.asarray(done.x)


class _Weighing:
    """Residuals over their sigmas, and their slopes: heights, known numbers, force."""

    def __init__(
        self,
        relief: Relief,
        model: SlabModel,
        unknowns: tuple[FittedNumber, ...],
        force: KnownForce | None,
        apart: float,
    ) -> None:
        self.relief, self.unknowns, self.force = relief, unknowns, force
        self._widening = apart
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
            return self._far  # no such press: a step too far
        rows = [self._over_sigma(coat.coat_mm - self.relief.heights_mm)]
        rows.append((values - self._known) / self._sigma)
        if self.force is not None:
            rows.append(np.array([(coat.force_n - self.force.force_n) / self.force.sigma_n]))
        found = np.concatenate(rows)
        if self._far is None:
            self._far = np.full_like(found, _TOO_FAR * (1 + float(np.abs(found).max())))
        return found

    def slopes(self, values: FloatArray) -> FloatArray:
        """Return (m, n) their derivatives."""
        found = self._solved(values).slopes()
        rows = [np.stack([self._over_sigma(one) for one in found.coat_mm], axis=-1)]
        rows.append(np.diag(1 / self._sigma))
        if self.force is not None:
            rows.append(found.force_n[None] / self.force.sigma_n)
        return np.concatenate(rows)

    def told(self, values: FloatArray) -> FittedSlab:
        """Return what was found, with its covariance."""
        coat, slopes = self._solved(values), self.slopes(values)
        cells = int(self._weighted.sum())
        chi_square, shared = self._spread(values)
        heights, known = (part.T @ part for part in (slopes[:cells], slopes[cells:]))
        found = _inverse(heights + known, self.unknowns)
        # By the noise that is there, of an estimate with the weights that it was made with.
        covariance = found @ (heights * chi_square * shared / self._widening + known) @ found
        for field in coat.theory_mm:
            shift = found @ slopes[:cells].T @ self._over_sigma(field)
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

    def apart(self, values: FloatArray) -> float:
        """Return by how much the heights' information is less than their sigma's: a variance."""
        chi_square, shared = self._spread(values)
        return max(chi_square * shared, 1.0)

    def _spread(self, values: FloatArray) -> tuple[float, float]:
        """Return chi-square per degree of freedom, and over how many cells an error is shared."""
        rest = self._on_cells(self._solved(values).coat_mm - self.relief.heights_mm)
        variance, area = variance_and_area(rest, self._weighted, self.relief.cell_area_mm2)
        cells = int(self._weighted.sum())
        freedom = cells / max(cells - len(values), 1)
        return variance * freedom, area / self.relief.cell_area_mm2

    @cached_property
    def _known(self) -> FloatArray:
        return np.array([one.known for one in self.unknowns])

    @cached_property
    def _sigma(self) -> FloatArray:
        return np.array([one.sigma for one in self.unknowns])

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
    """Invert a normal matrix, whose numbers have different units."""
    scale = np.sqrt(np.diag(normal))
    if (scale == 0).any():
        blind = unknowns[int(np.argmin(scale))].name
        raise FitError(f"slab: the coat tells nothing of {blind}; leave it out of what is fitted")
    correlation = normal / np.outer(scale, scale)
    if np.linalg.cond(correlation) > 1e10:
        names = ", ".join(one.name for one in unknowns)
        raise FitError(f"slab: the coat cannot tell apart {names}; fit fewer, or tell the travel")
    return np.asarray(np.linalg.inv(correlation) / np.outer(scale, scale))
