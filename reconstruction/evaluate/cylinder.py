"""Least-squares cylinder: axis, radius, radial residuals."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from reconstruction.arrays import BoolImage, Doubles
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import ResidualStats, residual_stats
from reconstruction.evaluate.outliers import inliers, spread

_LEAST_POINTS = 20


@dataclass(frozen=True, eq=False)
class CylinderFit:
    """Cylinder round an axis.

    Attributes
    ----------
    point_mm : (xyz) float
        Point of the axis nearest to the points' centroid.
    axis : (xyz) float
        Unit vector with its largest component positive.
    radius_mm : float
    residuals_mm : (n,) float
        Radial distances of the points kept, positive outside.
    kept : (n,) bool
    """

    point_mm: Doubles
    axis: Doubles
    radius_mm: float
    residuals_mm: Doubles
    kept: BoolImage

    @property
    def stats(self) -> ResidualStats:
        """Statistics of the radial residuals."""
        return residual_stats(self.residuals_mm)


def fit_cylinder(points_mm: ArrayLike, axis: ArrayLike) -> CylinderFit:
    """Fit a cylinder: soft-L1 first, then least squares without outliers.

    Parameters
    ----------
    points_mm : (n, 3) float
    axis : (3,) float
        Direction within some 20 degrees of the true one.

    Raises
    ------
    FitError : too few points, or the fit does not converge
    """
    points = np.asarray(points_mm, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < _LEAST_POINTS:
        raise FitError(f"points have shape {points.shape}; a cylinder needs at least (20, 3)")
    centroid = points.mean(axis=0)
    frame = _frame(np.asarray(axis, np.float64))
    local = (points - centroid) @ frame.T
    scale = max(spread(local[:, 2] - np.median(local[:, 2])), 1e-6)
    rough = _solve(local, _start(local), "soft_l1", 0.1 * scale)
    kept = inliers(_radial(rough, local))
    fine = _solve(local[kept], rough, "linear", 1.0)
    direction, foot = _axis_of(fine)
    return CylinderFit(
        point_mm=centroid + foot @ frame,
        axis=_upright(direction @ frame),
        radius_mm=float(abs(fine[4])),
        residuals_mm=_radial(fine, local[kept]),
        kept=kept,
    )


def _frame(axis: Doubles) -> Doubles:
    """Rows: axis and two directions across it."""
    axis = axis / np.linalg.norm(axis)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    return np.stack([axis, across, np.cross(axis, across)])


def _start(local: Doubles) -> Doubles:
    """Start from a circle across the axis: y^2 + z^2 = 2 a y + 2 b z + c, linear (Kasa 1976)."""
    y, z = local[:, 1], local[:, 2]
    design = np.column_stack([2.0 * y, 2.0 * z, np.ones_like(y)])
    (a, b, c), *_ = np.linalg.lstsq(design, y * y + z * z, rcond=None)
    return np.array([a, b, 0.0, 0.0, np.sqrt(c + a * a + b * b)])


def _solve(local: Doubles, start: Doubles, loss: str, scale_mm: float) -> Doubles:
    found = least_squares(_radial, start, args=(local,), loss=loss, f_scale=scale_mm)
    if not found.success:
        raise FitError(f"the cylinder fit does not converge ({found.message})")
    return np.asarray(found.x)


def _axis_of(parameters: Doubles) -> tuple[Doubles, Doubles]:
    """Direction, and the axis' point nearest to the origin, in the local frame."""
    y, z, slope_y, slope_z, _ = parameters
    direction = np.array([1.0, slope_y, slope_z])
    direction /= np.linalg.norm(direction)
    point = np.array([0.0, y, z])
    return direction, point - (point @ direction) * direction


def _radial(parameters: Doubles, local: Doubles) -> Doubles:
    direction, foot = _axis_of(parameters)
    across = local - foot
    across = across - np.outer(across @ direction, direction)
    radial: Doubles = np.linalg.norm(across, axis=1) - abs(parameters[4])
    return radial


def _upright(axis: Doubles) -> Doubles:
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))
