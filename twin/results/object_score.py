"""Score the object itself: deviation of its points from the truth, and its measurands.

A contact sensor measures the coat, but the object is the required result. Under a thin sheet, the
object's points are those of `twin.results.under_sheet`, from which the local thickness is
subtracted, not the nominal one. Under a slab, subtracting a thickness does not give the object.
Lengths of the object are then not measured, and deviations are those from the specimen offset
outwards by the nominal thickness. The coat has separate figures, without subtraction.
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
from twin.results.object_points import ObjectPoints, ObjectView, is_covered, seen_object
from twin.results.quantities import measurands_of, nominal_mm
from twin.results.under_sheet import SheetCompensation

NO_POINTS = "no points of the object were measured"
_ALIGNED_NAMES = {"none": "", "offset": "offset_", "offset_tilt": "offset_tilt_", "rigid": "rigid_"}

NO_CALIBRATION = (
    "U is a lower limit: it does not contain the uncertainty of the calibration, which for "
    "photometric stereo is not known; state calibration_um"
)
"""Condition of a length by a method without fringes whose measurand has no `calibration_um`."""


@dataclass(frozen=True, eq=False)
class MeasuredQuantity:
    """Result of one measurand: value, uncertainty, and whether it is within tolerance.

    Attributes
    ----------
    measurand : the request of the quantity
    nominal : nominal length, mm; None if not known
    value : value of the object, in the measurand's unit; None if there is none, `why` gives the
        reason
    coat : value fitted to the coat without subtraction of a thickness, if the object is covered
    true_face : value fitted to the true visible surface: the result of a perfect measurement
    uncertainty : uncertainty of the value, um (for a share, as a share)
    covered : True if the elastomer is between object and coat, so that `coat` is not a value of
        the object
    tolerance : limits on the deviation of the value, um (for a share, on the share); None if not
        stated
    points_mm : (n, xyz) the fitted points, world frame; None without a value
    why : reason why there is no value; else empty
    condition : condition under which the uncertainty is valid; empty: none
    """

    measurand: ObjectMeasurand
    nominal: float | None
    value: float | None
    true_face: float | None
    uncertainty: CombinedUncertainty
    tolerance: Tolerance | None
    points_mm: FloatArray | None
    why: str = ""
    coat: float | None = None
    covered: bool = False
    condition: str = ""

    @property
    def error(self) -> float | None:
        """Deviation of the value, as the tolerance limits it.

        For a length, it is the value minus the nominal length, um; None if one of them is missing.
        For any other quantity, it is the value in the measurand's unit; None if it is missing.
        """
        return self._deviation_of(self.value)

    @property
    def true_face_error(self) -> float | None:
        """Deviation of the value of the true visible surface: the effect of the elastomer.

        It is computed from `true_face` as `error` is computed from `value`; None if it is missing.
        """
        return self._deviation_of(self.true_face)

    @property
    def decision(self) -> Decision | None:
        """Verdict of ISO 14253-1 on the tolerance; None without a tolerance."""
        if self.tolerance is None:
            return None
        if self.error is None:
            return "cannot tell"
        return self.tolerance.verdict(self.error, self.uncertainty.expanded)

    @property
    def margin(self) -> float | None:
        """Distance of the error from the nearest limit, minus U; None without tolerance or value.

        It is negative if the tolerance is not met with the expanded uncertainty U.
        """
        if self.tolerance is None or self.error is None:
            return None
        return self.tolerance.margin(self.error, self.uncertainty.expanded)

    def _deviation_of(self, value: float | None) -> float | None:
        if self.measurand.unit != "mm":
            return value
        known = value is not None and self.nominal is not None
        return 1e3 * (value - self.nominal) if known else None  # type: ignore[operator]


@dataclass(frozen=True, eq=False)
class ObjectScore:
    """Measured values of the object and their figures.

    Attributes
    ----------
    observed : measured points of the object; None if there are none
    quantities : results of the measurands
    aligned : deviations of the touching measured points from the true object, by alignment
    figures : figures by name, as in `result.json`
    """

    observed: ObjectView | None
    quantities: tuple[MeasuredQuantity, ...]
    aligned: dict[Alignment, Deviations]
    figures: dict[str, Metric]

    @property
    def under_sheet(self) -> bool:
        """Whether the points are those under a thin sheet, with the local thickness subtracted."""
        return self.observed is not None and self.observed.measured.under is not None

    def quantity(self, name: str) -> MeasuredQuantity:
        """Return the result of a measurand by its name, such as radius_1.

        Raises
        ------
        InputError : there is no measurand of this name
        """
        for measured in self.quantities:
            if measured.measurand.name == name:
                return measured
        names = ", ".join(measured.measurand.name for measured in self.quantities) or "none"
        raise InputError(f"quantity: found {name!r}, allowed: {names}")


def score_object(
    experiment: Experiment,
    points: tuple[NDArray[np.floating], BoolImage, FloatImage | None],
    truth: Truth,
    pressed: PressedElastomer | None,
    compensation: SheetCompensation | None = None,
) -> ObjectScore:
    """Compare measured points with the specimen and fit its measurands.

    Parameters
    ----------
    points : world_mm (row, col, xyz), valid (row, col), sigma_z_mm (row, col) or None
    pressed : the pressed elastomer; None for a bare specimen
    compensation : reconstruction of the object under a thin sheet; None without a sheet

    Raises
    ------
    InputError : a measurand names a part that the specimen does not have
    """
    requests, features = measurands_of(experiment), features_of(experiment.specimen)
    under = None if compensation is None else compensation.compensated
    observed = seen_object(experiment, points, truth, pressed, under)
    without = why_not_compensated(experiment, compensation)
    quantities = tuple(
        _quantity(
            quantity, feature_of(features, quantity), observed, without, experiment.method.fringes
        )
        for quantity in requests
    )
    measured = _aligned(observed, observed.measured) if observed else {}
    true_face = _aligned(observed, observed.true_face) if observed else {}
    figures = dict(deviation_figures(observed, measured, true_face))
    for quantity in quantities:
        figures |= dict(quantity_figures(quantity))
    return ObjectScore(observed, quantities, measured, figures | summary_of(quantities))


def _aligned(observed: ObjectView, points: ObjectPoints) -> dict[Alignment, Deviations]:
    """Return the deviations of the touching points by alignment; empty if too few points."""
    points_used = points.part(points.touching).thinned().points_mm
    distance = observed.surface.distance_mm
    if not len(points_used):
        return {}
    normals = normals_of(points_used, distance)
    try:
        return {how: deviations(points_used, distance, how, normals) for how in ALIGNMENTS}
    except FitError:
        return {}


def deviation_figures(
    observed: ObjectView | None,
    measured: dict[Alignment, Deviations],
    true_face: dict[Alignment, Deviations],
) -> Iterator[tuple[str, Metric]]:
    """Yield name and value of the figures of the points' deviation from the true object."""
    yield "object_points", 0 if observed is None else int(observed.measured.touching.sum())
    yield "object_coverage_share", None if observed is None else observed.coverage
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
    """Return why lengths of the object cannot be measured through its coat; empty if they can."""
    elastomer = experiment.elastomer
    if not is_covered(experiment) or (
        compensation is not None and compensation.compensated is not None
    ):
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
    request: ObjectMeasurand,
    feature: Feature,
    observed: ObjectView | None,
    without: str,
    fringes: bool,
) -> MeasuredQuantity:
    """Return the result of one measurand.

    Parameters
    ----------
    without : reason why a covered object has no lengths; empty if it has lengths
    fringes : whether the method projects fringes: its calibration is that on a dot board
    """
    value, coat, true_value, why = None, None, None, NO_POINTS
    covered = observed is not None and observed.covered
    if observed is not None:
        hidden = request.hidden and covered
        if hidden and without:
            why = without
        else:
            value, why = _attempt(request, feature, observed, observed.measured)
        if hidden:
            coat, _ = _attempt(request, feature, observed, _whole(request, observed.coat))
        true_face = _whole(request, observed.true_face) if hidden else observed.true_face
        true_value, _ = _attempt(request, feature, observed, true_face)
    calibration_um: float | None = 0.0
    if value is not None:
        calibration_um = request.sigma_of_calibration_um(_in_unit(request, value.value), fringes)
    return MeasuredQuantity(
        measurand=request,
        nominal=nominal_mm(feature, request),
        value=None if value is None else _in_unit(request, value.value),
        true_face=None if true_value is None else _in_unit(request, true_value.value),
        uncertainty=CombinedUncertainty(
            noise=0.0 if value is None else 1e3 * value.noise_mm,
            repeatability=request.repeatability_um,
            calibration=calibration_um or 0.0,
            coverage_factor=request.coverage_factor,
            elastomer=0.0
            if value is None
            else 1e3 * _elastomer_mm(request, feature, observed, value),
        ),
        tolerance=tolerance_of(request),
        points_mm=None if value is None else value.points_mm,
        why=why,
        coat=None if coat is None else _in_unit(request, coat.value),
        covered=covered and request.hidden,
        condition="" if value is None else condition_of(value, calibration_um is not None),
    )


