"""Table of a study, with one row per case in the order of the study, and its best designs.

The best designs are the Pareto front of the objectives: designs that no other design dominates.
"""

import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import InputError
from reconstruction.writing import write_bytes, write_text
from twin.config.study import Constraint, Objective
from twin.extras import missing
from twin.files import creating
from twin.results import parts
from twin.results.figures import why_absent
from twin.results.rows import is_number
from twin.study.cases import Case
from twin.study.derived import DERIVED, with_derived
from twin.study.feasibility import (
    DESIGN,
    RESERVES,
    TOLERANCES,
    UNMET,
    feasibility_in_words,
    has_tolerances,
    reserves,
    shortfall,
    spread_over_repeats,
    unmet_conditions,
)
from twin.study.index import Entry, Index
from twin.study.record import StudyRecord, read_record
from twin.study.remarks import Remark, remarks_of
from twin.study.store import Store

_HEAD = ("case", "state", "reason", "feasible")


@dataclass(frozen=True, eq=False)
class StudyTable:
    """Table of settings and figures of all cases of a study.

    Attributes
    ----------
    record : the study and its base experiment
    axes : headings of the varied fields
    metrics : headings of the figures
    rows : one mapping by heading per case. A missing figure is None or absent. `reason` is the
        reason of a failure, or the conditions that an infeasible case does not meet
    cases : the cases in the order of the rows
    remarks : warnings of the cases, the most frequent first
    """

    record: StudyRecord
    axes: tuple[str, ...]
    metrics: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]
    cases: tuple[Case, ...]
    remarks: tuple[Remark, ...] = ()

    @property
    def conditions(self) -> tuple[str, ...]:
        """Titles of the conditions of feasibility: the constraints, and the tolerances if any."""
        judged = any(has_tolerances(case.experiment) for case in self.cases)
        bounds = tuple(bound.title for bound in self.record.study.constraint)
        return (*bounds, *((TOLERANCES,) if judged else ()))

    @property
    def columns(self) -> tuple[str, ...]:
        """All headings of the table, in the order of the columns."""
        return (*self.axes, *_HEAD, *self.metrics)

    def done(self) -> list[Mapping[str, Any]]:
        """Return the rows of the cases that were measured."""
        return [row for row in self.rows if row["state"] == "done"]


def read_table(folder: Path, derived: Iterable[str] = DERIVED) -> StudyTable:
    """Read the table of the study that was run last into a store.

    Parameters
    ----------
    folder : the store
    derived : names of derived figures to be added; pitches of a sheet take 0.1 s per case

    Raises
    ------
    InputError : the folder is not a store, or no case has a metric that the study names
    """
    store = Store(folder)
    if not store.exists():
        raise InputError(f"{folder}: is no store of a sweep; give the -o DIR of twin sweep")
    record = read_record(folder)
    cases, entries = record.cases().run, Index(store).entries()
    axes = tuple(dict.fromkeys(title for case in cases for title in case.settings))
    metrics = _metrics(record, cases, entries)
    bounds = record.study.constraint
    rows = [_row(case, entries.get(case.digest), bounds, derived) for case in cases]
    if record.study.repeats > 1:
        spread_over_repeats(rows)
    known = [entries[case.digest] for case in cases if case.digest in entries]
    done = {entry.digest: entry.figures for entry in known if entry.state == "done"}
    remarks = remarks_of(done, cases)
    return StudyTable(record, axes, metrics, tuple(map(_explained, rows)), cases, remarks)


def _metrics(
    record: StudyRecord, cases: Iterable[Case], entries: Mapping[str, Entry]
) -> tuple[str, ...]:
    figures_of_cases = [entries[case.digest].figures for case in cases if case.digest in entries]
    known = dict.fromkeys(name for figures in figures_of_cases for name in figures)
    requested = record.study.metrics
    unknown = [name for name in requested if name not in known and name not in DERIVED]
    if unknown and known:
        raise InputError(
            f"metrics: found {', '.join(unknown)}, allowed {', '.join(sorted({*known, *DERIVED}))}"
        )
    return requested or tuple(known)


