"""An identification as a person meets it: samples as labelled arrays, intervals in pictures."""

from typing import TYPE_CHECKING

import numpy as np

from reconstruction.netcdf import Labelled, LabelledArrays

if TYPE_CHECKING:
    from reconstruction.drawing import Drawing
    from twin.identification.known import Identified

_PANELS = 3


def samples_of(found: "Identified") -> LabelledArrays:
    """Return the samples of the free fields by model, in the fields' own units."""
    count = min(len(one.posterior.z) for one in found.models)
    dims = ("model", "sample")
    by_model = np.stack([one.posterior.values[-count:] for one in found.models])
    variables: dict[str, Labelled] = {
        name: (dims, by_model[:, :, i], {"long_name": free.path})
        for i, (name, free) in enumerate(found.problem.free.items())
    }
    names = [", ".join(one.combination.values()) or "only" for one in found.models]
    weights = [one.probability for one in found.models]
    told = {"units": "1", "long_name": "probability given the rows"}
    variables["probability"] = ("model", np.array(weights), told)
    coords: dict[str, Labelled] = {"model": ("model", np.array(names, dtype=object), {})}
    return LabelledArrays(variables, coords)


def fields_in_short(found: "Identified") -> dict[str, str]:
    """Return mean and central 95 % interval of each free field as texts; units in the names."""
    return {
        name: f"{one.mean:.4g} ({one.low_95:.4g} to {one.high_95:.4g})"
        for name, one in found.intervals().items()
    }


def posterior_drawing(found: "Identified") -> "Drawing":
    """Return the samples of each free field with its central 95 % interval."""
    from reconstruction.drawing import Drawing, draw_distribution

    rows = -(-len(found.problem.free) // _PANELS)
    drawing = Drawing(_PANELS, rows)
    panels = drawing.subplots(rows, _PANELS, squeeze=False).ravel()
    intervals = found.intervals()
    for axes, (name, free), values in zip(
        panels, found.problem.free.items(), found.values.T, strict=False
    ):
        ends = intervals[name].low_95, intervals[name].high_95
        draw_distribution(axes, values, free.path, ends)
    for axes in panels[len(found.problem.free) :]:
        axes.set_axis_off()
    return drawing
