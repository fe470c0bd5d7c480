"""Fits with their uncertainty, alignment and the decision rule, on surfaces in closed form."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from reconstruction.errors import FitError
from reconstruction.evaluate.conformity import CombinedUncertainty, Tolerance
from reconstruction.evaluate.deviation import deviations, normals_of
from reconstruction.evaluate.estimates import (
    ball_radius,
    cylinder_radius,
    shared_by,
    step_between,
    v_groove,
    wave_depth,
)

SIGMA_MM = 0.004
X, Y = (axis.ravel() for axis in np.meshgrid(np.linspace(-3, 3, 61), np.linspace(-2, 2, 41)))


def _step(noise):
    upper, lower = X > 1, X < -1
    z = 0.1 * (X > 0) + 0.01 * X - 0.02 * Y + noise
    return step_between(np.column_stack([X, Y]), z, upper, lower), 0.1


def _wave(noise):
    z = 0.03 * np.cos(2 * np.pi * (X - 0.3) / 1.7) + 0.02 * X + noise
    return wave_depth(X, z, 1.7), 0.06


def _groove(noise):
    z = 0.05 * X - 0.4 * np.maximum(0, 1 - 2 * np.abs(X - 0.2) / 1.5) + noise
    return v_groove(X, z, 0.3, 1.2).depth, 0.4


def _opening(noise):
    z = 0.05 * X - 0.4 * np.maximum(0, 1 - 2 * np.abs(X - 0.2) / 1.5) + noise
    return v_groove(X, z, 0.3, 1.2).width, 1.5


def _ball(noise):
    points = np.column_stack([X, Y, np.sqrt(25 - X**2 - Y**2) + noise])
    return ball_radius(points)[0], 5.0


def _cylinder(noise):
    points = np.column_stack([X, Y, np.sqrt(25 - X**2) + noise])
    return cylinder_radius(points, np.array([0.0, 1.0, 0.0]))[0], 5.0


FITS = [_step, _wave, _groove, _opening, _ball, _cylinder]


@pytest.mark.parametrize("fit", FITS)
def test_the_stated_uncertainty_is_the_scatter_of_the_value(fit):
    """Setup: 100 surfaces of known size with independent normal errors of 4 um along z.

    Expected: without noise the true value; with it values that scatter by the uncertainty stated
    (chi-square of 100 values within 99.9 %), about the true value, within 2 u in about 95 %.
    """
    exact, true = fit(np.zeros(len(X)))
    assert exact.value == pytest.approx(true, rel=1e-6)
    rng = np.random.default_rng(7)
    result = [fit(rng.normal(0, SIGMA_MM, len(X)))[0] for _ in range(100)]
    values = np.array([estimate.value for estimate in result])
    stated = np.array([estimate.noise_mm(np.full(len(X), SIGMA_MM), 1.0) for estimate in result])
    scatter = np.std(values, ddof=1) / np.mean(stated)
    assert 0.78 < scatter < 1.25
    assert abs(values.mean() - true) < 4 * np.mean(stated) / 10
    # Binomial: fewer than 88 of 100 within 2 u has a probability of 0.2 %.
    assert (np.abs(values - true) <= 2 * stated).sum() >= 88


def test_errors_that_neighbours_share_average_less():
    """Setup: white noise after a Gaussian of 1 pixel: 4 pi points share an error.

    Expected: the scatter of the step is the predicted one, 3.5 times that of independent points;
    200 values give a scatter to 5 %, and plateaus are cut off at their rim.
    """
    rng, draws = np.random.default_rng(3), []
    for _ in range(200):
        noise = gaussian_filter(rng.normal(size=(41, 61)), 1.0, mode="wrap")
        draws.append(_step(SIGMA_MM * noise.ravel() / np.sqrt(1 / (4 * np.pi)))[0].value)
    sigma, exact = np.full(len(X), SIGMA_MM), _step(np.zeros(len(X)))[0]
    assert np.std(draws) == pytest.approx(exact.noise_mm(sigma, shared_by(1.0)), rel=0.2)
    alone = exact.noise_mm(sigma, 1.0)
    assert exact.noise_mm(sigma, 9.0) == pytest.approx(3 * alone)
    assert exact.noise_mm(sigma, 1e9) < 10 * SIGMA_MM  # not beyond all points moving together


def test_a_gaussian_filter_shares_errors_over_its_correlation_area():
    """Setup: white noise filtered by a Gaussian of 1.5 pixels; the mean of a wide window.

    Expected: its variance is that of independent pixels times 4 pi s^2.
    """
    rng = np.random.default_rng(1)
    filtered = [gaussian_filter(rng.normal(size=(128, 128)), 1.5, mode="wrap") for _ in range(300)]
    pixel = np.mean([np.var(image) for image in filtered])
    mean = np.var([image[32:96, 32:96].mean() for image in filtered]) * 64**2
    # 300 draws know a variance to 8 %.
    assert mean / pixel == pytest.approx(shared_by(1.5), rel=0.25)


def test_a_small_exact_level_is_no_outlier_next_to_a_large_bent_one():
    """Three hundred points 0.1 mm up, exact; two thousand below, a few of them on a flank."""
    upper, lower = (X > 2) & (Y > 0), X < 1
    flank = np.where((X > 0.8) & (Y > 1), 0.01, 0.0) * lower
    result = step_between(np.column_stack([X, Y]), 0.1 * upper + flank, upper, lower)
    assert result.value == pytest.approx(0.1, abs=1e-4)
    assert result.used[upper].all()
    assert not result.used[flank > 0].any()


def test_too_few_points_raise_an_error():
    few = np.zeros(4)
    with pytest.raises(FitError, match="upper level"):
        step_between(np.zeros((4, 2)), few, few > 0, few == 0)
    with pytest.raises(FitError, match="20 over at least one pitch"):
        wave_depth(few, few, 1.0)


def _ripple(points):
    """Signed distance from z = 0.05 x + 0.2 cos(x) cos(y) along z, times the normal's z."""
    x, y, z = points.T
    return (z - 0.2 * np.cos(x) * np.cos(y)) * 0.99


