"""Score the object itself: its deviation from the truth, and its measurands with their verdicts.

A contact sensor measures the coat; the object is the required result. Under a thin sheet the
object's points are those of `twin.results.under_sheet`: the local thickness is taken off, and no
nominal one. Under a slab no thickness makes an object of the coat: its lengths are not measured
then, and deviations are those from the specimen grown by the nominal thickness. The coat
itself has separate figures, without subtraction.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage
from reconstruction.errors import FitError, InputError
from reconstruction.evaluate.conformity import CombinedUncertainty, Decision, Tolerance
from reconstruction.evaluate.deviation import (
    ALIGNMENTS,
    Alignment,
    Deviations,
    deviations,
    normals_of,
)
from twin.config.measurands import ObjectMeasurand
from twin.config.models import Experiment
from twin.mechanics import PressedElastomer
from twin.mechanics.choice import is_slab
from twin.optics.stack import Truth
from twin.results.features import Feature, feature_of, features_of
from twin.results.figures import Metric
from twin.results.measurands import FittedValue, measurand_of
from twin.results.object_fits import fit
from twin.results.object_points import ObjectPoints, SeenObject, is_covered, seen_object
from twin.results.quantities import measurands_of, nominal_mm
from twin.results.under_sheet import SheetCompensation

NOTHING_FOUND = "no points of the object were measured"
_ALIGNED_NAMES = {"none": "", "offset": "offset_", "offset_tilt": "offset_tilt_", "rigid": "rigid_"}


@dataclass(frozen=True, eq=False)
class MeasuredQuantity:
    """One measurand: value, uncertainty, and whether it is within tolerance.

    Attributes
    ----------
    value : of the object, in the measurand's unit; None if absent, `why` gives the reason
    coat : the same of the measured surface, coat or specimen, without subtraction
    true_face : that of the true surface: the result of a perfect measurement
    uncertainty : of the value, in um (of a share: as the share)
    covered : the elastomer is between object and coat: `coat` is an apparent figure
    tolerance : on the value's deviation, in um (of a share: on the share); None: none is given
    points_mm : (n, xyz) the fitted points; None without a value
    """

    asked: ObjectMeasurand
    nominal: float | None
    value: float | None
    true_face: float | None
    uncertainty: CombinedUncertainty
    tolerance: Tolerance | None
    points_mm: FloatArray | None
    why: str = ""
    coat: float | None = None
    covered: bool = False

    @property
    def error(self) -> float | None:
        """Value less nominal, um; of form and deviation the value, of coverage the share."""
        return self._deviation_of(self.value)

    @property
    def true_face_error(self) -> float | None:
        """The same of the true coat: the elastomer's effect."""
        return self._deviation_of(self.true_face)

    @property
    def decision(self) -> Decision | None:
        """Within tolerance or not, by ISO 14253-1; None without a tolerance."""
        if self.tolerance is None:
            return None
        if self.error is None:
            return "cannot tell"
        return self.tolerance.verdict(self.error, self.uncertainty.expanded)

    @property
    def margin(self) -> float | None:
        """By how much it is within tolerance beyond U; None without a tolerance or a value."""
        if self.tolerance is None or self.error is None:
            return None
        return self.tolerance.margin(self.error, self.uncertainty.expanded)

    def _deviation_of(self, value: float | None) -> float | None:
        if self.asked.unit != "mm":
            return value
        known = value is not None and self.nominal is not None
        return 1e3 * (value - self.nominal) if known else None  # type: ignore[operator]


@dataclass(frozen=True, eq=False)
class ObjectScore:
    """Measured values of the object.

    Attributes
    ----------
    seen : None without points of the object
    quantities : its measurands
    aligned : deviations of the measured points that touch, by alignment
    """

    seen: SeenObject | None
    quantities: tuple[MeasuredQuantity, ...]
    aligned: dict[Alignment, Deviations]
    figures: dict[str, Metric]

    @property
    def under_sheet(self) -> bool:
        """Whether the points are those found under a thin sheet, its local thickness taken off."""
        return self.seen is not None and self.seen.measured.under is not None

    def quantity(self, name: str) -> MeasuredQuantity:
        """Return a measurand by its name, such as radius_1.

        Raises
        ------
        InputError : there is none of that name
        """
        for one in self.quantities:
            if one.asked.name == name:
                return one
        names = ", ".join(one.asked.name for one in self.quantities) or "none"
        raise InputError(f"quantity: found {name!r}, allowed: {names}")


