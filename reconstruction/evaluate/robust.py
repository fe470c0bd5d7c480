"""Fit balls, cylinders and linear models of heights to points with outliers; lengths in mm."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import (
    InlierFit,
    ResidualStats,
    SphereFit,
    fit_inliers,
    fit_sphere,
    inliers,
    radial_jacobian,
    radial_mm,
    residual_stats,
    spread,
)

# Number of soft-L1 fits: the scale of the residuals for the first one is from a fit that outliers
# have biased.
_SOFT_TURNS = 2
# Newton's steps end below this share of the scale of the residuals; usually after five steps.
_NEWTON_STEP, _MOST_NEWTON_STEPS = 1e-6, 20
_LEAST_POINTS = 20
# Points of a cylinder need 5 to 15 steps; those of a ball may drift for hundreds to no cylinder.
_MOST_CYLINDER_STEPS = 40


@dataclass(frozen=True, eq=False)
class BallFit:
    """Sphere fitted to the points of a ball, outliers excluded.

    Attributes
    ----------
    centre_mm : (xyz) float
    radius_mm : float
    radius_sigma_mm : float
        Standard uncertainty of the radius from the scatter of the residuals, which are assumed
        independent. Points of filtered maps have correlated residuals and a larger uncertainty.
    residuals_mm : (inlier,) float
        Radial distances of the inliers from the sphere, positive outside.
    inliers : (n,) bool
        Points that are no outliers.
    """

    centre_mm: FloatArray
    radius_mm: float
    radius_sigma_mm: float
    residuals_mm: FloatArray
    inliers: BoolImage

    @property
    def form_mm(self) -> float:
        """Largest minus smallest radial distance, the probing error (form) of VDI/VDE 2634-2."""
        return float(np.ptp(self.residuals_mm))

    @property
    def stats(self) -> ResidualStats:
        """Statistics of the radial distances of the inliers."""
        return residual_stats(self.residuals_mm)


def fit_ball(points_mm: ArrayLike) -> BallFit:
    """Fit a sphere to the points of a ball, outliers excluded.

    A fit with soft-L1 loss determines the first outliers. A least squares fit to the other points
    is repeated, each time without the outliers of the previous fit.
    `reconstruction.evaluate.fit.fit_sphere` uses every point.

    Parameters
    ----------
    points_mm : (n, 3) float, n >= 5, not coplanar

    Raises
    ------
    FitError : points are too few, coplanar or not finite
    """
    points = np.asarray(points_mm, np.float64)
    start = fit_sphere(points)
    parameters = soft_sphere(points, np.append(start.centre_mm, start.radius_mm))

    def radial(sphere: SphereFit) -> FloatArray:
        return radial_mm(np.append(sphere.centre_mm, sphere.radius_mm), points)

    first = inliers(radial_mm(parameters, points))
    fit = fit_inliers(lambda used: fit_sphere(points[used]), radial, first)
    ball, fitted = fit.shape, fit.fitted
    sigma_mm = _radius_sigma_mm(points[fitted], ball.centre_mm, ball.residuals_mm)
    return BallFit(ball.centre_mm, ball.radius_mm, sigma_mm, ball.residuals_mm, fitted)


def soft_sphere(points: FloatArray, start: FloatArray) -> FloatArray:
    """Return centre and radius, (4,), with the least soft-L1 loss of the radial distances.

    Parameters
    ----------
    start : (4,) centre and radius of a first fit
    """
    parameters = start
    for _ in range(_SOFT_TURNS):
        scale_mm = max(spread(radial_mm(parameters, points)), 1e-9)
        solution = _soft_newton(points, parameters, scale_mm)
        if solution is None:
            solution = least_squares(
                radial_mm,
                parameters,
                radial_jacobian,
                args=(points,),
                loss="soft_l1",
                f_scale=scale_mm,
                x_scale="jac",
            ).x
        parameters = np.asarray(solution)
    return parameters


def _soft_newton(points: FloatArray, start: FloatArray, scale_mm: float) -> FloatArray | None:
    """Return centre and radius, (4,), as `soft_sphere` for one scale.

    The soft-L1 loss of a residual f is 2 (sqrt(1 + z) - 1) with z = (f / scale)^2: its slope by f
    is proportional to f / sqrt(1 + z), and the derivative of the slope to (1 + z)^(-3/2). The
    steps are those of Newton's method without the curvature of the distance itself. Returns None
    without convergence.
    """
    axes, sphere, before = np.ascontiguousarray(points.T), start, np.inf
    for _ in range(_MOST_NEWTON_STEPS):
        toward = sphere[:3, None] - axes
        distance = np.sqrt(np.einsum("ij,ij->j", toward, toward))
        if not distance.all():
            return None
        left = distance - sphere[3]
        flat = 1.0 / (1.0 + np.square(left / scale_mm))
        weight = np.sqrt(flat)
        slopes = np.vstack([toward / distance, np.full_like(distance, -1.0)])
        try:
            step = np.linalg.solve((slopes * (weight * flat)) @ slopes.T, -slopes @ (weight * left))
        except np.linalg.LinAlgError:
            return None
        size = float(np.abs(step).max())
        if not size < before:
            return None
        sphere, before = sphere + step, size
        if size <= _NEWTON_STEP * scale_mm:
            return sphere
    return None


def _radius_sigma_mm(points: FloatArray, centre_mm: FloatArray, residuals_mm: FloatArray) -> float:
    """Return the standard uncertainty of a fitted radius, mm, from the scatter of the residuals.

    It is the radius's element of s sqrt((J^T J)^-1), with the standard deviation s of the residuals
    and the Jacobian J with the rows (-unit normal, -1).
    """
    freedom = len(points) - 4
    if freedom < 1:
        raise FitError(f"ball: {len(points)} points are left without outliers, 5 needed")
    away = points - centre_mm
    normals = away / np.linalg.norm(away, axis=1, keepdims=True)
    # The radius' variance is from the part of the ones orthogonal to the normals' components.
    ones = np.ones(len(points))
    orthogonal = ones - normals @ np.linalg.lstsq(normals, ones, rcond=None)[0]
    return float(np.sqrt(residuals_mm @ residuals_mm / freedom / (orthogonal @ orthogonal)))


@dataclass(frozen=True, eq=False)
class CylinderFit:
    """Cylinder fitted to points, outliers excluded.

    Attributes
    ----------
    point_mm : (xyz) float
        Point of the axis nearest to the centroid of the points.
    axis : (xyz) float
        Unit vector along the axis, with its largest component positive.
    radius_mm : float
    residuals_mm : (inlier,) float
        Radial distances of the inliers from the cylinder, positive outside.
    inliers : (n,) bool
        Points that are no outliers.
    """

    point_mm: FloatArray
    axis: FloatArray
    radius_mm: float
    residuals_mm: FloatArray
    inliers: BoolImage

    @property
    def stats(self) -> ResidualStats:
        """Statistics of the radial distances of the inliers."""
        return residual_stats(self.residuals_mm)


def fit_cylinder(points_mm: ArrayLike, axis: ArrayLike) -> CylinderFit:
    """Fit a cylinder to points, outliers excluded.

    A fit with soft-L1 loss determines the outliers; one least squares fit uses the other points.

    Parameters
    ----------
    points_mm : (n, 3) float
    axis : (3,) float
        Approximate direction of the axis, within about 20 degrees.

    Raises
    ------
    FitError : there are fewer than 20 points, or the fit does not converge
    """
    points = np.asarray(points_mm, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < _LEAST_POINTS:
        raise FitError(f"points have shape {points.shape}; a cylinder needs at least (20, 3)")
    centroid = points.mean(axis=0)
    frame = _frame(np.asarray(axis, np.float64))
    local = (points - centroid) @ frame.T
    scale = max(spread(local[:, 2] - np.median(local[:, 2])), 1e-6)
    rough = _solve(local, _start(local), "soft_l1", 0.1 * scale)
    used = inliers(_from_axis(rough, local))
    fine = _solve(local[used], rough, "linear", 1.0)
    direction, foot = _axis_of(fine)
    return CylinderFit(
        point_mm=centroid + foot @ frame,
        axis=_upright(direction @ frame),
        radius_mm=float(abs(fine[4])),
        residuals_mm=_from_axis(fine, local[used]),
        inliers=used,
    )


def _frame(axis: FloatArray) -> FloatArray:
    """Return a rotation matrix (3, 3); its rows are the unit axis and two directions across it."""
    axis = axis / np.linalg.norm(axis)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    return np.stack([axis, across, np.cross(axis, across)])


def _start(local: FloatArray) -> FloatArray:
    """Return the start (5,) of a cylinder fit in the local frame, with x along the axis.

    The parameters are y and z of the axis, its two slopes, here 0, and the radius. A circle is
    fitted across the axis by the linear equation y^2 + z^2 = 2 a y + 2 b z + c (Kasa 1976).
    """
    y, z = local[:, 1], local[:, 2]
    design = np.column_stack([2.0 * y, 2.0 * z, np.ones_like(y)])
    (a, b, c), *_ = np.linalg.lstsq(design, y * y + z * z, rcond=None)
    return np.array([a, b, 0.0, 0.0, np.sqrt(c + a * a + b * b)])


def _solve(local: FloatArray, start: FloatArray, loss: str, scale_mm: float) -> FloatArray:
    solution = least_squares(
        _from_axis,
        start,
        _from_axis_jacobian,
        args=(local,),
        loss=loss,
        f_scale=scale_mm,
        max_nfev=_MOST_CYLINDER_STEPS,
    )
    if not solution.success:
        raise FitError(f"the cylinder fit does not converge ({solution.message})")
    return np.asarray(solution.x)


def _axis_of(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unit direction and the point nearest to the origin, of a cylinder's axis.

    Both are (xyz) in the local frame. `parameters` are those of `_start`.
    """
    y, z, slope_y, slope_z, _ = parameters
    direction = np.array([1.0, slope_y, slope_z])
    direction /= np.linalg.norm(direction)
    point = np.array([0.0, y, z])
    return direction, point - (point @ direction) * direction


