"""The object in a report: its measurands with verdicts, and deviation from its true shape.

The object is the specimen itself, in contrast to the coat over it.
"""

import numpy as np

from reconstruction.evaluate.conformity import NOT_WITHIN, WITHIN
from twin.report.object_picture import object_figure, touches
from twin.report.page import (
    Block,
    Grade,
    JudgedTarget,
    Note,
    Section,
    Verdict,
    judged,
    target,
)
from twin.report.table import Column, Row, Table
from twin.report.words import NONE, in_ascii, number, percent, signed
from twin.results.object_points import is_covered
from twin.results.object_score import MeasuredQuantity
from twin.results.record import Measurement
from twin.results.under_sheet import more_contact

# Ratio to the good limit above which the deviation of the object's points is graded poor.
_POOR_DEVIATION = 5.0
_NO_POINT = "no measured point is on the object"
_NOT_MEASURED = "not measured"
_ALIGNED = (
    ("none", "as measured"),
    ("offset", "offset along z taken off"),
    ("offset_tilt", "offset and tilt taken off"),
    ("rigid", "rigid best fit"),
)


def object_section(measured: Measurement) -> list[Section]:
    """Return the section on the object: measurands, deviation, and remedies for missing values.

    Returns an empty list if the object was not measured.
    """
    score = measured.object
    if score.observed is None or not (score.aligned or score.quantities):
        return []
    tables: list[Block] = [quantity_table(measured)] if score.quantities else []
    if score.aligned:
        deviation = deviation_table(measured), Note(_how(measured))
        tables = [object_figure(measured), *tables, *deviation]
    blocks = [*tables, *(Note(remedy) for remedy in _remedies(measured))]
    return [Section("object", "The object", tuple(blocks))]


def object_verdict(measured: Measurement) -> Verdict:
    """Return the judgement of the object by its tolerances, or by its deviation.

    The deviation is used if no tolerance is stated.
    """
    score, question = measured.object, "How accurately is the object measured?"
    toleranced = [quantity for quantity in score.quantities if quantity.tolerance is not None]
    if toleranced:
        words = tuple(map(measurand_in_words, toleranced))
        return Verdict(question, _headline(toleranced), _grade(toleranced), words)
    figures = measured.figures
    rms_um, share = figures.get("object_rms_um"), figures.get("object_coverage_share")
    lengths = tuple(measurand_in_words(quantity) for quantity in score.quantities[:2])
    first = next(iter(_lengths(measured)), None)
    if rms_um is None or share is None:
        known = first is not None and first.value is not None
        headline = _short(first) if first is not None and known else _NO_POINT
        grade: Grade = "check" if known else "poor"
        return Verdict(question, headline, grade, (*lengths, *_remedies(measured)))
    deviation = f"{rms_um:.1f}\N{NO-BREAK SPACE}µm RMS where it {touches(measured.experiment)}"
    return judged(
        question,
        deviation if first is None or first.value is None else _short(first),
        [*_of_lengths(measured), _of_points(measured, deviation)],
        (
            f"{percent(share)} of the object {touches(measured.experiment)} and has a point",
            *_remedies(measured),
            "for a verdict, state a tolerance in [[measurand]] of the experiment",
        ),
    )


def _lengths(measured: Measurement) -> list[MeasuredQuantity]:
    return [quantity for quantity in measured.object.quantities if quantity.measurand.unit == "mm"]


def _of_lengths(measured: Measurement) -> list[JudgedTarget]:
    """Return the targets of the lengths without tolerance: measured, true value within U.

    The first length and those that the experiment requests must be measured.
    """
    required = bool(measured.experiment.measurand)
    return [
        _of_length(quantity, required or not number)
        for number, quantity in enumerate(_lengths(measured))
    ]


def _of_length(quantity: MeasuredQuantity, required: bool) -> JudgedTarget:
    words, error = measurand_in_words(quantity), quantity.error
    if quantity.value is None:
        return target(words, met=not required)
    # The true length is the specimen's own; a stated nominal length may differ from it.
    if error is None or quantity.measurand.nominal_mm is not None:
        return target(words, met=True)
    met = abs(error) <= quantity.uncertainty.expanded
    return target(words if met else f"{words} (target: deviation within U)", met)


