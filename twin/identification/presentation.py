"""Presentation of an identification: samples as labelled arrays, intervals as texts, plots."""

from typing import TYPE_CHECKING

import numpy as np

from reconstruction.netcdf import Labelled, LabelledArrays

if TYPE_CHECKING:
    from reconstruction.drawing import Drawing
    from twin.identification.known import Identified

_PANELS = 3


def samples_of(identified: "Identified") -> LabelledArrays:
    """Return the samples (model, sample) of each free field, and each model's probability.

    An improbable model has fewer samples; NaN follows them.
    """
    count = min(len(model.posterior.z) for model in identified.probable)
    dims = ("model", "sample")
    shape = (len(identified.models), count, len(identified.problem.free))
    by_model = np.full(shape, np.nan)
    for samples, model in zip(by_model, identified.models, strict=True):
        last = model.posterior.values[-count:]
        samples[: len(last)] = last
    variables: dict[str, Labelled] = {
        name: (dims, by_model[:, :, i], {"long_name": free.path})
        for i, (name, free) in enumerate(identified.problem.free.items())
    }
    names = [", ".join(model.combination.values()) or "only" for model in identified.models]
    weights = [model.probability for model in identified.models]
    attributes = {"units": "1", "long_name": "probability given the rows"}
    variables["probability"] = ("model", np.array(weights), attributes)
    coords: dict[str, Labelled] = {"model": ("model", np.array(names, dtype=object), {})}
    return LabelledArrays(variables, coords)


def fields_in_short(identified: "Identified") -> dict[str, str]:
    """Return the mean and central 95 % interval of each free field as text, by the field's name."""
    return {
        name: f"{interval.mean:.4g} ({interval.low_95:.4g} to {interval.high_95:.4g})"
        for name, interval in identified.intervals().items()
    }


def posterior_drawing(identified: "Identified") -> "Drawing":
    """Draw the histogram of each free field's samples with its central 95 % interval."""
    from reconstruction.drawing import Drawing, draw_distribution

    rows = -(-len(identified.problem.free) // _PANELS)
    drawing = Drawing(_PANELS, rows)
    panels = drawing.subplots(rows, _PANELS, squeeze=False).ravel()
    intervals = identified.intervals()
    for axes, (name, free), values in zip(
        panels, identified.problem.free.items(), identified.values.T, strict=False
    ):
        ends = intervals[name].low_95, intervals[name].high_95
        draw_distribution(axes, values, free.path, ends)
    for axes in panels[len(identified.problem.free) :]:
        axes.set_axis_off()
    return drawing
