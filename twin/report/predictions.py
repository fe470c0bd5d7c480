"""Report page of predictions that are scored against a data set, with a classical baseline."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import counted
from reconstruction.evaluate.methods import PREDICTIONS, DataSetScore, ScoredMethod
from reconstruction.evaluate.predictions import LABELS
from reconstruction.evaluate.samples import ALL_SPLITS
from twin.report.canvas import FIT, MEASURED, axes_at, chart, drawing, legend_above, plain_log
from twin.report.page import REPORT_FILE, Figure, Page, Section, write_page
from twin.report.table import Column, Row, Table

_PANEL_IN, _MOST_ROWS, _LOG_RANGE = 2.8, 200, 20.0
_FIGURES = (
    ("completeness", "completeness"),
    ("rms", "RMS"),
    ("mean_absolute", "mean absolute error"),
    ("bias", "mean error"),
    ("wrong_order_share", "share of wrong orders"),
)


def write_score_page(folder: Path, result: DataSetScore, folders: Sequence[Path]) -> Path:
    """Write `report.html` and its figures of a scored data set; return the path of the page.

    Parameters
    ----------
    folders : predictions, if any, and data set; the page states their names

    Raises
    ------
    InputError : the page cannot be written
    """
    *predictions, dataset = (path.absolute().name for path in folders)
    given = f"Predictions in {predictions[0]}" if predictions else "A classical method"
    page = Page(
        kind="score",
        title=dataset,
        lead=f"{given}, compared with the true values of the data set {dataset}, "
        f"{_splits(result.split)}. Pixels that show the measured surface and are lit are compared.",
        sections=[_section(method, result) for method in _methods(result)],
        warned="Warnings",
        warnings=_warnings(result),
    )
    return write_page(folder / REPORT_FILE, page)


def _splits(split: str) -> str:
    return "all splits" if split == ALL_SPLITS else f"split {split}"


def _methods(result: DataSetScore) -> list[str]:
    return list(dict.fromkeys(part.method for part in result.parts))


def _warnings(result: DataSetScore) -> list[str]:
    lines = [
        f"{part.method} {part.source}: no prediction for "
        f"{counted(len(part.score.without_prediction), 'sample')}. This lowers the "
        "completeness.".strip()
        for part in result.parts
        if part.score.without_prediction
    ]
    return [*lines, *(f"No score of the baseline: {why}" for why in result.unable.values())]


def _section(method: str, result: DataSetScore) -> Section:
    parts = [part for part in result.parts if part.method == method]
    rows = [row for part in parts for row in _error_rows(part)]
    columns = (
        Column("source", "source"),
        Column("quantity", "quantity"),
        *(Column(key, heading, kind="number") for key, heading in _FIGURES),
    )
    shown = [column for column in columns if any(row.get(column.key) is not None for row in rows)]
    name = method or "errors"
    figure = Figure(
        f"{name}_samples",
        "RMS error of the single samples",
        "Share of the samples whose RMS error is at most that of the horizontal axis. A curve "
        "further left is better. Samples without a predicted pixel are not in a curve, which then "
        "ends below 1.",
        "Distribution of the RMS error over the samples for each quantity.",
        partial(draw_errors, parts=parts),
    )
    errors = Table(
        name,
        "Errors of all samples together",
        "",
        tuple(shown),
        tuple(rows),
        ("Depth in µm, phase in rad, angle between normals in degrees.",),
    )
    objects = [row for row in result.by_object() if row.get("method", "") == method]
    return Section(name, method or "Errors", (errors, figure, _object_table(name, objects)))


def _error_rows(part: ScoredMethod) -> list[Row]:
    """Return a row of figures for each quantity of a score."""
    figures = part.score.figures()
    rows: list[Row] = []
    for quantity in part.score.names:
        stem, unit = LABELS[quantity]
        quantity_text = f"{stem} ({unit})".replace("_", " ").replace("(um)", "(µm)")
        row: dict[str, Any] = {"source": _label_of(part), "quantity": quantity_text}
        for key, _ in _FIGURES:
            value = figures.get(f"{stem}_{key}_{unit}", figures.get(f"{stem}_{key}"))
            row[key] = None if value is None else f"{value:.4g}"
        rows.append(row)
    return rows


def _object_table(name: str, rows: Sequence[dict[str, Any]]) -> Table:
    names = dict.fromkeys(key for row in rows for key in row if key != "method")
    kept = [key for key in names if "_rms_" in key or "_completeness" in key]
    first = [key for key in ("object", "split", "samples") if key in names]
    columns = tuple(Column(key, _heading(key), _decimals(key)) for key in (*first, *kept))
    cells = tuple({column.key: row.get(column.key) for column in columns} for row in rows)
    notes = (f"The first {_MOST_ROWS} of {len(rows)}; all are in objects.csv.",)
    return Table(
        f"{name}_objects",
        "Objects",
        "",
        columns,
        cells[:_MOST_ROWS],
        notes if len(rows) > _MOST_ROWS else (),
    )


def _decimals(key: str) -> int:
    return 1 if key.endswith("_um") else 4


def _heading(key: str) -> str:
    """Return the name of a column in words: depth_rms_um becomes "depth RMS (µm)"."""
    stem, rms, unit = key.partition("_rms_")
    return (
        f"{stem} RMS ({unit.replace('um', 'µm')})".replace("_", " ")
        if rms
        else stem.replace("_", " ")
    )


def _label_of(part: ScoredMethod) -> str:
    return part.source if part.source == PREDICTIONS else f"baseline: {part.source}"


def draw_errors(path: Path, parts: Sequence[ScoredMethod]) -> None:
    """Draw the distribution of the RMS error over the samples, one panel for each quantity.

    Raises
    ------
    InputError : the file cannot be written
    """
    quantities = list(dict.fromkeys(name for part in parts for name in part.score.names))
    step_in = _PANEL_IN + 0.7
    with drawing(path, len(quantities) * step_in + 0.1, 0.8 * _PANEL_IN + 1.0) as figure:
        for number, quantity in enumerate(quantities):
            place = (number * step_in + 0.6, 0.45)
            axes = axes_at(figure, *place, _PANEL_IN, 0.8 * _PANEL_IN)
            shown = [part for part in parts if quantity in part.score.names]
            spans: list[float] = []
            for part in shown:
                errors, shares = rms_distribution(part, quantity)
                line = "-" if part.source == PREDICTIONS else "--"
                colour = MEASURED if part.source == PREDICTIONS else FIT
                axes.step(errors, shares, line, where="post", color=colour, label=_label_of(part))
                spans += [errors[0], errors[-1]] if errors.size else []
            stem, unit = LABELS[quantity]
            if spans and max(spans) > _LOG_RANGE * min(spans) > 0:
                axes.set_xscale("log")
                plain_log(axes.xaxis)
            else:
                axes.set_xlim(left=0.0)
            xlabel = f"RMS error of {stem.replace('_', ' ')} ({unit.replace('um', 'µm')})"
            chart(axes, "", xlabel, "share of samples" if not number else "", ylim=(0.0, 1.02))
            legend_above(axes, len(shown))


def rms_distribution(part: ScoredMethod, quantity: str) -> tuple[FloatArray, FloatArray]:
    """Return the sorted RMS errors (n,) of the samples, and the share of samples up to each.

    The smallest error is there twice, first with the share 0. Samples without an error count.
    """
    known = [rms[quantity] for rms in part.score.rms.values() if quantity in rms]
    errors = np.sort(np.array([rms for rms in known if rms is not None], np.float64))
    shares = np.arange(errors.size + 1) / max(len(known), 1)
    return (np.r_[errors[:1], errors], shares) if errors.size else (errors, errors)