def _of_points(measured: Measurement, deviation: str) -> JudgedTarget:
    """Return the target of the deviation of the object's points, with the deviation as text."""
    limit_um = measured.experiment.score.good_within_um
    p95_um, rms_um = map(measured.figures.known, ("object_p95_um", "object_rms_um"))
    words = (
        f"deviation of the points from the true object {deviation}; 95 % deviate by up to "
        f"{p95_um:.1f} µm (good up to {limit_um:g} µm)"
    )
    # RMS: a few large outliers
    return JudgedTarget(words, _grade_of_deviation(max(p95_um, rms_um) / limit_um))


def _short(quantity: MeasuredQuantity) -> str:
    """Return name and value (mm) of a length with its expanded uncertainty, for a headline."""
    name = quantity.measurand.name.replace("_", " ")
    return f"{name}: {quantity.value:.4f}\N{NO-BREAK SPACE}mm {_interval(quantity)}"


def is_touched_too_little(measured: Measurement) -> bool:
    """Return True if a thin sheet touches too little of the object to measure it."""
    compensation = measured.compensation
    return bool(_remedies(measured)) and compensation is not None and not compensation.why


def _remedies(measured: Measurement) -> list[str]:
    """Return advice on how to measure the object; empty if its dimensions were measured."""
    compensation, lengths = measured.compensation, _lengths(measured)
    has_points = measured.figures.get("object_rms_um") is not None
    is_absent = compensation is not None and any(quantity.value is None for quantity in lengths)
    if has_points and not is_absent and not any(map(_is_lost, lengths)):
        return []
    if compensation is None:
        return ["to measure the object, press deeper, or measure a different part of it"]
    if compensation.compensated is None:
        return [compensation.why]
    return [f"to measure the object, {more_contact(compensation.compensated)}"]


def _grade_of_deviation(over_limit: float) -> Grade:
    if over_limit <= 1.0:
        return "good"
    return "check" if over_limit <= _POOR_DEVIATION else "poor"


def object_sentence(measured: Measurement) -> str:
    """Return the result for the object as one line of ASCII text, its dimensions first."""
    return f"object: {'; '.join(object_lines(measured))}"


def object_lines(measured: Measurement) -> list[str]:
    """Return the result for the object as a list of texts: dimensions, deviation, remedies.

    If tolerances are stated, the list contains only the judged measurands.
    """
    score, figures = measured.object, measured.figures
    toleranced = [quantity for quantity in score.quantities if quantity.tolerance is not None]
    if toleranced:
        return [in_ascii(measurand_in_words(quantity)) for quantity in toleranced]
    lines = [in_ascii(measurand_in_words(quantity)) for quantity in _lengths(measured)]
    rms_um = figures.get("object_rms_um")
    if rms_um is None:
        lines.append(_NO_POINT)
    else:
        share = percent(figures.get("object_coverage_share"))
        where = f"on the {share} of it that {touches(measured.experiment)}"
        lines.append(f"deviation of its points {rms_um:.1f} um RMS {where}")
    return [*lines, *_remedies(measured)]


def measurand_in_words(quantity: MeasuredQuantity) -> str:
    """Return the result of a measurand as text.

    The text contains the value of the object with expanded uncertainty U, the deviation from the
    nominal value, the decision, and the apparent value in the coat. Unknown parts are omitted.
    """
    name = quantity.measurand.name.replace("_", " ")
    verdict = f", {quantity.decision}" if quantity.decision else ""
    coat = ""
    if quantity.covered and quantity.coat is not None:
        coat = f"; apparent in the coat: {quantity.coat:.4f} mm"
    if quantity.value is None:
        return f"{name}: not measured, {quantity.why}{coat}"
    if quantity.measurand.unit == "share":
        return f"{name}: {percent(quantity.value)}{verdict}"
    if quantity.measurand.unit == "um" or quantity.nominal is None:
        unit = "µm" if quantity.measurand.unit == "um" else "mm"
        return f"{name}: {quantity.value:.4g} {unit} {_interval(quantity)}{verdict}{coat}"
    if _is_lost(quantity):
        return (
            f"{name}: object {quantity.nominal:g} mm, not measured (fit: {quantity.value:.3g} mm)"
        )
    error = signed(float(quantity.error or 0.0), 1)
    value = f"{quantity.value:.4f} mm {_interval(quantity)}"
    difference = f"{error} µm from the object's {quantity.nominal:g} mm"
    condition = f"; {quantity.condition}" if quantity.condition else ""
    return f"{name}: {value}, {difference}{verdict}{condition}{coat}"


