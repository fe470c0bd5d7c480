"""Dimensions of synthetic surfaces with known true values, with noise and outliers."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from reconstruction.errors import FitError
from reconstruction.evaluate import (
    areal_roughness,
    bar_width,
    break_width,
    fit_ball,
    fit_cylinder,
    flatness,
    slope_change_width,
    step_height,
)
from reconstruction.evaluate.fit import fit_sphere, radial_mm, spread
from reconstruction.evaluate.robust import _from_axis, _from_axis_jacobian, soft_sphere

NOISE_MM = 0.002


def with_outliers(values, rng, share=0.05, size=0.5):
    """Move a share of the values far up."""
    moved = values.copy()
    chosen = rng.random(values.shape[0]) < share
    moved[chosen] += size * (1 + rng.random(chosen.sum()))
    return moved


@pytest.mark.parametrize("outliers", [0.0, 0.05, 0.3])
@pytest.mark.parametrize("half_angle", [0.2, 1.0])
def test_the_soft_sphere_is_that_of_scipy(outliers, half_angle):
    """Expected: the least loss by scipy's trust region, to 1e-4 of the scale of the residuals."""
    rng = np.random.default_rng(5)
    slope, turn = half_angle * np.sqrt(rng.random(800)), rng.uniform(0, 2 * np.pi, 800)
    distance = 4.0 + with_outliers(rng.normal(0, NOISE_MM, 800), rng, outliers, 0.02)
    points = distance[:, None] * np.column_stack(
        [np.sin(slope) * np.cos(turn), np.sin(slope) * np.sin(turn), np.cos(slope)]
    )
    start = np.append(fit_sphere(points).centre_mm, fit_sphere(points).radius_mm)
    fitted, expected = soft_sphere(points, start), start
    tight = {"loss": "soft_l1", "xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "x_scale": "jac"}
    for _ in range(2):
        scale = spread(radial_mm(expected, points))
        expected = least_squares(radial_mm, expected, args=(points,), f_scale=scale, **tight).x
    left = radial_mm(fitted, points) - radial_mm(expected, points)
    assert np.abs(left).max() < 1e-4 * NOISE_MM


def test_flatness_of_a_tilted_noisy_plane():
    """5 % of outliers a hundred sigmas off: RMS within 3 % of the noise, tilt within 1e-4."""
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-5, 5, (2, 20_000))
    z = 0.1 * x - 0.05 * y + rng.normal(0, NOISE_MM, x.size)
    estimate = flatness(np.column_stack([x, y, with_outliers(z, rng)]))
    normal = np.array([-0.1, 0.05, 1.0]) / np.sqrt(1 + 0.01 + 0.0025)
    np.testing.assert_allclose(estimate.plane.normal, normal, atol=1e-4)
    assert estimate.rms_mm == pytest.approx(NOISE_MM / np.sqrt(1.0125), rel=0.03)
    assert estimate.peak_to_valley_mm < 10 * NOISE_MM
    assert estimate.inliers.mean() == pytest.approx(0.95, abs=0.01)


def test_flatness_of_a_saddle_is_its_height():
    x, y = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    estimate = flatness(np.column_stack([x.ravel(), y.ravel(), 0.01 * (x * y).ravel()]))
    assert estimate.peak_to_valley_mm == pytest.approx(0.02, rel=1e-6)


def cap(rng, count, radius_mm=4.0, half_angle_deg=40.0):
    """Points spread evenly over a cap of a ball round (1, -2, 3), (count, 3) mm, and normals."""
    z = rng.uniform(np.cos(np.deg2rad(half_angle_deg)), 1.0, count)
    phi, across = rng.uniform(0, 2 * np.pi, count), np.sqrt(1 - z**2)
    normals = np.column_stack([across * np.cos(phi), across * np.sin(phi), z])
    return np.array([1.0, -2.0, 3.0]) + radius_mm * normals, normals


def test_ball_of_exact_points():
    """Expected: to rounding; no point of exact data is excluded."""
    estimate = fit_ball(cap(np.random.default_rng(7), 500)[0])
    assert estimate.radius_mm == pytest.approx(4.0, abs=1e-9)
    np.testing.assert_allclose(estimate.centre_mm, [1.0, -2.0, 3.0], atol=1e-9)
    assert estimate.form_mm < 1e-9
    assert estimate.inliers.all()