def score_object(
    experiment: Experiment,
    points: tuple[NDArray[np.floating], BoolImage, FloatImage | None],
    truth: Truth,
    pressed: PressedElastomer | None,
    compensation: SheetCompensation | None = None,
) -> ObjectScore:
    """Compare measured points with the specimen itself.

    Parameters
    ----------
    points : world_mm (row, col, xyz), valid (row, col), sigma_z_mm (row, col) or None
    compensation : input of the compensation of the object under a thin sheet

    Raises
    ------
    InputError : a measurand names a part that the specimen does not have
    """
    asked, features = measurands_of(experiment), features_of(experiment.specimen)
    under = None if compensation is None else compensation.found
    seen = seen_object(experiment, points, truth, pressed, under)
    without = why_not_compensated(experiment, compensation)
    found = tuple(_quantity(one, feature_of(features, one), seen, without) for one in asked)
    measured = _aligned(seen, seen.measured) if seen else {}
    true_face = _aligned(seen, seen.true_face) if seen else {}
    figures = dict(deviation_figures(seen, measured, true_face))
    for one in found:
        figures |= dict(quantity_figures(one))
    return ObjectScore(seen, found, measured, figures | summary_of(found))


def _aligned(seen: SeenObject, points: ObjectPoints) -> dict[Alignment, Deviations]:
    """Return the deviations of the touching points by alignment; none where there are too few."""
    kept = points.part(points.touching).thinned().points_mm
    distance = seen.surface.distance_mm
    if not len(kept):
        return {}
    normals = normals_of(kept, distance)
    try:
        return {how: deviations(kept, distance, how, normals) for how in ALIGNMENTS}
    except FitError:
        return {}


def deviation_figures(
    seen: SeenObject | None,
    measured: dict[Alignment, Deviations],
    true_face: dict[Alignment, Deviations],
) -> Iterator[tuple[str, Metric]]:
    """Yield the figures of the deviation from the true object."""
    yield "object_points", 0 if seen is None else int(seen.measured.touching.sum())
    yield "object_coverage_share", None if seen is None else seen.coverage
    for name, of in (("object_", measured), ("true_face_object_", true_face)):
        for how in ALIGNMENTS:
            left, word = of.get(how), _ALIGNED_NAMES[how]
            yield f"{name}{word}rms_um", None if left is None else 1e3 * _rms(left)
        plain, rigid = of.get("none"), of.get("rigid")
        bias_mm = None if plain is None else float(plain.deviation_mm.mean())
        yield f"{name}bias_um", None if bias_mm is None else 1e3 * bias_mm
        yield f"{name}p95_um", None if plain is None else 1e3 * plain.p95_mm
        yield f"{name}form_um", None if rigid is None else 1e3 * _form(rigid)


def _rms(left: Deviations) -> float:
    return left.rms(np.ones(len(left.deviation_mm))).value


def _form(left: Deviations) -> float:
    return left.form(np.ones(len(left.deviation_mm))).value


def why_not_compensated(
    experiment: Experiment, compensation: SheetCompensation | None = None
) -> str:
    """Return the reason why the coat shows no lengths of the object; empty where it does."""
    elastomer = experiment.elastomer
    if not is_covered(experiment) or (compensation is not None and compensation.found is not None):
        return ""
    if compensation is not None:
        return compensation.why
    if is_slab(elastomer):
        return (
            f"the coat on {elastomer.thickness_mm:g} mm of silicone is no parallel surface of the "
            "object; twin compensate fits the numbers of a known form behind it"
        )
    return "how thick the elastomer is over the object is not known under this layer"


def _quantity(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject | None, without: str
) -> MeasuredQuantity:
    """Measure one quantity; `without`: why a covered object has no lengths, empty if it has."""
    value, coat, true_value, why = None, None, None, NOTHING_FOUND
    covered = seen is not None and seen.covered
    if seen is not None:
        value, why = _attempt(asked, feature, seen, seen.measured)
        if asked.hidden and covered:
            coat, _ = _attempt(asked, feature, seen, _whole(asked, seen.coat))
            true_value, _ = _attempt(asked, feature, seen, _whole(asked, seen.true_face))
            value, why = (None, without) if without else (value, why)
        else:
            true_value, _ = _attempt(asked, feature, seen, seen.true_face)
    return MeasuredQuantity(
        asked=asked,
        nominal=nominal_mm(feature, asked),
        value=None if value is None else _in_unit(asked, value.value),
        true_face=None if true_value is None else _in_unit(asked, true_value.value),
        uncertainty=CombinedUncertainty(
            noise=0.0 if value is None else 1e3 * value.noise_mm,
            repeatability=asked.repeatability_um,
            calibration=asked.calibration_um,
            coverage_factor=asked.coverage_factor,
            elastomer=0.0 if value is None else 1e3 * _elastomer_mm(asked, feature, seen, value),
        ),
        tolerance=tolerance_of(asked),
        points_mm=None if value is None else value.points_mm,
        why=why,
        coat=None if coat is None else _in_unit(asked, coat.value),
        covered=covered and asked.hidden,
    )


