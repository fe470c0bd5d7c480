"""The object itself in a report: its measurands with verdicts, and its deviation."""

import numpy as np

from reconstruction.evaluate.conformity import NOT_WITHIN, WITHIN
from twin.report.object_picture import object_figure, touches
from twin.report.page import Block, Grade, Note, Section, Verdict
from twin.report.table import Column, Row, Table
from twin.report.words import NONE, number, percent, signed
from twin.results.object_points import is_covered
from twin.results.object_score import MeasuredQuantity
from twin.results.record import Measurement
from twin.results.under_sheet import more_contact

# Of the good limit: an object whose points deviate more is not what was measured.
_POOR_DEVIATION = 5.0
_NOTHING = "no point lies on it"
_NOT_MEASURED = "not measured"
_ALIGNED = (
    ("none", "as the sensor gave them"),
    ("offset", "offset along z taken off"),
    ("offset_tilt", "offset and tilt taken off"),
    ("rigid", "rigid best fit"),
)


def object_section(measured: Measurement) -> list[Section]:
    """Return what the measurement says of the object, and what to do where it says nothing."""
    found = measured.object
    if found.seen is None or not (found.aligned or found.quantities):
        return []
    tables: list[Block] = [quantity_table(measured)] if found.quantities else []
    if found.aligned:
        deviation = deviation_table(measured), Note(_how(measured))
        tables = [object_figure(measured), *tables, *deviation]
    blocks = [*tables, *(Note(one) for one in _remedies(measured))]
    return [Section("object", "The object", tuple(blocks))]


def object_verdict(measured: Measurement) -> Verdict:
    """Judge the object: by its tolerances, or by its deviation where none are given."""
    found, question = measured.object, "Does the sensor measure the object?"
    judged = [one for one in found.quantities if one.tolerance is not None]
    if judged:
        return Verdict(question, _headline(judged), _grade(judged), tuple(map(told, judged)))
    figures = measured.figures
    rms_um, share = figures.get("object_rms_um"), figures.get("object_coverage_share")
    lengths = tuple(told(one) for one in found.quantities[:2])
    first = next((one for one in found.quantities if one.asked.unit == "mm"), None)
    if rms_um is None or share is None:
        known = first is not None and first.value is not None
        headline = _short(first) if first is not None and known else _NOTHING
        grade: Grade = "check" if known else "poor"
        return Verdict(question, headline, grade, (*lengths, *_remedies(measured)))
    limit_um = measured.experiment.score.good_within_um
    p95_um = figures.known("object_p95_um")
    deviation = f"{rms_um:.1f}\N{NO-BREAK SPACE}µm RMS where it {touches(measured.experiment)}"
    return Verdict(
        question,
        deviation if first is None or first.value is None else _short(first),
        _grade_of_deviation(max(p95_um, rms_um) / limit_um),  # RMS: a few large outliers
        (
            *lengths,
            f"deviation of its points {deviation}; 95 % deviate by up to {p95_um:.1f} µm (good "
            f"up to {limit_um:g} µm)",
            f"{percent(share)} of it {touches(measured.experiment)} and has a point",
            *_remedies(measured),
            "state a tolerance in [[measurand]] for a verdict",
        ),
    )


def _short(one: MeasuredQuantity) -> str:
    """Write a length with its expanded uncertainty, for a headline."""
    name = one.asked.name.replace("_", " ")
    return f"{name}: {one.value:.4f}\N{NO-BREAK SPACE}mm {_interval(one)}"


def _remedies(measured: Measurement) -> list[str]:
    """Say what makes more of the object touch; nothing where its dimensions were measured."""
    found, compensation = measured.object, measured.compensation
    lengths = [one for one in found.quantities if one.asked.unit == "mm"]
    nothing = measured.figures.get("object_rms_um") is None
    if not nothing and (compensation is None or all(one.value is not None for one in lengths)):
        return []
    if compensation is None:
        return ["to measure it, press deeper, or look at another part"]
    if compensation.found is None:
        return [compensation.why]
    return [f"to measure it, {more_contact(compensation.found)}"]


