"""Least-squares sphere of a measured ball: centre, radius, form, outliers left out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from reconstruction.arrays import BoolImage, Doubles
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import ResidualStats, fit_sphere, residual_stats
from reconstruction.evaluate.outliers import inliers, spread

_MOST_TURNS = 20
# The first scale comes from a fit that outliers have pulled off: it is taken anew once.
_SOFT_TURNS = 2


@dataclass(frozen=True, eq=False)
class BallFit:
    """Sphere through the points of a ball.

    Attributes
    ----------
    centre_mm : (xyz) float
    radius_mm : float
    radius_sigma_mm : float
        Standard uncertainty of the radius from the scatter of the residuals, taken as independent
        of each other; filtered maps have correlated ones and a larger uncertainty.
    residuals_mm : (n,) float
        Radial distances of the points kept, positive outside.
    kept : (n,) bool
    """

    centre_mm: Doubles
    radius_mm: float
    radius_sigma_mm: float
    residuals_mm: Doubles
    kept: BoolImage

    @property
    def form_mm(self) -> float:
        """Range of the radial distances, as in the probing error (form) of VDI/VDE 2634-2."""
        return float(np.ptp(self.residuals_mm))

    @property
    def stats(self) -> ResidualStats:
        """Statistics of the radial residuals."""
        return residual_stats(self.residuals_mm)


def fit_ball(points_mm: ArrayLike) -> BallFit:
    """Fit a sphere: soft-L1 first, then least squares, repeated without outliers.

    Unlike `reconstruction.evaluate.fit.fit_sphere`, which keeps every point.

    Parameters
    ----------
    points_mm : (n, 3) float, n >= 5, not coplanar

    Raises
    ------
    FitError : too few, coplanar or non-finite points
    """
    points = np.asarray(points_mm, np.float64)
    first = fit_sphere(points)
    parameters = _softly(points, np.append(first.centre_mm, first.radius_mm))
    kept = inliers(_radial(parameters, points))
    for _ in range(_MOST_TURNS):
        fine = fit_sphere(points[kept])
        now = inliers(_radial(np.append(fine.centre_mm, fine.radius_mm), points))
        if np.array_equal(now, kept):
            break
        kept = now
    fine = fit_sphere(points[kept])
    sigma_mm = _radius_sigma_mm(points[kept], fine.centre_mm, fine.residuals_mm)
    return BallFit(fine.centre_mm, fine.radius_mm, sigma_mm, fine.residuals_mm, kept)


def _softly(points: Doubles, start: Doubles) -> Doubles:
    """Return centre and radius with the least soft-L1 sum of radial distances."""
    parameters = start
    for _ in range(_SOFT_TURNS):
        scale_mm = max(spread(_radial(parameters, points)), 1e-9)
        found = least_squares(
            _radial, parameters, args=(points,), loss="soft_l1", f_scale=scale_mm, x_scale="jac"
        )
        parameters = np.asarray(found.x)
    return parameters


def _radius_sigma_mm(points: Doubles, centre_mm: Doubles, residuals_mm: Doubles) -> float:
    """Return s sqrt((J^T J)^-1) of the radius; J: minus the unit normals, minus one."""
    freedom = len(points) - 4
    if freedom < 1:
        raise FitError(f"ball: {len(points)} points are left without outliers, 5 needed")
    away = points - centre_mm
    normals = away / np.linalg.norm(away, axis=1, keepdims=True)
    # The radius' variance is what of the ones is not a mixture of the normals' components.
    ones = np.ones(len(points))
    alone = ones - normals @ np.linalg.lstsq(normals, ones, rcond=None)[0]
    return float(np.sqrt(residuals_mm @ residuals_mm / freedom / (alone @ alone)))


def _radial(parameters: Doubles, points: Doubles) -> Doubles:
    distance: Doubles = np.linalg.norm(points - parameters[:3], axis=1) - parameters[3]
    return distance
