"""Verdict of a study in words and as a picture: the design to build and the reason, or what misses.

The last sentence of the page is "Build this: ..., because ...", or "Build none of these ...".
"""

from collections.abc import Iterator, Mapping, Sequence

from reconstruction.errors import counted
from twin.report.page import Block, Figure, Grade, Note, Verdict
from twin.report.study_figures import draw_trade
from twin.report.study_words import amount, axis_headings, settings_text, titles_of
from twin.report.words import label_of, percent, split_unit
from twin.results.rows import is_number
from twin.study.feasibility import Reserve
from twin.study.sensitivity import group_labels, variance_shares
from twin.study.table import Row, StudyTable
from twin.study.verdict import Advice, StudyVerdict

_QUESTION = "Which design to build?"
_SIDES = {
    "above": "try values above it",
    "below": "try values below it",
    "near": "try values near it",
    "at": "choose it",
}


def verdict_sentence(table: StudyTable, verdict: StudyVerdict) -> str:
    """Return the verdict as one sentence: "Build this: ..., because ...", or "Build none ..."."""
    if verdict.row is None:
        names = " and ".join(goal.metric for goal in verdict.objectives)
        return f"Build none of these designs: no case has a value of {names}."
    settings = settings_text(table, verdict.row, verdict.axes)
    if verdict.feasible:
        return f"Build this: {settings}, because {_reason(table, verdict)}."
    missed = " and ".join(_missed(name, reserve) for name, reserve in verdict.missed.items())
    missed = missed or "its conditions in one of its repeats"
    tail = f"; {advice_text(table, verdict)}" if verdict.advice else ""
    return f"Build none of these designs: the nearest, {settings}, misses {missed}{tail}."


def verdict_card(table: StudyTable, verdict: StudyVerdict) -> Verdict:
    """Return the verdict as the card at the head of the page."""
    if verdict.row is None or not verdict.feasible:
        headline = f"none of {counted(verdict.designs, 'design')} meets all conditions"
        return Verdict(_QUESTION, headline, "poor", (verdict_sentence(table, verdict),))
    warned = [remark.text for remark in table.remarks if verdict.row["case"] in remark.digests]
    grade: Grade = "check" if warned else "good"
    count = counted(len(warned), "warning of this design", "warnings of this design")
    more = (f"{count}, listed below",) if warned else ()
    reasons = (*_sentences(table, verdict), *more)
    return Verdict(_QUESTION, settings_text(table, verdict.row, verdict.axes), grade, reasons)


def _sentences(table: StudyTable, verdict: StudyVerdict) -> tuple[str, ...]:
    return tuple(part[:1].upper() + part[1:] for part in _reason(table, verdict).split("; "))


def _reason(table: StudyTable, verdict: StudyVerdict) -> str:
    """Return why the feasible design is the one to build, as parts separated by semicolons."""
    values = _values_text(verdict, verdict.values)
    of = counted(verdict.designs, "measured design")
    conditions = " that meets all conditions" if table.conditions else ""
    if verdict.designs == 1:
        parts = [f"it is the only measured design, with {values}"]
    elif verdict.met == 1:
        parts = [f"it is the only one of {of}{conditions or ' with a value'}, with {values}"]
    elif len(verdict.objectives) > 1:
        parts = [_on_the_front(verdict, values)]
    else:
        least = "smallest" if verdict.objectives[0].goal == "minimise" else "largest"
        kind = "feasible" if table.conditions else "measured"
        label, _ = label_of(verdict.objectives[0].metric)
        value = amount(*_first(verdict.values))
        parts = [f"of {verdict.met} {kind} designs it has the {least} {label}, {value}"]
        parts += _next(table, verdict)
    return "; ".join([*parts, *_reserve(verdict)])


def _first(values: Mapping[str, float]) -> tuple[float, str]:
    name, value = next(iter(values.items()))
    return value, label_of(name)[1]


def _values_text(verdict: StudyVerdict, values: Mapping[str, float]) -> str:
    shown = {goal.metric: label_of(goal.metric) for goal in verdict.objectives}
    return " and ".join(f"{shown[n][0]} {amount(v, shown[n][1])}" for n, v in values.items())


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
    axes = tuple(axis for axis in verdict.axes if row[axis] != other[axis])
    value = amount(*_first(verdict.next_values))
    return [f"the next has {value}, with {settings_text(table, other, axes)}"]


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
        return (
            f"{label.capitalize()} has the largest effect{_share(advice)}, and the design is at "
            f"an end of this axis: {_SIDES[advice.side].replace('it', level)}."
        )
    least = verdict.least
    of = split_unit(least[1].figure)[1] if least else ""
    mean = amount(advice.mean, of)
    return (
        f"{label} would help most{_share(advice)}: the mean reserve is largest, {mean}, at {level}"
        f", {_SIDES[advice.side]}"
    )


def _share(advice: Advice) -> str:
    return "" if advice.share is None else f" ({percent(advice.share)} of the variance)"


def verdict_blocks(table: StudyTable, verdict: StudyVerdict) -> Iterator[Block]:
    """Yield the trade of the design as a picture, its warnings, and at the end the verdict."""
    if verdict.row is not None:
        over = _traded(table, verdict)
        if over:
            yield _trade(table, verdict, verdict.row, over)
        warned = [remark.text for remark in table.remarks if verdict.row["case"] in remark.digests]
        if warned:
            yield Note(f"Warnings of this design: {' '.join(map(_stopped, warned))}")
    if verdict.feasible and verdict.advice:
        yield Note(advice_text(table, verdict))
    yield Note(verdict_sentence(table, verdict), "verdict")


def _stopped(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


def _traded(table: StudyTable, verdict: StudyVerdict) -> list[str]:
    """Return the columns over which the trade is drawn: a second objective, and two axes.

    The axes are those that explain most of the variance of the first objective.
    """
    objective = verdict.objectives[0].metric
    rows = _with_numbers(table, [objective])
    values = [float(row[objective]) for row in rows]
    effects = variance_shares(values, {axis: group_labels(rows, axis) for axis in verdict.axes})
    ranked = [effect.axis for effect in sorted(effects, key=lambda effect: -effect.value)]
    return [goal.metric for goal in verdict.objectives[1:2]] + ranked[:2]


def _with_numbers(table: StudyTable, names: Sequence[str]) -> list[Row]:
    return [row for row in table.done() if all(is_number(row.get(name)) for name in names)]


def _trade(table: StudyTable, verdict: StudyVerdict, chosen: Row, over: Sequence[str]) -> Figure:
    objective, titles = verdict.objectives[0].metric, titles_of(table)
    figures = [name for name in over if name not in table.axes]
    rows = _with_numbers(table, [objective, *figures])
    title = titles.get(objective, objective)
    names = ", ".join(titles.get(name, name) for name in over)
    star = "recommended" if verdict.feasible else "nearest"
    return Figure(
        "trade",
        "Trade",
        f"{title} of all cases over {names}. Star: the {star} design; dots: feasible cases; "
        "crosses: cases that miss a condition.",
        f"{title} over {names}",
        lambda path: draw_trade(path, rows, chosen, (objective, over), titles),
    )