def _row(
    case: Case, entry: Entry | None, bounds: tuple[Constraint, ...], derived: Iterable[str]
) -> dict[str, Any]:
    state = entry.state if entry else "missing"
    known = entry.figures if entry else {}
    all_figures = with_derived(case.experiment, known, derived) if known else {}
    figures = {name: _cell(value) for name, value in all_figures.items()}
    head: dict[str, Any] = {
        "case": case.digest,
        "state": state,
        "reason": _reason(entry) if entry else "",
        "feasible": None,
        UNMET: {},
        RESERVES: {},
        DESIGN: design_of(case.settings, case.settings),
    }
    if state == "done":
        head[RESERVES] = reserves(case, figures, bounds)
        head[UNMET] = unmet_conditions(case, figures, bounds)
        head["feasible"] = not head[UNMET]
    return figures | dict(case.settings) | head


def _explained(row: dict[str, Any]) -> dict[str, Any]:
    """Return the row; if its reason is empty, the reason lists the conditions that are not met."""
    missed = "; ".join(f"{name}: {value}" for name, value in row[UNMET].items())
    return row if row["reason"] or not missed else row | {"reason": f"not feasible: {missed}"}


def _reason(entry: Entry) -> str:
    """Return the reason why figures of a case are missing; empty if none is known."""
    unfitted = entry.figures.get("unfitted_balls")
    reason = entry.reason or why_absent(entry.figures)
    return reason or (_cell(unfitted) if unfitted else "")


def _cell(value: Any) -> Any:
    return "; ".join(map(str, value)) if isinstance(value, list) else value


def csv_text(table: StudyTable) -> str:
    """Return the table as CSV text with a line of headings."""
    return parts.csv_text(table.columns, table.rows)


def write_csv(table: StudyTable, path: Path) -> None:
    """Write the table as a new CSV file in UTF-8.

    Raises
    ------
    InputError : the file exists or cannot be written
    """
    with creating(path) as part:
        write_text(part, csv_text(table))


