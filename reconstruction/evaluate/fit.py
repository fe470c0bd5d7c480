"""Fit spheres and planes by least squares, with residual statistics and outliers; lengths in mm."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError

# Ratio of singular values below which points count as coplanar or collinear; rounding errors only.
DEGENERATE_RATIO = 1e-10
# 1.4826 MAD estimates the standard deviation of a normal distribution.
MAD_TO_SIGMA = 1.4826
# A Gauss-Newton step is about 0.01 x the previous step if the points determine a sphere well.
_MOST_STEPS, _STEP_OF_ROUNDING = 30, 1e-13
REJECT_BEYOND_SIGMAS = 4.0
"""Residuals beyond this many standard deviations are outliers; one of 16,000 normally distributed
residuals is."""

Shape = TypeVar("Shape")


@dataclass(frozen=True)
class ResidualStats:
    """RMS, mean and 95th percentile of the absolute residuals, mm, as the paper defines them."""

    rmse_mm: float
    mae_mm: float
    p95_mm: float


@dataclass(frozen=True, eq=False)
class SphereFit:
    """Sphere fitted to points by least squares.

    centre_mm is (xyz). residuals_mm (n,) are the radial distances of the points, positive outside.
    """

    centre_mm: FloatArray
    radius_mm: float
    residuals_mm: FloatArray

    @property
    def stats(self) -> ResidualStats:
        """Statistics of the radial distances of the points from the sphere."""
        return residual_stats(self.residuals_mm)


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """Plane fitted to points by least squares.

    centroid_mm is the mean of the points (xyz). normal is the unit normal (xyz) with z >= 0.
    residuals_mm (n,) are the distances of the points, positive along the normal.
    """

    centroid_mm: FloatArray
    normal: FloatArray
    residuals_mm: FloatArray

    @property
    def stats(self) -> ResidualStats:
        """Statistics of the distances of the points from the plane."""
        return residual_stats(self.residuals_mm)


def residual_stats(residuals_mm: ArrayLike) -> ResidualStats:
    """Return RMSE, MAE and 95th percentile of signed residuals, (n,) mm.

    Raises
    ------
    FitError : there are no residuals
    """
    values_mm = np.asarray(residuals_mm, dtype=np.float64)
    if values_mm.size == 0:
        raise FitError("no residuals to evaluate: the fit region holds no valid point")
    return ResidualStats(
        rmse_mm=rms(values_mm),
        mae_mm=float(np.mean(np.abs(values_mm))),
        p95_mm=p95_of_size(values_mm),
    )


def mean(values: NDArray[np.floating]) -> float:
    """Return the mean of at least one value, summed in double precision."""
    return float(np.mean(values, dtype=np.float64))


def rms(values: NDArray[np.floating]) -> float:
    """Return the root mean square of at least one value, summed in double precision."""
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def p95_of_size(values: NDArray[np.floating]) -> float:
    """Return the 95th percentile of the absolute values."""
    return quantile(np.abs(values), 0.95)


def median(values: NDArray[np.floating]) -> float:
    """Return the median of values (n,), all finite."""
    return quantile(values, 0.5)


def quantile(values: NDArray[np.floating], share: float) -> float:
    """Return the quantile of finite values (n,) at a share between 0 and 1.

    The quantile is interpolated linearly between two values. It is found by a partition at one
    index. The median and percentile of numpy partition the values at three indices, which takes
    several times as long.
    """
    at = share * (len(values) - 1)
    low = int(at)
    parted = np.partition(values, low)
    value = float(parted[low])
    if at > low:
        value += (at - low) * (float(parted[low + 1 :].min()) - value)
    return value


def fit_sphere(points_mm: ArrayLike) -> SphereFit:
    """Fit the sphere with the least sum of squared radial distances.

    Parameters
    ----------
    points_mm : (n, 3) float, n >= 4, not coplanar

    Raises
    ------
    FitError : points are too few, coplanar or not finite
    """
    return fit_sphere_both_ways(points_mm)[0]


def fit_sphere_algebraic(points_mm: ArrayLike) -> SphereFit:
    """Fit the sphere with the least sum of squares of (squared distance from its centre - R^2).

    This fit is linear, and therefore common in short programs; but noise biases it towards smaller
    spheres (Kasa, IEEE Transactions on Instrumentation and Measurement 25, 8-14, 1976). On a
    spherical cap the radius decreases from R to R / (1 + 12 sigma^2 / S^2). Here sigma is the noise
    of the points and S the height of the cap, both much less than R. The formula is for points
    distributed evenly over the cap's projection.

    Parameters
    ----------
    points_mm : (n, 3) float, n >= 4, not coplanar

    Raises
    ------
    FitError : points are too few, coplanar or not finite
    """
    points = _checked(points_mm, 4, "sphere")
    local, offset, scale = _centred(points)
    return _sphere_of(_algebraic_sphere(local), points, offset, scale)


def fit_sphere_both_ways(points_mm: ArrayLike) -> tuple[SphereFit, SphereFit]:
    """Return the results of `fit_sphere` and `fit_sphere_algebraic` for points, (n, 3) float.

    The algebraic fit is the start of the iteration of `fit_sphere`, so that it needs no extra time.

    Raises
    ------
    FitError : points are too few, coplanar or not finite
    """
    points = _checked(points_mm, 4, "sphere")
    # Centred and scaled: the algebraic start and the iteration then work with numbers near one.
    local, offset, scale = _centred(points)
    start = _algebraic_sphere(local)
    solution = _gauss_newton(local, start)
    if solution is None:
        solution = least_squares(
            radial_mm, start, radial_jacobian, args=(local,), method="lm", xtol=1e-14, ftol=1e-14,
            gtol=1e-14,
        ).x  # fmt: skip
    return _sphere_of(solution, points, offset, scale), _sphere_of(start, points, offset, scale)


def _gauss_newton(local: FloatArray, start: FloatArray) -> FloatArray | None:
    """Return the sphere (4,) of centre and radius with the least squared radial distances.

    None if the steps do not decrease to rounding errors, as for points that hardly determine a
    sphere.

    Parameters
    ----------
    local : (n, 3) centred and scaled points
    start : (4,) the algebraic sphere
    """
    axes, sphere, before = np.ascontiguousarray(local.T), start, np.inf
    for _ in range(_MOST_STEPS):
        toward = sphere[:3, None] - axes
        distance = np.sqrt(np.einsum("ij,ij->j", toward, toward))
        # A point at the centre has no direction.
        if not distance.all():
            return None
        slopes = np.vstack([toward / distance, np.full_like(distance, -1.0)])
        normal, downhill = slopes @ slopes.T, slopes @ (sphere[3] - distance)
        try:
            step = np.linalg.solve(normal, downhill)
        except np.linalg.LinAlgError:
            return None
        sphere, size = sphere + step, float(np.abs(step).max())
        if size <= _STEP_OF_ROUNDING * max(1.0, float(np.abs(sphere).max())):
            return sphere
        if size > before:
            return None
        before = size
    return None


def _sphere_of(
    sphere: FloatArray, points: FloatArray, offset: FloatArray, scale: float
) -> SphereFit:
    """Return the sphere in mm from a solution (4,) in centred and scaled coordinates."""
    centre, radius = sphere[:3] * scale + offset, abs(float(sphere[3])) * scale
    return SphereFit(centre, radius, np.linalg.norm(points - centre, axis=1) - radius)


def _centred(points: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return centred and scaled points, their mean (xyz), mm, and the scale, mm.

    The scale is the RMS distance of the points from their mean.
    """
    offset = points.mean(axis=0)
    scale = float(np.sqrt(np.mean(np.sum((points - offset) ** 2, axis=1)))) or 1.0
    return (points - offset) / scale, offset, scale