def _grade_of_deviation(over_limit: float) -> Grade:
    if over_limit <= 1.0:
        return "good"
    return "check" if over_limit <= _POOR_DEVIATION else "poor"


def object_sentence(measured: Measurement) -> str:
    """Say how well the object itself was measured, in ASCII: its dimensions first."""
    return f"object: {'; '.join(object_lines(measured))}"


def object_lines(measured: Measurement) -> list[str]:
    """Return the same statement by statement: dimensions, deviation, what to do."""
    found, figures = measured.object, measured.figures
    judged = [one for one in found.quantities if one.tolerance is not None]
    if judged:
        return [_ascii(told(one)) for one in judged]
    lines = [_ascii(told(one)) for one in found.quantities if one.asked.unit == "mm"]
    rms_um = figures.get("object_rms_um")
    if rms_um is None:
        lines.append(_NOTHING)
    else:
        share = percent(figures.get("object_coverage_share"))
        where = f"on the {share} of it that {touches(measured.experiment)}"
        lines.append(f"deviation of its points {rms_um:.1f} um RMS {where}")
    return [*lines, *_remedies(measured)]


def told(one: MeasuredQuantity) -> str:
    """Say what was found of a measurand: the object's value first, with U; then the coat's."""
    name = one.asked.name.replace("_", " ")
    verdict = f", {one.decision}" if one.decision else ""
    coat = ""
    if one.covered and one.coat is not None:
        coat = f"; apparent in the coat: {one.coat:.4f} mm"
    if one.value is None:
        return f"{name}: not measured, {one.why}{coat}"
    if one.asked.unit == "share":
        return f"{name}: {percent(one.value)}{verdict}"
    if one.asked.unit == "um" or one.nominal is None:
        unit = "µm" if one.asked.unit == "um" else "mm"
        return f"{name}: {one.value:.4g} {unit} {_interval(one)}{verdict}{coat}"
    if _is_lost(one):
        return f"{name}: object {one.nominal:g} mm, not measured (found: {one.value:.3g} mm)"
    error = signed(float(one.error or 0.0), 1)
    chain = f"{one.value:.4f} mm {_interval(one)}, {error} µm from the object's {one.nominal:g} mm"
    return f"{name}: {chain}{verdict}{coat}"


def _interval(one: MeasuredQuantity) -> str:
    expanded = one.uncertainty.expanded
    return f"± {expanded:.2g} µm (k = {one.uncertainty.coverage_factor:g})"


def _is_lost(one: MeasuredQuantity) -> bool:
    """Tell whether a length is wrong by more than itself: what was fitted is another thing."""
    return one.nominal is not None and abs(float(one.error or 0.0)) > 1e3 * one.nominal


def _ascii(text: str) -> str:
    for other, plain in (("µ", "u"), ("±", "+-"), ("−", "-"), ("\N{NO-BREAK SPACE}", " ")):
        text = text.replace(other, plain)
    return text


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
    Column("value", "object, measured", kind="number"),
    Column("expanded", "U (µm)", kind="number"),
    Column("nominal", "nominal", kind="number"),
    Column("error", "deviation (µm)", kind="number"),
    Column("limits", "allowed (µm)", kind="number"),
    Column("verdict", "verdict"),
)
_APPARENT = Column("coat", "apparent in the coat", kind="number")
_TRUTH = Column("coat", "truth's (µm)", kind="number")
_PARTS = Column("parts", "parts of u (µm)", kind="number")


def quantity_table(measured: Measurement) -> Table:
    """Return the measurands: the object's value, U with its parts, verdict, and the coat's."""
    found, covered = measured.object, is_covered(measured.experiment)
    factors = sorted({f"{one.uncertainty.coverage_factor:g}" for one in found.quantities})
    elastomer = "of the elastomer that is subtracted, " if covered else ""
    surface = (
        "Apparent in the coat: the same of the measured coat, with nothing taken off."
        if covered
        else "Truth's: the deviation that the true surface seen has, without any error of the "
        "optics."
    )
    return Table(
        "measurands",
        "Measurands",
        "",
        (*_QUANTITIES, _APPARENT if covered else _TRUTH, _PARTS),
        tuple(_row(one) for one in found.quantities),
        (
            f"U: expanded uncertainty with k = {', '.join(factors)} (2: about 95 %), of the noise "
            f"and texture of the points through the fit, {elastomer}and of "
            "repeatability and calibration where they are stated. Verdict after ISO 14253-1 with "
            "guard band U: within tolerance by U or more, outside by U or more, or it cannot be "
            f"told. {surface}",
            *_absences(found.quantities),
        ),
        look="compared",
    )