@pytest.mark.parametrize(
    ("alignment", "left_um"),
    [("none", 50.0), ("offset", 20.0), ("offset_tilt", 1.5), ("rigid", 1.0)],
)
def test_each_alignment_subtracts_its_motion(alignment, left_um):
    """Setup: a rippled surface measured 40 um too high, tilted by 0.5 mrad per axis, 20 um aside.

    Expected: no motion, the offset, also the tilt, also the sliding is subtracted; the remainder
    of each is less than the larger parts that remain.
    """
    z = 0.2 * np.cos(X) * np.cos(Y)
    points = np.column_stack([X, Y, z])
    turned = points + np.column_stack([0 * X + 0.005, 0 * X, 0.04 + 0.008 * X - 0.004 * Y])
    result = deviations(turned, _ripple, alignment, normals_of(turned, _ripple))
    rms_um = 1e3 * np.sqrt(np.mean(result.deviation_mm**2))
    assert rms_um < left_um
    if alignment != "none":
        assert result.offset_mm == pytest.approx(-0.04, abs=2e-3)
    if alignment == "offset":
        tilt_um = 1e3 * np.sqrt(np.mean((0.008 * X - 0.004 * Y) ** 2))
        assert rms_um == pytest.approx(tilt_um, rel=0.1)


def test_alignment_keeps_undetermined_motion_at_zero():
    """A ball turns on itself: the best fit neither turns nor drifts, and finds the shift."""
    points = np.column_stack([X, Y, np.sqrt(25 - X**2 - Y**2)]) + np.array([0.01, -0.02, 0.03])

    def ball(at):
        return np.linalg.norm(at, axis=1) - 5

    result = deviations(points, ball, "rigid", normals_of(points, ball))
    assert np.abs(result.deviation_mm).max() < 1e-6
    # Shift or turn of a cap: one and the same; the least of both is taken.
    assert result.tilt_deg < 0.5


def test_form_is_the_band_of_95_percent():
    rng = np.random.default_rng(5)
    points = np.column_stack([X, Y, rng.normal(0, SIGMA_MM, len(X))])

    def plane(at):
        return at[:, 2]

    result = deviations(points, plane, "rigid", normals_of(points, plane))
    form = result.form(np.ones(len(X)))
    # +-1.96 sigma; a quantile of 2501 values is known to about 5 % of sigma.
    assert form.value == pytest.approx(2 * 1.96 * SIGMA_MM, rel=0.06)
    assert result.rms(np.ones(len(X))).value == pytest.approx(SIGMA_MM, rel=0.05)


BY_HAND = [
    (5.0, 2.0, "within tolerance"),
    (8.0, 2.0, "within tolerance"),  # exactly U inside of the limit
    (9.0, 2.0, "cannot tell"),
    (10.0, 2.0, "cannot tell"),
    (11.9, 2.0, "cannot tell"),
    (12.0, 2.0, "not within tolerance"),
    (-13.0, 2.0, "not within tolerance"),
    (-9.0, 2.0, "cannot tell"),
    (10.0, 0.0, "within tolerance"),
    (10.1, 0.0, "not within tolerance"),
    (0.0, 11.0, "cannot tell"),  # U is wider than the tolerance: no conformity can be proved
]


@pytest.mark.parametrize(("value", "expanded", "decided"), BY_HAND)
def test_the_decision_rule_by_hand(value, expanded, decided):
    """Tolerance -10 to 10, ISO 14253-1: U is subtracted on both sides for conformity."""
    assert Tolerance(-10.0, 10.0).verdict(value, expanded) == decided


def test_one_sided_tolerances_and_expanded_uncertainty():
    assert Tolerance(upper=10.0).verdict(-1e6, 3.0) == "within tolerance"
    assert Tolerance(lower=0.9).margin(0.95, 0.0) == pytest.approx(0.05)
    budget = CombinedUncertainty(
        noise=3.0, repeatability=4.0, calibration=12.0, coverage_factor=2.0
    )
    assert budget.standard == pytest.approx(13.0)
    assert budget.expanded == pytest.approx(26.0)
