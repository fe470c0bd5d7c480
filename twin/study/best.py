"""The best designs of a study: the Pareto front of what is to become small or large."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import InputError
from twin.config.study import Objective
from twin.study.table import StudyTable

MOST_DESIGNS = 6

Row = Mapping[str, Any]


def objective_of(text: str) -> Objective:
    """Read "METRIC" (to be small) or "+METRIC" (to be large), as on a command line."""
    goal: Any = "maximise" if text.startswith("+") else "minimise"
    return Objective(metric=text.removeprefix("+"), goal=goal)


def best_rows(rows: Sequence[Row], objectives: Sequence[Objective]) -> list[Row]:
    """Return the feasible rows that no other beats in one objective without losing in another.

    Rows of the front come by the first objective, best first.

    Raises
    ------
    InputError
        No finished, feasible case has all objectives.
    """
    names = [objective.metric for objective in objectives]
    usable = usable_rows(rows, objectives)
    if not usable:
        known = sorted({n for row in rows for n, v in row.items() if isinstance(v, float)})
        raise InputError(
            f"no feasible case has {', '.join(names)}; there are {', '.join(known) or 'no figures'}"
        )
    costs = np.array([[_cost(row, one) for one in objectives] for row in usable])
    front = [row for row, kept in zip(usable, on_front(costs), strict=True) if kept]
    return sorted(front, key=lambda row: _cost(row, objectives[0]))


def ranked_rows(rows: Sequence[Row], objectives: Sequence[Objective]) -> list[Row]:
    """Return the Pareto front; for a single objective all feasible rows, best first.

    Raises
    ------
    InputError
        No finished, feasible case has all objectives.
    """
    front = best_rows(rows, objectives)
    if len(objectives) > 1:
        return front
    return sorted(usable_rows(rows, objectives), key=lambda row: _cost(row, objectives[0]))


def goals_of(table: StudyTable, asked: Sequence[Objective] = ()) -> list[Objective]:
    """Return what makes a design good: what is asked for, what the study says, or a small error."""
    named = [name for name in table.metrics if "rmse" in name or "error" in name]
    first = (*named, *table.metrics)[0]
    return list(asked or table.record.study.goals) or [Objective(metric=first)]


def designs_of(rows: Sequence[Row], axes: Sequence[str]) -> list[Row]:
    """Return the first rows of different designs, as many as a report shows in pictures."""
    found: dict[str, Row] = {}
    for row in rows:
        found.setdefault(repr([row[axis] for axis in axes if axis != "seed"]), row)
    return list(found.values())[:MOST_DESIGNS]


def usable_rows(rows: Sequence[Row], objectives: Sequence[Objective]) -> list[Row]:
    """Return the feasible rows that have all objectives: who measured nothing cannot win."""
    names = [objective.metric for objective in objectives]
    return [
        row for row in rows if row.get("feasible") and all(is_number(row.get(n)) for n in names)
    ]


def on_front(costs: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which rows (case,) of costs (case, objective) no other row dominates."""
    kept = np.ones(len(costs), bool)
    for i, cost in enumerate(costs):
        better = np.all(costs <= cost, axis=1) & np.any(costs < cost, axis=1)
        kept[i] = not better.any()
    return kept


def is_number(value: object) -> TypeGuard[float]:
    """Tell whether a cell is a figure: neither text nor yes or no nor empty."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _cost(row: Row, objective: Objective) -> float:
    value = float(row[objective.metric])
    return value if objective.goal == "minimise" else -value
