"""Section of a study's page: largest value of an axis at which all conditions are met.

For each setting of the other axes, it has the limit in a table, and the limited figures over the
axis in a picture. `twin.study.axis_limit` computes the limits.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, StrMethodFormatter

from twin.report.canvas import FIT, INK, axes_at, drawing, plain_spines
from twin.report.page import Block, Figure, Grade, Note, Section, Verdict
from twin.report.study_words import amount, axis_headings, titles_of, value_text
from twin.report.table import Column, Table
from twin.results.rows import is_number
from twin.study.axis_limit import AxisLimit, axis_limits
from twin.study.table import Row, StudyTable, design_of

_MOST_PANELS, _MOST_CURVES = 4, 10
_LEAST_RATIO = 3.0  # of the largest to the smallest value of a logarithmic axis
_MARKERS = "osD^vPX<>*"


def limit_sentences(table: StudyTable) -> list[str]:
    """Return one sentence per setting of the other axes, the largest limit first."""
    axis = table.record.study.limit_axis
    if axis is None:
        return []
    label, unit = axis_headings(table)[axis]
    return [
        f"{_settings(table, limit)}: {label} {_limit_text(limit, unit)}{_reason(limit)}"
        for limit in axis_limits(table)
    ]


def limit_verdicts(table: StudyTable) -> list[Verdict]:
    """Return the card with all limits for the head of the page; empty without `limit_axis`."""
    limits, axis = axis_limits(table), table.record.study.limit_axis
    if axis is None or not limits:
        return []
    label, unit = axis_headings(table)[axis]
    best = limits[0]
    headline = f"{_settings(table, best)}: {_limit_text(best, unit)}"
    grade: Grade = "poor" if best.met is None else "good"
    reasons = tuple(limit_sentences(table))
    return [Verdict(f"Up to which {label} are all conditions met?", headline, grade, reasons)]


def limit_sections(table: StudyTable) -> Iterator[Section]:
    """Yield the section with table and picture of the limits; nothing without `limit_axis`."""
    limits, axis = axis_limits(table), table.record.study.limit_axis
    if axis is None or not limits:
        return
    label = axis_headings(table)[axis][0]
    blocks: list[Block] = [
        Note(
            f"Largest {label} at which all conditions are met. Met, missed: the levels of the study"
            " between which the limit is; between them the distance of the figure from its limit is"
            " taken as linear."
        ),
        _table(table, axis, limits),
    ]
    figures = _limited_figures(table)
    if figures:
        blocks.append(_figure(table, axis, figures))
    yield Section("limits", f"Largest {label}", tuple(blocks))


def _settings(table: StudyTable, limit: AxisLimit) -> str:
    headings = axis_headings(table)
    parts = (f"{headings[n][0]} {amount(v, headings[n][1])}" for n, v in limit.settings.items())
    return ", ".join(parts) or "this design"


def _limit_text(limit: AxisLimit, unit: str) -> str:
    if limit.met is None:
        return f"below {amount(limit.missed, unit)}"
    if limit.missed is None:
        return f"{amount(limit.met, unit)} or more"
    bounds = f"between {value_text(limit.met)} and {amount(limit.missed, unit)}"
    return bounds if limit.value is None else f"{limit.value:.3g} {unit}".strip() + f", {bounds}"


def _reason(limit: AxisLimit) -> str:
    again = ", ".join(map(value_text, limit.met_again))
    more = f"; met again at {again}" if again else ""
    return f" ({limit.condition}{more})" if limit.condition else ""


def _table(table: StudyTable, axis: str, limits: Sequence[AxisLimit]) -> Table:
    headings = axis_headings(table)
    label, unit = headings[axis]
    others = [name for name in table.axes if name not in (axis, "seed")]
    columns = (
        *(Column(name, headings[name][0], unit=headings[name][1]) for name in others),
        Column("limit", f"largest {label}", unit=unit, kind="number"),
        Column("met_at", "met at", unit=unit, kind="number"),
        Column("missed_at", "missed at", unit=unit, kind="number"),
        Column("condition", "missed condition", kind="reason"),
    )
    rows = tuple(
        {name: value_text(limit.settings[name]) for name in others}
        | {
            "limit": value_text(limit.value and float(f"{limit.value:.3g}")),
            "met_at": value_text(limit.met),
            "missed_at": value_text(limit.missed),
            "condition": _reason(limit).strip(" ()"),
        }
        for limit in limits
    )
    return Table("axis_limits", "", "", columns, rows, look="cases")


def _limited_figures(table: StudyTable) -> list[str]:
    """Return the figures that a constraint limits and that cases have, in the order of the file."""
    bounds = table.record.study.constraint
    names = dict.fromkeys(bound.value for bound in bounds if bound.per is None)
    done = table.done()
    return [n for n in names if any(is_number(row.get(n)) for row in done)][:_MOST_PANELS]


def _figure(table: StudyTable, axis: str, figures: Sequence[str]) -> Figure:
    titles = titles_of(table, figures)
    names = ", ".join(titles[name] for name in figures)
    return Figure(
        "limits",
        "",
        f"{names} over {titles[axis]}, one curve per setting of the other axes (mean of repeats). "
        "Dashed: limits.",
        f"{names} over {titles[axis]}",
        lambda path: _draw(path, table, axis, figures),
    )


def _draw(path: Path, table: StudyTable, axis: str, figures: Sequence[str]) -> None:
    """Draw the limited figures over the axis as PNG, logarithmic over a wide range."""
    width, height, titles = 3.1, 2.6, titles_of(table, figures)
    curves = _curves(table, axis)
    lines = -(-len(curves) // 2)
    with drawing(path, len(figures) * (width + 0.95) + 0.2, height + 0.95 + 0.2 * lines) as figure:
        for across, name in enumerate(figures):
            left, top = 0.75 + across * (width + 0.95), 0.3 + 0.2 * lines
            place = axes_at(figure, left, top, width, height)
            _draw_panel(place, curves, axis, name)
            for bound in table.record.study.constraint:
                if bound.value == name and bound.per is None:
                    _draw_limits(place, bound.at_least, bound.at_most)
            place.set(xlabel=titles[axis], ylabel=titles[name])
            if not across:
                place.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)


def _curves(table: StudyTable, axis: str) -> dict[str, list[Row]]:
    """Return the finished rows of each setting of the other axes, by its name."""
    others = [name for name in table.axes if name not in (axis, "seed")]
    by_design: dict[str, list[Row]] = {}
    for row in table.done():
        by_design.setdefault(design_of(row, others), []).append(row)
    named = {
        ", ".join(value_text(rows[0][name]) for name in others) or "this design": rows
        for rows in by_design.values()
    }
    return dict(list(named.items())[:_MOST_CURVES])


def _draw_panel(place: Axes, curves: dict[str, list[Row]], axis: str, name: str) -> None:
    drawn_x, drawn_y = list[float](), list[float]()
    for (label, rows), marker in zip(curves.items(), _MARKERS, strict=False):
        by_level: dict[float, list[float]] = {}
        for row in rows:
            if is_number(row.get(name)):
                by_level.setdefault(float(row[axis]), []).append(float(row[name]))
        x = sorted(by_level)
        y = [float(np.mean(by_level[level])) for level in x]
        place.plot(x, y, f"{marker}-", markersize=4, linewidth=1.1, label=label)
        drawn_x, drawn_y = drawn_x + x, drawn_y + y
    for values, scale, ruler in (
        (drawn_x, place.set_xscale, place.xaxis),
        (drawn_y, place.set_yscale, place.yaxis),
    ):
        if values and min(values) > 0.0 and max(values) > _LEAST_RATIO * min(values):
            scale("log")
            ruler.set_major_formatter(StrMethodFormatter("{x:g}"))
            ruler.set_minor_formatter(NullFormatter())
    plain_spines(place)


def _draw_limits(place: Axes, *limits: float | None) -> None:
    for limit in limits:
        if limit is not None:
            place.axhline(limit, color=FIT, linestyle="--", linewidth=1.0)
            place.annotate(f"{limit:g}", (1.0, limit), xycoords=("axes fraction", "data"),
                           xytext=(2, 0), textcoords="offset points", color=INK, fontsize=7.5,
                           va="center")  # fmt: skip
