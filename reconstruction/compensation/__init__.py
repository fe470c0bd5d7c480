"""Compute the rigid object behind a coat from the measured relief, without ground truth."""

from reconstruction.compensation.bar import BarPlace, BarUnderSheet, bar_under_sheet
from reconstruction.compensation.fitted_slab import (
    CoatSlopes,
    CompensatedSlab,
    FittedNumber,
    FittedSlab,
    KnownForce,
    SlabCoat,
    SlabModel,
)
from reconstruction.compensation.gel import CompensatedGel, GelLayer, compensate_gel
from reconstruction.compensation.known_ball import (
    CalibratedSheet,
    KnownTravel,
    calibrate_sheet,
    require_determined,
)
from reconstruction.compensation.parts import Compensated, ObjectPart, parts_of
from reconstruction.compensation.presentation import contact_arrays
from reconstruction.compensation.relief import Relief, SheetOpening, relief_on_frame
from reconstruction.compensation.sheet import CompensatedSheet, compensate_sheet
from reconstruction.compensation.sheet_layer import SheetLayer
from reconstruction.compensation.slab import bound_under_slab, fit_under_slab

__all__ = [
    "BarPlace",
    "BarUnderSheet",
    "CalibratedSheet",
    "CoatSlopes",
    "Compensated",
    "CompensatedGel",
    "CompensatedSheet",
    "CompensatedSlab",
    "FittedNumber",
    "FittedSlab",
    "GelLayer",
    "KnownForce",
    "KnownTravel",
    "ObjectPart",
    "Relief",
    "SheetLayer",
    "SheetOpening",
    "SlabCoat",
    "SlabModel",
    "bar_under_sheet",
    "bound_under_slab",
    "calibrate_sheet",
    "compensate_gel",
    "compensate_sheet",
    "contact_arrays",
    "fit_under_slab",
    "parts_of",
    "relief_on_frame",
    "require_determined",
]