def condition_of(value: FittedValue, calibrated: bool = True) -> str:
    """Return the condition under which the uncertainty of a fitted value is valid; empty: none.

    `calibrated`: whether the uncertainty includes that of the sensor's calibration.
    """
    without = "" if calibrated else NO_CALIBRATION
    return "; ".join(filter(None, (without, _condition_of_patches(value))))


def _condition_of_patches(value: FittedValue) -> str:
    """Return the condition for a contact of a few patches of the coat's texture; empty: none.

    The scatter of a coat's texture is estimated from the residuals of the fit. Over a contact of
    only a few patches of the texture, the fit follows the texture, and one press does not show it.
    """
    points, estimate = value.of, value.estimate
    if points is None or points.under is None or points.pixels is None or estimate is None:
        return ""
    noise = points.under.noise_of(estimate, points.pixels)
    if noise.is_known:
        return ""
    return (
        f"U is a lower limit: the contact has only {noise.patches:.0f} independent patches of the "
        f"coat, and one press determines their scatter from {noise.least_patches} on; repeat the "
        "press at other places of the coat"
    )


def _whole(request: ObjectMeasurand, points: ObjectPoints) -> ObjectPoints:
    """Return the points of a coat for a fit to the coat: points in contact only, or all of them.

    This is a property of the quantity, see `MeasurandKind.coat_in_contact`.
    """
    if measurand_of(request).coat_in_contact:
        return points
    return replace(points, touching=np.ones(len(points.points_mm), bool))


