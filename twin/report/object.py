"""The object itself in a report: its measurands with verdicts, and its deviation."""

import numpy as np

from reconstruction.evaluate.conformity import NOT_WITHIN, WITHIN
from twin.config.measurands import LENGTHS
from twin.report.object_picture import object_figure, touches
from twin.report.page import Block, Grade, Note, Section, Verdict
from twin.report.table import Column, Row, Table
from twin.report.words import NONE, number, percent, signed
from twin.results.object_score import MeasuredQuantity
from twin.results.record import Measurement

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
        f"{rms_um:.1f}\N{NO-BREAK SPACE}µm RMS where it {touches(measured.experiment)}",
        _grade_of_deviation(p95_um / limit_um),
        (
            f"95 % of its points there deviate by up to {p95_um:.1f} µm (good up to "
            f"{limit_um:g} µm)",
            f"{percent(share)} of it {touches(measured.experiment)} and has a point",
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
    where = f"on the {share} of it that {touches(measured.experiment)}"
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
    touched = touches(measured.experiment)
    skin_mm = seen.surface.skin_mm
    added = (
        f" The elastomer's nominal thickness of {skin_mm:g} mm lies between and is taken off along "
        "the normal, as a stylus' radius is."
        if skin_mm
        else ""
    )
    return (
        f"Distances along the normal of the specimen's own surface, of the points where it "
        f"{touched}: {share} of it. The second column is the same for the true {_surface(measured)}"
        f" at these pixels: what a perfect measurement would leave.{added}"
    )


def object_rows(measured: Measurement) -> dict[str, str]:
    """Return the measurands' deviations by name, as a comparison of methods shows them."""
    return {
        f"{one.asked.name.replace('_', ' ')}: deviation (µm)": number(one.error, "+.1f")
        for one in measured.object.quantities
        if one.asked.unit != "share"
    }
