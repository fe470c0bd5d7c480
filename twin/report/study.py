"""The report of a study as one HTML page: effects, front, best designs, and every case."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from twin.config.study import Objective
from twin.pipeline.progress import Watcher, nobody
from twin.report.html import Picture, Plate, draw_pictures, template, write_page
from twin.report.study_designs import Design, Scales, design_plates, designs_of
from twin.report.study_view import (
    draw_effects,
    draw_front,
    draw_interactions,
    draw_main_effects,
    draw_parallel,
)
from twin.study.best import is_number, ranked_rows, usable_rows
from twin.study.pictures import pictures_of
from twin.study.sensitivity import Effect, effects_of, without
from twin.study.store import Store
from twin.study.table import StudyTable, read_table

REPORT_FILE = "report.html"
_MOST_METRICS, _MOST_PAIRS, _MOST_BEST = 5, 6, 12

Row = Mapping[str, Any]

_SENSITIVITY_WORDS = {
    "grid": "Share of the variance over all cases that each axis explains by itself; what is left "
    "to 1 are interactions. Exact for this grid, so there is no interval.",
    "saltelli": "First-order Sobol' indices with 95 % bootstrap intervals; diamonds: total, with "
    "interactions.",
    "morris": "Mean absolute effect of crossing the whole axis, in the figure's unit, with 95 % "
    "bootstrap intervals; diamonds: spread of the effect, by curvature and interactions.",
}


@dataclass(frozen=True)
class Shown:
    """What the page shows of a study."""

    table: StudyTable
    rows: list[Row]
    metrics: list[str]
    objectives: list[Objective]
    best: list[Row]
    effects: dict[str, list[Effect]]


def write_study(
    folder: Path,
    watch: Watcher = nobody,
    objectives: Sequence[Objective] = (),
    into: Path | None = None,
) -> Path:
    """Write `report.html`, `figures/*.png` and `pictures/*.npz` into the store of a sweep.

    The best designs are measured once more for their pictures, unless the store holds these; where
    that is not possible the page says why.

    Parameters
    ----------
    folder : the -o DIR of `twin sweep`; nothing else is read
    watch : told how far the report is
    objectives : what makes a design good; by default what the study says, or a small error
    into : existing folder to write page and figures into instead

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        The folder is no store, no case is finished, or the page cannot be written.
    """
    watch("report", 0.0)
    shown = _shown(read_table(folder), objectives)
    designs, plates = _designs(shown, folder, watch)
    path = (into or folder) / REPORT_FILE
    pictures = draw_pictures(path.parent, [*_plates(shown), *plates], watch)
    page = template("study.html").render(_page(shown, designs, pictures))
    write_page(path, page)
    watch("report", 1.0)
    return path


def _shown(table: StudyTable, asked: Sequence[Objective]) -> Shown:
    done = table.done()
    if not done:
        raise InputError("report: no case of the study is finished; run twin sweep first")
    metrics = [name for name in table.metrics if _is_number(done, name)][:_MOST_METRICS]
    if not metrics:
        raise InputError("report: no figure is a number in every case; name others in metrics")
    rows = [row for row in done if all(is_number(row.get(name)) for name in metrics)]
    objectives = list(asked or table.record.study.goals)
    objectives = objectives or [Objective(metric=_first_error(table.metrics))]
    effects = {name: effects_of(table, name) for name in metrics}
    return Shown(
        table,
        rows,
        metrics,
        objectives,
        ranked_rows(done, objectives) if usable_rows(done, objectives) else [],
        {name: found for name, found in effects.items() if found},
    )


def _designs(shown: Shown, folder: Path, watch: Watcher) -> tuple[list[Design], list[Plate]]:
    """Take the pictures of the best designs; returns what is told of them, and the plates."""
    rows = designs_of(shown.best, shown.table.axes)
    by_digest = {case.digest: case for case in shown.table.cases}
    cases = [by_digest[row["case"]] for row in rows]
    pictures, failed = pictures_of(Store(folder), cases, watch)
    scales = Scales.of(pictures.values()) if pictures else None
    designs, plates = [], list[Plate]()
    for number, row in enumerate(rows, start=1):
        digest = row["case"]
        settings = [(name, _text(row[name])) for name in shown.table.axes]
        name = ", ".join(f"{title} {text}" for title, text in settings)
        mine = list[Plate]()
        if scales and digest in pictures:
            mine = design_plates(number, name, pictures[digest], scales)
        figures = [(metric, _text(row.get(metric))) for metric in shown.table.metrics]
        names = [plate.name for plate in mine]
        designs.append(Design(number, digest, settings, figures, names, failed.get(digest, "")))
        plates += mine
    return designs, plates


def _is_number(rows: Sequence[Row], name: str) -> bool:
    """Tell whether a figure is a number in more than half of the cases (some have no ball)."""
    return sum(is_number(row.get(name)) for row in rows) > len(rows) / 2


def _first_error(metrics: Sequence[str]) -> str:
    return next((name for name in metrics if "rmse" in name or "error" in name), metrics[0])


def _plates(shown: Shown) -> list[Plate]:
    rows, axes, metrics = shown.rows, shown.table.axes, shown.metrics
    plates = [
        Plate("main_effects", lambda path: draw_main_effects(path, rows, axes, metrics),
              "each figure over each axis",
              "Line: mean over all other axes; band: range of all cases. A row has one scale."),
        Plate("parallel", lambda path: draw_parallel(path, rows, axes, metrics),
              "one line per case over all axes and figures",
              f"Every case is one line, coloured by {metrics[0]}."),
    ]  # fmt: skip
    pairs = list(combinations(axes, 2))[:_MOST_PAIRS]
    if pairs:
        plates += [_interactions(rows, pairs, metric) for metric in metrics[:2]]
    if len(shown.objectives) > 1 and shown.best:
        names = [one.metric for one in shown.objectives]
        whole = [row for row in shown.table.done() if all(is_number(row.get(n)) for n in names)]
        plates.append(
            Plate("front", lambda path: draw_front(path, whole, shown.best, shown.objectives),
                  "two objectives of all cases with the Pareto front",
                  "Designs that no other beats in every objective.")
        )  # fmt: skip
    method = shown.table.record.study.sampling.method
    if shown.effects:
        plates.append(
            Plate("sensitivity", lambda path: draw_effects(path, shown.effects, method),
                  "sensitivity of each figure to each axis",
                  _SENSITIVITY_WORDS[method] + _left_out(shown))
        )  # fmt: skip
    return plates


def _left_out(shown: Shown) -> str:
    """Say how many cases the effects of each figure do without."""
    counts = {name: without(shown.table, name) for name in shown.effects}
    parts = ", ".join(f"{count} without {name}" for name, count in counts.items() if count)
    return f" Cases left out: {parts}." if parts else ""


def _interactions(rows: list[Row], pairs: list[tuple[str, str]], metric: str) -> Plate:
    return Plate(
        f"interactions_{metric}",
        lambda path: draw_interactions(path, rows, pairs, metric),
        f"mean {metric} over pairs of axes",
        f"Mean {metric} over pairs of axes; one colour scale for all maps.",
    )


def _page(shown: Shown, designs: list[Design], pictures: dict[str, Picture]) -> dict[str, Any]:
    table, study = shown.table, shown.table.record.study
    states: dict[str, int] = {}
    for row in table.rows:
        states[row["state"]] = states.get(row["state"], 0) + 1
    columns = [*table.axes, *shown.metrics]
    of_designs = {name for design in designs for name in design.names}
    return {
        "study": study,
        "states": states,
        "columns": columns,
        "pictures": [picture for name, picture in pictures.items() if name not in of_designs],
        "designs": designs,
        "drawn": pictures,
        "unpictured": list(dict.fromkeys(one.failure for one in designs if one.failure)),
        "objectives": [f"{one.goal} {one.metric}" for one in shown.objectives],
        "constraints": [bound.title for bound in study.constraint],
        "best": [_cells(row, columns) for row in shown.best[:_MOST_BEST]],
        "cases": [_cells(row, columns) for row in table.rows],
        "left_out": len(table.done()) - len(shown.rows),
    }


def _cells(row: Row, columns: Sequence[str]) -> dict[str, Any]:
    texts = [_text(row.get(name)) for name in columns]
    file = "failure.json" if row["state"] == "failed" else "result.json"
    there = row["state"] in ("done", "failed")
    return {
        "texts": texts,
        "state": row["state"],
        "feasible": row["feasible"],
        "reason": row["reason"],
        "digest": row["case"],
        "link": f"cases/{row['case']}/{file}" if there else "",
        "experiment": f"cases/{row['case']}/experiment.toml",
    }


def _text(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