def _elastomer_mm(
    request: ObjectMeasurand, feature: Feature, observed: ObjectView | None, value: FittedValue
) -> float:
    """Return the standard uncertainty, mm, of a value by uncertain parameters of the sheet.

    The value is fitted again with all points moved by each standard uncertainty of the layer. For
    a radius, the error of the theory of thin sheets is added. For a width determined from free
    spans, the fit itself determines this uncertainty.
    """
    points = None if observed is None else observed.measured
    if observed is None or points is None or points.under is None or value.estimate is None:
        return value.layer_mm
    under, cells = points.under, points.pixels
    assert cells is not None
    changes = [
        fit(request, feature, observed, replace(points, points_mm=moved)).value - value.value
        for moved in under.moved(points.points_mm, cells)
    ]
    changes += measurand_of(request).theory_mm(value.value, under.sheet)
    return float(np.linalg.norm(changes))


def _attempt(
    request: ObjectMeasurand, feature: Feature, observed: ObjectView, points: ObjectPoints
) -> tuple[FittedValue | None, str]:
    try:
        value = fit(request, feature, observed, points)
    except FitError as error:
        return None, str(error)
    if request.unit == "mm" and not value.value > 2 * value.noise_mm:
        return None, (
            f"{request.quantity}: not determined by these points: {value.value:.3g} mm, u = "
            f"{value.noise_mm:.2g} mm"
        )
    return value, ""


def _in_unit(request: ObjectMeasurand, value: float) -> float:
    return 1e3 * value if request.unit == "um" else value


def tolerance_of(request: ObjectMeasurand) -> Tolerance | None:
    """Return the tolerance on a measurand's deviation, um, or on a share; None if not stated."""
    if request.plus_minus_um is not None:
        return Tolerance(-request.plus_minus_um, request.plus_minus_um)
    if request.at_least is not None:
        return Tolerance(lower=request.at_least)
    if request.nominal_mm is not None and measurand_of(request).nominal_is_limit:
        return Tolerance(upper=request.upper_um or 0.0)
    if request.lower_um is None and request.upper_um is None:
        return None
    return Tolerance(
        -np.inf if request.lower_um is None else request.lower_um,
        np.inf if request.upper_um is None else request.upper_um,
    )


def quantity_figures(measured: MeasuredQuantity) -> Iterator[tuple[str, Metric]]:
    """Yield name and value of the figures of one measurand."""
    name, unit = f"object_{measured.measurand.name}", measured.measurand.unit
    yield f"{name}_{unit}", measured.value
    if measured.covered:
        yield f"{name}_coat_{unit}", measured.coat
    yield f"{name}_true_face_{unit}", measured.true_face
    if unit != "share":
        known = measured.value is not None
        yield f"{name}_expanded_um", measured.uncertainty.expanded if known else None
        yield f"{name}_noise_um", measured.uncertainty.noise if known else None
    if unit == "mm" and measured.nominal is not None:
        yield f"{name}_error_um", measured.error
        yield f"{name}_abs_error_um", None if measured.error is None else abs(measured.error)
    if measured.tolerance is not None:
        yield f"{name}_margin_{'share' if unit == 'share' else 'um'}", measured.margin
        yield f"{name}_verdict", str(measured.decision)
    if measured.why:
        yield f"{name}_why", measured.why
    if measured.condition:
        yield f"{name}_condition", measured.condition


def summary_of(quantities: tuple[MeasuredQuantity, ...]) -> dict[str, Metric]:
    """Return the numbers of measurands with a tolerance and within it, and the least margin, um.

    Empty if no measurand has a tolerance. Designs are ranked by the least margin.
    """
    judged = [measured for measured in quantities if measured.tolerance is not None]
    if not judged:
        return {}
    within = sum(measured.decision == "within tolerance" for measured in judged)
    margins = [measured.margin for measured in judged if measured.measurand.unit != "share"]
    least = None if not margins or None in margins else min(m for m in margins if m is not None)
    return {
        "measurands_judged": len(judged),
        "measurands_within": within,
        "least_margin_um": least,
    }
