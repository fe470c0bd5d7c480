"""Fit measurands to the points of an object; the fits themselves are in `twin.results.measurands`.

Each takes points in the world and returns a value with its slope by each point's height, in mm.
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
    """Fit one quantity to measured points, or to the true face's.

    Raises
    ------
    FitError : the points do not determine it
    """
    fitted = measurand_of(request).fit(request, feature, observed, in_ranges(request, points))
    require_determined(request.quantity, fitted.noise_mm, fitted.points_mm)
    return fitted


def require_determined(quantity: str, noise_mm: float, points_mm: FloatArray) -> None:
    """Raise FitError if a fit's noise is larger than the extent of its points.

    A groove that the coat does not show has any width, a flat face any radius.

    Parameters
    ----------
    noise_mm : standard deviation of the fitted value by noise
    points_mm : (n, xyz) float, mm; world

    Raises
    ------
    FitError : names both lengths
    """
    extent_mm = float(np.ptp(points_mm[:, :2], axis=0).max()) if len(points_mm) else 0.0
    if noise_mm > extent_mm:
        raise FitError(
            f"{quantity}: not determined, noise leaves it open by {noise_mm:.3g} mm (1 sigma), "
            f"more than the {extent_mm:.3g} mm that its points extend over"
        )
