"""Calibrate the elastomer layer of a sensor on a press of known balls."""

from typing import Any

import numpy as np

from reconstruction.arrays import at_pixels
from reconstruction.compensation import CalibratedSheet, KnownTravel, SheetLayer, calibrate_sheet
from reconstruction.errors import InputError
from reconstruction.triangulation import PointMap
from twin.config.sensor_layer import SensorLayer
from twin.config.specimen_base import Specimen
from twin.mechanics.choice import is_slab, may_wrap
from twin.pipeline.slab_object import calibrate_slab, slab_object
from twin.results.under_sheet import sheet_layer

_UM = 1e3


def calibrated_layer(
    points: PointMap,
    layer: SensorLayer,
    ball_diameter_mm: float,
    specimen: Specimen | None = None,
) -> tuple[SensorLayer, dict[str, Any]]:
    """Fit thickness and modulus of a layer to a press of known balls.

    Parameters
    ----------
    points : measured points of the coat
    layer : prior values of elastomer and load
    ball_diameter_mm : known diameter of every ball in contact
    specimen : ball under a thick slab, if the layer has no specimen

    Returns
    -------
    the layer with the fitted values, and the figures for result.json

    Raises
    ------
    InputError : the elastomer is neither sheet nor slab, or no ball is in contact
    """
    elastomer, valid = layer.elastomer, points.valid
    measured = (
        at_pixels(points.points_world_mm, valid).astype(np.float64),
        at_pixels(points.sigma_z_mm, valid).astype(np.float64),
    )
    if is_slab(elastomer):
        return calibrate_slab(*measured, slab_object(layer, specimen), ball_diameter_mm)
    if not may_wrap(elastomer):
        raise InputError(
            f"--ball-diameter-mm: found {elastomer.layout}, {elastomer.thickness_mm:g} mm thick; a "
            "ball calibrates a sheet or slab with layout = 'opposite_face'"
        )
    calibrated = calibrate_sheet(
        *measured, sheet_layer(layer), ball_diameter_mm / 2, travel=_known_travel(layer)
    )
    return _with_sheet(layer, calibrated.layer), _calibration_figures(calibrated)


def _with_sheet(layer: SensorLayer, sheet: SheetLayer) -> SensorLayer:
    """Return the layer with the fitted values of a sheet and their standard uncertainties."""
    values = {
        "shore_a": None,
        "shore_00": None,
        "young_modulus_kpa": sheet.young_modulus_kpa,
        "thickness_mm": sheet.thickness_mm,
        "rim_compliance_mm2_per_n": sheet.rim_compliance_mm2_per_n,
    }
    sigma = {
        "thickness_mm": sheet.sigma_thickness_mm,
        "young_modulus_kpa": sheet.sigma_young_modulus_kpa,
        "pre_stretch": sheet.sigma_pre_stretch,
        "rim_compliance_mm2_per_n": sheet.sigma_rim_compliance_mm2_per_n,
    }
    elastomer, known = layer.elastomer, layer.sigma
    return layer.model_copy(
        update={
            "elastomer": type(elastomer).model_validate(elastomer.model_dump() | values),
            "sigma": type(known).model_validate(known.model_dump() | sigma),
        }
    )


def _calibration_figures(calibrated: CalibratedSheet) -> dict[str, Any]:
    """Return the figures of a calibration for result.json; a value that was not fitted is None."""
    sheet = calibrated.layer
    modulus = sheet.young_modulus_kpa, sheet.sigma_young_modulus_kpa
    rim = sheet.rim_compliance_mm2_per_n, sheet.sigma_rim_compliance_mm2_per_n
    modulus_kpa, modulus_sigma_kpa = modulus if calibrated.modulus_fitted else (None, None)
    compliance, sigma_compliance = rim if calibrated.rim_fitted else (None, None)
    return {
        "calibrated_thickness_mm": sheet.thickness_mm,
        "calibrated_thickness_sigma_um": _UM * sheet.sigma_thickness_mm,
        "calibrated_modulus_kpa": modulus_kpa,
        "calibrated_modulus_sigma_kpa": modulus_sigma_kpa,
        "calibrated_rim_compliance_mm2_per_n": compliance,
        "calibrated_rim_compliance_sigma_mm2_per_n": sigma_compliance,
        "radius_before_calibration_mm": calibrated.radius_before_mm,
        "thickness_per_pre_stretch_mm": calibrated.thickness_per_pre_stretch_mm,
        "calibration_balls": calibrated.balls,
    }


def _known_travel(layer: SensorLayer) -> KnownTravel | None:
    """Return the measured travel of the press with its uncertainty; None if one is not stated.

    The uncertainty includes that of the plane of the undeformed coat.
    """
    travel_mm, sigma_mm = layer.press.depth_mm, layer.sigma.depth_mm
    if travel_mm is None or sigma_mm is None:
        return None
    return KnownTravel(travel_mm, float(np.hypot(sigma_mm, layer.sigma.plane_mm)))
