"""Dimensions with their standard uncertainty: plateaus, grooves, waves, balls, cylinders; mm.

Each fit returns its value and the derivative of the value by each point's height, so that any
uncertainty of the points can be propagated: u^2 = N sum (dv/dz_i)^2 sigma_i^2 (JCGM 100, 5.1.2).
N is how many neighbouring points share one error: a Gaussian filter of standard deviation s pixels
averages the noise of 4 pi s^2 of them, so that many points carry the information of one.
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
# Residuals of 0.1 um are no outliers, however exact the other points are.
_NEVER_OUT_MM = 1e-4
_SINGULAR = 1e-9


@dataclass(frozen=True, eq=False)
class FittedDimension:
    """A value that was fitted to points.

    Attributes
    ----------
    value : mm
    slope : (n,) derivative of the value by each point's height; 0 for a point left out
    residuals_mm : (n,) of all points; `used` tells which took part
    design : (n, k) change of each point's height by the parameters of the shape, 0 for a point
        left out; None where no shape is fitted
    gradient : (k,) derivative of the value by these parameters
    """

    value: float
    slope: FloatArray
    residuals_mm: FloatArray
    used: BoolImage
    design: FloatArray | None = None
    gradient: FloatArray | None = None

    def noise_mm(self, sigma_mm: FloatArray, together: float) -> float:
        """Return the standard uncertainty that the points' (n,) causes.

        Parameters
        ----------
        together : how many neighbouring points share one error, at least 1
        """
        alone = float(np.sum((self.slope * sigma_mm) ** 2))
        # Sharing cannot do more than move all points by their sigma in one direction.
        all_as_one = float(np.sum(np.abs(self.slope) * sigma_mm)) ** 2
        return float(np.sqrt(min(max(together, 1.0) * alone, all_as_one)))

    def bound_mm(self, sigma_mm: FloatArray, points_each: float = 1.0) -> float | None:
        """Return the least standard deviation that any unbiased fit of the shape can have.

        The Cramer-Rao bound sqrt(g^T F^-1 g), F = sum_i J_i J_i^T / sigma_i^2 the information of
        points whose errors are independent and normal, J_i `design`, g `gradient`; a fit weighted
        by 1 / sigma^2 attains it. None where no shape is fitted, or its points do not fix it.

        Parameters
        ----------
        sigma_mm : (n,) of the heights, above 0 where used
        points_each : how many measured points each one stands for
        """
        parts = self._bound_parts(sigma_mm)
        return None if parts is None else float(np.sqrt(parts.sum() / points_each))

    def bound_shares(self, sigma_mm: FloatArray) -> FloatArray | None:
        """Return by how much the bound changes with each point's sigma, (n,): d ln b / d ln sigma.

        They are at least 0 and add up to 1: where the information about the value comes from.
        """
        parts = self._bound_parts(sigma_mm)
        if parts is None:
            return None
        shares = np.zeros(len(self.used))
        shares[self.used] = parts / parts.sum()
        return shares

    def _bound_parts(self, sigma_mm: FloatArray) -> FloatArray | None:
        """Return (J_i x)^2 / sigma_i^2 of the points used, x = F^-1 g: they add up to g^T x."""
        if self.design is None or self.gradient is None:
            return None
        weighted = self.design[self.used] / sigma_mm[self.used, None]
        size = np.linalg.norm(weighted, axis=0)
        if len(weighted) < len(size) or not size.all():
            return None
        triangle = np.asarray(np.linalg.qr(weighted / size, mode="r"))
        if np.abs(np.diag(triangle)).min() < _SINGULAR:
            return None
        found = np.linalg.solve(triangle, np.linalg.solve(triangle.T, self.gradient / size))
        return np.asarray((weighted @ (found / size)) ** 2)


def shared_by(filter_sigma_px: float, stride_px: int = 1) -> float:
    """Return how many of the points (every `stride_px`-th pixel) share one error after a filter.

    The squared sum over the sum of squares of a Gaussian's autocorrelation: 4 pi sigma^2.
    """
    return max(1.0, 4.0 * np.pi * filter_sigma_px**2 / stride_px**2)


def step_between(
    xy_mm: FloatArray, z_mm: FloatArray, upper: BoolImage, lower: BoolImage
) -> FittedDimension:
    """Fit two parallel planes z = a + b x + c y + h upper; the value is h.

    ISO 5436-1 type A1 with planes in the place of lines: the caller leaves out the edges.

    Parameters
    ----------
    xy_mm, z_mm : (n, 2), (n,) float
    upper, lower : (n,) bool, points on the raised and on the lower plateau

    Raises
    ------
    FitError : fewer than five points on a plateau
    """
    for name, part in (("upper", upper), ("lower", lower)):
        if part.sum() < _LEAST_POINTS:
            raise FitError(f"step: {part.sum()} points on the {name} level, 5 needed")
    design = np.column_stack([upper.astype(np.float64), np.ones(len(z_mm)), xy_mm])
    return _parameters(design, z_mm, (upper, lower))[0]


def fit_linear(design: FloatArray, z_mm: FloatArray) -> FittedDimension:
    """Fit heights z = design p without outliers; the value is the first parameter of p.

    Parameters
    ----------
    design : (n, k) float, change of each height by each parameter
    z_mm : (n,) float, heights

    Raises
    ------
    FitError : fewer than five points, or fewer than parameters
    """
    least = max(_LEAST_POINTS, design.shape[1])
    if len(z_mm) < least:
        raise FitError(f"{len(z_mm)} points, {least} needed")
    return _parameters(design, z_mm, (np.ones(len(z_mm), bool),))[0]


def wave_depth(s_mm: FloatArray, z_mm: FloatArray, pitch_mm: float) -> FittedDimension:
    """Fit a + b s and a sine of known pitch; the value is its depth from crest to root.

    Parameters
    ----------
    s_mm, z_mm : (n,) float, place across the grooves and height

    Raises
    ------
    FitError : too few points, or less than one pitch of them
    """
    if len(s_mm) < _LEAST_IN_FIT or np.ptp(s_mm) < pitch_mm:
        raise FitError(f"grooves: {len(s_mm)} points, 20 over at least one pitch needed")
    angle = 2 * np.pi * s_mm / pitch_mm
    design = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(s_mm)), s_mm])
    parts = _parameters(design, z_mm, (np.ones(len(z_mm), bool),), count=2)
    size = float(np.hypot(parts[0].value, parts[1].value))
    slope = sum(one.value / max(size, 1e-12) * one.slope for one in parts)
    towards = np.array([2 * one.value / max(size, 1e-12) for one in parts] + [0.0, 0.0])
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
    """A V groove: its depth, its width at the face, and the place of its root."""

    depth: FittedDimension
    width: FittedDimension
    root_mm: float


def v_groove(s_mm: FloatArray, z_mm: FloatArray, depth_mm: float, width_mm: float) -> GrooveFit:
    """Fit z = a + b s - depth max(0, 1 - 2 |s - root| / width): a face and two straight flanks.

    Parameters
    ----------
    s_mm, z_mm : (n,) float
    depth_mm, width_mm : about how deep and wide the groove is; within a factor of two

    Raises
    ------
    FitError : too few points, or the fit does not converge
    """
    if len(s_mm) < _LEAST_IN_FIT:
        raise FitError(f"groove: {len(s_mm)} points, 20 needed")
    middle = float(np.median(s_mm[z_mm <= np.quantile(z_mm, 0.05)]))
    start = np.array([float(np.quantile(z_mm, 0.9)), 0.0, depth_mm, width_mm, middle])
    scale = np.array([depth_mm, depth_mm / width_mm, depth_mm, width_mm, width_mm])

    def residual(found: FloatArray) -> FloatArray:
        a, b, depth, width, root = found
        fall = np.maximum(0.0, 1.0 - 2.0 * np.abs(s_mm - root) / width)
        return np.asarray(a + b * s_mm - depth * fall - z_mm)

    found = least_squares(residual, start, x_scale=scale, loss="soft_l1", f_scale=0.05 * depth_mm)
    found = least_squares(residual, found.x, x_scale=scale)
    if not found.success or min(found.x[2:4]) <= 0:
        raise FitError(f"groove: the fit does not converge ({found.message})")
    back = np.linalg.pinv(found.jac)
    used = np.ones(len(z_mm), bool)
    depth, width = (
        FittedDimension(
            float(found.x[n]), np.asarray(back[n]), -found.fun, used, found.jac, np.eye(5)[n]
        )
        for n in (2, 3)
    )
    return GrooveFit(depth, width, float(found.x[4]))


def ball_radius(points_mm: FloatArray) -> tuple[FittedDimension, BallFit]:
    """Fit a ball without outliers; the value is its radius.

    Raises
    ------
    FitError : too few or coplanar points
    """
    fit = fit_ball(points_mm)
    kept = points_mm[fit.kept]
    normals = kept - fit.centre_mm
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    design = np.column_stack([np.ones(len(kept)), normals])
    return _radius(fit.radius_mm, design, normals[:, 2], fit.kept, fit.residuals_mm), fit


def ball_radius_of_all(points_mm: FloatArray) -> FittedDimension:
    """Fit a ball to all points by least squares; the value is its radius.

    Raises
    ------
    FitError : too few or coplanar points
    """
    fit = fit_sphere(points_mm)
    normals = points_mm - fit.centre_mm
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    design = np.column_stack([np.ones(len(normals)), normals])
    kept = np.ones(len(normals), bool)
    return _radius(fit.radius_mm, design, normals[:, 2], kept, fit.residuals_mm)


def cylinder_radius(points_mm: FloatArray, axis: FloatArray) -> tuple[FittedDimension, CylinderFit]:
    """Fit a cylinder without outliers, its axis within some 20 degrees of `axis` (xyz).

    Raises
    ------
    FitError : too few points, or the fit does not converge
    """
    fit = fit_cylinder(points_mm, axis)
    kept = points_mm[fit.kept] - fit.point_mm
    along = kept @ fit.axis
    normals = kept - np.outer(along, fit.axis)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    across = np.linalg.svd(fit.axis[None])[2][1:]
    sides = normals @ across.T
    design = np.column_stack([np.ones(len(kept)), sides, sides * along[:, None]])
    return _radius(fit.radius_mm, design, normals[:, 2], fit.kept, fit.residuals_mm), fit


def _radius(
    radius_mm: float, design: FloatArray, upward: FloatArray, kept: BoolImage, residuals: FloatArray
) -> FittedDimension:
    """Return a radius whose points' errors along z count by their share along the normal."""
    slope, all_residuals = np.zeros(len(kept)), np.zeros(len(kept))
    slope[kept] = np.linalg.pinv(design)[0] * upward
    all_residuals[kept] = residuals
    heights = np.zeros((len(kept), design.shape[1]))
    heights[kept] = design / upward[:, None]
    first = np.eye(design.shape[1])[0]
    return FittedDimension(radius_mm, slope, all_residuals, kept, heights, first)


def _parameters(
    design: FloatArray, z_mm: FloatArray, groups: tuple[BoolImage, ...], count: int = 1
) -> list[FittedDimension]:
    """Fit by least squares, repeated without outliers; return the first `count` parameters.

    An outlier is one among its own group: a small level must not be one beside a large one.
    """

    def good(residuals: FloatArray) -> BoolImage:
        good = np.zeros(len(z_mm), bool)
        for group in groups:
            left = residuals[group]
            good[group] = inliers(left) | (np.abs(left - np.median(left)) <= _NEVER_OUT_MM)
        return good

    fit = fit_heights(design, z_mm, good, first=np.any(groups, axis=0))
    kept, residuals = fit.inliers, z_mm - design @ fit.shape
    slopes = np.zeros((design.shape[1], len(z_mm)))
    slopes[:, kept] = np.linalg.pinv(design[kept])
    used, unit = design * kept[:, None], np.eye(design.shape[1])
    return [
        FittedDimension(float(fit.shape[k]), slopes[k], residuals, kept, used, unit[k])
        for k in range(count)
    ]
