"""Presentation of trials: labelled arrays, and results of measurands as texts and plots."""

from typing import TYPE_CHECKING

import numpy as np

from reconstruction.netcdf import Labelled, LabelledArrays
from twin.results.rows import is_number
from twin.study.trials import PART, TRIAL, TRIALS

if TYPE_CHECKING:
    from reconstruction.drawing import Drawing
    from twin.propagation.results import Measurand, Uncertainty

_PANELS = 3
_DESCRIPTION = "trials of a measurement; trial 0 is the nominal one"


def trial_arrays(result: "Uncertainty", absent: float = np.nan) -> LabelledArrays:
    """Return a variable (trial,) for each input and each figure; the unit is in the name.

    Parameters
    ----------
    absent : stored value for trials that lack the figure
    """
    rows = [row for row in result.table.rows if row.get(PART) == TRIALS]
    keys = [given.key for given in result.inputs().values()]
    known = dict.fromkeys(name for row in rows for name, v in row.items() if is_number(v))
    names = [*keys, *(name for name in known if name not in keys and name != TRIAL)]
    variables: dict[str, Labelled] = {}
    for name in names:
        values = [row[name] if is_number(row.get(name)) else absent for row in rows]
        meaning = "input" if name in keys else "figure of the measurement"
        attributes = {"long_name": meaning, "missing_value": absent}
        variables[name] = (TRIAL, np.array(values, np.float64), attributes)
    numbers = np.array([row[TRIAL] for row in rows])
    coords: dict[str, Labelled] = {TRIAL: (TRIAL, numbers, {})}
    return LabelledArrays(variables, coords, {"description": _DESCRIPTION})


def measurand_in_short(measurand: "Measurand") -> str:
    """Return a text with the mean and standard uncertainty of a measurand.

    The probabilistically symmetric coverage interval is added if it exists.
    """
    result = measurand.distribution
    text = f"{result.mean:.6g}, u {result.standard_uncertainty:.2g}"
    if result.symmetric is None:
        return text
    low, high = result.symmetric.low, result.symmetric.high
    return f"{text}, {100 * result.coverage:g} % {low:.6g} to {high:.6g}"


def trial_drawing(result: "Uncertainty") -> "Drawing":
    """Draw the histogram of each measurand over the trials, with its coverage interval."""
    from reconstruction.drawing import Drawing, draw_distribution

    rows = -(-len(result.measurands) // _PANELS)
    drawing = Drawing(_PANELS, rows)
    panels = drawing.subplots(rows, _PANELS, squeeze=False).ravel()
    for axes, measurand in zip(panels, result.measurands.values(), strict=False):
        interval = measurand.distribution.symmetric
        ends = None if interval is None else (interval.low, interval.high)
        draw_distribution(axes, measurand.distribution.values, measurand.name, ends)
    for axes in panels[len(result.measurands) :]:
        axes.set_axis_off()
    return drawing
