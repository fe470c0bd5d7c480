"""Gradient search for the design with the smallest bound on an uncertainty.

A bound is the lower bound on the uncertainty of a dimension. Each point of the search is a case
with the derivatives of the bound in its result. Derivatives with respect to fields that change
neither press nor camera are computed by automatic differentiation (`twin.pipeline.gradients`).
Those with respect to all other fields are computed from the difference to a second case nearby.

The state of the search is not stored: a second run requests the same points, reads their results
from the store and continues.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.config import ConfigError
from twin.config.study import Constraint, GradientSearch
from twin.results.rows import is_number
from twin.study.cases import Case, Cases, cases_of, point_at, quantity
from twin.study.outcome import SweepOutcome
from twin.study.record import StudyRecord, unbounded
from twin.study.store import Store

RunCases = Callable[[StudyRecord, Cases], SweepOutcome]
_DIFFERENCE = 1e-3  # step of a difference, in shares of an axis
_TOLERANCE = 1e-5  # of the logarithm of the objective, and of the relative excess over a limit
_INSIDE = 2.0 * _TOLERANCE
"""Relative margin to the limit of a constraint, so that accepted points satisfy the limit."""


def descend(record: StudyRecord, folder: Path, run: RunCases) -> list[SweepOutcome]:
    """Search until the objective improves no more, or the allowed number of cases is measured.

    Parameters
    ----------
    record : study with sampling.method = "gradient"
    folder : the store
    run : function that computes a batch of cases into the store

    Raises
    ------
    InputError : the objective has no derivatives, a constraint limits a figure, or no start point
        is a valid experiment
    """
    plan = record.study.gradient
    if plan is None:
        raise InputError(f"{record.study.name}: has no [gradient]; use twin sweep as it is")
    search = _BoundDescent(record, plan, Store(folder), run)
    for start in _starts(plan.starts, len(record.study.axis), record.study.sampling.seed):
        try:
            search.from_place(start)
        except _SpentError:
            break
    return search.outcomes


def _starts(count: int, axes: int, seed: int) -> FloatArray:
    from scipy.stats import qmc

    further = qmc.Sobol(axes, rng=np.random.default_rng(seed)).random_base2(7)[: count - 1]
    return np.concatenate([np.full((1, axes), 0.5), further])


class _SpentError(Exception):
    """Exception that ends the search, as the allowed number of cases is measured."""


@dataclass
class _BoundDescent:
    """Logarithm of the objective and its gradient as functions of the axes' shares, 0 to 1."""

    record: StudyRecord
    plan: GradientSearch
    store: Store
    run: RunCases
    outcomes: list[SweepOutcome] = field(default_factory=list)
    _cached: dict[bytes, tuple[float, FloatArray]] = field(default_factory=dict)
    _places: list[FloatArray] = field(default_factory=list)

    def from_place(self, start: FloatArray) -> None:
        """Search from a start point (axis,), given in shares of the axes."""
        minimize(
            lambda place: self.at(place)[0],
            start,
            jac=lambda place: self.at(place)[1],
            bounds=[(0.0, 1.0)] * len(start),
            constraints=[self._bound(bound, side) for bound, side in self._sides()],
            method="SLSQP",
            options={"ftol": _TOLERANCE, "maxiter": self.plan.evaluations},
        )

    def at(self, place: FloatArray) -> tuple[float, FloatArray]:
        """Return the value to minimise and its gradient (axis,) at a point in shares of the axes.

        The value is the logarithm of the objective, with reversed sign for an objective to
        maximise.
        """
        place = np.clip(place, 0.0, 1.0)
        key = place.tobytes()
        if key not in self._cached:
            self._cached[key] = self._measured(place)
        return self._cached[key]

    def _measured(self, place: FloatArray) -> tuple[float, FloatArray]:
        points = [place]
        named = self._case(place).conditions.derivatives
        differed = [n for n, a in enumerate(self.record.study.axis) if a.path not in named]
        for axis in differed:
            shifted = place.copy()
            shifted[axis] += _DIFFERENCE if place[axis] < 0.5 else -_DIFFERENCE
            points.append(shifted)
        figures = self._figures_of(points)
        sign = 1.0 if self.plan.objective.goal == "minimise" else -1.0
        value = _number(figures[0], self.plan.objective.metric)
        slope = np.zeros(len(place))
        for n, axis_plan in enumerate(self.record.study.axis):
            if n not in differed:
                name = f"{self.plan.objective.metric}_by_{axis_plan.path}"
                slope[n] = _number(figures[0], name) / value * self._stretch(n, place[n])
        for n, shifted, shifted_figures in zip(differed, points[1:], figures[1:], strict=True):
            change = np.log(_number(shifted_figures, self.plan.objective.metric) / value)
            slope[n] = change / (shifted[n] - place[n])
        return sign * float(np.log(value)), sign * slope

    def _stretch(self, axis: int, share: float) -> float:
        """Return the derivative of the value on an axis with respect to the share of the axis."""
        span = self.record.study.axis[axis]
        assert span.low is not None  # the validator's
        assert span.high is not None
        if span.scale == "log":
            ratio = float(span.high / span.low)
            return float(span.low * ratio**share * np.log(ratio))
        return float(span.high - span.low)

    def _figures_of(self, places: list[FloatArray]) -> list[dict[str, object]]:
        """Measure the points, in shares of the axes, and return their figures."""
        if len(self._places) + len(places) > self.plan.evaluations:
            raise _SpentError
        self._places += places
        points = tuple(point_at(self.record.study.axis, place) for place in self._places)
        cases = [self._case(place) for place in places]
        record = replace(self.record, points=points)
        self.outcomes.append(self.run(record, Cases(tuple(cases), 0)))
        results = [self.store.read(case.digest) or {} for case in cases]
        return [result.get("metrics") or {} for result in results]

    def _case(self, place: FloatArray) -> Case:
        study = self.record.study
        point = point_at(study.axis, place)
        return cases_of(unbounded(study), self.record.base, [point]).run[0]

    def _sides(self) -> list[tuple[Constraint, str]]:
        sides = []
        for bound in self.record.study.constraint:
            if any("." not in name for name in (bound.value, bound.per) if name):
                raise InputError(
                    f"constraint: found a bound on '{bound.value}'; a gradient search takes bounds "
                    "on fields of the experiment"
                )
            sides += [(bound, side) for side in ("at_least", "at_most") if _side(bound, side)]
        return sides

    def _bound(self, bound: Constraint, side: str) -> dict[str, object]:
        limit = getattr(bound, side)
        sign = 1.0 if side == "at_least" else -1.0

        def within(place: FloatArray) -> float:
            try:
                number = quantity(self._case(np.clip(place, 0.0, 1.0)).experiment, {}, bound)
            except ConfigError:
                return -1.0
            scale = abs(limit) or 1.0
            return -1.0 if number is None else sign * (number - limit) / scale - _INSIDE

        return {"type": "ineq", "fun": within}


def _side(bound: Constraint, side: str) -> bool:
    return getattr(bound, side) is not None


def _number(figures: dict[str, object], name: str) -> float:
    value = figures.get(name)
    if not is_number(value):
        known = sorted(n.split("_by_")[0] for n in figures if "_by_" in n)
        raise InputError(
            f"gradient.objective: found no number of {name}; allowed "
            + (", ".join(dict.fromkeys(known)) or "a bound that the expected points fix")
        )
    return value
