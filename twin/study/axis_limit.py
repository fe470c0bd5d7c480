"""Largest value of one axis at which a design meets all conditions, for each of the other axes.

The conditions are those of feasibility: constraints, and tolerances of measurands. The study file
names the axis (`limit_axis`). Along it, the levels up to the first one that misses a condition are
met. Between the last level that is met and the first one that is missed, the reserve of the missed
condition is linear in the value of the axis; both levels are the bounds of the result.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twin.results.rows import is_number
from twin.study.feasibility import RESERVES, Reserve
from twin.study.table import Row, StudyTable, design_of


@dataclass(frozen=True)
class AxisLimit:
    """Largest value of an axis at which all conditions are met, at one setting of the other axes.

    Attributes
    ----------
    settings : settings of the other axes by heading, without the seed
    met : last level before the first one that misses a condition; None: the smallest level misses
    missed : first level that misses a condition; None: no measured level misses one
    value : the limit between both, interpolated; None if one of both is None, or if the missed
        condition has no value
    condition : title of the condition that limits the value; empty if no level misses one
    met_again : levels above `missed` that meet all conditions, so that `value` is not the only
        limit
    """

    settings: Mapping[str, Any]
    met: float | None
    missed: float | None
    value: float | None
    condition: str
    met_again: tuple[float, ...] = ()

    @property
    def order(self) -> float:
        """Number by which limits are compared: the value, or else the last level that is met."""
        known = self.met if self.value is None else self.value
        return float("-inf") if known is None else known


def axis_limits(table: StudyTable) -> list[AxisLimit]:
    """Return the limits along the study's `limit_axis`, the largest first; empty without one.

    All repeats of a design have to meet a condition: their smallest reserve counts. A failed case
    misses all conditions. Cases that were not measured yet are left out.
    """
    axis = table.record.study.limit_axis
    if axis is None:
        return []
    others = [name for name in table.axes if name not in (axis, "seed")]
    groups: dict[str, list[Row]] = {}
    for row in table.rows:
        if row["state"] != "missing":
            groups.setdefault(design_of(row, others), []).append(row)
    limits = [
        _limit({name: rows[0][name] for name in others}, _levels(rows, axis))
        for rows in groups.values()
    ]
    return sorted(limits, key=lambda limit: -limit.order)


Reserves = Mapping[str, Reserve]


def _levels(rows: Sequence[Row], axis: str) -> list[tuple[float, Reserves]]:
    """Return the levels of an axis in order, each with the smallest reserve to each condition."""
    by_level: dict[float, dict[str, Reserve]] = {}
    for row in rows:
        held = by_level.setdefault(float(row[axis]), {})
        for title, reserve in _reserves(row).items():
            held[title] = min(held.get(title, reserve), reserve, key=lambda some: some.relative)
    return sorted(by_level.items())


def _reserves(row: Row) -> Reserves:
    if row["state"] == "done":
        reserves: Reserves = row[RESERVES]
        return reserves
    return {f"no result: {row['reason']}": Reserve("", None, 1.0)}


def _limit(settings: Mapping[str, Any], levels: list[tuple[float, Reserves]]) -> AxisLimit:
    met = [all(reserve.relative >= 0.0 for reserve in held.values()) for _, held in levels]
    if all(met):
        return AxisLimit(settings, levels[-1][0], None, None, "")
    first = met.index(False)
    missed, held = levels[first]
    again = tuple(
        level for (level, _), good in zip(levels[first:], met[first:], strict=True) if good
    )
    if first == 0:
        worst = min(held, key=lambda title: held[title].relative)
        return AxisLimit(settings, None, missed, None, worst, again)
    last, before = levels[first - 1]
    crossings = {
        title: _crossing(last, missed, before.get(title), reserve)
        for title, reserve in held.items()
        if reserve.relative < 0.0
    }
    known = {title: at for title, at in crossings.items() if at is not None}
    if not known or len(known) < len(crossings):
        return AxisLimit(settings, last, missed, None, next(iter(crossings)), again)
    condition = min(known, key=lambda title: known[title])
    return AxisLimit(settings, last, missed, known[condition], condition, again)


def _crossing(met: float, missed: float, before: Reserve | None, after: Reserve) -> float | None:
    """Return where a reserve is 0, linear between two levels; None if a reserve is not known."""
    if before is None or not is_number(before.amount) or not is_number(after.amount):
        return None
    share = before.amount / (before.amount - after.amount)
    return met + share * (missed - met)
