"""Verdict of a study on its page: card at the head; trade as a picture and sentence at the end.

The last sentence of the page is "Build this: ..., because ...", or "Build none of these ...".
"""

from collections.abc import Iterator, Sequence

from reconstruction.errors import counted
from twin.report.page import Block, Figure, Grade, Note, Verdict
from twin.report.study_figures import draw_trade
from twin.report.study_words import (
    advice_text,
    settings_text,
    titles_of,
    verdict_reasons,
    verdict_sentence,
)
from twin.results.rows import is_number
from twin.study.sensitivity import group_labels, variance_shares
from twin.study.table import Row, StudyTable
from twin.study.verdict import StudyVerdict

_QUESTION = "Which design to build?"


def verdict_card(table: StudyTable, verdict: StudyVerdict) -> Verdict:
    """Return the verdict as the card at the head of the page."""
    if verdict.row is None or not verdict.feasible:
        headline = f"none of {counted(verdict.designs, 'design')} satisfies all conditions"
        return Verdict(_QUESTION, headline, "poor", (verdict_sentence(table, verdict),))
    warned = [remark.text for remark in table.remarks if verdict.row["case"] in remark.digests]
    grade: Grade = "check" if warned else "good"
    count = counted(len(warned), "warning of this design", "warnings of this design")
    more = (f"{count}, listed below",) if warned else ()
    reasons = (*_sentences(table, verdict), *more)
    return Verdict(_QUESTION, settings_text(table, verdict.row, verdict.axes), grade, reasons)


def _sentences(table: StudyTable, verdict: StudyVerdict) -> tuple[str, ...]:
    return tuple(part[:1].upper() + part[1:] for part in verdict_reasons(table, verdict))


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
    others = [axis for axis in ranked if axis != objective]
    return [goal.metric for goal in verdict.objectives[1:2]] + others[:2]


def _with_numbers(table: StudyTable, names: Sequence[str]) -> list[Row]:
    return [row for row in table.done() if all(is_number(row.get(name)) for name in names)]


def _trade(table: StudyTable, verdict: StudyVerdict, chosen: Row, over: Sequence[str]) -> Figure:
    objective = verdict.objectives[0].metric
    titles = titles_of(table, [goal.metric for goal in verdict.objectives])
    figures = [name for name in over if name not in table.axes]
    rows = _with_numbers(table, [objective, *figures])
    title = titles[objective]
    names = ", ".join(titles[name] for name in over)
    star = "recommended" if verdict.feasible else "nearest"
    return Figure(
        "trade",
        "Trade",
        f"{title[:1].upper()}{title[1:]} of all cases over {names}. Star: the {star} design; dots: "
        "feasible cases; crosses: cases that miss a condition.",
        f"{title} over {names}",
        lambda path: draw_trade(path, rows, chosen, (objective, over), titles),
    )