def write_parquet(table: StudyTable, path: Path) -> None:
    """Write the table as a new Parquet file.

    Raises
    ------
    InputError : pyarrow is not installed, or the file exists or cannot be written
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise missing("--parquet", "pyarrow", "sweep") from None
    columns = {name: one_type([row.get(name) for row in table.rows]) for name in table.columns}
    memory = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(columns), memory)
    with creating(path) as part:
        write_bytes(part, memory.getbuffer())


def one_type(values: list[Any]) -> list[Any]:
    """Return the values of a column as one type; None remains None.

    Integers mixed with floats become floats. Any other mixture of types becomes text.
    """
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        return values
    wanted: type = float if kinds == {int, float} else str
    return [None if value is None else wanted(value) for value in values]


MOST_DESIGNS = 6

Row = Mapping[str, Any]


def objective_of(text: str) -> Objective:
    """Return the objective given by "METRIC" (minimise) or "+METRIC" (maximise)."""
    goal: Any = "maximise" if text.startswith("+") else "minimise"
    return Objective(metric=text.removeprefix("+"), goal=goal)


def best_rows(rows: Sequence[Row], objectives: Sequence[Objective]) -> list[Row]:
    """Return the Pareto front of the feasible rows, sorted by the first objective, best first.

    Raises
    ------
    InputError : no finished, feasible case has all objectives
    """
    names = [objective.metric for objective in objectives]
    usable = usable_rows(rows, objectives)
    if not usable:
        raise InputError(_why_none(rows, names))
    costs = costs_of(usable, objectives)
    front = np.flatnonzero(on_front(costs))
    return [usable[place] for place in front[np.argsort(costs[front, 0], kind="stable")]]


def costs_of(rows: Sequence[Row], objectives: Sequence[Objective]) -> FloatArray:
    """Return the costs (row, objective); repeats of a design have the mean of their costs."""
    costs = np.array([[cost_of(row, objective) for objective in objectives] for row in rows])
    places: dict[Any, list[int]] = {}
    for place, row in enumerate(rows):
        places.setdefault(row.get(DESIGN, place), []).append(place)
    for together in places.values():
        costs[together] = costs[together].mean(axis=0)
    return costs


def _why_none(rows: Sequence[Row], names: Sequence[str]) -> str:
    """Return why no row is the best: no feasible case, or no case with the objectives."""
    if any(all(is_number(row.get(name)) for name in names) for row in rows):
        return f"no feasible case has {', '.join(names)}: {feasibility_in_words(rows)}"
    known = sorted({n for row in rows for n, v in row.items() if isinstance(v, float)})
    allowed = ", ".join(known) or "none, as no case has figures"
    return f"no feasible case has {', '.join(names)}; allowed {allowed}"


def nearest_rows(rows: Sequence[Row], objectives: Sequence[Objective]) -> list[Row]:
    """Return the rows that have all objectives, the nearest to all limits first.

    Use this for a study without a feasible case. The distance is the sum of all distances beyond
    limits, each divided by the size of the limit; of repeats the largest counts, and
    it is infinite if a repeat failed or lacks an objective. Rows with equal distances are sorted by
    the number of missed conditions, then by the first objective.
    """
    names = [objective.metric for objective in objectives]
    some, worst = [], dict[str, float]()
    for row in rows:
        if row["state"] == "missing":
            continue
        has_all = all(is_number(row.get(name)) for name in names)
        distance = shortfall(row) if has_all else math.inf
        worst[row[DESIGN]] = max(distance, worst.get(row[DESIGN], 0.0))
        some += [row] if has_all else []

    def order(row: Row) -> tuple[float, int, float]:
        return worst[row[DESIGN]], len(row[UNMET]), cost_of(row, objectives[0])

    return sorted(some, key=order)


def ranked_rows(rows: Sequence[Row], objectives: Sequence[Objective]) -> list[Row]:
    """Return the rows of the Pareto front; for a single objective all feasible rows, best first.

    Raises
    ------
    InputError : no finished, feasible case has all objectives
    """
    front = best_rows(rows, objectives)
    if len(objectives) > 1:
        return front
    usable = usable_rows(rows, objectives)
    order = np.argsort(costs_of(usable, objectives)[:, 0], kind="stable")
    return [usable[place] for place in order]


def goals_of(table: StudyTable, requested: Sequence[Objective] = ()) -> list[Objective]:
    """Return the requested objectives; if there are none, those of the study, or a default.

    The default is to minimise the first figure with "rmse" or "error" in its name. If there is
    none, the first figure is minimised.
    """
    named = [name for name in table.metrics if "rmse" in name or "error" in name]
    first = (*named, *table.metrics)[0]
    return list(requested or table.record.study.goals) or [Objective(metric=first)]


def design_of(settings: Mapping[str, Any], axes: Iterable[str]) -> str:
    """Return the settings of a design, all axes but the seed, as text for comparisons."""
    return repr([settings[axis] for axis in axes if axis != "seed"])


def designs_of(rows: Sequence[Row], axes: Sequence[str]) -> list[Row]:
    """Return the first row of each design, at most as many as a report has pictures."""
    designs: dict[str, Row] = {}
    for row in rows:
        designs.setdefault(design_of(row, axes), row)
    return list(designs.values())[:MOST_DESIGNS]


def usable_rows(rows: Sequence[Row], objectives: Sequence[Objective]) -> list[Row]:
    """Return the rows of feasible cases that have a value of every objective."""
    names = [objective.metric for objective in objectives]
    return [
        row for row in rows if row.get("feasible") and all(is_number(row.get(n)) for n in names)
    ]


def on_front(costs: FloatArray) -> BoolImage:
    """Return a mask (case,) of the rows of costs (case, objective) that no other row dominates."""
    on_front_mask = np.ones(len(costs), bool)
    for i, cost in enumerate(costs):
        better = np.all(costs <= cost, axis=1) & np.any(costs < cost, axis=1)
        on_front_mask[i] = not better.any()
    return on_front_mask


def cost_of(row: Row, objective: Objective) -> float:
    """Return the objective of a row as a value to minimise: negative if it is maximised."""
    value = float(row[objective.metric])
    return value if objective.goal == "minimise" else -value
