"""Picture of the object: measured relief, true object, deviation and section.

Coordinates are in the world frame, mm. The section is a vertical plane through the specimen, with
coordinate s = 0 at the middle of the specimen.
"""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from reconstruction.arrays import FloatArray
from twin.config.models import Experiment
from twin.report.canvas import (
    FIT,
    MEASURED,
    MEASURED_FILL,
    NOMINAL,
    axes_at,
    chart,
    diverging,
    draw_map,
    drawing,
    height_scale,
    legend_above,
    near_truth,
    symmetric_limit,
)
from twin.report.page import Figure
from twin.report.relief import average_on_grid, draw_cells
from twin.report.section import Trace, trace_through_apexes
from twin.results.measurands import measurand_of
from twin.results.object_points import ObjectPoints, ObjectView
from twin.results.record import Measurement
from twin.specimens import shape_of

_MAP_CELLS = 320
_BAND_PIXELS = 1.5


def touches(experiment: Experiment) -> str:
    """Return the words for the part of the object that has points: "is touched" or "is seen"."""
    return "is touched" if experiment.method.presses else "is seen"


def object_figure(measured: Measurement) -> Figure:
    """Return the figure of measured relief, true object, deviation and section."""
    return Figure(
        "object",
        "Measured relief, true object, deviation and section",
        "Top: measured and true height z (mm) on the same scale; outliers are not shown. Bottom "
        "left: deviation of the points from the true object along its normal (µm), mean offset in "
        f"z subtracted, where the specimen {touches(measured.experiment)}; elsewhere gray. Bottom "
        f"right: section with measured points, the true surface of the specimen{grown(measured)}, "
        f"and the fitted feature (dashed); large points were used in the fit.{_behind(measured)}",
        "maps of measured relief, true object and deviation, and a section",
        lambda path: draw_object(path, measured),
    )


def grown(measured: Measurement) -> str:
    """Return the words on the offset of the drawn true object by the elastomer's thickness.

    The text is empty if no constant thickness is added.
    """
    visible = measured.object.observed
    return (
        " (offset by the thickness of the elastomer)"
        if visible is not None and visible.surface.skin_mm
        else ""
    )


def _behind(measured: Measurement) -> str:
    """Return a sentence on the object points below a sheet; empty without a sheet."""
    if not measured.object.under_sheet:
        return ""
    return " Deviation and large points: object points, one local thickness below the coat."


def draw_object(path: Path, measured: Measurement) -> None:
    """Draw the picture of `object_figure` as PNG."""
    score = measured.object
    visible, aligned = score.observed, score.aligned["offset"]
    assert visible is not None
    points, pixel_mm = _shown_points(measured, visible.coat), visible.pixel_mm
    z_true = np.ma.masked_invalid(visible.heights.z_mm + visible.surface.skin_mm)
    low, high = height_scale(points[:, 2])
    half = visible.heights.pitch_mm / 2
    with drawing(path, 10.0, 7.0) as figure:
        cells = average_on_grid(points, points[:, 2], pixel_mm, _MAP_CELLS)
        outline = cells.extent_mm
        draw_cells(
            axes_at(figure, 0.6, 0.35, 3.5, 2.6), cells, "measured relief",
            "z (mm)", ends=(low, high), extend="both",
        )  # fmt: skip
        extent = (
            float(visible.heights.x_mm[0] - half),
            float(visible.heights.x_mm[-1] + half),
            float(visible.heights.y_mm[0] - half),
            float(visible.heights.y_mm[-1] + half),
        )
        draw_map(
            axes_at(figure, 5.5, 0.35, 3.5, 2.6), z_true, extent, "true object", "z (mm)",
            ends=(low, high), extend="both",
        )  # fmt: skip
        deviation_um = 1e3 * aligned.deviation_mm
        limit_um = symmetric_limit(deviation_um)
        apart_mm = pixel_mm * np.sqrt(visible.measured.touching.sum() / max(len(deviation_um), 1))
        cells = average_on_grid(aligned.points_mm, deviation_um, float(apart_mm), _MAP_CELLS)
        axes = axes_at(figure, 0.6, 3.95, 3.5, 2.6)
        draw_cells(
            axes, cells, "deviation, offset subtracted", "deviation (µm)",
            cmap=diverging(), ends=(-limit_um, limit_um), extend="both",
        )  # fmt: skip
        axes.set(xlim=outline[:2], ylim=outline[2:])
        _draw_section(axes_at(figure, 5.7, 3.95, 4.0, 2.6), measured, visible)


