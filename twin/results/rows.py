"""Tables with one row of settings and figures per case: as labelled arrays, and as plots."""

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
    """Return True if the value of a cell is a number: not a text, not a bool, not None."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def rows_as_arrays(rows: Sequence[Row], names: Sequence[str]) -> LabelledArrays:
    """Return the named columns of a table as arrays along the dimension `case`.

    A column with numbers is float, with NaN for a missing number. A column of text has "" for a
    missing text. A column with neither is left out. The rows are labelled by the column `case` if
    there is one, else by their numbers. Units are in the names.
    """
    variables: dict[str, Labelled] = {}
    for name in names:
        values = [row.get(name) for row in rows]
        if any(map(is_number, values)):
            figures = [value if is_number(value) else np.nan for value in values]
            variables[name] = ("case", np.array(figures, np.float64), {})
        elif any(isinstance(value, str) for value in values):
            texts = [value if isinstance(value, str) else "" for value in values]
            variables[name] = ("case", np.array(texts, dtype=object), {})
    numbers: Labelled = ("case", np.arange(len(rows)), {})
    return LabelledArrays(variables, {"case": variables.pop("case", numbers)})


def draw_rows(rows: Sequence[Row], x: str, names: Sequence[str], by: str = "") -> "Drawing":
    """Draw up to three columns of figures over a setting into a Matplotlib figure, a panel each.

    Parameters
    ----------
    x : name of the column on the horizontal axis, with numbers or texts
    names : names of columns; the first three of those with numbers are drawn
    by : name of the column that is shown by colour; empty: one colour
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