def _interval(quantity: MeasuredQuantity) -> str:
    expanded = quantity.uncertainty.expanded
    return f"± {expanded:.2g} µm (k = {quantity.uncertainty.coverage_factor:g})"


def _is_lost(quantity: MeasuredQuantity) -> bool:
    """Return True if the error exceeds the nominal length: probably another feature was fitted."""
    return (
        quantity.nominal is not None and abs(float(quantity.error or 0.0)) > 1e3 * quantity.nominal
    )


def _headline(toleranced: list[MeasuredQuantity]) -> str:
    within = sum(quantity.decision == WITHIN for quantity in toleranced)
    if len(toleranced) == 1:
        return str(toleranced[0].decision)
    return f"{within} of {len(toleranced)} within tolerance"


def _grade(toleranced: list[MeasuredQuantity]) -> Grade:
    if all(quantity.decision == WITHIN for quantity in toleranced):
        return "good"
    return "poor" if any(quantity.decision == NOT_WITHIN for quantity in toleranced) else "check"


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
_TRUTH = Column("coat", "true surface (µm)", kind="number")
_PARTS = Column("parts", "parts of u (µm)", kind="number")


def quantity_table(measured: Measurement) -> Table:
    """Return the table of measurands: value of the object, U, contributions to u, and verdict.

    A further column has the apparent value in the coat. Without a coat, it has the error of the
    true visible surface.
    """
    score, covered = measured.object, is_covered(measured.experiment)
    factors = sorted({f"{quantity.uncertainty.coverage_factor:g}" for quantity in score.quantities})
    elastomer = "the subtracted elastomer, " if covered else ""
    surface = (
        "Apparent in the coat: the measurand of the measured coat, thickness not subtracted."
        if covered
        else "True surface: deviation of the true visible surface, without errors of the optics."
    )
    return Table(
        "measurands",
        "Measurands",
        "",
        (*_QUANTITIES, _APPARENT if covered else _TRUTH, _PARTS),
        tuple(_row(quantity) for quantity in score.quantities),
        (
            f"U: expanded uncertainty with k = {', '.join(factors)} (2: about 95 %). It includes "
            f"noise and texture of the points, {elastomer}repeatability if it is stated, and "
            "calibration: parts of u, in this order. Verdict after ISO 14253-1 with guard band U: "
            f"within tolerance by U or more, outside by U or more, or undecided. {surface}",
            *_assumed(measured),
            *_conditions(score.quantities),
            *_absences(score.quantities),
        ),
        look="compared",
    )


def _assumed(measured: Measurement) -> list[str]:
    """Return a note with the standard uncertainties of sheet and load; empty without a sheet."""
    under = measured.compensation and measured.compensation.compensated
    if not under:
        return []
    layer = under.sheet.layer
    return [
        "Standard uncertainties of the sheet and its load ([sigma] of the experiment, else those "
        f"of inputs/handling): thickness {1e3 * layer.sigma_thickness_mm:.2g} µm, air "
        f"{layer.sigma_back_pressure_kpa:.2g} kPa, modulus {layer.sigma_young_modulus_kpa:.3g} "
        f"kPa, pre-stretch {layer.sigma_pre_stretch:.2g}."
    ]


def _conditions(quantities: tuple[MeasuredQuantity, ...]) -> list[str]:
    """Return one note for each condition of an uncertainty."""
    return [
        f"{quantity.measurand.name.replace('_', ' ')}: {quantity.condition}."
        for quantity in quantities
        if quantity.condition
    ]


def _absences(quantities: tuple[MeasuredQuantity, ...]) -> list[str]:
    """Return one note for each reason why measurands have no value.

    The reasons are too long for a column of the table.
    """
    missing: dict[str, list[str]] = {}
    for quantity in quantities:
        if quantity.value is None and quantity.why:
            missing.setdefault(quantity.why, []).append(quantity.measurand.name.replace("_", " "))
    return [f"{', '.join(names)} not measured: {why}." for why, names in missing.items()]


