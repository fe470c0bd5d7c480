"""Uncertainties for errors that are correlated in a pose; pixel ratios that captures state."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.reality_intervals import (
    CASE,
    RIGHT,
    WHITE_PX,
    WRONG,
    Errors,
    coverage,
    is_refused,
    is_right,
    pairs,
    poses,
    real_pairs,
)
from reconstruction.calibration import calibrate
from reconstruction.calibration.covariance import (
    TARGET_POSES,
    PoseBlock,
    inverse_normal,
    robust_covariance,
)
from reconstruction.errors import InputError

COMMON, OWN, ROWS = 3, 2, 20


def linear_slopes(count, rng):
    """Return the slopes (pose, row, free) of a linear problem with parameters of each pose."""
    slopes = np.zeros((count, ROWS, COMMON + OWN * count))
    for k in range(count):
        slopes[k][:, [*range(COMMON), *own(k)]] = rng.standard_normal((ROWS, COMMON + OWN))
    return slopes


def linear_errors(slopes, rng, correlated):
    """Return errors (pose, row): independent ones, and one pattern of random size per pose."""
    pattern = correlated * slopes[:, :, 0] * rng.standard_normal((len(slopes), 1))
    return rng.standard_normal(pattern.shape) + pattern


def own(k):
    return np.arange(COMMON + OWN * k, COMMON + OWN * (k + 1))


def fit(slopes, errors):
    """Return the solution, its residuals, the inverse normal matrix and the mean square."""
    J, e = slopes.reshape(-1, slopes.shape[-1]), errors.ravel()
    used = np.any(J != 0.0, axis=0)
    solution = np.zeros(J.shape[1])
    solution[used] = np.linalg.lstsq(J[:, used], e)[0]
    residuals = (e - J @ solution).reshape(errors.shape)
    return solution, residuals, np.sum(residuals**2) / (len(e) - used.sum())


def stated(slopes, residuals, variance):
    independent = inverse_normal(slopes.reshape(-1, slopes.shape[-1])) * variance
    blocks = [
        PoseBlock(s, r, own(k)) for k, (s, r) in enumerate(zip(slopes, residuals, strict=True))
    ]
    return independent, robust_covariance(blocks, independent, variance)


def test_covariance_is_the_jackknife_of_refits():
    """Oracle: the problem is solved again without each pose; the target by its definition."""
    rng = np.random.default_rng(0)
    slopes = linear_slopes(6, rng)
    errors = linear_errors(slopes, rng, 1.0)
    solution, residuals, variance = fit(slopes, errors)
    independent, robust = stated(slopes, residuals, variance)
    steps, scores, information = [], [], []
    for k in range(len(slopes)):
        rest = np.arange(len(slopes)) != k
        steps.append((fit(slopes[rest], errors[rest])[0] - solution)[:COMMON])
        basis = np.linalg.qr(slopes[k][:, own(k)])[0]
        alone = slopes[k][:, :COMMON] - basis @ (basis.T @ slopes[k][:, :COMMON])
        scores.append(alone.T @ residuals[k])
        information.append(alone.T @ alone)
    inverse = np.linalg.inv(sum(information))
    squares = sum(s @ inverse @ s for s in scores)
    expected = sum(np.trace(inverse @ (a - a @ inverse @ a)) for a in information)
    effect = max(1.0, squares / (variance * expected))
    jackknife = 5.0 / 6.0 * np.transpose(steps) @ np.array(steps)
    target = effect * independent[:COMMON, :COMMON]
    wanted = (5.0 * jackknife + TARGET_POSES * target) / (5.0 + TARGET_POSES)
    np.testing.assert_allclose(robust[:COMMON, :COMMON], wanted, rtol=1e-9)
    assert np.all(np.linalg.eigvalsh(robust) > 0.0)


@pytest.mark.parametrize(("correlated", "underestimated"), [(0.0, 1.0), (1.0, 8.0)])
def test_mean_stated_variance_is_the_scatter(correlated, underestimated):
    """Setup: 300 draws of 10 poses; errors like the first parameter have one size per pose.

    Expected: the mean variance is that of the draws, at most 60 % above. The variance by
    independent errors is less than a sixth of it if the errors are correlated.
    """
    rng = np.random.default_rng(1)
    slopes, estimates, variances = linear_slopes(10, rng), [], []
    for _ in range(300):
        solution, residuals, variance = fit(slopes, linear_errors(slopes, rng, correlated))
        estimates.append(solution[0])
        variances.append([c[0, 0] for c in stated(slopes, residuals, variance)])
    independent, robust = np.mean(variances, axis=0) / np.var(estimates)
    assert independent < 1.2 / underestimated
    assert 0.85 < robust < 1.6


def test_a_direction_that_one_pose_alone_determines_has_a_bounded_variance():
    """Setup: pose 0 has all but the share e = 0.001 of the information about a parameter.

    Without that pose the step is score / e, of variance 1 / e for errors of variance 1. Limited by
    L it is e / L^2, so that the mean variance over the true one is, with 10 poses and the target,
    (9 (9 / 10) e / L^2 + 2) / 11: 2.0 for L = 0.02, but 7.5 for 0.01, 0.6 for 0.04, and 740 without
    a limit. Expected: the stated variance within the scatter of 100 draws, and 90 % coverage.
    """
    rng, limit = np.random.default_rng(4), 0.02
    slopes = linear_slopes(10, rng)
    slopes[0][:, 0] *= 95.0
    own_part = [s[:, 0] - s[:, own(k)] @ np.linalg.lstsq(s[:, own(k)], s[:, 0])[0]
                for k, s in enumerate(slopes)]  # fmt: skip
    information = np.array([part @ part for part in own_part])
    others = float(information[1:].sum() / information.sum())
    estimates, variances = [], []
    for _ in range(100):
        solution, residuals, variance = fit(slopes, linear_errors(slopes, rng, 0.0))
        estimates.append(solution[0])
        variances.append(stated(slopes, residuals, variance)[1][0, 0])
    expected = (9.0 * 0.9 * others / limit**2 + TARGET_POSES) / (9.0 + TARGET_POSES)
    assert others == pytest.approx(0.001, rel=0.2)
    assert np.mean(variances) / np.var(estimates) == pytest.approx(expected, rel=0.35)
    assert np.mean(np.abs(estimates) <= 2.0 * np.sqrt(variances)) > 0.84


def test_intervals_cover_errors_that_are_correlated_in_a_pose():
    """Setup: 100 draws of 10 poses, as above. Expected: 2 standard uncertainties cover 94 % +- 4 %.

    By the covariance of independent errors they cover half for the parameter that the errors
    resemble.
    """
    rng = np.random.default_rng(5)
    slopes, covered = linear_slopes(10, rng), []
    for _ in range(100):
        solution, residuals, variance = fit(slopes, linear_errors(slopes, rng, 1.0))
        limits = [2.0 * np.sqrt(np.diag(c)) for c in stated(slopes, residuals, variance)]
        covered.append([np.abs(solution[:COMMON]) <= limit[:COMMON] for limit in limits])
    by_independent, by_robust = np.mean(covered, axis=0)
    assert by_robust.mean() == pytest.approx(0.94, abs=0.04)
    assert by_robust.min() > 0.8
    assert by_independent[0] < 0.6


def test_disjoint_sets_of_poses_agree_within_their_intervals():
    """Setup: 4 pairs of sets, dots displaced alike over a third of the board, a bent board.

    Expected: 95 % within two standard uncertainties; by independent errors half of them.
    """
    fits = pairs(4)
    assert coverage(fits) >= 0.9
    assert coverage(fits, "independent_covariance") < 0.7


@pytest.mark.skipif(not CASE.is_dir(), reason="no folder of real captures")
def test_sets_of_real_poses_agree_within_their_intervals():
    """Public captures by a diamond chip: three poses each, of five."""
    assert coverage(real_pairs(CASE)) >= 0.95


@pytest.fixture(scope="module")
def observed():
    return poses(np.random.default_rng(2), 5, Errors(WHITE_PX, 0.0, 0.0))


@pytest.mark.parametrize("name", ["half the columns, stated", "half the rows, stated"])
def test_pixel_ratio_of_the_captures_gives_the_rig(observed, name):
    assert is_right(RIGHT[name](observed))


def test_coordinates_without_relation_to_the_board_are_refused(observed):
    assert is_refused(WRONG["coordinates without relation"](observed))


def test_captures_that_state_different_pixels_are_refused(observed):
    changed = [replace(observed[0], projector_pixel_ratio=2.0), *observed[1:]]
    with pytest.raises(InputError, match=r"different pixel_ratio \(1, 2\)"):
        calibrate(changed)


def test_a_baseline_no_rig_has_is_refused(observed):
    """Setup: the board's squares in metres; the baseline is 0.2, read as mm."""
    metres = [replace(view, points_mm=1e-3 * view.points_mm) for view in observed]
    with pytest.raises(InputError, match=r"baseline_mm is 0\.2\d*, plausible 1 to"):
        calibrate(metres)
