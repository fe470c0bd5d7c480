"""Words of a study: headings with units, settings of a design, and the verdict as a sentence.

The unit of a figure is the suffix of its name. The unit of an axis is the suffix of its name, or
else of the path that it varies.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from reconstruction.errors import counted
from twin.report.words import NONE, label_of, percent, split_unit
from twin.study.feasibility import Reserve
from twin.study.table import Row, StudyTable
from twin.study.verdict import Advice, StudyVerdict

_SIDES = {
    "above": "try values above {}",
    "below": "try values below {}",
    "near": "try values near {}",
    "at": "choose {}",
}


def headings_of(table: StudyTable, more: Iterable[str] = ()) -> dict[str, tuple[str, str]]:
    """Return label and unit of every axis and figure of a study, by its name.

    `more` are names of further figures, such as objectives.
    """
    return {name: label_of(name) for name in (*table.metrics, *more)} | axis_headings(table)


def axis_headings(table: StudyTable) -> dict[str, tuple[str, str]]:
    """Return label and unit of every axis of a study, by its title."""
    paths = {axis.title: axis.path or "" for axis in table.record.study.axis}
    names = {}
    for title in table.axes:
        stem, unit = split_unit(title)
        names[title] = stem.replace("_", " "), unit or split_unit(paths.get(title, ""))[1]
    return names


def titles_of(table: StudyTable, more: Iterable[str] = ()) -> dict[str, str]:
    """Return the headings of all axes and figures, with the unit in brackets, by name."""
    both = headings_of(table, more).items()
    return {name: f"{label} ({unit})" if unit else label for name, (label, unit) in both}


def value_text(value: Any) -> str:
    """Return the value of a cell as text: numbers with four digits, a dash for None."""
    if value is None:
        return NONE
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def amount(value: Any, unit: str) -> str:
    """Return a value with its unit."""
    space = "" if unit in ("", "°") else " "
    return f"{value_text(value)}{space}{unit}"


def settings_text(table: StudyTable, row: Row, axes: tuple[str, ...] | None = None) -> str:
    """Return the settings of a row with units, for example "thickness 0.1 mm, mix C"."""
    headings = axis_headings(table)
    parts = []
    for axis in table.axes if axes is None else axes:
        label, unit = headings[axis]
        parts.append(f"{label} {amount(row[axis], unit)}")
    return ", ".join(parts)


def verdict_sentence(table: StudyTable, verdict: StudyVerdict) -> str:
    """Return the verdict as one sentence: "Build this: ..., because ...", or "Build none ..."."""
    if verdict.row is None:
        names = " and ".join(goal.metric for goal in verdict.objectives)
        return f"Build none of these designs: no case has a value of {names}."
    settings = settings_text(table, verdict.row, verdict.axes)
    if verdict.feasible:
        return f"Build this: {settings}, because {'; '.join(verdict_reasons(table, verdict))}."
    missed = " and ".join(_missed(name, reserve) for name, reserve in verdict.missed.items())
    missed = missed or "its conditions in one of its repeats"
    tail = f"; {advice_text(table, verdict)}" if verdict.advice else ""
    return f"Build none of these designs: the nearest, {settings}, misses {missed}{tail}."


def verdict_reasons(table: StudyTable, verdict: StudyVerdict) -> list[str]:
    """Return why the feasible design is the one to build: one or more parts of a sentence."""
    values = _values_text(verdict.values)
    of = counted(verdict.designs, "measured design")
    conditions = " that satisfies all conditions" if table.conditions else ""
    if verdict.designs == 1:
        parts = [f"it is the only measured design, with {values}"]
    elif verdict.met == 1:
        parts = [f"it is the only one of {of}{conditions or ' with a value'}, with {values}"]
    elif len(verdict.objectives) > 1:
        parts = [_on_the_front(verdict, values)]
    else:
        least = "smallest" if verdict.objectives[0].goal == "minimise" else "largest"
        kind = "feasible" if table.conditions else "measured"
        label, value = _name_of(verdict.objectives[0].metric), amount(*_first(verdict.values))
        parts = [f"its {label} is the {least} of {verdict.met} {kind} designs, {value}"]
        parts += _next(table, verdict)
    return [*parts, *_reserve(verdict)]


def _first(values: Mapping[str, float]) -> tuple[float, str]:
    name, value = next(iter(values.items()))
    return value, label_of(name)[1]


def _name_of(figure: str) -> str:
    """Return the label of a figure for a sentence: "z error (RMS)" for "z error, RMS"."""
    name, _, kind = label_of(figure)[0].partition(", ")
    return f"{name} ({kind})" if kind else name


def _values_text(values: Mapping[str, float]) -> str:
    return " and ".join(f"{_name_of(n)} {amount(v, label_of(n)[1])}" for n, v in values.items())


def _on_the_front(verdict: StudyVerdict, values: str) -> str:
    if verdict.front == 1:
        return f"of {verdict.met} feasible designs it is the best in all objectives, with {values}"
    return (
        f"with {values} it is, of the {verdict.front} designs on the Pareto front, the nearest to "
        "the best value of each objective"
    )


def _next(table: StudyTable, verdict: StudyVerdict) -> list[str]:
    if verdict.next is None or verdict.row is None:
        return []
    row, other = verdict.row, verdict.next
    # An objective may be an axis itself: its value is stated once.
    objective = verdict.objectives[0].metric
    axes = tuple(a for a in verdict.axes if row[a] != other[a] and a != objective)
    settings = f", with {settings_text(table, other, axes)}" if axes else ""
    return [f"the next has {amount(*_first(verdict.next_values))}{settings}"]


def _reserve(verdict: StudyVerdict) -> list[str]:
    """Return a text on the smallest reserve; none if the objective is a margin itself."""
    if verdict.least is None or "margin" in verdict.objectives[0].metric:
        return []
    name, reserve = verdict.least
    return [f"its smallest reserve is {_reserve_text(reserve)} ({name})"]


def _reserve_text(reserve: Reserve) -> str:
    if reserve.amount is None:
        return "not known"
    return amount(abs(reserve.amount), split_unit(reserve.figure)[1])


def _missed(name: str, reserve: Reserve) -> str:
    if reserve.amount is None:
        return f"{name} (no value)"
    return f"{name} by {_reserve_text(reserve)}"


def advice_text(table: StudyTable, verdict: StudyVerdict) -> str:
    """Return which axis would help most, at which level, and which values to try next."""
    advice = verdict.advice
    if advice is None:
        return ""
    label, unit = axis_headings(table)[advice.axis]
    level = amount(advice.level, unit)
    if verdict.feasible:
        axis = label[:1].upper() + label[1:]
        return (
            f"{axis} has the largest effect{_share(advice)}, and the design is at an end "
            f"of this axis: {_SIDES[advice.side].format(level)}."
        )
    least = verdict.least
    of = split_unit(least[1].figure)[1] if least else ""
    mean = amount(advice.mean, of)
    return (
        f"{label} would help most{_share(advice)}: the mean reserve is largest, {mean}, at {level}"
        f", {_SIDES[advice.side].format('it')}"
    )


def _share(advice: Advice) -> str:
    return "" if advice.share is None else f" ({percent(advice.share)} of the variance)"
