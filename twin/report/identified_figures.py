"""Figures of an identification: joint densities of field pairs, and differences of the rows.

Fields are the unknown properties, rows the measured values.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import NullLocator

from reconstruction.arrays import FloatArray
from twin.config.problem import Free
from twin.identification.known import Identified
from twin.report.canvas import (
    FAINT,
    FIT,
    INK,
    MEASURED,
    MEASURED_FILL,
    axes_at,
    drawing,
    legend_above,
    plain_spines,
)
from twin.report.words import split_unit

AGREES = 2.0
"""Largest difference of a row from its prediction that counts as agreement, in standard deviations
of this difference."""
_PANEL_IN, _LEFT_IN, _TOP_IN, _BELOW_IN, _GAP_IN = 1.45, 0.75, 0.15, 0.5, 0.14
_BINS = 36


def field_words(name: str, free: Free) -> str:
    """Return the label of a field, with the unit at the end of the field's path in brackets."""
    unit = split_unit(free.path.rsplit(".", 1)[-1])[1]
    words = split_unit(name)[0].replace("_", " ")
    return f"{words} ({unit})" if unit else words


def draw_corner(identified: Identified, path: Path) -> None:
    """Draw the posterior densities of all fields and of all pairs of fields as PNG (corner plot).

    The panels of single fields also show the profile of the likelihood.
    """
    free, values = identified.problem.free, identified.values
    count, profiles = len(free), identified.profiles()
    panels = count * (_PANEL_IN + _GAP_IN)
    with drawing(path, _LEFT_IN + panels, _TOP_IN + panels + _BELOW_IN) as figure:
        for row, (name, upper) in enumerate(free.items()):
            for column, lower in enumerate(list(free.values())[: row + 1]):
                left = _LEFT_IN + column * (_PANEL_IN + _GAP_IN)
                top = _TOP_IN + row * (_PANEL_IN + _GAP_IN)
                axes = axes_at(figure, left, top, _PANEL_IN, _PANEL_IN)
                if row == column:
                    _density(axes, upper, values[:, row], profiles[name])
                else:
                    _pair(axes, (lower, upper), values[:, [column, row]])
                _label(axes, list(free.items()), row, column)


def _density(
    axes: Axes, free: Free, samples: FloatArray, profile: tuple[FloatArray, FloatArray]
) -> None:
    axes.hist(
        samples, _edges(free).tolist(), density=True, color=MEASURED_FILL, histtype="stepfilled"
    )
    top = axes.get_ylim()[1]
    at, heights = profile
    axes.plot(at, 0.95 * top * np.exp(heights), color=FIT, linewidth=1.1)
    axes.set(xlim=(free.low, free.high), yticks=[], xscale=free.scale)


def _pair(axes: Axes, free: tuple[Free, Free], samples: FloatArray) -> None:
    across, up = free
    bins = [_edges(across), _edges(up)]
    density, x, y = np.histogram2d(samples[:, 0], samples[:, 1], bins=bins)
    axes.pcolormesh(x, y, np.sqrt(density.T), cmap="Blues", rasterized=True)
    axes.set(xscale=across.scale, yscale=up.scale)
    axes.set(xlim=(across.low, across.high), ylim=(up.low, up.high))


def _edges(free: Free) -> FloatArray:
    return free.value(np.linspace(0.0, 1.0, _BINS + 1))


def mark(axis: Axis, free: Free) -> None:
    """Set the ticks of an axis to the ends and the middle of a field's range, as plain numbers."""
    marks = free.value(np.array([0.0, 0.5, 1.0]))
    axis.set_ticks(marks.tolist(), labels=[f"{value:.2g}" for value in marks])
    axis.set_minor_locator(NullLocator())


def _label(axes: Axes, free: list[tuple[str, Free]], row: int, column: int) -> None:
    names = [field_words(name, field) for name, field in free]
    mark(axes.xaxis, free[column][1])
    if row != column:
        mark(axes.yaxis, free[row][1])
    axes.tick_params(labelsize=6.0, which="both")
    if row == len(free) - 1:
        axes.set_xlabel(names[column], fontsize=8.0)
    else:
        axes.tick_params(labelbottom=False, which="both")
    if column == 0 and row:
        axes.set_ylabel(names[row], fontsize=8.0)
    elif column:
        axes.tick_params(labelleft=False, which="both")


def draw_rows(identified: Identified, path: Path) -> None:
    """Draw the normalised difference of every row as PNG.

    It is the measured minus the predicted value, divided by the standard deviation of this
    difference.
    """
    rows = identified.best.predictions
    height = 0.9 + 0.26 * len(rows)
    with drawing(path, 7.0, height) as figure:
        axes = axes_at(figure, 2.3, 0.35, 4.4, height - 0.85)
        axes.axvspan(-AGREES, AGREES, color="#eef3f8")
        axes.axvline(0.0, color=FAINT, linewidth=0.8)
        for fitted, face, label in ((True, MEASURED, "fitted"), (False, "white", "held out")):
            at = [i for i, prediction in enumerate(rows) if prediction.fitted == fitted]
            axes.plot(
                [rows[i].deviation for i in at],
                at,
                "o",
                color=MEASURED,
                markerfacecolor=face,
                label=label,
            )
        axes.set_yticks(range(len(rows)), [prediction.row for prediction in rows], color=INK)
        axes.invert_yaxis()
        farthest = max(3.0, *(abs(prediction.deviation) for prediction in rows)) * 1.1
        axes.set(xlim=(-farthest, farthest), ylim=(len(rows) - 0.5, -0.5))
        axes.set_xlabel("(measured − predicted) / standard deviation of the difference")
        plain_spines(axes)
        legend_above(axes, 2)
