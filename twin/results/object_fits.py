"""Fit a measurand to points of an object, and check that the points determine its value.

The fits of the kinds of measurands are in `twin.results.measurands`.
"""

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import FitError
from twin.config.measurands import ObjectMeasurand
from twin.results.features import Feature
from twin.results.measurands import FittedValue, in_ranges, measurand_of
from twin.results.object_points import ObjectPoints, ObjectView


def fit(
    request: ObjectMeasurand, feature: Feature, observed: ObjectView, points: ObjectPoints
) -> FittedValue:
    """Fit one measurand to the measured points, or to points of the true face.

    Raises
    ------
    FitError : the points do not determine the value
    """
    fitted = measurand_of(request).fit(request, feature, observed, in_ranges(request, points))
    require_determined(request.quantity, fitted.noise_mm, fitted.points_mm)
    return fitted


def require_determined(quantity: str, noise_mm: float, points_mm: FloatArray) -> None:
    """Raise FitError if a fit's noise is larger than the extent of its points.

    Such a value is not determined: a groove that the coat does not show has any width, and a flat
    face has any radius.

    Parameters
    ----------
    quantity : name of the quantity, for the message
    noise_mm : standard deviation of the fitted value by noise, mm
    points_mm : (n, xyz) float, mm; points of the fit in the world frame

    Raises
    ------
    FitError : the noise is larger than the extent; the message states both
    """
    extent_mm = float(np.ptp(points_mm[:, :2], axis=0).max()) if len(points_mm) else 0.0
    if noise_mm > extent_mm:
        raise FitError(
            f"{quantity}: not determined, noise leaves it open by {noise_mm:.3g} mm (1 sigma), "
            f"more than the {extent_mm:.3g} mm that its points extend over"
        )