def _row(quantity: MeasuredQuantity) -> dict[str, str]:
    share, digits = quantity.measurand.unit == "share", 4 if quantity.measurand.unit == "mm" else 2
    unit = {"mm": " mm", "um": " µm", "share": ""}[quantity.measurand.unit]
    length = quantity.measurand.unit == "mm"
    row = {
        "name": quantity.measurand.name.replace("_", " "),
        "nominal": NONE if quantity.nominal is None else f"{quantity.nominal:g} mm",
        "limits": _limits(quantity),
        "coat": _surface_cell(quantity),
    }
    if _is_lost(quantity):
        lost = quantity.decision or f"fit: {quantity.value:.3g} mm"
        return row | {"value": _NOT_MEASURED, "verdict": lost}
    return row | {
        "value": NONE if quantity.value is None else f"{quantity.value:.{digits}f}{unit}",
        "error": NONE if quantity.error is None or share else signed(quantity.error, 1),
        "expanded": NONE
        if quantity.value is None or share
        else f"{quantity.uncertainty.expanded:.2g}",
        "parts": NONE if quantity.value is None or share else _parts(quantity),
        "verdict": quantity.decision
        or (_NOT_MEASURED if quantity.why else "no tolerance" if length else NONE),
    }


def _surface_cell(quantity: MeasuredQuantity) -> str:
    if quantity.covered:
        return NONE if quantity.coat is None else f"{quantity.coat:.4f} mm"
    error = quantity.true_face_error
    return NONE if error is None or quantity.measurand.unit == "share" else signed(error, 1)


def _parts(quantity: MeasuredQuantity) -> str:
    known = quantity.uncertainty
    parts = known.noise, known.elastomer, known.repeatability, known.calibration
    return ", ".join(f"{u:.2g}" for u in parts)


def _limits(quantity: MeasuredQuantity) -> str:
    if quantity.tolerance is None:
        return NONE
    low, high = quantity.tolerance.lower, quantity.tolerance.upper
    if np.isinf(low):
        return f"up to {high:g}"
    return f"from {low:g}" if np.isinf(high) else f"{low:+g} to {high:+g}".replace("-", "−")


def deviation_table(measured: Measurement) -> Table:
    """Return the table of deviations (um) from the true object: RMS after each alignment, and form.

    The form is the width of the band with 95 % of the deviations after the rigid alignment. One
    column has the deviations of the measured points. The other column has those of the true coat,
    or of the true visible surface: the effect of the elastomer without measurement errors.
    """
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
    raw = ", thickness not subtracted" if measured.object.under_sheet else ""
    shown = {"rms": "measured", "coat": f"true {_surface(measured)}{raw}"}
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
    points = measured.object.observed
    assert points is not None  # or there would be no section
    share = percent(points.coverage)
    touched = touches(measured.experiment)
    skin_mm = points.surface.skin_mm
    added = (
        f" The nominal thickness of the elastomer between, {skin_mm:g} mm, is subtracted along the "
        "normal, like the radius of a stylus."
        if skin_mm
        else ""
    )
    if measured.object.under_sheet:
        return (
            "Distances along the normal of the true specimen, of the object points computed from "
            f"the coat: {share} of the specimen {touched} and has such a point. Contact and local "
            "thickness are computed from the measured coat, the elastomer and the air pressure; "
            "the thickness is subtracted along the normal. The second column is the true coat at "
            "the same points, thickness not subtracted."
        )
    return (
        f"Distances along the normal of the true specimen, of the points where it {touched}: "
        f"{share} of it. The second column is the same deviation of the true {_surface(measured)} "
        f"at these pixels, which a measurement without error would have.{added}"
    )


def object_rows(measured: Measurement) -> dict[str, str]:
    """Return value with U, and deviation, of each measurand as text, by label with its unit.

    A comparison of methods shows these texts in its table.
    """
    rows = {}
    for quantity in measured.object.quantities:
        name = quantity.measurand.name.replace("_", " ")
        if quantity.measurand.unit == "mm":
            rows[f"{name} (mm)"] = (
                NONE if quantity.value is None else f"{quantity.value:.4f} {_interval(quantity)}"
            )
        if quantity.measurand.unit != "share":
            rows[f"{name}: deviation (µm)"] = number(quantity.error, "+.1f")
    return rows