def fit_plane(points_mm: ArrayLike) -> PlaneFit:
    """Fit the plane with the least sum of squared orthogonal distances.

    Parameters
    ----------
    points_mm : (n, 3) float, n >= 3, not collinear

    Raises
    ------
    FitError : points are too few, collinear or not finite
    """
    points = _checked(points_mm, 3, "plane")
    centroid = points.mean(axis=0)
    _, singular, axes = np.linalg.svd(points - centroid, full_matrices=False)
    if singular[1] <= DEGENERATE_RATIO * singular[0]:
        raise FitError(
            f"the {len(points)} points are on one line; a plane needs a second direction"
        )
    normal = axes[2] if axes[2, 2] >= 0.0 else -axes[2]
    return PlaneFit(centroid, normal, (points - centroid) @ normal)


def _checked(points_mm: ArrayLike, least: int, shape: str) -> FloatArray:
    points = np.asarray(points_mm, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise FitError(f"points for the {shape} have shape {points.shape}; give (n, 3)")
    if len(points) < least:
        raise FitError(f"{len(points)} points do not fix a {shape}; give at least {least}")
    if not bool(np.all(np.isfinite(points))):
        raise FitError(f"points for the {shape} hold NaN or infinity; pass valid points only")
    return points


def _algebraic_sphere(local: FloatArray) -> FloatArray:
    """Return centre c and radius, (4,), from the linear system |p|^2 = 2 c p + k for points p."""
    system = np.column_stack([2.0 * local, np.ones(len(local))])
    solution, _, _, singular = np.linalg.lstsq(system, np.sum(local**2, axis=1))
    if singular[-1] <= DEGENERATE_RATIO * singular[0]:
        raise FitError(f"the {len(local)} points are in one plane; a sphere needs curvature")
    centre = solution[:3]
    return np.append(centre, np.sqrt(max(solution[3] + centre @ centre, 0.0)))


def radial_mm(sphere: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Return the radial distances (n,) of points (n, 3) from a sphere (4,), positive outside.

    The elements of `sphere` are the centre (xyz) and the radius.
    """
    toward = sphere[:3] - points_mm
    distance: FloatArray = np.sqrt(np.einsum("ij,ij->i", toward, toward)) - sphere[3]
    return distance


def radial_jacobian(sphere: FloatArray, points_mm: FloatArray) -> FloatArray:
    """Return the derivatives (n, 4) of `radial_mm` by centre (xyz) and radius."""
    toward = sphere[:3] - points_mm
    # A point at the centre has no direction; its row may have any finite value.
    distance = np.maximum(np.sqrt(np.einsum("ij,ij->i", toward, toward)), 1e-300)
    return np.column_stack([toward / distance[:, None], -np.ones(len(points_mm))])


def spread(values: NDArray[np.floating]) -> float:
    """Return the robust standard deviation of values (n,): 1.4826 x median absolute deviation."""
    away = values - median(values)
    return MAD_TO_SIGMA * median(np.abs(away, out=away))


def inliers(residuals_mm: FloatArray) -> BoolImage:
    """Return True, (n,), for residuals within four robust standard deviations of their median."""
    limit = REJECT_BEYOND_SIGMAS * max(spread(residuals_mm), 1e-12)
    is_inlier: BoolImage = np.abs(residuals_mm - median(residuals_mm)) <= limit
    return is_inlier


@dataclass(frozen=True, eq=False)
class InlierFit(Generic[Shape]):
    """Result of `fit_inliers`: a shape fitted to points, outliers excluded.

    Attributes
    ----------
    shape : result of the last fit
    fitted : (n,) bool, points used in the last fit
    inliers : (n,) bool, points that are no outliers of the last fit; equal to `fitted` unless the
        largest number of fits was reached
    """

    shape: Shape
    fitted: BoolImage
    inliers: BoolImage


def fit_inliers(
    fit: Callable[[BoolImage], Shape],
    residuals_mm: Callable[[Shape], FloatArray],
    first: BoolImage,
    judge: Callable[[FloatArray], BoolImage] = inliers,
    most_fits: int = 21,
) -> InlierFit[Shape]:
    """Repeat a fit without the outliers of the previous fit, until the used points do not change.

    Parameters
    ----------
    fit : function that returns the shape fitted to the points in a mask (n,) bool
    residuals_mm : function that returns the residuals (n,) of all points for a shape
    first : (n,) bool, points of the first fit
    judge : function that returns the points (n,) bool that are no outliers, for residuals (n,)
    most_fits : largest number of fits; the last fit is returned
    """
    used, good = first, first
    for _ in range(most_fits):
        used = good
        shape = fit(used)
        good = judge(residuals_mm(shape))
        if np.array_equal(good, used):
            break
    return InlierFit(shape, used, good)
