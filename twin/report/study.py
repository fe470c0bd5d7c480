"""Report of a study as one HTML page: effects, Pareto front, best designs, and all cases.

The report draws the data in the store of the study. `twin.study.pictures.picture_best` measures the
best designs again to make their pictures.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

from markupsafe import Markup

from reconstruction.errors import InputError, counted
from twin.config.study import Objective
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.report.page import (
    REPORT_FILE,
    STAGE,
    Block,
    Figure,
    Gallery,
    Note,
    Page,
    Section,
    write_page,
)
from twin.report.study_figures import (
    Scales,
    design_figures,
    draw_effects,
    draw_front,
    draw_interactions,
    draw_main_effects,
    draw_parallel,
)
from twin.report.study_limits import limit_sections, limit_verdicts
from twin.report.study_verdict import verdict_blocks, verdict_card
from twin.report.study_words import headings_of, settings_text, titles_of, value_text
from twin.report.table import Column, Table
from twin.results.rows import is_number
from twin.study.feasibility import feasibility_in_words
from twin.study.pictures import CasePicture, stored_picture
from twin.study.sensitivity import Effect, effects_of, without
from twin.study.table import (
    StudyTable,
    designs_of,
    goals_of,
    nearest_rows,
    ranked_rows,
    read_table,
    usable_rows,
)
from twin.study.verdict import StudyVerdict, verdict_of

_MOST_METRICS, _MOST_PAIRS, _MOST_BEST = 5, 6, 12
_UNTAKEN = "not drawn yet; twin sweep report measures the best designs and draws them"

Row = Mapping[str, Any]

_SENSITIVITY_WORDS = {
    "grid": "Share of the variance over all cases that each axis explains by itself; the remainder "
    "to 1 is due to interactions. Exact for this grid, so there is no interval.",
    "saltelli": "First-order Sobol' indices with 95 % bootstrap intervals; diamonds: total, with "
    "interactions.",
    "morris": "Mean absolute effect of crossing the whole axis, in the figure's unit, with 95 % "
    "bootstrap intervals; diamonds: spread of the effect, by curvature and interactions.",
}


@dataclass(frozen=True)
class Shown:
    """Data of a study for its page.

    Attributes
    ----------
    table : all cases with their values
    rows : finished cases that have all values `metrics`
    metrics : names of the measured values that are plotted
    best : best feasible cases, or cases on the Pareto front
    verdict : the design to build, or the nearest to the limits
    titles : headings of axes and measured values, with units, by name
    effects : sensitivities of a measured value to the axes of the study, by name of the value
    pictures : pictures of the best designs, by the case's digest
    failed : reasons why designs have no picture, by the case's digest
    """

    table: StudyTable
    rows: list[Row]
    metrics: list[str]
    objectives: list[Objective]
    best: list[Row]
    verdict: StudyVerdict
    titles: Mapping[str, str]
    effects: dict[str, list[Effect]]
    pictures: dict[str, CasePicture] = field(default_factory=dict)
    failed: Mapping[str, str] = field(default_factory=dict)


def write_study(
    folder: Path,
    watch: ProgressCallback = no_progress,
    objectives: Sequence[Objective] = (),
    into: Path | None = None,
    failed: Mapping[str, str] | None = None,
) -> Path:
    """Write `report.html` and `figures/*.png` into the store of a sweep; return the page's path.

    Parameters
    ----------
    folder : the -o DIR of `twin sweep`; no other file is read
    objectives : values to optimise; by default the objectives of the study, or the error
    into : existing folder for the page and its figures; None: `folder`
    failed : reason why a design has no picture, by the case's digest

    Raises
    ------
    InputError : the folder is no store, no case is finished, or the page cannot be written
    """
    watch(STAGE, 0.0)
    shown = _shown(folder, read_table(folder), objectives, failed or {})
    return write_page((into or folder) / REPORT_FILE, _page(shown), watch)


def _shown(
    folder: Path, table: StudyTable, requested: Sequence[Objective], failed: Mapping[str, str]
) -> Shown:
    done = table.done()
    if not done:
        raise InputError("report: no case of the study is finished; run twin sweep first")
    metrics = [name for name in table.metrics if _is_number(done, name)][:_MOST_METRICS]
    if not metrics:
        raise InputError("report: no figure is a number in every case; name others in metrics")
    rows = [row for row in done if all(is_number(row.get(name)) for name in metrics)]
    objectives = goals_of(table, requested)
    best = ranked_rows(done, objectives) if usable_rows(done, objectives) else []
    effects = {name: effects_of(table, name) for name in metrics}
    digests = [str(row["case"]) for row in designs_of(best, table.axes)]
    pictures = {digest: stored_picture(folder, digest) for digest in digests}
    return Shown(
        table,
        rows,
        metrics,
        objectives,
        best,
        verdict_of(table, requested),
        titles_of(table, [objective.metric for objective in objectives]),
        {name: effect for name, effect in effects.items() if effect},
        {digest: picture for digest, picture in pictures.items() if picture is not None},
        failed,
    )


def _page(shown: Shown) -> Page:
    study = shown.table.record.study
    states: dict[str, int] = {}
    for row in shown.table.rows:
        states[row["state"]] = states.get(row["state"], 0) + 1
    summary = "".join(f", {count} {state}" for state, count in states.items())
    cases = counted(len(shown.table.rows), "case")
    lead = f"{study.description or study.base}: {cases}{summary}."
    conditions = "; ".join(shown.table.conditions)
    return Page(
        kind="design study",
        title=study.name.replace("_", " "),
        lead=lead + (f" Feasible: {conditions}." if conditions else ""),
        sections=[
            *limit_sections(shown.table),
            Section("best", "Best designs", tuple(_best(shown))),
            *(Section(f"of_{f.name}", f.title, (replace(f, title=""),)) for f in _figures(shown)),
            Section("cases", "All cases", tuple(_cases(shown))),
            Section("verdict", "Verdict", tuple(verdict_blocks(shown.table, shown.verdict))),
        ],
        verdicts=[*limit_verdicts(shown.table), verdict_card(shown.table, shown.verdict)],
        warned="Warnings of the cases" if shown.table.remarks else "",
        warnings=remark_lines(shown.table),
        wide=True,
    )


def remark_lines(table: StudyTable) -> list[str]:
    """Return one line for each kind of warning of the finished cases, with the number of cases."""
    done = len({row["case"] for row in table.done()})
    return [remark.in_words(done) for remark in table.remarks]


def _best(shown: Shown) -> list[Block]:
    if not shown.best:
        return _nearest(shown)
    goals = ", ".join(f"{objective.goal} {objective.metric}" for objective in shown.objectives)
    several = len(shown.objectives) > 1
    order = "Feasible cases on the Pareto front" if several else "Feasible cases, best first"
    columns = [*shown.table.axes, *shown.metrics]
    rows = tuple(_row(row, columns) for row in shown.best[:_MOST_BEST])
    heads = (*_columns(shown, columns), Column("case", "case"))
    blocks: list[Block] = [
        Note(f"{order}: {goals}."),
        Table("best_cases", "", "", heads, rows, look="cases"),
        *_designs(shown),
    ]
    if shown.pictures:
        note = (
            "All designs have the same height scale and the same error scale, which includes 99 % "
            "of all errors."
        )
        blocks.append(Note(note))
    return blocks


def _nearest(shown: Shown) -> list[Block]:
    """Return a note that no case is feasible, and the cases nearest to the limits."""
    words = feasibility_in_words(shown.table.rows)
    note = Note(f"No case is feasible: {words}.", "failure")
    some = nearest_rows(shown.table.rows, shown.objectives)[:_MOST_BEST]
    if not some:
        return [note]
    columns = [*shown.table.axes, *shown.metrics]
    more = (Column("case", "case"), Column("remark", "missed", kind="reason"))
    rows = tuple(_row(row, columns) for row in some)
    lead = Note("Infeasible cases, the nearest to the limits first.")
    return [
        note,
        lead,
        Table("nearest_cases", "", "", (*_columns(shown, columns), *more), rows, look="cases"),
    ]


def _designs(shown: Shown) -> list[Block]:
    """Return sections on the best designs with pictures, and notes why pictures are missing."""
    sections, reasons = list[Block](), dict[str, None]()
    scales = Scales.of(shown.pictures.values()) if shown.pictures else None
    for place, row in enumerate(designs_of(shown.best, shown.table.axes), start=1):
        digest = str(row["case"])
        settings = settings_text(shown.table, row)
        picture = shown.pictures.get(digest)
        gallery: list[Block] = []
        if scales is not None and picture is not None:
            gallery = [Gallery(tuple(design_figures(place, settings, picture, scales)), 3)]
        else:
            reasons[shown.failed.get(digest, _UNTAKEN)] = None
        metrics = " · ".join(
            f"{shown.titles[metric]} {value_text(row.get(metric))}"
            for metric in shown.table.metrics
        )
        blocks = (Note(metrics), *gallery, Note(_links(digest)))
        sections.append(Section(f"design_{place}", f"{place} · {settings}", blocks))
    return [*(Note(f"Without pictures: {reason}") for reason in reasons), *sections]


def _links(digest: str) -> str:
    return Markup(
        '<a href="cases/{0}/result.json">result</a> · <a href="cases/{0}/experiment.toml">'
        "experiment</a> · with all files and a page of its own, from the folder of this page: "
        "<code>twin measure cases/{0}/experiment.toml -o measured/{0}</code>"
    ).format(digest)


def _figures(shown: Shown) -> list[Figure]:
    rows, axes, metrics = shown.rows, shown.table.axes, shown.metrics
    titles = shown.titles
    figures = [
        Figure("main_effects", "Main effects",
               "Line: mean over all other axes; band: range of all cases. A row has one scale.",
               "each figure over each axis",
               lambda path: draw_main_effects(path, rows, axes, metrics, titles)),
        Figure("parallel", "All cases in parallel coordinates",
               f"Every case is one line, coloured by {titles[metrics[0]]}.",
               "one line per case over all axes and figures",
               lambda path: draw_parallel(path, rows, axes, metrics, titles)),
    ]  # fmt: skip
    several = list(combinations(axes, 2))[:_MOST_PAIRS]
    if several:
        figures += [_interactions(shown, several, metric) for metric in metrics[:2]]
    return [*figures, *_front(shown), *_sensitivity(shown)]


def _front(shown: Shown) -> list[Figure]:
    if len(shown.objectives) < 2 or not shown.best:
        return []
    names = [objective.metric for objective in shown.objectives]
    whole = [row for row in shown.table.done() if all(is_number(row.get(n)) for n in names)]
    return [
        Figure("front", "Pareto front", "Two objectives of all cases. Front: feasible designs for "
               "which no feasible design is better in every objective.",
               "two objectives of all cases with the Pareto front",
               lambda path: draw_front(
                   path, whole, shown.best, shown.objectives, shown.titles))
    ]  # fmt: skip


def _sensitivity(shown: Shown) -> list[Figure]:
    if not shown.effects:
        return []
    method = shown.table.record.study.sampling.method
    return [
        Figure("sensitivity", "Sensitivity", _SENSITIVITY_WORDS[method] + _left_out(shown),
               "sensitivity of each figure to each axis",
               lambda path: draw_effects(path, shown.effects, method, shown.titles))
    ]  # fmt: skip


def _interactions(shown: Shown, several: list[tuple[str, str]], metric: str) -> Figure:
    title, titles = shown.titles[metric], shown.titles
    return Figure(
        f"interactions_{metric}",
        f"Interactions: {title}",
        f"Mean {title} over pairs of axes; one colour scale for all maps.",
        f"mean {title} over pairs of axes",
        lambda path: draw_interactions(path, shown.rows, several, metric, titles),
    )


def _left_out(shown: Shown) -> str:
    """Return a sentence with the number of cases omitted from the sensitivities of each value."""
    counts = {name: without(shown.table, name) for name in shown.effects}
    parts = ", ".join(f"{count} without {name}" for name, count in counts.items() if count)
    return f" Cases left out: {parts}." if parts else ""


def _cases(shown: Shown) -> list[Block]:
    table, left_out = shown.table, len(shown.table.done()) - len(shown.rows)
    columns = [*table.axes, *shown.metrics]
    more = ("feasible", "case", "experiment", "remark")
    heads = (*_columns(shown, columns), *(Column(name, name) for name in more[:3]),
             Column("remark", "remark", kind="reason"))  # fmt: skip
    rows = tuple(_row(row, columns) for row in table.rows)
    kinds = tuple(str(row["state"]) for row in table.rows)
    lack = counted(left_out, "finished case lacks", "finished cases lack")
    notes = [f"{lack} one of the figures; left out of the plots."]
    return [
        *(Note(note) for note in notes if left_out),
        Note(
            Markup(
                "One case with all files and a page of its own: <code>twin measure "
                "cases/CASE/experiment.toml -o measured/CASE</code>."
            )
        ),
        Table("all_cases", "", "", heads, rows, kinds=kinds, look="cases"),
    ]


def _columns(shown: Shown, names: Sequence[str]) -> list[Column]:
    headings = headings_of(shown.table)
    return [Column(n, headings[n][0], unit=headings[n][1], kind="number") for n in names]


def _row(row: Row, columns: Sequence[str]) -> dict[str, str]:
    state, digest, reason = str(row["state"]), str(row["case"]), str(row["reason"] or "")
    there = state in ("done", "failed")
    file = "failure.json" if state == "failed" else "result.json"
    if state != "done":
        reason = f"{state}: {reason}" if reason else state
    feasible = row["feasible"]
    return {name: value_text(row.get(name)) for name in columns} | {
        "feasible": "" if feasible is None else ("yes" if feasible else "no"),
        "case": _link(digest, file, digest) if there else digest,
        "experiment": _link(digest, "experiment.toml", "experiment") if there else "",
        "remark": reason,
    }


def _link(digest: str, file: str, text: str) -> str:
    return Markup('<a href="cases/{}/{}">{}</a>').format(digest, file, text)


def _is_number(rows: Sequence[Row], name: str) -> bool:
    """Return True if a value is a number in more than 50 % of the cases."""
    return sum(is_number(row.get(name)) for row in rows) > len(rows) / 2