def _shown_points(measured: Measurement, coat: ObjectPoints) -> FloatArray:
    """Return the measured points (n, xyz) near the true surface, or all points if none is near."""
    points, truth = coat.points_mm, measured.truth
    if not truth.measured.any():
        return points
    near = near_truth(points, truth.points_world_mm[truth.measured].astype(np.float64))
    return points[near] if near.any() else points


def trace_of(experiment: Experiment) -> Trace:
    """Return the line of the section: through the balls, or along the x axis of the specimen."""
    if shape_of(experiment.specimen).spheres():
        return trace_through_apexes(experiment)
    turn, at = np.deg2rad(experiment.specimen.yaw_deg), experiment.specimen
    return Trace(np.array([at.x_mm, at.y_mm]), np.array([np.cos(turn), np.sin(turn)]))


def _draw_section(axes: Axes, measured: Measurement, visible: ObjectView) -> None:
    trace, points = trace_of(measured.experiment), _shown_points(measured, visible.coat)
    place, z = _band(trace, points, visible.pixel_mm)
    coat = "measured coat" if measured.experiment.method.presses else "measured"
    axes.plot(place, z, ".", ms=2.0, color=MEASURED_FILL, label=coat)
    fitted = next(
        (quantity for quantity in measured.object.quantities if quantity.points_mm is not None),
        None,
    )
    if fitted is not None and fitted.points_mm is not None:
        used, used_z = _band(trace, fitted.points_mm, visible.pixel_mm)
        axes.plot(used, used_z, ".", ms=3.5, color=MEASURED, label="fitted")
    grid = np.linspace(float(place.min()), float(place.max()), 600) if len(place) else place
    true = _true_profile(visible, trace, grid)
    axes.plot(grid, true, color=NOMINAL, lw=1.0, label="true object")
    if fitted is not None and fitted.points_mm is not None:
        kind = measurand_of(fitted.measurand)
        for s, line in kind.curves(fitted.points_mm, trace, visible):
            axes.plot(s, line, color=FIT, lw=1.2, ls="--")
    low, high = (float(z.min()), float(z.max())) if len(z) else (0.0, 1.0)
    margin = 0.15 * max(high - low, 0.01)
    chart(axes, "section", f"{trace.axis} (mm)", "z (mm)", ylim=(low - margin, high + margin))
    if len(place):
        axes.set_xlim(float(place.min()) - margin, float(place.max()) + margin)
    legend_above(axes, 3)


def _band(trace: Trace, points: FloatArray, pixel_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return position along a section and height, mm, of the points near it, by position.

    Points are near if they are at most 1.5 camera pixels from the section.
    """
    near = np.abs(trace.offset(points[:, 0], points[:, 1])) <= _BAND_PIXELS * pixel_mm
    place = np.asarray(trace.position(points[near, 0], points[near, 1]), np.float64)
    order = np.argsort(place)
    return place[order], points[near, 2][order]


def _true_profile(visible: ObjectView, trace: Trace, place: FloatArray) -> FloatArray:
    """Return the drawn height (world z, mm) of the true object along a section.

    The height is that of the upper side of the object plus the thickness `skin_mm` of the elastomer
    between object and coat; NaN outside the object.
    """
    z = visible.heights.z_mm[visible.heights.cells_of(trace.points(place))] if len(place) else place
    return np.where(np.isfinite(z), z + visible.surface.skin_mm, np.nan)
