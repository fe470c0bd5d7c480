"""Flatness: deviations from the least-squares reference plane, outliers left out of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolImage, Doubles
from reconstruction.evaluate.fit import PlaneFit, fit_plane
from reconstruction.evaluate.outliers import inliers

_MOST_TURNS = 20


@dataclass(frozen=True, eq=False)
class Flatness:
    """Deviations of points from their plane.

    Attributes
    ----------
    peak_to_valley_mm, rms_mm : float
        ISO 12781-1's peak-to-valley and RMS flatness deviation, over the points kept.
    kept : (n,) bool
        Points that are no outliers.
    plane : PlaneFit
        Through the points kept.
    """

    peak_to_valley_mm: float
    rms_mm: float
    kept: BoolImage
    plane: PlaneFit


def flatness(points_mm: ArrayLike) -> Flatness:
    """Fit the reference plane (least squares, repeated without outliers) and rate the deviations.

    Parameters
    ----------
    points_mm : (n, 3) float

    Raises
    ------
    FitError : too few points, or they lie on a line
    """
    points = np.asarray(points_mm, np.float64)
    plane = fit_plane(points)
    kept = np.ones(len(points), bool)
    for _ in range(_MOST_TURNS):
        now = inliers(distances_mm(points, plane))
        if np.array_equal(now, kept):
            break
        kept = now
        plane = fit_plane(points[kept])
    residuals = plane.residuals_mm
    return Flatness(float(np.ptp(residuals)), float(np.sqrt(np.mean(residuals**2))), kept, plane)


def distances_mm(points_mm: Doubles, plane: PlaneFit) -> Doubles:
    """Signed distances of points (n, 3) from a plane."""
    distances: Doubles = (points_mm - plane.centroid_mm) @ plane.normal
    return distances