def _from_axis(parameters: FloatArray, local: FloatArray) -> FloatArray:
    direction, foot = _axis_of(parameters)
    across = local - foot
    across = across - np.outer(across @ direction, direction)
    radial: FloatArray = np.linalg.norm(across, axis=1) - abs(parameters[4])
    return radial


def _from_axis_jacobian(parameters: FloatArray, local: FloatArray) -> FloatArray:
    """Return the derivatives (n, 5) of `_from_axis` by the parameters of `_start`.

    A point moves with the unit normal from the axis, and by a slope the more, the farther along the
    axis it is; the length of the direction has no effect.
    """
    direction, foot = _axis_of(parameters)
    along = local @ direction
    across = local - foot - np.outer(along, direction)
    sides = across[:, 1:] / np.linalg.norm(across, axis=1, keepdims=True)
    turned = sides * (along - parameters[:2] @ direction[1:])[:, None] * direction[0]
    return np.column_stack([-sides, -turned, np.full(len(local), -np.sign(parameters[4]))])


def _upright(axis: FloatArray) -> FloatArray:
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))


def fit_heights(
    design: FloatArray,
    z_mm: FloatArray,
    judge: Callable[[FloatArray], BoolImage] = inliers,
    *,
    first: BoolImage | None = None,
    most_fits: int = 20,
) -> InlierFit[FloatArray]:
    """Fit the parameters p of heights z = design p by least squares, outliers excluded.

    The fit is repeated, each time without the outliers of the previous one.

    Parameters
    ----------
    design : (n, k) derivative of each height by each parameter
    z_mm : (n,) heights
    judge, most_fits : as in `fit_inliers`
    first : (n,) bool, points of the first fit; None: all points
    """
    return fit_inliers(
        lambda used: np.asarray(np.linalg.lstsq(design[used], z_mm[used], rcond=None)[0]),
        lambda parameters: np.asarray(z_mm - design @ parameters),
        np.ones(len(z_mm), bool) if first is None else first,
        judge,
        most_fits,
    )
