"""Plots of measured and true heights of a measurement, and its maps as a labelled data set."""

from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import Reason
from reconstruction.drawing import Drawing, draw_cells, draw_section, gridded
from reconstruction.errors import InputError
from reconstruction.netcdf import PIXELS, Labelled, LabelledArrays, pixel_coordinates

if TYPE_CHECKING:
    from twin.results.record import Measurement


def measurement_drawing(measured: "Measurement") -> Drawing:
    """Draw the measured heights, their deviation from the true surface, and a section of both.

    Raises
    ------
    InputError : no pixel has a point
    """
    points, truth = measured.points, measured.truth
    valid = points.valid
    if not valid.any():
        raise InputError(f"plot: found no valid point in {measured.experiment.name}")
    measured_mm = points.world_mm[valid]
    relief = gridded(measured_mm, measured_mm[:, 2])
    drawing = Drawing(3)
    panels = drawing.subplots(1, 3)
    draw_cells(panels[0], relief, "measured heights", "z (mm)")
    known = valid & truth.measured
    if known.any():
        error_um = 1e3 * (points.world_mm[known][:, 2] - truth.points_world_mm[known][:, 2])
        deviation = gridded(points.world_mm[known], error_um)
        draw_cells(panels[1], deviation, "deviation from the true surface", "um", signed=True)
    else:
        panels[1].set_axis_off()
    true_mm = truth.points_world_mm[truth.measured]
    both = {"measured": relief}
    if len(true_mm):
        both["true"] = gridded(true_mm, true_mm[:, 2])
    draw_section(panels[2], both)
    return drawing


def measurement_arrays(measured: "Measurement") -> LabelledArrays:
    """Return the maps (row, col) of a measurement: measured z, true z, deviation and sigma.

    World x and y of the point of each pixel are coordinates. At pixels without a point, all maps
    except `true_z` are NaN, and `mask_reason` gives the reason. In files that `twin` writes, these
    pixels are 0. `true_z` is NaN at pixels that do not show the measured surface. There is no map
    of sigma if the method predicts none.
    """
    points, truth = measured.points, measured.truth
    valid = points.valid
    x_mm, y_mm, z_mm = (np.where(valid, points.world_mm[..., axis], np.nan) for axis in range(3))
    true_mm = np.where(truth.measured, truth.points_world_mm[..., 2], np.nan)
    maps = {
        "z": (z_mm, "mm", "measured world z"),
        "true_z": (true_mm, "mm", "world z of the true surface at the pixel's centre"),
        "deviation": (1e3 * (z_mm - true_mm), "um", "measured less true z"),
    }
    if points.sigma_z_mm is not None:
        sigma_mm = np.where(valid, points.sigma_z_mm, np.nan)
        maps["sigma_z"] = (sigma_mm, "mm", "predicted standard deviation of z")
    coords = pixel_coordinates(*points.reason.shape)
    for name, values in (("x", x_mm), ("y", y_mm)):
        coords[name] = (PIXELS, values, {"units": "mm", "long_name": f"world {name} of the point"})
    flags = {
        "flag_values": np.array([int(reason) for reason in Reason], np.uint8),
        "flag_meanings": " ".join(reason.name for reason in Reason),
    }
    attributes = {"units": "1", "long_name": "why a pixel has no point; 0: it has one"} | flags
    variables: dict[str, Labelled] = {
        name: (PIXELS, values, {"units": unit, "long_name": text})
        for name, (values, unit, text) in maps.items()
    }
    return LabelledArrays(
        variables | {"mask_reason": (PIXELS, points.reason, attributes)},
        coords=coords,
        attrs={
            "title": measured.experiment.name,
            "modality": measured.experiment.modality,
            "experiment_digest": measured.digest,
        },
    )
