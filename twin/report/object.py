"""The object itself in a report: its measurands with verdicts, its deviation, one picture.

World frame, mm; the section runs through the specimen, s = 0 at its middle.
"""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from reconstruction.arrays import FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate import fit_ball
from reconstruction.evaluate.conformity import NOT_WITHIN, WITHIN
from twin.config.measurands import LENGTHS
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
from twin.report.page import Block, Figure, Grade, Note, Section, Verdict
from twin.report.section import Trace, trace_through_apexes
from twin.report.surfaces import average_on_grid
from twin.report.table import Column, Row, Table
from twin.report.words import NONE, number, percent, signed
from twin.results.object_points import SeenObject
from twin.results.object_score import MeasuredQuantity
from twin.results.record import Measurement
from twin.specimens import shape_of

_MAP_CELLS = 320
_BAND_PIXELS = 1.5
# Of the good limit: an object whose points deviate more is not what was measured.
_POOR_DEVIATION = 5.0
_ALIGNED = (
    ("none", "as the sensor gave them"),
    ("offset", "offset along z taken off"),
    ("offset_tilt", "offset and tilt taken off"),
    ("rigid", "rigid best fit"),
)


def object_section(measured: Measurement) -> list[Section]:
    """Return what the measurement says of the object; nothing where no point lies on it."""
    found = measured.object
    if found.seen is None or not found.aligned:
        return []
    tables = [quantity_table(measured)] if found.quantities else []
    picture = object_figure(measured)
    blocks: list[Block] = [picture, *tables, deviation_table(measured), Note(_how(measured))]
    return [Section("object", "The object", tuple(blocks))]


def object_verdict(measured: Measurement) -> Verdict:
    """Judge the object: by its tolerances, or by its deviation where none are given."""
    found, question = measured.object, "Does the sensor measure the object?"
    coated = measured.experiment.method.presses
    judged = [one for one in found.quantities if one.tolerance is not None]
    if judged:
        return Verdict(
            question, _headline(judged), _grade(judged), tuple(told(one, coated) for one in judged)
        )
    figures = measured.figures
    rms_um, share = figures.get("object_rms_um"), figures.get("object_coverage_share")
    if rms_um is None or share is None:
        return Verdict(question, "no point lies on it", "poor", (object_sentence(measured),))
    limit_um = measured.experiment.score.good_within_um
    p95_um = figures.known("object_p95_um")
    return Verdict(
        question,
        f"{rms_um:.1f}\N{NO-BREAK SPACE}µm RMS where it {_touches(measured.experiment)}",
        _grade_of_deviation(p95_um / limit_um),
        (
            f"95 % of its points there deviate by up to {p95_um:.1f} µm (good up to "
            f"{limit_um:g} µm)",
            f"{percent(share)} of it {_touches(measured.experiment)} and has a point",
            *(told(one, coated) for one in found.quantities[:2]),
            "state a tolerance in [[measurand]] for a verdict",
        ),
    )


def _grade_of_deviation(over_limit: float) -> Grade:
    if over_limit <= 1.0:
        return "good"
    return "check" if over_limit <= _POOR_DEVIATION else "poor"


def object_sentence(measured: Measurement) -> str:
    """Say in one sentence how well the object itself was measured, in ASCII."""
    found, figures = measured.object, measured.figures
    coated = measured.experiment.method.presses
    judged = [one for one in found.quantities if one.tolerance is not None]
    if judged:
        leading = _ascii(told(judged[0], coated))
        if len(judged) == 1:
            return f"object: {leading}"
        outcome = "; ".join(f"{one.asked.name} {one.decision}" for one in judged)
        return f"object: {outcome}; {leading}"
    rms_um = figures.get("object_rms_um")
    if rms_um is None:
        return "object: no point lies on it; press deeper, or look at another part"
    share = percent(figures.get("object_coverage_share"))
    where = f"on the {share} of it that {_touches(measured.experiment)}"
    first = next((one for one in found.quantities if one.error is not None), None)
    more = "" if first is None else f"; {_ascii(told(first, coated))}"
    return f"object: deviation {rms_um:.1f} um RMS {where}{more}"


