"""Draw main effects, interactions, parallel coordinates, Pareto front, sensitivities and designs.

An axis of a study is a setting that varies from case to case. A value is a result of each case. It
has the same scale in all plots of a picture, so that the plots can be compared.
"""

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from reconstruction.arrays import FloatArray
from twin.config.study import Objective
from twin.report.canvas import (
    FAINT,
    FIT,
    INK,
    MEASURED,
    MEASURED_FILL,
    add_colorbar,
    axes_at,
    drawing,
    no_ticks,
    plain_spines,
    sequential,
    symmetric_limit,
)
from twin.report.page import Figure
from twin.report.pixel_panels import ZScale, draw_small, show_picture, show_z, show_z_error
from twin.results.rows import is_number
from twin.study.pictures import CasePicture
from twin.study.sensitivity import Effect, groups_of

Row = Mapping[str, Any]
Titles = Mapping[str, str]
"""Headings of axes and values by name; a name without heading is its own heading."""
_LABEL_WIDTH = 22  # characters of a line along an axis of a small plot


def _title(titles: Titles, name: str) -> str:
    """Return the heading of a name in lines that fit along the axis of a small plot."""
    return textwrap.fill(titles.get(name, name), _LABEL_WIDTH)


def numbers(rows: Sequence[Row], name: str) -> FloatArray:
    """Return the value `name` of every row, (row,)."""
    return np.array([float(row[name]) for row in rows])


def _labelled_groups(rows: Sequence[Row], axis: str) -> tuple[list[str], list[list[Row]]]:
    """Return the labels of the levels of an axis, and the rows of each level."""
    groups = groups_of(rows, axis)
    labels = [f"{level:.4g}" if isinstance(level, float) else str(level) for level, _ in groups]
    return labels, [group for _, group in groups]


def draw_main_effects(
    path: Path,
    rows: Sequence[Row],
    axes: Sequence[str],
    metrics: Sequence[str],
    titles: Titles,
) -> None:
    """Draw each value over each axis as PNG: mean over all other axes, and range of all cases."""
    width, height = 2.2, 1.5
    size = 0.9 + len(axes) * (width + 0.3), 0.4 + len(metrics) * (height + 0.65)
    with drawing(path, *size) as figure:
        for down, metric in enumerate(metrics):
            for across, axis in enumerate(axes):
                left, top = 0.85 + across * (width + 0.3), 0.3 + down * (height + 0.65)
                place = axes_at(figure, left, top, width, height)
                _draw_effect(place, rows, axis, metric)
                if across:
                    place.set_yticklabels([])
                else:
                    place.set_ylabel(_title(titles, metric))
                if down == len(metrics) - 1:
                    place.set_xlabel(_title(titles, axis))


def _draw_effect(place: Axes, rows: Sequence[Row], axis: str, metric: str) -> None:
    names, groups = _labelled_groups(rows, axis)
    values = [numbers(group, metric) for group in groups]
    at = np.arange(len(names))
    place.fill_between(
        at, [v.min() for v in values], [v.max() for v in values], color=MEASURED_FILL, alpha=0.5
    )
    place.plot(at, [v.mean() for v in values], "o-", color=MEASURED, markersize=4)
    long = max(map(len, names)) > 5
    place.set_xticks(at, names, rotation=30 if long else 0, ha="right" if long else "center")
    place.set_ylim(*_limits(numbers(rows, metric)))
    plain_spines(place)


