"""Least-squares spheres, planes and cylinders, residual statistics, and outliers; lengths mm."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from reconstruction.arrays import BoolImage, FloatArray
from reconstruction.errors import FitError

# Singular value ratio below which points count as coplanar (collinear): rounding only.
DEGENERATE_RATIO = 1e-10
# 1.4826 MAD estimates the standard deviation of a normal distribution.
MAD_TO_SIGMA = 1.4826
# A Gauss-Newton step is a hundredth of the one before it on points that fix a sphere well.
_MOST_STEPS, _STEP_OF_ROUNDING = 30, 1e-13
REJECT_BEYOND_SIGMAS = 4.0
"""One of 16,000 normal residuals lies beyond."""


@dataclass(frozen=True)
class ResidualStats:
    """RMSE, MAE and 95th percentile of the absolute residuals, as the paper defines them."""

    rmse_mm: float
    mae_mm: float
    p95_mm: float


@dataclass(frozen=True, eq=False)
class SphereFit:
    """Least-squares sphere; residuals_mm (n,) are radial distances, positive outside."""

    centre_mm: FloatArray
    radius_mm: float
    residuals_mm: FloatArray

    @property
    def stats(self) -> ResidualStats:
        """Statistics of the radial residuals."""
        return residual_stats(self.residuals_mm)


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """Least-squares plane; unit normal with z >= 0; residuals_mm (n,) positive along it."""

    centroid_mm: FloatArray
    normal: FloatArray
    residuals_mm: FloatArray

    @property
    def stats(self) -> ResidualStats:
        """Statistics of the distances from the plane."""
        return residual_stats(self.residuals_mm)


def residual_stats(residuals_mm: ArrayLike) -> ResidualStats:
    """Return the statistics of signed residuals, (n,) mm.

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


def rms(values: FloatArray) -> float:
    """Return the root mean square of at least one value."""
    return float(np.sqrt(np.mean(values**2)))


def p95_of_size(values: FloatArray) -> float:
    """Return the 95th percentile of the values' sizes."""
    return float(np.percentile(np.abs(values), 95.0))


def fit_sphere(points_mm: ArrayLike) -> SphereFit:
    """Fit the sphere with the least sum of squared radial distances.

    Parameters
    ----------
    points_mm : (n, 3) float, n >= 4, not coplanar

    Raises
    ------
    FitError : too few, coplanar or non-finite points
    """
    return fit_sphere_both_ways(points_mm)[0]


def fit_sphere_algebraic(points_mm: ArrayLike) -> SphereFit:
    """Fit the sphere with the least sum of squared differences of squared distances.

    Linear, so it is what short programs use; but noise pulls it towards smaller spheres (Kasa, IEEE
    Transactions on Instrumentation and Measurement 25, 8-14, 1976). On a cap the radius shrinks to
    R / (1 + 12 sigma^2 / S^2) for points spread evenly over the plan, with their noise sigma and
    the cap's height S, both small beside R.

    Parameters
    ----------
    points_mm : (n, 3) float, n >= 4, not coplanar

    Raises
    ------
    FitError : too few, coplanar or non-finite points
    """
    points = _checked(points_mm, 4, "sphere")
    local, offset, scale = _centred(points)
    return _sphere_of(_algebraic_sphere(local), points, offset, scale)


def fit_sphere_both_ways(points_mm: ArrayLike) -> tuple[SphereFit, SphereFit]:
    """Return `fit_sphere` and `fit_sphere_algebraic` of the same points, (n, 3) float.

    The second is the start of the first.

    Raises
    ------
    FitError : too few, coplanar or non-finite points
    """
    points = _checked(points_mm, 4, "sphere")
    # Centred and scaled: the algebraic start and the iteration then see numbers near one.
    local, offset, scale = _centred(points)
    start = _algebraic_sphere(local)
    found = _gauss_newton(local, start)
    if found is None:
        found = least_squares(
            _radial, start, _radial_jacobian, args=(local,), method="lm", xtol=1e-14, ftol=1e-14,
            gtol=1e-14,
        ).x  # fmt: skip
    return _sphere_of(found, points, offset, scale), _sphere_of(start, points, offset, scale)


def _gauss_newton(local: FloatArray, start: FloatArray) -> FloatArray | None:
    """Return the sphere (centre, radius) with the least radial distances, from the algebraic one.

    None where steps do not shrink to rounding: of points that hardly fix a sphere.
    """
    axes, found, before = np.ascontiguousarray(local.T), start, np.inf
    for _ in range(_MOST_STEPS):
        toward = found[:3, None] - axes
        distance = np.sqrt(np.einsum("ij,ij->j", toward, toward))
        # A point at the centre has no direction.
        if not distance.all():
            return None
        slopes = np.vstack([toward / distance, np.full_like(distance, -1.0)])
        normal, downhill = slopes @ slopes.T, slopes @ (found[3] - distance)
        step = np.linalg.solve(normal, downhill)
        found, size = found + step, float(np.abs(step).max())
        if size <= _STEP_OF_ROUNDING * max(1.0, float(np.abs(found).max())):
            return found
        if size > before:
            return None
        before = size
    return None


def _sphere_of(
    found: FloatArray, points: FloatArray, offset: FloatArray, scale: float
) -> SphereFit:
    """Return the sphere (centre, radius) found in centred and scaled coordinates, in mm."""
    centre, radius = found[:3] * scale + offset, abs(float(found[3])) * scale
    return SphereFit(centre, radius, np.linalg.norm(points - centre, axis=1) - radius)


