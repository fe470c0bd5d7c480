"""Search down the derivatives of a bound: each point is a case, whose result holds its derivatives.

Fields that move neither press nor camera are differentiated (`twin.pipeline.gradients`); by others
the bound is seen from a second case beside. Nothing of the search is stored: run again, it asks for
the same points, finds them in the store and goes on.
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
_BESIDE = 1e-3  # of an axis
_TOLERANCE = 1e-5  # of the logarithm of the objective, and of a bound's excess by its limit
_INSIDE = 2.0 * _TOLERANCE
"""How far within a bound, by its limit, the search aims: what it accepts is then within."""


def descend(record: StudyRecord, folder: Path, run: RunCases) -> list[SweepOutcome]:
    """Search until the bound falls no more, or as many cases are measured as are allowed.

    Parameters
    ----------
    record : with sampling.method = "gradient"
    folder : the store
    run : computes a batch

    Raises
    ------
    InputError : the objective has no derivatives, a constraint is on a figure, or no first point is
        a valid experiment
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
    """All cases that are allowed are measured."""


@dataclass
class _BoundDescent:
    """Values and slopes of the logarithm of the objective over the unit cube of the axes."""

    record: StudyRecord
    plan: GradientSearch
    store: Store
    run: RunCases
    outcomes: list[SweepOutcome] = field(default_factory=list)
    _found: dict[bytes, tuple[float, FloatArray]] = field(default_factory=dict)
    _places: list[FloatArray] = field(default_factory=list)

    def from_place(self, start: FloatArray) -> None:
        """Search from one place of the unit cube."""
        minimize(
            lambda place: self.at(place)[0],
            start,
            jac=lambda place: self.at(place)[1],
            bounds=[(0.0, 1.0)] * len(start),
            constraints=[self._bound(one, side) for one, side in self._sides()],
            method="SLSQP",
            options={"ftol": _TOLERANCE, "maxiter": self.plan.evaluations},
        )

    def at(self, place: FloatArray) -> tuple[float, FloatArray]:
        """Return the logarithm of the objective, and its slope by each axis' share."""
        place = np.clip(place, 0.0, 1.0)
        key = place.tobytes()
        if key not in self._found:
            self._found[key] = self._measured(place)
        return self._found[key]

    def _measured(self, place: FloatArray) -> tuple[float, FloatArray]:
        asked = [place]
        named = self._case(place).conditions.derivatives
        differed = [n for n, a in enumerate(self.record.study.axis) if a.path not in named]
        for axis in differed:
            beside = place.copy()
            beside[axis] += _BESIDE if place[axis] < 0.5 else -_BESIDE
            asked.append(beside)
        figures = self._figures_of(asked)
        sign = 1.0 if self.plan.objective.goal == "minimise" else -1.0
        value = _number(figures[0], self.plan.objective.metric)
        slope = np.zeros(len(place))
        for n, one in enumerate(self.record.study.axis):
            if n not in differed:
                name = f"{self.plan.objective.metric}_by_{one.path}"
                slope[n] = _number(figures[0], name) / value * self._stretch(n, place[n])
        for n, beside, other in zip(differed, asked[1:], figures[1:], strict=True):
            change = np.log(_number(other, self.plan.objective.metric) / value)
            slope[n] = change / (beside[n] - place[n])
        return sign * float(np.log(value)), sign * slope

    def _stretch(self, axis: int, share: float) -> float:
        """Return the change of an axis' value by its share."""
        one = self.record.study.axis[axis]
        assert one.low is not None  # the validator's
        assert one.high is not None
        if one.scale == "log":
            ratio = float(one.high / one.low)
            return float(one.low * ratio**share * np.log(ratio))
        return float(one.high - one.low)

    def _figures_of(self, places: list[FloatArray]) -> list[dict[str, object]]:
        """Measure places that are new, and return the figures of all."""
        if len(self._places) + len(places) > self.plan.evaluations:
            raise _SpentError
        self._places += places
        points = tuple(point_at(self.record.study.axis, place) for place in self._places)
        cases = [self._case(place) for place in places]
        record = replace(self.record, points=points)
        self.outcomes.append(self.run(record, Cases(tuple(cases), 0)))
        found = [self.store.read(case.digest) or {} for case in cases]
        return [one.get("metrics") or {} for one in found]

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