def _limits(values: FloatArray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    margin = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def draw_interactions(
    path: Path,
    rows: Sequence[Row],
    pairs: Sequence[tuple[str, str]],
    metric: str,
    titles: Titles,
) -> None:
    """Draw maps of the mean of a value over each pair of axes, on one colour scale, as PNG."""
    low, high = numbers(rows, metric).min(), numbers(rows, metric).max()
    across = min(3, len(pairs))
    down = -(-len(pairs) // across)
    with drawing(path, 1.4 + across * 3.0, 0.3 + down * 2.9) as figure:
        for number, (x, y) in enumerate(pairs):
            left, top = 0.8 + number % across * 3.0, 0.25 + number // across * 2.9
            place = axes_at(figure, left, top, 2.1, 2.0)
            shown = _draw_pair(place, rows, (x, y), metric, (float(low), float(high)))
            place.set_xlabel(_title(titles, x))
            place.set_ylabel(_title(titles, y))
        add_colorbar(place, shown, f"mean {titles.get(metric, metric)}")


def _draw_pair(
    place: Axes, rows: Sequence[Row], pair: tuple[str, str], metric: str, ends: tuple[float, float]
) -> Any:
    columns, groups = _labelled_groups(rows, pair[0])
    lines, by_line = _labelled_groups(rows, pair[1])
    line_of = {id(row): number for number, group in enumerate(by_line) for row in group}
    means = np.full((len(lines), len(columns)), np.nan)
    for column, group in enumerate(groups):
        for line in range(len(lines)):
            cell = [float(row[metric]) for row in group if line_of[id(row)] == line]
            means[line, column] = np.mean(cell) if cell else np.nan
    shown = place.imshow(
        np.ma.masked_invalid(means), sequential(), vmin=ends[0], vmax=ends[1], origin="lower",
        aspect="auto",
    )  # fmt: skip
    place.set_xticks(range(len(columns)), columns, rotation=30)
    place.set_yticks(range(len(lines)), lines)
    return shown


def draw_parallel(
    path: Path,
    rows: Sequence[Row],
    axes: Sequence[str],
    metrics: Sequence[str],
    titles: Titles,
) -> None:
    """Draw every case as a line over axes and values (parallel coordinates), as PNG.

    The colour of a line is the first value in `metrics`.
    """
    names = [*axes, *metrics]
    places = np.stack([_places(rows, name) for name in names], axis=1)
    colour = numbers(rows, metrics[0])
    with drawing(path, 1.7 + 1.15 * len(names), 3.3) as figure:
        place = axes_at(figure, 1.0, 0.3, 1.15 * (len(names) - 1), 2.3)
        segments = [np.column_stack([np.arange(len(names)), line]) for line in places]
        lines = LineCollection(segments, cmap=sequential(), linewidths=0.8, alpha=0.7)
        lines.set_array(colour)
        place.add_collection(lines)
        place.set_xlim(0, len(names) - 1)
        place.set_ylim(-0.07, 1.07)
        place.spines[:].set_visible(False)
        shown = [_title(titles, name) for name in names]
        place.set_xticks(range(len(names)), shown, rotation=20, ha="right")
        place.set_yticks([])
        for at, name in enumerate(names):
            place.axvline(at, color=FAINT, linewidth=0.6)
            for height, text in zip((-0.035, 1.035), _ends(rows, name), strict=True):
                place.text(at, height, text, fontsize=7.0, color=INK, ha="center", va="center")
        add_colorbar(place, lines, titles.get(metrics[0], metrics[0]))


def _places(rows: Sequence[Row], name: str) -> FloatArray:
    """Return the positions (0 to 1) of all rows on the vertical line of a column, (row,).

    Numbers are scaled between their smallest and largest value; texts are equally spaced.
    """
    column = [row[name] for row in rows]
    if not all(isinstance(value, (int, float)) for value in column):
        order = {value: i for i, value in enumerate(dict.fromkeys(map(str, column)))}
        column = [order[str(value)] for value in column]
    values = np.array(column, np.float64)
    return np.asarray((values - values.min()) / (np.ptp(values) or 1.0))


def _ends(rows: Sequence[Row], name: str) -> tuple[str, str]:
    column = [row[name] for row in rows]
    if all(isinstance(value, (int, float)) for value in column):
        return f"{min(column):.3g}", f"{max(column):.3g}"
    known = list(dict.fromkeys(map(str, column)))
    return known[0], known[-1]


def draw_front(
    path: Path,
    rows: Sequence[Row],
    front: Sequence[Row],
    objectives: Sequence[Objective],
    titles: Titles,
) -> None:
    """Draw two objectives of all cases as points, and the cases on the Pareto front, as PNG."""
    x, y = objectives[0].metric, objectives[1].metric
    with drawing(path, 5.4, 3.9) as figure:
        place = axes_at(figure, 0.8, 0.3, 4.3, 2.9)
        feasible = [row for row in rows if row["feasible"]]
        rest = [row for row in rows if not row["feasible"]]
        place.plot(numbers(rest, x), numbers(rest, y), "x", color=FAINT, label="not feasible")
        place.plot(numbers(feasible, x), numbers(feasible, y), "o", color=MEASURED_FILL,
                   markersize=4, label="feasible")  # fmt: skip
        order = sorted(front, key=lambda row: float(row[x]))
        place.plot(numbers(order, x), numbers(order, y), "o-", color=FIT, markersize=5,
                   linewidth=1.0, label="best")  # fmt: skip
        place.set_xlabel(f"{titles.get(x, x)}: {objectives[0].goal}")
        place.set_ylabel(f"{titles.get(y, y)}: {objectives[1].goal}")
        place.legend()
        plain_spines(place)


def draw_trade(
    path: Path,
    rows: Sequence[Row],
    chosen: Row,
    columns: tuple[str, Sequence[str]],
    titles: Titles,
) -> None:
    """Draw a figure of all cases over other columns, with the chosen design, as PNG.

    Parameters
    ----------
    columns : name of the figure, and names of the columns over which it is drawn
    """
    objective, over = columns
    width, height, gap = 2.6, 2.3, 0.35
    with drawing(path, 1.0 + len(over) * (width + gap), height + 1.15) as figure:
        for across, name in enumerate(over):
            place = axes_at(figure, 0.9 + across * (width + gap), 0.45, width, height)
            _draw_column(place, rows, chosen, name, objective)
            place.set_xlabel(titles.get(name, name))
            if across:
                place.set_yticklabels([])
            else:
                place.set_ylabel(_title(titles, objective))
                place.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)


def _draw_column(place: Axes, rows: Sequence[Row], chosen: Row, name: str, objective: str) -> None:
    labels, groups = _labelled_groups(rows, name)
    is_categorical = not all(is_number(row[name]) for row in rows)
    at = {id(row): number for number, group in enumerate(groups) for row in group}
    kinds = (("not feasible", False, "x", FAINT), ("feasible", True, "o", MEASURED))
    for label, feasible, marker, colour in kinds:
        some = [row for row in rows if bool(row["feasible"]) == feasible]
        x = [at[id(row)] for row in some] if is_categorical else numbers(some, name)
        place.plot(x, numbers(some, objective), marker, color=colour, markersize=4, label=label)
    x_chosen = at[id(chosen)] if is_categorical else float(chosen[name])
    place.plot(
        [x_chosen], [float(chosen[objective])], "*", color=FIT, markersize=13, label="this design"
    )
    if is_categorical:
        place.set_xticks(range(len(labels)), labels, rotation=30, ha="right")
    place.set_ylim(*_limits(numbers(rows, objective)))
    plain_spines(place)


def draw_effects(
    path: Path, effects: Mapping[str, Sequence[Effect]], method: str, titles: Titles
) -> None:
    """Draw the sensitivities as PNG, with one group of bars per value.

    Intervals are drawn unless `method` is "grid".
    """
    with drawing(path, 7.2, 0.4 + sum(0.75 + 0.28 * len(e) for e in effects.values())) as figure:
        top = 0.3
        for metric, ranking in effects.items():
            height = 0.28 * len(ranking)
            place = axes_at(figure, 1.9, top, 4.6, height)
            draw_effect_bars(place, ranking, intervals=method != "grid")
            place.set_title(titles.get(metric, metric), fontsize=8.5)
            place.set_yticks(place.get_yticks(), [_title(titles, e.axis) for e in ranking])
            place.set_xlim(left=0.0, right=None if method == "morris" else 1.05)
            top += height + 0.75


def draw_effect_bars(place: Axes, effects: Sequence[Effect], intervals: bool = True) -> None:
    """Draw the effect of each axis as a bar, the first effect on top.

    If `intervals` is True, also draw confidence intervals, and total effects as diamonds.
    """
    at = np.arange(len(effects))[::-1]
    value = np.array([e.value for e in effects])
    place.barh(at, value, 0.6, color=MEASURED)
    if intervals:
        ends = np.array([[e.low, e.high] for e in effects]).T
        reach = np.maximum((ends - value) * [[-1.0], [1.0]], 0.0)
        place.errorbar(value, at, xerr=reach, fmt="none", ecolor=INK)
        totals = [np.nan if e.total is None else e.total for e in effects]
        place.plot(totals, at, "d", color=FIT, markersize=4)
    place.set_yticks(at, [e.axis for e in effects])
    plain_spines(place)


@dataclass(frozen=True)
class Scales:
    """Scales that the pictures of all designs on a page have in common.

    Attributes
    ----------
    z : scale of the true heights of all designs
    error_um : limit of the error scale, see `symmetric_limit`
    """

    z: ZScale
    error_um: float

    @classmethod
    def of(cls, pictures: Iterable[CasePicture]) -> "Scales":
        """Return the common scales of at least one picture."""
        shown = list(pictures)
        z_mm = np.concatenate([picture.true_z_mm for picture in shown])
        errors_um = np.concatenate([picture.error_um[picture.scored] for picture in shown])
        width_mm = max(float(picture.width_mm) for picture in shown)
        return cls(ZScale.of(z_mm, width_mm), symmetric_limit(errors_um))


def design_figures(
    number: int, settings: str, picture: CasePicture, scales: Scales
) -> list[Figure]:
    """Return the three pictures of one design: camera image, measured heights and z error.

    Parameters
    ----------
    number : place of the design in the ranking
    settings : label of the design
    """
    colours, shape = picture.seen.ndim == 3, picture.measured.shape
    image_caption = "camera image" if colours else "fringe image: black is 0, white is saturation"
    z_mm = np.ma.masked_array(picture.z_mm.astype(np.float64), ~picture.measured)
    error_um = np.ma.masked_array(picture.error_um, ~picture.scored)
    width_mm = float(picture.width_mm)

    def show_heights(axes: Axes) -> None:
        show_z(axes, z_mm, width_mm, scales.z)
        no_ticks(axes)

    shown: tuple[tuple[str, str, Callable[[Axes], None]], ...] = (
        ("seen", image_caption, lambda axes: show_picture(axes, picture.seen)),
        ("heights", "measured heights; white: no measurement", show_heights),
        ("error", "z error against the true surface; gray: no measurement",
         lambda axes: show_z_error(axes, error_um, scales.error_um)),
    )  # fmt: skip
    return [
        Figure(
            f"design_{number}_{kind}",
            "",
            caption,
            f"{settings}: {caption}",
            partial(draw_small, show=show, shape=shape, bar=kind != "seen"),
        )
        for kind, caption, show in shown
    ]
