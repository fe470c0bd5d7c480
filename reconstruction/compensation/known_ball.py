"""Calibrate thickness, modulus and rim compliance of a sheet on a press of a known ball.

Lengths are in mm, pressures in kPa. From the known radius of the ball one press determines the
local thickness of the sheet over the ball. If the air pressure is known, the press also determines
the tension of the free span and so the modulus. One press does not separate thickness h and
pre-stretch s: a mounted sheet is thinner by s^-2, and no measured quantity changes if h s^-2 is
nearly constant. The calibrated thickness is therefore valid only with the stated pre-stretch, and
for every later press of the same mounted sheet.

With a compliant rim the sheet over the ball is thicker. The compliance is fitted if it has an
uncertainty, using its prior value and the additional data that exist. A known travel gives the
height of the ball's tip, z = travel - h s^-2 above the mounted coat. A modulus known from
another measurement gives the tension of the free span. The fit is by weighted least squares with
Gauss-Newton steps.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compensation.parts import ObjectPart, parts_of
from reconstruction.compensation.sheet import CompensatedSheet, compensate_sheet
from reconstruction.compensation.sheet_layer import SheetLayer
from reconstruction.errors import FitError, require_number
from reconstruction.evaluate.estimates import ball_radius

_MOST_TURNS = 6
_CLOSE_MM, _CLOSE_MM2_PER_N = 1e-5, 0.05
# Error of the free span's modulus, and its increase per mm of thickness in a frame of 12 mm, where
# the sheet bends; compared with the one-dimensional solver, tests/compensation.
_MODULUS_THEORY, _MODULUS_PER_MM = 0.02, 0.15
# Error of the tip's height in addition to `theory_mm` of a radius; compared with the twin's sheet.
_TIP_THEORY_MM = 2e-3
# Increase of the rim's compliance for its derivative, times shear modulus times thickness.
_STEP_MM = 0.05
# Allowed factor to the thickness and the modulus of the layer file. A thickness is known to a few
# per cent, a modulus from the hardness to 20 %. A wrong unit or ball gives a larger factor.
_THICKNESS_FACTOR, _MODULUS_FACTOR = 2.0, 3.0
# Allowed factor during the iteration, which may overshoot the solution.
_STEP_FACTOR = 5.0
# Largest ratio of standard uncertainty to value: above it the expanded one (k = 2) exceeds 50 %.
_MOST_RELATIVE_SIGMA = 0.25
# Range over mean of the radii of equal balls: the thickness of a sheet is not uniform.
_MOST_RADIUS_SPREAD = 0.1
# Largest compliance of a usable rim, and upper limit of the key in the elastomer file.
_SOFTEST_MM2_PER_N = 100.0


@dataclass(frozen=True)
class KnownTravel:
    """Travel of the stage after first contact, and its standard uncertainty, mm."""

    travel_mm: float
    sigma_mm: float


@dataclass(frozen=True, eq=False)
class CalibratedSheet:
    """Values of a sheet calibrated on one press of a known ball, or of several equal balls.

    Attributes
    ----------
    layer : sheet with the fitted thickness, modulus and rim compliance and their standard
        uncertainties; the pre-stretch has no uncertainty, because it is common to later presses
    radius_before_mm : measured radius of the ball with the values before the calibration
    balls : number of contact parts that are balls
    thickness_per_pre_stretch_mm : change of the fitted thickness per unit of assumed pre-stretch
    modulus_fitted : whether the free span determined a modulus
    rim_fitted : whether the rim's compliance was fitted
    """

    layer: SheetLayer
    radius_before_mm: float
    balls: int
    thickness_per_pre_stretch_mm: float
    modulus_fitted: bool
    rim_fitted: bool


def calibrate_sheet(
    points_mm: FloatArray,
    sigma_z_mm: FloatArray,
    layer: SheetLayer,
    ball_radius_mm: float,
    *,
    sigma_radius_mm: float = 0.0,
    travel: KnownTravel | None = None,
) -> CalibratedSheet:
    """Fit the sheet thickness for which the ball has its known radius, and the sheet's modulus.

    Parameters
    ----------
    points_mm : (n, xyz) measured points of the coat, world
    sigma_z_mm : (n,) standard uncertainty of the z coordinate of each point
    layer : prior values, at which the fit starts; the rim's compliance is fitted if
        `sigma_rim_compliance_mm2_per_n` is not 0
    ball_radius_mm : known radius of every ball in contact
    sigma_radius_mm : standard uncertainty of `ball_radius_mm`
    travel : travel of the stage after first contact; used only for the rim's compliance; None:
        unknown

    Raises
    ------
    FitError : no part of the contact is a ball; the balls have different radii; no thickness and
        rim compliance give the radius; the data do not determine them; or thickness or modulus
        differ from those of `layer` by a large factor
    InputError : the radius is not a positive number
    """
    require_number("ball radius", ball_radius_mm, 0.0, open_low=True)
    require_number("sigma of the ball radius", sigma_radius_mm, 0.0)
    known = _Known(layer, ball_radius_mm, sigma_radius_mm, travel)
    here, before, measured, softer, fit = _converged(points_mm, sigma_z_mm, known)
    _require_settled(fit)
    _require_thickness(known, here.thickness_mm, _THICKNESS_FACTOR)
    require_determined("thickness_mm", here.thickness_mm, float(fit.sigma[0]))
    _require_modulus(known.prior, measured.modulus_kpa)
    if here.rim_compliance_mm2_per_n > _SOFTEST_MM2_PER_N:
        raise FitError(
            f"calibration: the rim has a compliance of {here.rim_compliance_mm2_per_n:.3g} mm^2/N, "
            f"allowed 0 to {_SOFTEST_MM2_PER_N:g}; check travel and modulus of the layer"
        )
    calibrated = replace(
        here,
        sigma_thickness_mm=fit.sigma[0],
        sigma_pre_stretch=0.0,
        sigma_rim_compliance_mm2_per_n=fit.sigma[1] if known.fits_rim else 0.0,
    )
    free = measured.modulus_kpa
    of_rim = _modulus_by_rim(here, measured, softer) * calibrated.sigma_rim_compliance_mm2_per_n
    return CalibratedSheet(
        layer=calibrated if free is None else _with_modulus(calibrated, free, of_rim),
        radius_before_mm=before,
        balls=measured.balls,
        thickness_per_pre_stretch_mm=2 * here.thickness_mm / here.pre_stretch,
        modulus_fitted=free is not None,
        rim_fitted=known.fits_rim,
    )


def require_determined(name: str, value: float, sigma: float) -> None:
    """Check that the standard uncertainty of a calibrated number is at most 25 % of the number.

    Raises
    ------
    FitError : the uncertainty is larger
    """
    if not sigma <= _MOST_RELATIVE_SIGMA * abs(value):
        raise FitError(
            f"calibration: {name} is {value:.3g} +- {sigma:.2g}, allowed an uncertainty of up to "
            f"{_MOST_RELATIVE_SIGMA:.0%}; press the ball deeper, or record with less noise"
        )


def _require_modulus(layer: SheetLayer, modulus_kpa: float | None) -> None:
    low, high = layer.young_modulus_kpa / _MODULUS_FACTOR, layer.young_modulus_kpa * _MODULUS_FACTOR
    if modulus_kpa is not None and not low <= modulus_kpa <= high:
        raise FitError(
            f"calibration: the free span has a modulus of {modulus_kpa:.3g} kPa, allowed {low:.3g} "
            f"to {high:.3g}; check hardness or modulus, and back_pressure_kpa = "
            f"{layer.back_pressure_kpa:g} of the layer"
        )


def _require_equal(balls: list[ObjectPart]) -> None:
    radii = np.array([ball.radius_mm for ball in balls])
    if np.ptp(radii) > _MOST_RADIUS_SPREAD * radii.mean():
        raise FitError(
            f"calibration: balls in contact have radii of {radii.min():.3g} to {radii.max():.3g} "
            "mm, allowed one diameter; press one ball, or equal ones"
        )


@dataclass(frozen=True)
class _Known:
    """Values known before the calibration: sheet, ball and travel (None: unknown travel)."""

    prior: SheetLayer
    radius_mm: float
    sigma_radius_mm: float
    travel: KnownTravel | None

    @property
    def fits_rim(self) -> bool:
        return self.prior.sigma_rim_compliance_mm2_per_n > 0


@dataclass(frozen=True)
class _Balls:
    """Means over the balls of one press, computed with one set of layer values.

    Attributes
    ----------
    radius_mm : measured radius
    radius_by_thickness : derivative of the radius by the sheet thickness
    noise_mm, theory_mm : standard uncertainties of the radius from noise, and from the model
    tip_mm : world z of the balls' highest points
    thinning : ratio of local to undeformed thickness over the balls
    modulus_kpa : modulus from the free span; None if the free span does not determine a modulus
    balls : number of balls
    """

    radius_mm: float
    radius_by_thickness: float
    noise_mm: float
    theory_mm: float
    tip_mm: float
    thinning: float
    modulus_kpa: float | None
    balls: int


def _converged(
    points_mm: FloatArray, sigma_z_mm: FloatArray, known: _Known
) -> tuple[SheetLayer, float, _Balls, _Balls | None, "_Fit"]:
    """Iterate the fit of the layer until its steps are small, or `_MOST_TURNS` times.

    Returns
    -------
    Five values: the fitted layer; the radius, mm, with the prior values; the measurements with the
    fitted layer; those with a softer rim, or None if the rim is not fitted; the last step
    """
    here, before = known.prior, 0.0
    for turn in range(_MOST_TURNS):
        measured = _measure_balls(points_mm, sigma_z_mm, here)
        before = measured.radius_mm if turn == 0 else before
        softer = _measure_balls(points_mm, sigma_z_mm, _softer(here)) if known.fits_rim else None
        fit = _fit(known, here, measured, softer)
        if fit.is_close or turn == _MOST_TURNS - 1:
            break
        here = _moved(known, here, fit)
    return here, before, measured, softer, fit


def _measure_balls(points_mm: FloatArray, sigma_z_mm: FloatArray, layer: SheetLayer) -> _Balls:
    compensated = compensate_sheet(points_mm, sigma_z_mm, layer)
    balls = [part for part in parts_of(compensated) if part.form == "ball"]
    if not balls:
        raise FitError("calibration: no part of the contact is a ball; press one, with air")
    _require_equal(balls)
    radius, slope, tip = _mean_ball(compensated, balls)
    free = compensated.modulus_of_free_span_kpa()
    return _Balls(
        radius_mm=radius,
        radius_by_thickness=slope,
        noise_mm=float(np.sqrt(np.mean([ball.noise_mm**2 for ball in balls]) / len(balls))),
        theory_mm=compensated.theory_mm(radius),
        tip_mm=tip,
        thinning=float(np.mean([compensated.thinning[ball.core].mean() for ball in balls])),
        modulus_kpa=None if free is None else free[0],
        balls=len(balls),
    )


def _softer(layer: SheetLayer) -> SheetLayer:
    step = _STEP_MM / layer.tension_unit_n_mm
    return replace(layer, rim_compliance_mm2_per_n=layer.rim_compliance_mm2_per_n + step)


@dataclass(frozen=True, eq=False)
class _Fit:
    """One Gauss-Newton step and the standard uncertainties of the fitted values.

    Both arrays contain the thickness, mm, and, if the rim is fitted, its compliance, mm^2/N.
    """

    step: FloatArray
    sigma: FloatArray

    @property
    def is_close(self) -> bool:
        return bool(abs(self.step[0]) < _CLOSE_MM and abs(self.step[1:]).sum() < _CLOSE_MM2_PER_N)


def _require_settled(fit: _Fit) -> None:
    """Raise FitError if the last step of a value is larger than its standard uncertainty."""
    if not np.all(np.abs(fit.step) <= fit.sigma):
        raise FitError(
            f"calibration: after {_MOST_TURNS} steps the thickness still changes by "
            f"{abs(fit.step[0]):.2g} mm; check the ball, and thickness_mm and back_pressure_kpa of "
            "the layer"
        )


def _fit(known: _Known, here: SheetLayer, measured: _Balls, softer: _Balls | None) -> _Fit:
    sigma = float(np.linalg.norm([measured.noise_mm, measured.theory_mm, known.sigma_radius_mm]))
    misfits = [(known.radius_mm - measured.radius_mm) / sigma]
    slopes = [[measured.radius_by_thickness / sigma]]
    if softer is not None:
        per = 1 / (_softer(here).rim_compliance_mm2_per_n - here.rim_compliance_mm2_per_n)
        slopes[0].append((softer.radius_mm - measured.radius_mm) * per / sigma)
        for misfit, by_thickness, by_compliance in _further(known, here, measured, softer):
            misfits.append(misfit)
            slopes.append([by_thickness, by_compliance * per])
    matrix, target = np.array(slopes), np.array(misfits)
    step = np.linalg.lstsq(matrix, target, rcond=None)[0]
    if softer is not None and step[1] < -here.rim_compliance_mm2_per_n:
        # A rim cannot have a negative compliance; the limit is a rigid rim.
        rigid = -here.rim_compliance_mm2_per_n
        thickness_only = np.linalg.lstsq(matrix[:, :1], target - matrix[:, 1] * rigid, rcond=None)[
            0
        ]
        step = np.array([thickness_only[0], rigid])
    return _Fit(step, np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix))))


def _further(
    known: _Known, here: SheetLayer, measured: _Balls, softer: _Balls
) -> Iterator[tuple[float, float, float]]:
    """Yield the further equations of the fit that determine the rim's compliance.

    They are the prior value, the known travel and the known modulus, as far as each exists. Each
    equation is (misfit, derivative by thickness, change for the rim of `_softer`), all divided by
    the standard uncertainty of the misfit.
    """
    prior = known.prior
    prior_sigma, at = prior.sigma_rim_compliance_mm2_per_n, here.rim_compliance_mm2_per_n
    change = _softer(here).rim_compliance_mm2_per_n - at
    yield (prior.rim_compliance_mm2_per_n - at) / prior_sigma, 0.0, change / prior_sigma
    if known.travel is not None:
        mounted = here.pre_stretch**-2
        expected_mm = known.travel.travel_mm - here.thickness_mm * mounted
        shares = measured.noise_mm, measured.theory_mm, _TIP_THEORY_MM, known.travel.sigma_mm
        sigma = float(np.linalg.norm(shares))
        yield (
            (expected_mm - measured.tip_mm) / sigma,
            (mounted - measured.thinning) / sigma,
            (softer.tip_mm - measured.tip_mm) / sigma,
        )
    if measured.modulus_kpa and softer.modulus_kpa and prior.sigma_young_modulus_kpa:
        theory = (_MODULUS_THEORY + _MODULUS_PER_MM * here.thickness_mm) * measured.modulus_kpa
        sigma = float(np.hypot(theory, prior.sigma_young_modulus_kpa))
        yield (
            (prior.young_modulus_kpa - measured.modulus_kpa) / sigma,
            -measured.modulus_kpa / here.thickness_mm / sigma,
            (softer.modulus_kpa - measured.modulus_kpa) / sigma,
        )


def _require_thickness(known: _Known, thickness_mm: float, factor: float) -> None:
    """Raise FitError if a thickness differs from the layer's prior one by more than a factor."""
    prior_mm = known.prior.thickness_mm
    if not prior_mm / factor <= thickness_mm <= prior_mm * factor:
        raise FitError(
            f"calibration: a radius of {known.radius_mm:g} mm would take a sheet of "
            f"{thickness_mm:.3g} mm, allowed {prior_mm / _THICKNESS_FACTOR:.3g} to "
            f"{prior_mm * _THICKNESS_FACTOR:.3g}; check the ball, and thickness_mm = "
            f"{prior_mm:g} and back_pressure_kpa = {known.prior.back_pressure_kpa:g} of the "
            "layer"
        )