def told(one: MeasuredQuantity, coated: bool) -> str:
    """Say what was found of a measurand, with its expanded uncertainty and verdict.

    Parameters
    ----------
    coated : a coat was measured, which is told between object and measurement
    """
    name = one.asked.name.replace("_", " ")
    if one.value is None:
        return f"{name}: none, {one.why}"
    verdict = f": {one.decision}" if one.decision else ""
    if one.asked.unit == "share":
        return f"{name} {percent(one.value)}{verdict}"
    interval = f"± {one.uncertainty.expanded:.2g} µm (k = {one.uncertainty.coverage_factor:g})"
    if one.asked.unit == "um" or one.nominal is None:
        unit = "µm" if one.asked.unit == "um" else "mm"
        return f"{name} {one.value:.4g} {unit} {interval}{verdict}"
    if _is_lost(one):
        return f"{name}: object {one.nominal:g} mm, not measured (found: {one.value:.3g} mm)"
    error = signed(float(one.error or 0.0), 1)
    coat = "" if not coated or one.true_face is None else f"coat {one.true_face:.4f} mm, "
    chain = f"object {one.nominal:g} mm, {coat}measured {one.value:.4f} mm"
    return f"{name}: {chain}: {error} µm {interval}{verdict.replace(': ', ', ')}"


def _is_lost(one: MeasuredQuantity) -> bool:
    """Tell whether a length is wrong by more than itself: what was fitted is another thing."""
    return one.nominal is not None and abs(float(one.error or 0.0)) > 1e3 * one.nominal


def _ascii(text: str) -> str:
    for other, plain in (("µ", "u"), ("±", "+-"), ("−", "-"), ("\N{NO-BREAK SPACE}", " ")):
        text = text.replace(other, plain)
    return text


def _touches(experiment: Experiment) -> str:
    return "is touched" if experiment.method.presses else "is seen"


def _headline(judged: list[MeasuredQuantity]) -> str:
    within = sum(one.decision == WITHIN for one in judged)
    if len(judged) == 1:
        return str(judged[0].decision)
    return f"{within} of {len(judged)} within tolerance"


def _grade(judged: list[MeasuredQuantity]) -> Grade:
    if all(one.decision == WITHIN for one in judged):
        return "good"
    return "poor" if any(one.decision == NOT_WITHIN for one in judged) else "check"


_QUANTITIES = (
    Column("name", "measurand"),
    Column("nominal", "nominal", kind="number"),
    Column("value", "measured", kind="number"),
    Column("error", "deviation (µm)", kind="number"),
    Column("expanded", "U (µm)", kind="number"),
    Column("limits", "allowed (µm)", kind="number"),
    Column("verdict", "verdict"),
    Column("coat", "truth's (µm)", kind="number"),
    Column("parts", "parts of u (µm)", kind="number"),
)


def quantity_table(measured: Measurement) -> Table:
    """Return the measurands: value, deviation, uncertainty with its parts, verdict."""
    found = measured.object
    hidden = (
        " What the elastomer does to the object is no part of U: it is in the deviation, and alone "
        "in the deviation of the true coat."
        if measured.experiment.method.presses
        else ""
    )
    factors = sorted({f"{one.uncertainty.coverage_factor:g}" for one in found.quantities})
    return Table(
        "measurands",
        "Measurands",
        "",
        _QUANTITIES,
        tuple(_row(one) for one in found.quantities),
        (
            f"U: expanded uncertainty with k = {', '.join(factors)} (2: about 95 %), of the noise "
            "of the points through the fit, and of repeatability and calibration where they are "
            "stated. Verdict after ISO 14253-1 with guard band U: within tolerance by U or more, "
            f"outside by U or more, or it cannot be told.{hidden} Truth's: the deviation that the "
            "true surface seen has, without any error of the optics. Parts of u: points, "
            "repeatability, calibration.",
        ),
        look="compared",
    )


