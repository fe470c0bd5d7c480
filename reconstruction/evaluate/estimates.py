"""Fit steps, grooves, waves, balls and cylinders, with derivatives for their uncertainty; mm.

Each fit returns its value v and the derivative of v by the height z_i of each point. The standard
uncertainties sigma_i of the points are then propagated by u^2 = N sum (dv/dz_i)^2 sigma_i^2
(JCGM 100, 5.1.2). N is the number of neighbouring points that have a common error: a Gaussian
filter of standard deviation s pixels averages the noise of 4 pi s^2 points, which then have the
information of a single point.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError
from reconstruction.evaluate.fit import fit_sphere, inliers
from reconstruction.evaluate.robust import (
    BallFit,
    CylinderFit,
    fit_ball,
    fit_cylinder,
    fit_heights,
)

_LEAST_POINTS = 5
_LEAST_IN_FIT = 20
# Residuals up to 0.1 um are never outliers, however small the other residuals are.
_NEVER_OUT_MM = 1e-4
_SINGULAR = 1e-9


@dataclass(frozen=True, eq=False)
class FittedDimension:
    """A dimension fitted to points, with the derivatives that propagate the points' uncertainty.

    Attributes
    ----------
    value : fitted dimension, mm
    slope : (n,) derivative of the value by each point's height; 0 for an unused point
    residuals_mm : (n,) residuals of the points
    used : (n,) bool, points used in the last fit
    design : (n, k) derivative of each point's height by the k parameters of the shape, 0 for an
        unused point; None if no shape is fitted
    gradient : (k,) derivative of the value by the parameters of the shape; None if no shape is
        fitted
    slope_of_residual : (n,) derivative of the value by each residual, 0 for an unused point; None:
        residuals are heights, so that it is `slope`
    """

    value: float
    slope: FloatArray
    residuals_mm: FloatArray
    used: BoolImage
    design: FloatArray | None = None
    gradient: FloatArray | None = None
    slope_of_residual: FloatArray | None = None

    def noise_mm(self, sigma_mm: FloatArray, together: float) -> float:
        """Return the standard uncertainty of the value, mm, from that of the points' heights.

        Parameters
        ----------
        sigma_mm : (n,) standard uncertainty of each point's height
        together : number of neighbouring points that have a common error, at least 1
        """
        alone = float(np.sum((self.slope * sigma_mm) ** 2))
        # Upper limit: one common error moves all points by their sigma.
        all_as_one = float(np.sum(np.abs(self.slope) * sigma_mm)) ** 2
        return float(np.sqrt(min(max(together, 1.0) * alone, all_as_one)))

    def bound_mm(self, sigma_mm: FloatArray, points_each: float = 1.0) -> float | None:
        """Return the least standard deviation, mm, that any unbiased fit of the shape can have.

        This is the Cramer-Rao bound sqrt(g^T F^-1 g) with the information
        F = sum_i J_i J_i^T / sigma_i^2 of independent, normally distributed errors. J_i is row i of
        `design`, g is `gradient`. A fit weighted by 1 / sigma^2 attains the bound. None if no shape
        is fitted, or if the points do not determine it.

        Parameters
        ----------
        sigma_mm : (n,) standard deviation of each height, above 0 for every used point
        points_each : number of measured points per point of the fit
        """
        parts = self._bound_parts(sigma_mm)
        return None if parts is None else float(np.sqrt(parts.sum() / points_each))

    def bound_shares(self, sigma_mm: FloatArray) -> FloatArray | None:
        """Return the share of each point in the bound: d ln(bound) / d ln(sigma_i), (n,).

        The shares are at least 0 and their sum is 1. None if there is no bound, see `bound_mm`.
        """
        parts = self._bound_parts(sigma_mm)
        if parts is None:
            return None
        shares = np.zeros(len(self.used))
        shares[self.used] = parts / parts.sum()
        return shares

    def _bound_parts(self, sigma_mm: FloatArray) -> FloatArray | None:
        """Return the contribution of each used point to the squared bound, mm^2, or None.

        The contributions are (J_i x)^2 / sigma_i^2 with x = F^-1 g; their sum is g^T x.
        """
        if self.design is None or self.gradient is None:
            return None
        weighted = self.design[self.used] / sigma_mm[self.used, None]
        size = np.linalg.norm(weighted, axis=0)
        if len(weighted) < len(size) or not size.all():
            return None
        triangle = np.asarray(np.linalg.qr(weighted / size, mode="r"))
        if np.abs(np.diag(triangle)).min() < _SINGULAR:
            return None
        solution = np.linalg.solve(triangle, np.linalg.solve(triangle.T, self.gradient / size))
        return np.asarray((weighted @ (solution / size)) ** 2)


def shared_by(filter_sigma_px: float, stride_px: int = 1) -> float:
    """Return the number of neighbouring points that have a common error after a Gaussian filter.

    It is 4 pi sigma^2 pixels: the squared sum of the filter's weights over the sum of squares.
    Points are every `stride_px`-th pixel along rows and columns.

    Parameters
    ----------
    filter_sigma_px : standard deviation sigma of the filter
    """
    return max(1.0, 4.0 * np.pi * filter_sigma_px**2 / stride_px**2)


def step_between(
    xy_mm: FloatArray, z_mm: FloatArray, upper: BoolImage, lower: BoolImage
) -> FittedDimension:
    """Fit a step between two parallel planes, z = a + b x + c y + h upper; the value is h.

    This is ISO 5436-1 type A1 with planes instead of lines. The caller excludes points near edges.

    Parameters
    ----------
    xy_mm, z_mm : (n, 2), (n,) float
    upper, lower : (n,) bool, points on the upper and on the lower plateau

    Raises
    ------
    FitError : there are fewer than five points on a plateau
    """
    for name, part in (("upper", upper), ("lower", lower)):
        if part.sum() < _LEAST_POINTS:
            raise FitError(f"step: {part.sum()} points on the {name} level, 5 needed")
    design = np.column_stack([upper.astype(np.float64), np.ones(len(z_mm)), xy_mm])
    return _parameters(design, z_mm, (upper, lower))[0]


def fit_linear(design: FloatArray, z_mm: FloatArray) -> FittedDimension:
    """Fit the parameters p of heights z = design p, outliers excluded; the value is p[0].

    Parameters
    ----------
    design : (n, k) float, derivative of each height by each parameter
    z_mm : (n,) float, heights

    Raises
    ------
    FitError : there are fewer than five points, or fewer points than parameters
    """
    least = max(_LEAST_POINTS, design.shape[1])
    if len(z_mm) < least:
        raise FitError(f"{len(z_mm)} points, {least} needed")
    return _parameters(design, z_mm, (np.ones(len(z_mm), bool),))[0]


def wave_depth(s_mm: FloatArray, z_mm: FloatArray, pitch_mm: float) -> FittedDimension:
    """Fit a line a + b s plus a sine of known pitch to a profile of grooves.

    The value is the height of the sine from crest to root.

    Parameters
    ----------
    s_mm, z_mm : (n,) float, position across the grooves and height

    Raises
    ------
    FitError : there are fewer than 20 points, or they cover less than one pitch
    """
    if len(s_mm) < _LEAST_IN_FIT or np.ptp(s_mm) < pitch_mm:
        raise FitError(f"grooves: {len(s_mm)} points, 20 over at least one pitch needed")
    angle = 2 * np.pi * s_mm / pitch_mm
    design = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(s_mm)), s_mm])
    parts = _parameters(design, z_mm, (np.ones(len(z_mm), bool),), count=2)
    size = float(np.hypot(parts[0].value, parts[1].value))
    slope = sum(part.value / max(size, 1e-12) * part.slope for part in parts)
    towards = np.array([2 * part.value / max(size, 1e-12) for part in parts] + [0.0, 0.0])
    return FittedDimension(
        2 * size,
        np.asarray(2 * slope),
        parts[0].residuals_mm,
        parts[0].used,
        parts[0].design,
        towards,
    )


@dataclass(frozen=True, eq=False)
class GrooveFit:
    """Fitted V groove: depth, width at the face, and position s of the root; all in mm."""

    depth: FittedDimension
    width: FittedDimension
    root_mm: float


def v_groove(s_mm: FloatArray, z_mm: FloatArray, depth_mm: float, width_mm: float) -> GrooveFit:
    """Fit a groove with two straight flanks in a flat face to a profile.

    The model is z = a + b s - depth max(0, 1 - 2 |s - root| / width).

    Parameters
    ----------
    s_mm, z_mm : (n,) float, position across the groove and height
    depth_mm, width_mm : approximate depth and width of the groove, within a factor of two

    Raises
    ------
    FitError : there are fewer than 20 points, or the fit does not converge
    """
    if len(s_mm) < _LEAST_IN_FIT:
        raise FitError(f"groove: {len(s_mm)} points, 20 needed")
    middle = float(np.median(s_mm[z_mm <= np.quantile(z_mm, 0.05)]))
    start = np.array([float(np.quantile(z_mm, 0.9)), 0.0, depth_mm, width_mm, middle])
    scale = np.array([depth_mm, depth_mm / width_mm, depth_mm, width_mm, width_mm])

    def residual(parameters: FloatArray) -> FloatArray:
        a, b, depth, width, root = parameters
        fall = np.maximum(0.0, 1.0 - 2.0 * np.abs(s_mm - root) / width)
        return np.asarray(a + b * s_mm - depth * fall - z_mm)

    solution = least_squares(
        residual, start, x_scale=scale, loss="soft_l1", f_scale=0.05 * depth_mm
    )
    solution = least_squares(residual, solution.x, x_scale=scale)
    if not solution.success or min(solution.x[2:4]) <= 0:
        raise FitError(f"groove: the fit does not converge ({solution.message})")
    back = np.linalg.pinv(solution.jac)
    used = np.ones(len(z_mm), bool)
    depth, width = (
        FittedDimension(
            float(solution.x[n]),
            np.asarray(back[n]),
            -solution.fun,
            used,
            solution.jac,
            np.eye(5)[n],
        )
        for n in (2, 3)
    )
    return GrooveFit(depth, width, float(solution.x[4]))


def ball_radius(points_mm: FloatArray) -> tuple[FittedDimension, BallFit]:
    """Fit a ball to points (n, xyz), outliers excluded; the value is its radius.

    Raises
    ------
    FitError : there are too few points, or they are coplanar
    """
    fit = fit_ball(points_mm)
    used_mm = points_mm[fit.inliers]
    normals = used_mm - fit.centre_mm
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    design = np.column_stack([np.ones(len(used_mm)), normals])
    return _radius(fit.radius_mm, design, normals[:, 2], fit.inliers, fit.residuals_mm), fit


def ball_radius_of_all(points_mm: FloatArray) -> FittedDimension:
    """Fit a ball to all points (n, xyz) by least squares; the value is its radius.

    Raises
    ------
    FitError : there are too few points, or they are coplanar
    """
    fit = fit_sphere(points_mm)
    normals = points_mm - fit.centre_mm
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    design = np.column_stack([np.ones(len(normals)), normals])
    used = np.ones(len(normals), bool)
    return _radius(fit.radius_mm, design, normals[:, 2], used, fit.residuals_mm)


def cylinder_radius(points_mm: FloatArray, axis: FloatArray) -> tuple[FittedDimension, CylinderFit]:
    """Fit a cylinder to points (n, xyz), outliers excluded; the value is its radius.

    Parameters
    ----------
    axis : (xyz) approximate direction of the axis, within about 20 degrees

    Raises
    ------
    FitError : there are too few points, or the fit does not converge
    """
    fit = fit_cylinder(points_mm, axis)
    used_mm = points_mm[fit.inliers] - fit.point_mm
    along = used_mm @ fit.axis
    normals = used_mm - np.outer(along, fit.axis)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    across = np.linalg.svd(fit.axis[None])[2][1:]
    sides = normals @ across.T
    design = np.column_stack([np.ones(len(used_mm)), sides, sides * along[:, None]])
    return _radius(fit.radius_mm, design, normals[:, 2], fit.inliers, fit.residuals_mm), fit


def _radius(
    radius_mm: float, design: FloatArray, upward: FloatArray, used: BoolImage, residuals: FloatArray
) -> FittedDimension:
    """Return a radius with its derivatives by the heights of the points.

    An error of a height changes the radial distance by its component along the surface normal.

    Parameters
    ----------
    design : (used, k) negative derivative of the radial residual by radius and k - 1 parameters
    upward : (used,) z component of the surface's unit normal
    used : (n,) bool, fitted points
    residuals : (used,) radial residuals, mm
    """
    radial, slope, all_residuals = np.zeros((3, len(used)))
    radial[used] = np.linalg.pinv(design)[0]
    slope[used] = radial[used] * upward
    all_residuals[used] = residuals
    heights = np.zeros((len(used), design.shape[1]))
    heights[used] = design / upward[:, None]
    first = np.eye(design.shape[1])[0]
    return FittedDimension(radius_mm, slope, all_residuals, used, heights, first, radial)


def _parameters(
    design: FloatArray, z_mm: FloatArray, groups: tuple[BoolImage, ...], count: int = 1
) -> list[FittedDimension]:
    """Fit heights z = design p by least squares, outliers excluded; return p[:count].

    Outliers are determined separately in each group of points (n,) bool. Otherwise a large plateau
    could hide the outliers of a small one, or exclude its points.
    """

    def good(residuals: FloatArray) -> BoolImage:
        good = np.zeros(len(z_mm), bool)
        for group in groups:
            left = residuals[group]
            good[group] = inliers(left) | (np.abs(left - np.median(left)) <= _NEVER_OUT_MM)
        return good

    fit = fit_heights(design, z_mm, good, first=np.any(groups, axis=0))
    fitted, residuals = fit.inliers, z_mm - design @ fit.shape
    slopes = np.zeros((design.shape[1], len(z_mm)))
    slopes[:, fitted] = np.linalg.pinv(design[fitted])
    used, unit = design * fitted[:, None], np.eye(design.shape[1])
    return [
        FittedDimension(float(fit.shape[k]), slopes[k], residuals, fitted, used, unit[k])
        for k in range(count)
    ]