def _moved(known: _Known, here: SheetLayer, fit: _Fit) -> SheetLayer:
    """Return the layer with thickness and rim compliance changed by the step of a fit.

    Raises
    ------
    FitError : the new thickness differs from the prior one by more than a factor of 5, so that no
        thickness gives the known radius
    """
    thickness = here.thickness_mm + fit.step[0]
    _require_thickness(known, thickness, _STEP_FACTOR)
    compliance = here.rim_compliance_mm2_per_n + float(fit.step[1:].sum())
    return replace(
        here,
        thickness_mm=float(thickness),
        rim_compliance_mm2_per_n=compliance,
    )


def _modulus_by_rim(here: SheetLayer, measured: _Balls, softer: _Balls | None) -> float:
    """Return the derivative of the free span's modulus by the compliance, kPa per mm^2/N."""
    if softer is None or measured.modulus_kpa is None or softer.modulus_kpa is None:
        return 0.0
    change = _softer(here).rim_compliance_mm2_per_n - here.rim_compliance_mm2_per_n
    return (softer.modulus_kpa - measured.modulus_kpa) / change


def _with_modulus(layer: SheetLayer, modulus_kpa: float, of_rim_kpa: float) -> SheetLayer:
    """Return the layer with the modulus from its free span and the modulus's standard uncertainty.

    The air pressure on the free span determines E h, modulus times thickness.

    Parameters
    ----------
    of_rim_kpa : standard uncertainty of the modulus from the rim's compliance
    """
    shares = (
        _MODULUS_THEORY + _MODULUS_PER_MM * layer.thickness_mm,
        layer.sigma_back_pressure_kpa / layer.back_pressure_kpa,
        layer.sigma_thickness_mm / layer.thickness_mm,
        of_rim_kpa / modulus_kpa,
    )
    sigma = modulus_kpa * float(np.linalg.norm(shares))
    return replace(layer, young_modulus_kpa=modulus_kpa, sigma_young_modulus_kpa=sigma)


def _mean_ball(
    compensated: CompensatedSheet, balls: list[ObjectPart]
) -> tuple[float, float, float]:
    """Return the balls' mean radius, its derivative by the thickness, and the mean tip height.

    Radius and height (world z of the highest point) are in mm.
    """
    small = 1e-3 * compensated.layer.thickness_mm
    slopes, tips = [], []
    for ball in balls:
        points, core = compensated.object_mm[ball.core], ball.core
        moved = points - small * (compensated.thinning[core, None] * compensated.normal[core])
        radius, fit = ball_radius(points)
        slopes.append((ball_radius(moved)[0].value - radius.value) / small)
        tips.append(fit.centre_mm[2] + fit.radius_mm)
    radii = [ball.radius_mm for ball in balls]
    return float(np.mean(radii)), float(np.mean(slopes)), float(np.mean(tips))
