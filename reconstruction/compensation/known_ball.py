"""Calibrate a sheet on one press of a known ball: its thickness, and with air its modulus; mm, kPa.

What one press determines: the local thickness over the ball, by its radius; and with known air the
tension of the free span, so the modulus. What it does not: thickness and pre-stretch apart. A sheet
stretched more into its frame is thinner by the square of it before anything touches: along that
ridge, h s^-2 nearly constant, nothing measured changes. The thickness is that at the pre-stretch
taken, and serves every later press of the same mounted sheet.
"""

from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compensation.parts import ObjectPart, parts_of
from reconstruction.compensation.sheet import CompensatedSheet, SheetLayer, compensate_sheet
from reconstruction.errors import FitError, require_number
from reconstruction.evaluate.estimates import ball_radius

_MOST_TURNS = 6
_CLOSE_MM = 1e-5
# Error of the free span's modulus, and what a mm of thickness adds in a frame of 12 mm, where the
# sheet bends: against the one-dimensional solver, tests/compensation.
_MODULUS_THEORY, _MODULUS_PER_MM = 0.02, 0.15
_THINNEST_SHARE, _THICKEST_SHARE = 0.2, 5.0


@dataclass(frozen=True, eq=False)
class CalibratedSheet:
    """A sheet as one press of a known ball tells it.

    Attributes
    ----------
    layer : with thickness and modulus found, and their standard uncertainties; the pre-stretch
        counts as exact, as later presses share it
    radius_before_mm : of the ball by the layer as it was believed
    balls : how many parts were balls
    thickness_per_pre_stretch_mm : by how much the thickness would grow per unit of pre-stretch
    modulus_found : whether the free span told one
    """

    layer: SheetLayer
    radius_before_mm: float
    balls: int
    thickness_per_pre_stretch_mm: float
    modulus_found: bool


def calibrate_sheet(
    points_mm: FloatArray,
    sigma_z_mm: FloatArray,
    layer: SheetLayer,
    ball_radius_mm: float,
    sigma_radius_mm: float = 0.0,
) -> CalibratedSheet:
    """Find the thickness with which the ball has its radius, and the modulus of the free span.

    Parameters
    ----------
    points_mm, sigma_z_mm : as `compensate_sheet`
    layer : as it is believed: where to begin
    ball_radius_mm, sigma_radius_mm : of every ball in contact, and its standard uncertainty

    Raises
    ------
    FitError : no part is a ball, or no thickness gives its radius
    InputError : the radius is no positive number
    """
    require_number("ball radius", ball_radius_mm, 0.0, open_low=True)
    require_number("sigma of the ball radius", sigma_radius_mm, 0.0)
    believed, before = layer.thickness_mm, 0.0
    for turn in range(_MOST_TURNS):
        found = compensate_sheet(points_mm, sigma_z_mm, layer)
        balls = [part for part in parts_of(found) if part.form == "ball"]
        if not balls:
            raise FitError("calibration: no part of the contact is a ball; press one, with air")
        radius, slope = _mean_radius(found, balls)
        before = radius if turn == 0 else before
        if abs(radius - ball_radius_mm) < _CLOSE_MM:
            break
        thickness = layer.thickness_mm + (ball_radius_mm - radius) / slope
        if not _THINNEST_SHARE * believed < thickness < _THICKEST_SHARE * believed:
            raise FitError(
                f"calibration: a radius of {ball_radius_mm:g} mm would take a sheet of "
                f"{thickness:.3g} mm; check the ball, and thickness_mm = {believed:g} of the layer"
            )
        layer = replace(layer, thickness_mm=thickness)
    noise = float(np.sqrt(np.mean([ball.noise_mm**2 for ball in balls]) / len(balls)))
    theory = found.theory_mm(ball_radius_mm)
    sigma = float(np.linalg.norm([noise, theory, sigma_radius_mm])) / abs(slope)
    calibrated = replace(layer, sigma_thickness_mm=sigma, sigma_pre_stretch=0.0)
    free = found.modulus_of_free_span_kpa()
    return CalibratedSheet(
        layer=calibrated if free is None else _with_modulus(calibrated, free[0], sigma),
        radius_before_mm=before,
        balls=len(balls),
        thickness_per_pre_stretch_mm=2 * layer.thickness_mm / layer.pre_stretch,
        modulus_found=free is not None,
    )


def _with_modulus(layer: SheetLayer, modulus_kpa: float, sigma_thickness_mm: float) -> SheetLayer:
    """Return the layer with the modulus of its free span; E h is what the air weighs."""
    shares = (
        _MODULUS_THEORY + _MODULUS_PER_MM * layer.thickness_mm,
        layer.sigma_back_pressure_kpa / layer.back_pressure_kpa,
        sigma_thickness_mm / layer.thickness_mm,
    )
    sigma = modulus_kpa * float(np.linalg.norm(shares))
    return replace(layer, young_modulus_kpa=modulus_kpa, sigma_young_modulus_kpa=sigma)


def _mean_radius(found: CompensatedSheet, balls: list[ObjectPart]) -> tuple[float, float]:
    """Return the balls' mean radius, and its derivative by the sheet's thickness."""
    small = 1e-3 * found.layer.thickness_mm
    slopes = []
    for ball in balls:
        points, core = found.object_mm[ball.core], ball.core
        moved = points - small * (found.thinning[core, None] * found.normal[core])
        slopes.append((ball_radius(moved)[0].value - ball_radius(points)[0].value) / small)
    return float(np.mean([ball.radius_mm for ball in balls])), float(np.mean(slopes))