def test_radius_of_noisy_balls_scatters_as_stated():
    """Setup: 60 caps of 1000 points with noise. Expected: errors over their stated standard
    uncertainty have mean 0 and RMS 1, each within four of its own standard errors.
    """
    rng = np.random.default_rng(8)
    ratios = []
    for _ in range(60):
        points, normals = cap(rng, 1000)
        estimate = fit_ball(points + rng.normal(0, NOISE_MM, (1000, 1)) * normals)
        ratios.append((estimate.radius_mm - 4.0) / estimate.radius_sigma_mm)
        assert estimate.stats.rmse_mm == pytest.approx(NOISE_MM, rel=0.15)
    assert abs(np.mean(ratios)) < 4 / np.sqrt(60)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=4 / np.sqrt(120))


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_ball_with_gross_outliers(share):
    """Setup: a share of the points 0.5 to 1 mm too high, all on one side of the surface.

    Expected: radius and centre within three of their standard uncertainties; least squares over
    all points, which the test must be able to fail with, misses by more than ten.
    """
    rng = np.random.default_rng(9)
    points, normals = cap(rng, 5000)
    points += rng.normal(0, NOISE_MM, (5000, 1)) * normals
    points[:, 2] = with_outliers(points[:, 2], rng, share)
    estimate = fit_ball(points)
    assert abs(estimate.radius_mm - 4.0) < 3 * estimate.radius_sigma_mm
    assert estimate.inliers.mean() == pytest.approx(1 - share, abs=0.02)
    assert abs(fit_sphere(points).radius_mm - 4.0) > 10 * estimate.radius_sigma_mm


def test_ball_needs_curvature_and_points():
    flat = np.column_stack([*np.random.default_rng(1).uniform(0, 1, (2, 50)), np.zeros(50)])
    with pytest.raises(FitError, match="one plane"):
        fit_ball(flat)
    with pytest.raises(FitError, match="points"):
        fit_ball(cap(np.random.default_rng(1), 4)[0])


@pytest.mark.parametrize("half_angle_deg", [20.0, 50.0])
def test_a_cap_of_a_ball_is_no_cylinder(half_angle_deg):
    points, _ = cap(np.random.default_rng(1), 2000, half_angle_deg=half_angle_deg)
    with pytest.raises(FitError, match="does not converge"):
        fit_cylinder(points, (1, 0, 0))


@pytest.mark.parametrize("radius_mm", [1.3, -1.3])
def test_derivatives_of_the_distance_from_a_cylinder_are_differences(radius_mm):
    points = np.random.default_rng(0).normal(size=(50, 3))
    parameters = np.array([0.3, -0.4, 0.2, -0.5, radius_mm])
    expected = [
        (_from_axis(parameters + step, points) - _from_axis(parameters - step, points)) / 2e-6
        for step in 1e-6 * np.eye(5)
    ]
    slopes = _from_axis_jacobian(parameters, points)
    np.testing.assert_allclose(slopes, np.transpose(expected), atol=1e-8)


def test_cylinder_seen_from_above():
    """The upper third of a rod of 2.405 mm radius, axis 8 degrees off the guess, outliers."""
    rng = np.random.default_rng(2)
    phi = rng.uniform(-np.pi / 3, np.pi / 3, 8000)
    along = rng.uniform(-4, 4, phi.size)
    radius = 2.405 + rng.normal(0, NOISE_MM, phi.size)
    points = np.column_stack([along, radius * np.sin(phi), radius * np.cos(phi)])
    points[:, 2] = with_outliers(points[:, 2], rng)
    c, s = np.cos(np.deg2rad(8)), np.sin(np.deg2rad(8))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    estimate = fit_cylinder(points @ turn.T + (1.0, 2.0, 3.0), (1, 0, 0))
    assert estimate.radius_mm == pytest.approx(2.405, abs=5e-4)
    np.testing.assert_allclose(estimate.axis, turn[:, 0], atol=2e-4)
    assert estimate.stats.rmse_mm == pytest.approx(NOISE_MM, rel=0.05)


@pytest.mark.parametrize("height", [0.3, -0.12])
def test_step_height_on_a_tilted_ground(height):
    rng = np.random.default_rng(3)
    s = np.linspace(-6, 6, 1201)
    z = 0.02 * s + height * (np.abs(s) < 1.5) + rng.normal(0, NOISE_MM, s.size)
    estimate = step_height(s, with_outliers(z, rng), -1.5, 1.5)
    assert estimate.height_mm == pytest.approx(height, abs=5e-4)
    assert estimate.rms_mm == pytest.approx(NOISE_MM, rel=0.1)


def test_width_of_a_rod_at_half_its_height():
    """A half round bar of radius r is 2 r sqrt(1 - 1/4) wide at half its height."""
    s = np.linspace(-6, 6, 2401)
    z = np.sqrt(np.maximum(2.0**2 - s**2, 0.0))
    estimate = bar_width(s, z)
    top = 2.0 - 0.006  # the median over the highest 10 % of the samples is slightly below
    assert estimate.height_mm == pytest.approx(top, abs=0.02)
    expected = 2 * np.sqrt(4.0 - (estimate.height_mm / 2) ** 2)
    assert estimate.width_mm == pytest.approx(expected, abs=1e-4)


def test_width_needs_ground_on_both_sides():
    s = np.linspace(0, 1, 50)
    with pytest.raises(FitError, match="longer profile"):
        bar_width(s, (s > 0.5).astype(float))