def _row(one: MeasuredQuantity) -> dict[str, str]:
    share, digits = one.asked.unit == "share", 4 if one.asked.unit == "mm" else 2
    unit = {"mm": " mm", "um": " µm", "share": ""}[one.asked.unit]
    length = one.asked.quantity in LENGTHS
    if _is_lost(one):
        return {
            "name": one.asked.name.replace("_", " "),
            "nominal": f"{one.nominal:g} mm",
            "value": "not measured",
            "limits": _limits(one),
            "verdict": one.decision or f"found: {one.value:.3g} mm",
        }
    return {
        "name": one.asked.name.replace("_", " "),
        "nominal": NONE if one.nominal is None else f"{one.nominal:g} mm",
        "value": NONE if one.value is None else f"{one.value:.{digits}f}{unit}",
        "error": NONE if one.error is None or share else signed(one.error, 1),
        "coat": NONE if one.true_face_error is None or share else signed(one.true_face_error, 1),
        "expanded": NONE if one.value is None or share else f"{one.uncertainty.expanded:.2g}",
        "parts": NONE if one.value is None or share else _parts(one),
        "limits": _limits(one),
        "verdict": one.decision or (one.why or ("none asked" if length else NONE)),
    }


def _parts(one: MeasuredQuantity) -> str:
    known = one.uncertainty
    return ", ".join(f"{u:.2g}" for u in (known.noise, known.repeatability, known.calibration))


def _limits(one: MeasuredQuantity) -> str:
    if one.tolerance is None:
        return NONE
    low, high = one.tolerance.lower, one.tolerance.upper
    if np.isinf(low):
        return f"up to {high:g}"
    return f"from {low:g}" if np.isinf(high) else f"{low:+g} to {high:+g}".replace("-", "−")


def deviation_table(measured: Measurement) -> Table:
    """Return the RMS deviation from the true object after each alignment, with the coat's own."""
    figures = measured.figures
    names = {"none": "", "offset": "offset_", "offset_tilt": "offset_tilt_", "rigid": "rigid_"}
    rows: list[Row] = [
        {
            "how": words,
            "rms": figures.get(f"object_{names[how]}rms_um"),
            "coat": figures.get(f"true_face_object_{names[how]}rms_um"),
        }
        for how, words in _ALIGNED
    ]
    form: Row = {
        "how": "form after that: band of 95 % of the deviations",
        "rms": figures.get("object_form_um"),
        "coat": figures.get("true_face_object_form_um"),
    }
    shown = {"rms": "measured", "coat": f"true {_surface(measured)}"}
    return Table(
        "object_deviation",
        "Deviation from the true object, RMS",
        "",
        (
            Column("how", "points"),
            *(Column(key, title, 2, "µm") for key, title in shown.items()),
        ),
        (*rows, form),
        look="compared",
    )


def _surface(measured: Measurement) -> str:
    return "coat" if measured.experiment.method.presses else "surface"


def _how(measured: Measurement) -> str:
    seen = measured.object.seen
    assert seen is not None  # or there would be no section
    share = percent(seen.coverage)
    touches = _touches(measured.experiment)
    skin_mm = seen.surface.skin_mm
    grown = (
        f" The elastomer's nominal thickness of {skin_mm:g} mm lies between and is taken off along "
        "the normal, as a stylus' radius is."
        if skin_mm
        else ""
    )
    return (
        f"Distances along the normal of the specimen's own surface, of the points where it "
        f"{touches}: {share} of it. The second column is the same for the true {_surface(measured)}"
        f" at these pixels: what a perfect measurement would leave.{grown}"
    )


