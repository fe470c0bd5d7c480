import numpy as np
import pytest
from scipy.optimize import least_squares

from reconstruction.errors import FitError
from reconstruction.evaluate.fit import (
    fit_plane,
    fit_sphere,
    fit_sphere_algebraic,
    median,
    quantile,
    residual_stats,
)


def cap(count, half_angle_deg, seed=0):
    """Return unit vectors spread evenly over a cap around +z."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(np.cos(np.radians(half_angle_deg)), 1.0, count)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, count)
    s = np.sqrt(1.0 - z**2)
    return np.column_stack([s * np.cos(azimuth), s * np.sin(azimuth), z])


@pytest.mark.parametrize("half_angle_deg", [10.0, 40.0, 180.0])
@pytest.mark.parametrize("offset_mm", [0.0, 1e4])
def test_exact_points_give_the_exact_sphere(half_angle_deg, offset_mm):
    centre = np.array([1.0, -2.0, -3.0]) + offset_mm
    fit = fit_sphere(centre + 4.0 * cap(500, half_angle_deg))
    assert fit.radius_mm == pytest.approx(4.0, abs=1e-7)
    np.testing.assert_allclose(fit.centre_mm, centre, atol=1e-7)
    assert fit.stats.rmse_mm < 1e-9


def test_radial_noise_averages_out():
    """Expected: 10 um noise on 20,000 points of a 50 degree cap moves the radius < 1 um."""
    rng = np.random.default_rng(4)
    radius = 4.0 + rng.normal(0.0, 0.01, (20000, 1))
    fit = fit_sphere(radius * cap(20000, 50.0))
    assert fit.radius_mm == pytest.approx(4.0, abs=1e-3)
    assert fit.stats.rmse_mm == pytest.approx(0.01, rel=0.02)
    assert fit.stats.mae_mm == pytest.approx(0.01 * np.sqrt(2.0 / np.pi), rel=0.02)
    assert fit.stats.p95_mm == pytest.approx(0.01 * 1.95996, rel=0.02)


def by_levenberg_marquardt(points):
    """Centre and radius by another way: MINPACK from the middle of the points, no derivatives."""

    def radial(sphere):
        return np.linalg.norm(points - sphere[:3], axis=1) - sphere[3]

    middle = points.mean(axis=0) - [0.0, 0.0, 1.0]
    start = np.append(middle, np.linalg.norm(points - middle, axis=1).mean())
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "max_nfev": 4000}
    return least_squares(radial, start, method="lm", **tight).x


@pytest.mark.parametrize("half_angle_deg", [25.0, 50.0, 120.0, 180.0])
@pytest.mark.parametrize("noise_mm", [0.001, 0.02, 0.2])
def test_the_sphere_is_the_one_with_the_least_radial_distances(half_angle_deg, noise_mm):
    """Setup: a cap with noise and a wave of its size, as a pressed face has.

    Expected: the sphere of another solver, to where that one stops (the sum of squares is flat
    there); the next Gauss-Newton step would move it by less than 1e-9 mm.
    """
    rng, directions = np.random.default_rng(6), cap(3000, half_angle_deg)
    wave = noise_mm * np.cos(9.0 * directions[:, :1])
    points = (4.0 + wave + rng.normal(0.0, noise_mm, (3000, 1))) * directions
    fit, reference = fit_sphere(points), by_levenberg_marquardt(points)
    assert np.abs(np.append(fit.centre_mm, fit.radius_mm) - reference).max() < 1e-6
    normals = (points - fit.centre_mm) / np.linalg.norm(
        points - fit.centre_mm, axis=1, keepdims=True
    )
    slopes = np.column_stack([normals, np.ones(len(points))])
    left_mm = np.linalg.solve(slopes.T @ slopes, slopes.T @ fit.residuals_mm)
    assert np.abs(left_mm).max() < 1e-9


def test_residuals_are_positive_outside():
    points = 4.0 * cap(200, 180.0)
    points[0] *= 1.01
    assert fit_sphere(points).residuals_mm[0] > 0.03


def test_statistics_are_those_of_the_paper():
    stats = residual_stats([3.0, -4.0, 0.0, 0.0])
    assert stats.rmse_mm == 2.5
    assert stats.mae_mm == 1.75
    assert stats.p95_mm == pytest.approx(3.85)


def test_plane():
    rng = np.random.default_rng(6)
    xy = rng.uniform(-5.0, 5.0, (300, 2))
    points = np.column_stack([xy, 1.0 + 0.5 * xy[:, 0]])
    fit = fit_plane(points)
    np.testing.assert_allclose(fit.normal, np.array([-0.5, 0.0, 1.0]) / np.sqrt(1.25), atol=1e-12)
    assert fit.stats.rmse_mm < 1e-12
    lifted = fit_plane(points + [[0.0, 0.0, 0.1 * (i == 0)] for i in range(300)])
    assert lifted.residuals_mm[0] > 0.05


@pytest.mark.parametrize(
    ("fit", "points", "message"),
    [
        (fit_sphere, np.zeros((3, 3)), "at least 4"),
        (fit_sphere, np.zeros((9, 3)), "one plane"),
        (fit_sphere, np.eye(3)[[0, 1, 2, 0, 1]], "one plane"),
        (fit_sphere, np.zeros((9, 2)), "shape"),
        (fit_sphere, np.full((9, 3), np.nan), "NaN"),
        (fit_plane, np.zeros((2, 3)), "at least 3"),
        (fit_plane, np.outer(np.arange(5.0), [1.0, 2.0, 3.0]), "one line"),
        (fit_plane, np.full((9, 3), np.inf), "infinity"),
    ],
)
def test_undetermined_shapes_are_rejected(fit, points, message):
    with pytest.raises(FitError, match=message):
        fit(points)


def test_no_residuals_are_rejected():
    with pytest.raises(FitError, match="no valid point"):
        residual_stats([])


def plan_cap(count, radius_mm, region_mm, noise_mm, seed=0):
    """Return points of a sphere spread evenly over the plan of a region, with radial noise."""
    rng = np.random.default_rng(seed)
    r = region_mm * np.sqrt(rng.uniform(0.0, 1.0, count))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, count)
    z = np.sqrt(radius_mm**2 - r**2)
    points = np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), z])
    return points * (1.0 + rng.normal(0.0, noise_mm, (count, 1)) / radius_mm)


@pytest.mark.parametrize("half_angle_deg", [10.0, 40.0, 180.0])
def test_exact_points_give_the_exact_sphere_algebraically_too(half_angle_deg):
    centre = np.array([1.0, -2.0, 3.0])
    fit = fit_sphere_algebraic(centre + 4.0 * cap(500, half_angle_deg))
    assert fit.radius_mm == pytest.approx(4.0, abs=1e-7)
    np.testing.assert_allclose(fit.centre_mm, centre, atol=1e-7)


@pytest.mark.parametrize("region_mm", [1.0, 1.2, 1.5, 2.5])
def test_noise_shrinks_the_algebraic_sphere_as_its_cap_says(region_mm):
    """r^2 regressed on z: noise in z attenuates the slope by 1 + sigma^2 / (S^2 / 12).

    Expected: R / (1 + 12 sigma^2 / S^2), but for a share S / R of the shift (noise is radial, and
    the sphere no paraboloid); the geometric fit does not shrink.
    """
    points = plan_cap(200_000, 4.0, region_mm, 0.013)
    sagitta_mm = 4.0 - np.sqrt(16.0 - region_mm**2)
    expected_mm = 4.0 / (1.0 + 12.0 * (0.013 / sagitta_mm) ** 2)
    radius_mm = fit_sphere_algebraic(points).radius_mm
    assert radius_mm - 4.0 == pytest.approx(expected_mm - 4.0, rel=0.03 + sagitta_mm / 4.0)
    assert fit_sphere(points).radius_mm == pytest.approx(4.0, abs=0.012)


def test_both_fits_refuse_the_same_points():
    with pytest.raises(FitError, match="one plane"):
        fit_sphere_algebraic(np.zeros((9, 3)))


@pytest.mark.parametrize(("seed", "count"), [(1, 6), (2, 8), (12, 7)])
def test_points_that_hardly_fix_a_sphere_have_a_least_one_too(seed, count):
    """Setup: a few scattered points, on which Gauss-Newton steps do not shrink.

    Expected: the sum of squares does not change to first order: the residuals sum to 0, and
    so do their components along the normals.
    """
    rng = np.random.default_rng(seed)
    assert rng.integers(5, 9) == count
    points = rng.normal(size=(count, 3)) * [1.0, 1.0, 0.3]
    fit = fit_sphere(points)
    away = points - fit.centre_mm
    normals = away / np.linalg.norm(away, axis=1, keepdims=True)
    assert abs(fit.residuals_mm.sum()) < 1e-7
    assert np.abs(fit.residuals_mm @ normals).max() < 1e-7
    assert fit.stats.rmse_mm > 0.05


@pytest.mark.parametrize("count", [1, 2, 3, 10, 999, 1000])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_quantiles_are_those_of_numpy(count: int, dtype: type) -> None:
    values = np.random.default_rng(count).normal(size=count).astype(dtype)
    original = values.copy()
    for share in (0.0, 0.05, 0.5, 0.95, 1.0):
        exact = np.quantile(values.astype(np.float64), share)
        assert quantile(values, share) == pytest.approx(exact, rel=1e-12)
    assert median(values) == pytest.approx(np.median(values.astype(np.float64)), rel=1e-12)
    assert np.array_equal(values, original)
