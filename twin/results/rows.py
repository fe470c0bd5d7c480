"""Rows of settings and figures, one per case: as labelled arrays, and drawn for a notebook."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from reconstruction.netcdf import Labelled, LabelledArrays

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from reconstruction.drawing import Drawing

Row = Mapping[str, Any]
_MOST_PANELS = 3


def is_number(value: object) -> TypeGuard[float]:
    """Whether a cell is a figure: neither text nor yes or no nor empty."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def rows_as_arrays(rows: Sequence[Row], names: Sequence[str]) -> LabelledArrays:
    """Return the columns of a table over its rows, each along the dimension `case`.

    Columns of figures are float with NaN where a row has none; columns of text have "" there; a
    column with neither is left out. The column `case` labels the rows, or else their numbers do.
    Units are in the names.
    """
    variables: dict[str, Labelled] = {}
    for name in names:
        values = [row.get(name) for row in rows]
        if any(map(is_number, values)):
            figures = [one if is_number(one) else np.nan for one in values]
            variables[name] = ("case", np.array(figures, np.float64), {})
        elif any(isinstance(one, str) for one in values):
            texts = [one if isinstance(one, str) else "" for one in values]
            variables[name] = ("case", np.array(texts, dtype=object), {})
    numbers: Labelled = ("case", np.arange(len(rows)), {})
    return LabelledArrays(variables, {"case": variables.pop("case", numbers)})


def draw_rows(rows: Sequence[Row], x: str, names: Sequence[str], by: str = "") -> "Drawing":
    """Draw the first columns of figures over a setting: a Matplotlib figure, one panel each.

    Parameters
    ----------
    x : column of numbers or of texts
    names : columns to choose from; those without a figure are left out
    by : column whose values are distinguished by colour
    """
    from reconstruction.drawing import Drawing

    shown = [name for name in names if any(is_number(row.get(name)) for row in rows)]
    drawing = Drawing(_MOST_PANELS)
    panels = drawing.subplots(1, _MOST_PANELS)
    for axes, name in zip(panels, shown, strict=False):
        for label in dict.fromkeys(row.get(by, "") for row in rows):
            _points(axes, [row for row in rows if row.get(by, "") == label], x, name, label)
        axes.set(xlabel=x, ylabel=name)
        axes.margins(0.15)
        axes.grid(visible=True, alpha=0.4)
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    if by and shown:
        panels[0].legend()
    return drawing


def _points(axes: "Axes", rows: Sequence[Row], x: str, name: str, label: str) -> None:
    known = [row for row in rows if is_number(row.get(name))]
    places = [row[x] if is_number(row.get(x)) else str(row.get(x)) for row in known]
    axes.plot(places, [row[name] for row in known], "o", label=label)