def object_figure(measured: Measurement) -> Figure:
    """Return relief, true object, deviation and section in one picture."""
    return Figure(
        "object",
        "Measured relief, true object, deviation and section",
        "Heights in mm on one scale; points far out are left out. Deviation along the normal, "
        f"offset taken off, where the specimen {_touches(measured.experiment)}; elsewhere gray. "
        f"The section shows measured points, the specimen's surface{_grown(measured)}, and what "
        "was fitted; thick points took part.",
        "maps of measured relief, true object and deviation, and a section",
        lambda path: draw_object(path, measured),
    )


def _grown(measured: Measurement) -> str:
    seen = measured.object.seen
    return " (grown by the elastomer between)" if seen is not None and seen.surface.skin_mm else ""


def draw_object(path: Path, measured: Measurement) -> None:
    """Draw the picture of `object_figure` as PNG."""
    found = measured.object
    seen, aligned = found.seen, found.aligned["offset"]
    assert seen is not None
    points, pixel_mm = _shown_points(measured, seen), seen.pixel_mm
    z_true = np.ma.masked_invalid(seen.heights.z_mm + seen.surface.skin_mm)
    low, high = height_scale(points[:, 2])
    half = seen.heights.pitch_mm / 2
    with drawing(path, 10.0, 7.0) as figure:
        cells = average_on_grid(points, points[:, 2], pixel_mm, _MAP_CELLS)
        outline = cells.extent_mm
        draw_map(
            axes_at(figure, 0.6, 0.35, 3.5, 2.6), cells.values, outline, "measured relief",
            "z (mm)", ends=(low, high), extend="both",
        )  # fmt: skip
        extent = (
            float(seen.heights.x_mm[0] - half),
            float(seen.heights.x_mm[-1] + half),
            float(seen.heights.y_mm[0] - half),
            float(seen.heights.y_mm[-1] + half),
        )
        draw_map(
            axes_at(figure, 5.5, 0.35, 3.5, 2.6), z_true, extent, "true object", "z (mm)",
            ends=(low, high), extend="both",
        )  # fmt: skip
        deviation_um = 1e3 * aligned.deviation_mm
        limit_um = symmetric_limit(deviation_um)
        apart_mm = pixel_mm * np.sqrt(seen.measured.touching.sum() / max(len(deviation_um), 1))
        cells = average_on_grid(aligned.points_mm, deviation_um, float(apart_mm), _MAP_CELLS)
        axes = axes_at(figure, 0.6, 3.95, 3.5, 2.6)
        draw_map(
            axes, cells.values, cells.extent_mm, "deviation, offset taken off", "deviation (µm)",
            cmap=diverging(), ends=(-limit_um, limit_um), extend="both",
        )  # fmt: skip
        axes.set(xlim=outline[:2], ylim=outline[2:])
        _draw_section(axes_at(figure, 5.7, 3.95, 4.0, 2.6), measured, seen)


def _shown_points(measured: Measurement, seen: SeenObject) -> FloatArray:
    """Return the points (n, xyz) near the true surface, or all where none is."""
    points, truth = seen.measured.points_mm, measured.truth
    if not truth.measured.any():
        return points
    near = near_truth(points, truth.points_world_mm[truth.measured].astype(np.float64))
    return points[near] if near.any() else points


def trace_of(experiment: Experiment) -> Trace:
    """Return the section's line: through the balls, or along the specimen's own x axis."""
    if shape_of(experiment.specimen).spheres():
        return trace_through_apexes(experiment)
    turn, at = np.deg2rad(experiment.specimen.yaw_deg), experiment.specimen
    return Trace(np.array([at.x_mm, at.y_mm]), np.array([np.cos(turn), np.sin(turn)]))


