"""Verdict of a study: the design to build; if none is feasible, the nearest and a helpful change.

A design is a point of the axes; its repeats, which differ in the seed, count together. Of several
objectives the verdict takes the design on the Pareto front that is nearest to the best value of
each objective, on scales from 0 (best of the front) to 1 (worst of the front).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from twin.config.study import Objective
from twin.results.rows import is_number
from twin.study.feasibility import DESIGN, RESERVES, Reserve
from twin.study.sensitivity import Effect, adjusted_shares, effects_on, group_labels, groups_of
from twin.study.table import (
    Row,
    StudyTable,
    best_rows,
    costs_of,
    goals_of,
    nearest_rows,
    usable_rows,
)


@dataclass(frozen=True)
class Advice:
    """Change of an axis that would improve a reserve most.

    Attributes
    ----------
    axis : heading of the axis
    share : share of the variance of the reserve that the axis explains, 0 to 1; None: not known
    level : level of the axis with the largest mean reserve, over all other axes; for a feasible
        design its own value
    mean : this mean reserve
    side : "above" or "below" if the level is at an end of the axis; "near": it is between; "at":
        the axis has no order
    """

    axis: str
    share: float | None
    level: Any
    mean: float
    side: str


@dataclass(frozen=True)
class StudyVerdict:
    """Design that a study recommends, or the design nearest to its limits.

    Attributes
    ----------
    feasible : whether the design satisfies all conditions
    row : row of the design in the table; of repeats the first; None: no case has all objectives
    axes : headings of the settings of the design
    values : value of each objective by its name, mean of the repeats
    reserves : smallest reserve of the design to each condition, over its repeats
    objectives : figures that are minimised or maximised
    next : the design with the next best value of a single objective; None: there is none
    next_values : values of the objectives of that design
    designs, met : number of measured designs, and number of feasible designs
    front : number of designs on the Pareto front
    advice : axis that would help most; for a feasible design the axis with the largest effect, only
        if the design is at its end
    """

    feasible: bool
    row: Row | None
    axes: tuple[str, ...]
    values: Mapping[str, float]
    reserves: Mapping[str, Reserve]
    objectives: tuple[Objective, ...]
    next: Row | None
    next_values: Mapping[str, float]
    designs: int
    met: int
    front: int
    advice: Advice | None

    @property
    def least(self) -> tuple[str, Reserve] | None:
        """The condition with the smallest reserve relative to its limit; None: no condition."""
        known = sorted(self.reserves.items(), key=lambda item: item[1].relative)
        return known[0] if known else None

    @property
    def missed(self) -> dict[str, Reserve]:
        """The conditions that the design misses, the worst first."""
        worst_first = sorted(self.reserves.items(), key=lambda item: item[1].relative)
        return {name: reserve for name, reserve in worst_first if reserve.relative < 0}


def verdict_of(table: StudyTable, requested: Sequence[Objective] = ()) -> StudyVerdict:
    """Return the verdict of a study with at least one finished case.

    Parameters
    ----------
    requested : objectives; default: those of the study, or its first error figure
    """
    goals, done = goals_of(table, requested), table.done()
    usable = usable_rows(done, goals)
    if usable:
        return _feasible(table, goals, usable)
    nearest = nearest_rows(table.rows, goals)
    row = nearest[0] if nearest else None
    held = {} if row is None else _reserves(done, row)
    worst = min(held.items(), key=lambda item: item[1].relative, default=None)
    return StudyVerdict(
        feasible=False,
        row=row,
        axes=_axes(table),
        values={} if row is None else _values(done, row, goals),
        reserves=held,
        objectives=tuple(goals),
        next=None,
        next_values={},
        designs=len({row[DESIGN] for row in done}),
        met=0,
        front=0,
        advice=None if worst is None or row is None else _helpful(table, worst[0], row),
    )


def _feasible(table: StudyTable, goals: list[Objective], usable: list[Row]) -> StudyVerdict:
    done, front = table.done(), _one_each(best_rows(usable, goals))
    row = front[_nearest_to_ideal(costs_of(front, goals))]
    following = None
    if len(goals) == 1:
        order = np.argsort(costs_of(usable, goals)[:, 0], kind="stable")
        others = [usable[place] for place in order if usable[place][DESIGN] != row[DESIGN]]
        following = others[0] if others else None
    return StudyVerdict(
        feasible=True,
        row=row,
        axes=_axes(table),
        values=_values(usable, row, goals),
        reserves=_reserves(done, row),
        objectives=tuple(goals),
        next=following,
        next_values={} if following is None else _values(usable, following, goals),
        designs=len({row[DESIGN] for row in done}),
        met=len({row[DESIGN] for row in usable}),
        front=len(front),
        advice=_at_an_end(table, goals[0], row),
    )


def _axes(table: StudyTable) -> tuple[str, ...]:
    return tuple(axis for axis in table.axes if axis != "seed")


def _one_each(rows: Sequence[Row]) -> list[Row]:
    """Return the first row of each design."""
    return list({row[DESIGN]: row for row in reversed(rows)}.values())[::-1]


def _nearest_to_ideal(costs: FloatArray) -> int:
    """Return the row of costs (design, objective) nearest to the best value of each objective."""
    span = np.ptp(costs, axis=0)
    scaled = (costs - costs.min(axis=0)) / np.where(span > 0, span, 1.0)
    return int(np.argmin((scaled**2).sum(axis=1)))


def _values(rows: Sequence[Row], chosen: Row, goals: Sequence[Objective]) -> dict[str, float]:
    same = [row for row in rows if row[DESIGN] == chosen[DESIGN]]
    names = [goal.metric for goal in goals]
    known = {n: [float(row[n]) for row in same if is_number(row.get(n))] for n in names}
    return {name: float(np.mean(values)) for name, values in known.items() if values}


def _reserves(rows: Sequence[Row], chosen: Row) -> dict[str, Reserve]:
    held: dict[str, Reserve] = {}
    for row in rows:
        if row[DESIGN] == chosen[DESIGN]:
            for name, reserve in row[RESERVES].items():
                held[name] = min(held.get(name, reserve), reserve, key=lambda some: some.relative)
    return held


def _helpful(table: StudyTable, condition: str, nearest: Row) -> Advice | None:
    """Return the change that would increase the reserve to a condition most; None: none known."""
    rows = [row for row in table.done() if condition in row[RESERVES]]
    amounts = {id(row): row[RESERVES][condition].amount for row in rows}
    known = [row for row in rows if amounts[id(row)] is not None]
    values = [float(amounts[id(row)]) for row in known]
    for effect in _ranked(table, known, values):
        advice, is_best = _advice(table, effect, known, values, nearest)
        if advice.side in ("above", "below") or not is_best:
            return advice
    return None


def _ranked(table: StudyTable, rows: Sequence[Row], values: Sequence[float]) -> list[Effect]:
    """Return the effects of the axes on a value of rows, the largest first; empty: not known."""
    by_row = {id(row): value for row, value in zip(rows, values, strict=True)}
    cells = [by_row.get(id(row)) for row in table.rows]
    labels = {axis: group_labels(rows, axis) for axis in _axes(table)}
    effects = effects_on(table, cells) or adjusted_shares(values, labels)
    return sorted(effects, key=lambda effect: -effect.value)


def _advice(
    table: StudyTable, effect: Effect, rows: Sequence[Row], values: Sequence[float], design: Row
) -> tuple[Advice, bool]:
    """Return the advice on an axis, and whether a design is in the group with the best level."""
    by_row = {id(row): value for row, value in zip(rows, values, strict=True)}
    groups = [
        (level, group, [by_row[id(row)] for row in group if id(row) in by_row])
        for level, group in groups_of(table.done(), effect.axis)
    ]
    means = [(level, group, float(np.mean(known))) for level, group, known in groups if known]
    best = max(range(len(means)), key=lambda place: means[place][2])
    level, group, mean = means[best]
    ends = {0: "below", len(means) - 1: "above"}
    side = ends.get(best, "near") if is_number(level) and len(means) > 1 else "at"
    of_variance = table.record.study.sampling.method != "morris"
    share = effect.value if of_variance else None
    return Advice(effect.axis, share, level, mean, side), any(row is design for row in group)


def _at_an_end(table: StudyTable, goal: Objective, chosen: Row) -> Advice | None:
    """Return the axis with the largest effect on an objective if the design is at its end.

    The end of an axis with more than nine numbers is the outermost of its parts.
    """
    rows = [row for row in table.done() if is_number(row.get(goal.metric))]
    sign = 1.0 if goal.goal == "maximise" else -1.0
    values = [sign * float(row[goal.metric]) for row in rows]
    for effect in _ranked(table, rows, values)[:1]:
        advice, is_best = _advice(table, effect, rows, values, chosen)
        if is_best and advice.side in ("above", "below"):
            return replace(advice, level=chosen[effect.axis])
    return None