def test_roughness_of_a_fine_wave_on_a_coarse_one():
    """A sine has Sq = A / sqrt(2) and Sa = 2 A / pi; the coarse wave is filtered off."""
    pitch = 0.01
    x, y = np.meshgrid(np.arange(0, 8, pitch), np.arange(0, 4, pitch))
    fine = 0.004 * np.sin(2 * np.pi * x / 0.137)
    coarse = 0.05 * np.sin(2 * np.pi * x / 16.0) + 0.1 * y
    estimate = areal_roughness(fine + coarse, np.ones_like(x, bool), pitch, nesting_mm=0.8)
    assert estimate.sq_mm == pytest.approx(0.004 / np.sqrt(2), rel=0.02)
    assert estimate.sa_mm == pytest.approx(0.004 * 2 / np.pi, rel=0.02)


@pytest.mark.parametrize("nesting_mm", [0.0, 0.19, 101.0, 1e300, float("nan")])
def test_a_nesting_index_that_filters_nothing_is_refused(nesting_mm):
    """Two pitches of 0.1 mm to ten fields of 10 mm; 1e300 would need a kernel of so many pixels."""
    flat = np.zeros((100, 40))
    with pytest.raises(FitError, match=r"^nesting_mm: found .* at least 0\.2 .* at most 100 "):
        areal_roughness(flat, flat == 0, 0.1, nesting_mm)


def test_the_filter_passes_half_at_its_nesting_index():
    """ISO 16610-61: a wave as long as the nesting index has half its amplitude in the roughness."""
    pitch, length = 0.02, 0.8
    x = np.tile(np.arange(0, 16, pitch), (200, 1))
    wave = 0.01 * np.sin(2 * np.pi * x / length)
    estimate = areal_roughness(wave, np.ones_like(x, bool), pitch, nesting_mm=length)
    assert estimate.sq_mm == pytest.approx(0.5 * 0.01 / np.sqrt(2), rel=0.03)


@pytest.mark.parametrize(("flank_mm", "inside"), [(0.4, 1.0), (1.0, 0.6), (6.0, 0.05)])
def test_slope_breaks_at_the_upper_edges_of_a_trapezoid(flank_mm, inside):
    """Expected: the width of the top, up to a sigma less a side on steep flanks, and its middle."""
    s, sigma = np.arange(-12.0, 12.0, 0.05), 0.15
    z = np.clip((4.0 + flank_mm - np.abs(s - 0.3)) / flank_mm, 0.0, 1.0)
    estimate = break_width(s, z, sigma)
    assert 8.0 - 2 * inside * sigma < estimate.width_mm < 8.0 + 0.005
    assert (estimate.left_mm + estimate.right_mm) / 2 == pytest.approx(0.3, abs=0.01)
    assert estimate.height_mm == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("flank_mm", [0.2, 0.6, 1.0, 6.0])
@pytest.mark.parametrize("height_mm", [0.1, 1.0, 3.0])
def test_slope_changes_fastest_at_the_upper_edges_however_steep(flank_mm, height_mm):
    """A Gaussian moves no kink; the foot of a flank of four sigma is seen by 0.01 sigma."""
    s, sigma = np.arange(-12.0, 12.0, 0.01), 0.05
    z = height_mm * np.clip((4.0 + flank_mm - np.abs(s - 0.3)) / flank_mm, 0.0, 1.0)
    estimate = slope_change_width(s, z, sigma)
    assert estimate.width_mm == pytest.approx(8.0, abs=0.002)
    assert (estimate.left_mm + estimate.right_mm) / 2 == pytest.approx(0.3, abs=0.001)


def test_the_first_edge_counts_where_a_profile_falls_twice():
    """Flanks of 45 degrees from 4 mm on, that fall off a ledge at 4.3 mm twice as steeply."""
    s = np.arange(-12.0, 12.0, 0.01)
    out = np.abs(s) - 4.0
    z = np.clip(1.0 - np.maximum(out, 0.0) - 2.0 * np.maximum(out - 0.3, 0.0), 0.0, 1.0)
    assert slope_change_width(s, z, 0.05).width_mm == pytest.approx(8.0, abs=0.005)


def test_a_round_crest_has_no_break_and_its_slope_changes_on_its_arc():
    """A strip touches a cylinder of radius 2 up to 0.5 rad from its top."""
    s, edge = np.arange(-6.0, 6.0, 0.01), 2.0 * np.sin(0.5)
    arc = np.sqrt(np.maximum(4.0 - s**2, 0.0))
    tent = 2.0 * np.cos(0.5) - np.tan(0.5) * (np.abs(s) - edge)
    z = np.where(np.abs(s) < edge, arc, tent)
    with pytest.raises(FitError, match="the crest is round"):
        break_width(s, z, 0.15)
    assert 0.0 < slope_change_width(s, z, 0.15).width_mm <= 2 * edge


def test_a_slope_that_does_not_break_is_refused():
    s = np.linspace(-3.0, 3.0, 100)
    with pytest.raises(FitError, match="bend down"):
        break_width(s, s**2, 0.1)
    with pytest.raises(FitError, match="bend down"):
        slope_change_width(s, s**2, 0.1)