def _draw_section(axes: Axes, measured: Measurement, seen: SeenObject) -> None:
    trace, points = trace_of(measured.experiment), _shown_points(measured, seen)
    place, z = _band(trace, points, seen.pixel_mm)
    axes.plot(place, z, ".", ms=2.0, color=MEASURED_FILL, label="measured")
    fitted = next((one for one in measured.object.quantities if one.points_mm is not None), None)
    if fitted is not None and fitted.points_mm is not None:
        used, used_z = _band(trace, fitted.points_mm, seen.pixel_mm)
        axes.plot(used, used_z, ".", ms=3.5, color=MEASURED, label="fitted")
    grid = np.linspace(float(place.min()), float(place.max()), 600) if len(place) else place
    true = _true_profile(seen, trace, grid)
    axes.plot(grid, true, color=NOMINAL, lw=1.0, label="true object")
    if fitted is not None and fitted.points_mm is not None:
        for s, line in _fit_lines(fitted, fitted.points_mm, trace, seen):
            axes.plot(s, line, color=FIT, lw=1.2, ls="--")
    low, high = (float(z.min()), float(z.max())) if len(z) else (0.0, 1.0)
    margin = 0.15 * max(high - low, 0.01)
    chart(axes, "section", f"{trace.axis} (mm)", "z (mm)", ylim=(low - margin, high + margin))
    if len(place):
        axes.set_xlim(float(place.min()) - margin, float(place.max()) + margin)
    legend_above(axes, 3)


def _band(trace: Trace, points: FloatArray, pixel_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return place along a section and height of the points beside it, in order."""
    near = np.abs(trace.offset(points[:, 0], points[:, 1])) <= _BAND_PIXELS * pixel_mm
    place = np.asarray(trace.position(points[near, 0], points[near, 1]), np.float64)
    order = np.argsort(place)
    return place[order], points[near, 2][order]


def _true_profile(seen: SeenObject, trace: Trace, place: FloatArray) -> FloatArray:
    """World z of the true object's upper side, grown by the skin, along a section; NaN: none."""
    z = seen.heights.z_mm[seen.heights.cells_of(trace.points(place))] if len(place) else place
    return np.where(np.isfinite(z), z + seen.surface.skin_mm, np.nan)


def _fit_lines(
    one: MeasuredQuantity, points: FloatArray, trace: Trace, seen: SeenObject
) -> list[tuple[FloatArray, FloatArray]]:
    """Return what was fitted, as curves (s, z): two levels, or the arc of a ball."""
    if one.asked.quantity == "radius" and seen.shape.spheres():
        return _arc(points, trace)
    if one.asked.quantity != "step_height" or one.value is None:
        return []
    place, z = trace.position(points[:, 0], points[:, 1]), points[:, 2]
    middle = (float(z.min()) + float(z.max())) / 2
    upper = z > middle
    design = np.column_stack([np.ones(len(z)), points[:, :2], upper])
    plane: Any = np.linalg.lstsq(design, z, rcond=None)[0]
    ends = np.array([float(place.min()), float(place.max())])
    base = plane[0] + trace.points(ends) @ plane[1:3]
    return [(ends, base), (ends, base + plane[3])]


def _arc(points: FloatArray, trace: Trace) -> list[tuple[FloatArray, FloatArray]]:
    try:
        ball = fit_ball(points)
    except FitError:
        return []
    middle = float(trace.position(ball.centre_mm[0], ball.centre_mm[1]))
    aside = float(trace.offset(ball.centre_mm[0], ball.centre_mm[1]))
    reach = float(np.ptp(trace.position(points[:, 0], points[:, 1]))) / 2
    s = np.linspace(-reach, reach, 200)
    up = np.maximum(ball.radius_mm**2 - s**2 - aside**2, 0.0)
    return [(middle + s, ball.centre_mm[2] + np.sqrt(up))]


def object_rows(measured: Measurement) -> dict[str, str]:
    """Return the measurands' deviations by name, as a comparison of methods shows them."""
    return {
        f"{one.asked.name.replace('_', ' ')}: deviation (µm)": number(one.error, "+.1f")
        for one in measured.object.quantities
        if one.asked.unit != "share"
    }