def _whole(asked: ObjectMeasurand, points: ObjectPoints) -> ObjectPoints:
    """Return the points of a coat that its own figure rests on: those in contact, or all of them.

    Which of both is a property of the quantity, see `MeasurandKind.coat_in_contact`.
    """
    if measurand_of(asked).coat_in_contact:
        return points
    return replace(points, touching=np.ones(len(points.points_mm), bool))


def _elastomer_mm(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject | None, value: FittedValue
) -> float:
    """Return a value's standard uncertainty by the uncertain parameters of the subtracted sheet.

    All points move together by each uncertainty of the layer; of a radius the theory of thin sheets
    neglects a little more. A width by the free spans has that within its own uncertainty.
    """
    points = None if seen is None else seen.measured
    if seen is None or points is None or points.under is None or value.estimate is None:
        return 0.0
    under, cells = points.under, points.pixels
    assert cells is not None
    changes = [
        fit(asked, feature, seen, replace(points, points_mm=moved)).value - value.value
        for moved in under.moved(points.points_mm, cells)
    ]
    changes += measurand_of(asked).theory_mm(value.value, under.sheet)
    return float(np.linalg.norm(changes))


def _attempt(
    asked: ObjectMeasurand, feature: Feature, seen: SeenObject, points: ObjectPoints
) -> tuple[FittedValue | None, str]:
    try:
        value = fit(asked, feature, seen, points)
    except FitError as error:
        return None, str(error)
    if asked.unit == "mm" and not value.value > 2 * value.noise_mm:
        return None, (
            f"{asked.quantity}: not determined by these points: {value.value:.3g} mm, u = "
            f"{value.noise_mm:.2g} mm"
        )
    return value, ""


def _in_unit(asked: ObjectMeasurand, value: float) -> float:
    return 1e3 * value if asked.unit == "um" else value


def tolerance_of(asked: ObjectMeasurand) -> Tolerance | None:
    """Return the tolerance of a measurand's deviation; None if not stated."""
    if asked.plus_minus_um is not None:
        return Tolerance(-asked.plus_minus_um, asked.plus_minus_um)
    if asked.at_least is not None:
        return Tolerance(lower=asked.at_least)
    if asked.nominal_mm is not None and measurand_of(asked).nominal_is_limit:
        return Tolerance(upper=asked.upper_um or 0.0)
    if asked.lower_um is None and asked.upper_um is None:
        return None
    return Tolerance(
        -np.inf if asked.lower_um is None else asked.lower_um,
        np.inf if asked.upper_um is None else asked.upper_um,
    )


def quantity_figures(one: MeasuredQuantity) -> Iterator[tuple[str, Metric]]:
    """Yield the figures of one measurand."""
    name, unit = f"object_{one.asked.name}", one.asked.unit
    yield f"{name}_{unit}", one.value
    if one.covered:
        yield f"{name}_coat_{unit}", one.coat
    yield f"{name}_true_face_{unit}", one.true_face
    if unit != "share":
        known = one.value is not None
        yield f"{name}_expanded_um", one.uncertainty.expanded if known else None
        yield f"{name}_noise_um", one.uncertainty.noise if known else None
    if unit == "mm" and one.nominal is not None:
        yield f"{name}_error_um", one.error
        yield f"{name}_abs_error_um", None if one.error is None else abs(one.error)
    if one.tolerance is not None:
        yield f"{name}_margin_{'share' if unit == 'share' else 'um'}", one.margin
        yield f"{name}_verdict", str(one.decision)
    if one.why:
        yield f"{name}_why", one.why


def summary_of(found: tuple[MeasuredQuantity, ...]) -> dict[str, Metric]:
    """Count the verdicts; designs are ranked by the least margin in um."""
    judged = [one for one in found if one.tolerance is not None]
    if not judged:
        return {}
    within = sum(one.decision == "within tolerance" for one in judged)
    margins = [one.margin for one in judged if one.asked.unit != "share"]
    least = None if not margins or None in margins else min(m for m in margins if m is not None)
    return {
        "measurands_judged": len(judged),
        "measurands_within": within,
        "least_margin_um": least,
    }