def _centred(points: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return points about their mean in units of their spread, the mean, and that spread."""
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
    FitError : too few, collinear or non-finite points
    """
    points = _checked(points_mm, 3, "plane")
    centroid = points.mean(axis=0)
    _, singular, axes = np.linalg.svd(points - centroid, full_matrices=False)
    if singular[1] <= DEGENERATE_RATIO * singular[0]:
        raise FitError(
            f"the {len(points)} points lie on one line; a plane needs a second direction"
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
    """Return centre and radius from the linear system |p|^2 = 2 c p + k."""
    system = np.column_stack([2.0 * local, np.ones(len(local))])
    solution, _, _, singular = np.linalg.lstsq(system, np.sum(local**2, axis=1))
    if singular[-1] <= DEGENERATE_RATIO * singular[0]:
        raise FitError(f"the {len(local)} points lie in one plane; a sphere needs curvature")
    centre = solution[:3]
    return np.append(centre, np.sqrt(max(solution[3] + centre @ centre, 0.0)))


def _radial(parameters: FloatArray, local: FloatArray) -> FloatArray:
    distance: FloatArray = np.linalg.norm(local - parameters[:3], axis=1) - parameters[3]
    return distance


def _radial_jacobian(parameters: FloatArray, local: FloatArray) -> FloatArray:
    toward = parameters[:3] - local
    # A point at the centre has no direction; any finite value serves for that one row.
    distance = np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-300)
    return np.column_stack([toward / distance, -np.ones(len(local))])


def spread(values: FloatArray) -> float:
    """Robust standard deviation of values, (n,)."""
    return float(MAD_TO_SIGMA * np.median(np.abs(values - np.median(values))))


def inliers(residuals_mm: FloatArray) -> BoolImage:
    """Tell which residuals, (n,) mm, lie within four robust standard deviations of their median."""
    limit = REJECT_BEYOND_SIGMAS * max(spread(residuals_mm), 1e-12)
    kept: BoolImage = np.abs(residuals_mm - np.median(residuals_mm)) <= limit
    return kept


_MOST_TURNS = 20
# The first scale comes from a fit that outliers have pulled off: it is taken anew once.
_SOFT_TURNS = 2
_LEAST_POINTS = 20


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

    centre_mm: FloatArray
    radius_mm: float
    radius_sigma_mm: float
    residuals_mm: FloatArray
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
    kept = inliers(_from_centre(parameters, points))
    for _ in range(_MOST_TURNS):
        fine = fit_sphere(points[kept])
        now = inliers(_from_centre(np.append(fine.centre_mm, fine.radius_mm), points))
        if np.array_equal(now, kept):
            break
        kept = now
    fine = fit_sphere(points[kept])
    sigma_mm = _radius_sigma_mm(points[kept], fine.centre_mm, fine.residuals_mm)
    return BallFit(fine.centre_mm, fine.radius_mm, sigma_mm, fine.residuals_mm, kept)


def _softly(points: FloatArray, start: FloatArray) -> FloatArray:
    """Return centre and radius with the least soft-L1 sum of radial distances."""
    parameters = start
    for _ in range(_SOFT_TURNS):
        scale_mm = max(spread(_from_centre(parameters, points)), 1e-9)
        found = least_squares(
            _from_centre,
            parameters,
            args=(points,),
            loss="soft_l1",
            f_scale=scale_mm,
            x_scale="jac",
        )
        parameters = np.asarray(found.x)
    return parameters


def _radius_sigma_mm(points: FloatArray, centre_mm: FloatArray, residuals_mm: FloatArray) -> float:
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


def _from_centre(parameters: FloatArray, points: FloatArray) -> FloatArray:
    distance: FloatArray = np.linalg.norm(points - parameters[:3], axis=1) - parameters[3]
    return distance


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

    point_mm: FloatArray
    axis: FloatArray
    radius_mm: float
    residuals_mm: FloatArray
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
    kept = inliers(_from_axis(rough, local))
    fine = _solve(local[kept], rough, "linear", 1.0)
    direction, foot = _axis_of(fine)
    return CylinderFit(
        point_mm=centroid + foot @ frame,
        axis=_upright(direction @ frame),
        radius_mm=float(abs(fine[4])),
        residuals_mm=_from_axis(fine, local[kept]),
        kept=kept,
    )


def _frame(axis: FloatArray) -> FloatArray:
    """Rows: axis and two directions across it."""
    axis = axis / np.linalg.norm(axis)
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    return np.stack([axis, across, np.cross(axis, across)])


def _start(local: FloatArray) -> FloatArray:
    """Start from a circle across the axis: y^2 + z^2 = 2 a y + 2 b z + c, linear (Kasa 1976)."""
    y, z = local[:, 1], local[:, 2]
    design = np.column_stack([2.0 * y, 2.0 * z, np.ones_like(y)])
    (a, b, c), *_ = np.linalg.lstsq(design, y * y + z * z, rcond=None)
    return np.array([a, b, 0.0, 0.0, np.sqrt(c + a * a + b * b)])


def _solve(local: FloatArray, start: FloatArray, loss: str, scale_mm: float) -> FloatArray:
    found = least_squares(_from_axis, start, args=(local,), loss=loss, f_scale=scale_mm)
    if not found.success:
        raise FitError(f"the cylinder fit does not converge ({found.message})")
    return np.asarray(found.x)


def _axis_of(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Direction, and the axis' point nearest to the origin, in the local frame."""
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


def _upright(axis: FloatArray) -> FloatArray:
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))