def _absences(quantities: tuple[MeasuredQuantity, ...]) -> list[str]:
    """Return one note for each reason why measurands have no value: a column is too narrow."""
    missing: dict[str, list[str]] = {}
    for one in quantities:
        if one.value is None and one.why:
            missing.setdefault(one.why, []).append(one.asked.name.replace("_", " "))
    return [f"{', '.join(names)} not measured: {why}." for why, names in missing.items()]


def _row(one: MeasuredQuantity) -> dict[str, str]:
    share, digits = one.asked.unit == "share", 4 if one.asked.unit == "mm" else 2
    unit = {"mm": " mm", "um": " µm", "share": ""}[one.asked.unit]
    length = one.asked.unit == "mm"
    row = {
        "name": one.asked.name.replace("_", " "),
        "nominal": NONE if one.nominal is None else f"{one.nominal:g} mm",
        "limits": _limits(one),
        "coat": _surface_cell(one),
    }
    if _is_lost(one):
        lost = one.decision or f"found: {one.value:.3g} mm"
        return row | {"value": _NOT_MEASURED, "verdict": lost}
    return row | {
        "value": NONE if one.value is None else f"{one.value:.{digits}f}{unit}",
        "error": NONE if one.error is None or share else signed(one.error, 1),
        "expanded": NONE if one.value is None or share else f"{one.uncertainty.expanded:.2g}",
        "parts": NONE if one.value is None or share else _parts(one),
        "verdict": one.decision or (_NOT_MEASURED if one.why else "none asked" if length else NONE),
    }


def _surface_cell(one: MeasuredQuantity) -> str:
    if one.covered:
        return NONE if one.coat is None else f"{one.coat:.4f} mm"
    error = one.true_face_error
    return NONE if error is None or one.asked.unit == "share" else signed(error, 1)


def _parts(one: MeasuredQuantity) -> str:
    known = one.uncertainty
    parts = known.noise, known.elastomer, known.repeatability, known.calibration
    return ", ".join(f"{u:.2g}" for u in parts)


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
    as_it_is = ", as it is" if measured.object.under_sheet else ""
    shown = {"rms": "measured", "coat": f"true {_surface(measured)}{as_it_is}"}
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
    touched = touches(measured.experiment)
    skin_mm = seen.surface.skin_mm
    added = (
        f" The elastomer's nominal thickness of {skin_mm:g} mm lies between and is taken off along "
        "the normal, as a stylus' radius is."
        if skin_mm
        else ""
    )
    if measured.object.under_sheet:
        return (
            "Distances along the normal of the specimen's own surface, of the points of the object "
            f"that were found behind the coat: {share} of it {touched} and has one. Contact and "
            "local thickness follow from the measured coat, elastomer and air; the thickness is "
            "taken off along the normal. The second column is the true coat at the same place, "
            "with nothing taken off."
        )
    return (
        f"Distances along the normal of the specimen's own surface, of the points where it "
        f"{touched}: {share} of it. The second column is the same for the true {_surface(measured)}"
        f" at these pixels: what a perfect measurement would leave.{added}"
    )


def object_rows(measured: Measurement) -> dict[str, str]:
    """Return the measurands by name, with U, as a comparison of methods shows them."""
    rows = {}
    for one in measured.object.quantities:
        name = one.asked.name.replace("_", " ")
        if one.asked.unit == "mm":
            rows[f"{name} (mm)"] = (
                NONE if one.value is None else f"{one.value:.4f} {_interval(one)}"
            )
        if one.asked.unit != "share":
            rows[f"{name}: deviation (µm)"] = number(one.error, "+.1f")
    return rows
