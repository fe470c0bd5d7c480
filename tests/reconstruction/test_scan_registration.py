"""Registration of patches of known surfaces from known stage errors: statistics of the errors."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from reconstruction.errors import InputError
from reconstruction.scan.elements import surface_elements, values_at
from reconstruction.scan.registration import StagePrior, register
from tests.reconstruction.scanned import (
    PITCH_MM,
    STAGE,
    hills,
    nominal_grid,
    patch_of,
    true_poses,
)

NOMINAL = nominal_grid(2, 2, 6.0, 5.0)
SMALL = (49, 63)


def plane(x, y):
    return 0 * x, 0 * x, 0 * x


def cylinder(x, y):
    return 0.4 * np.sin(0.9 * x), 0.36 * np.cos(0.9 * x), 0 * x


def filtered(noise):
    """Return noise of variance 1 that neighbouring pixels share, as after the decoder's filter."""
    smooth = gaussian_filter(noise, 1.0)
    return smooth / smooth.std()


def registered(surface, seed, stage=STAGE, nominal=NOMINAL, **settings):
    motion, T = true_poses(nominal, stage, seed)
    patches = [
        surface_elements(patch_of(pose, surface, 100 * seed + k, SMALL, **settings))
        for k, pose in enumerate(T)
    ]
    return register(patches, nominal, stage), motion


def relative_errors(done, motion):
    """Errors of the motion of each patch relative to the one before, over their sigma."""
    error, count = (done.motion - motion).ravel(), len(motion)
    step = np.eye(6 * count)[6:] - np.eye(6 * count)[:-6]
    return (step @ error / np.sqrt(np.diag(step @ done.covariance @ step.T))).reshape(-1, 6)


@pytest.mark.parametrize("blur", [None, filtered], ids=["independent", "correlated"])
def test_errors_over_20_seeds_are_as_large_as_predicted(blur):
    runs = [registered(hills, seed, blur=blur) for seed in range(20)]
    absolute = [(done.motion - motion) / done.sigma for done, motion in runs]
    relative = [relative_errors(*run) for run in runs]
    for values in (absolute, relative):
        assert 0.8 <= np.sqrt(np.mean(np.square(values))) <= 1.25
    if blur is None:  # the stated sigma is the true one
        assert 0.9 <= np.mean([done.birge_ratio for done, _ in runs]) <= 1.1
    sigma = np.mean([done.sigma for done, _ in runs], axis=(0, 1))
    assert (sigma[:3] < 0.6 * np.array(STAGE.sigma_mm)).all()  # relief determines all of them
    assert not any(free.axis in ("x", "y", "z") for done, _ in runs for free in done.free)


def test_a_plane_keeps_the_sigma_of_the_stage_along_itself():
    runs = [registered(plane, seed, blur=filtered) for seed in range(10)]
    for done, _ in runs:
        assert {free.axis for free in done.free} == {"x", "y", "rotation about z"}
    errors = [(done.motion - motion) / done.sigma for done, motion in runs]
    assert 0.8 <= np.sqrt(np.mean(np.square(errors))) <= 1.25
    x, y, z, *_ = runs[0][0].sigma[0]
    assert min(x, y) > 0.95 * STAGE.sigma_mm[0]
    assert z < 0.6 * STAGE.sigma_mm[2]


def test_a_cylinder_slides_along_its_axis_only():
    done, _ = registered(cylinder, 1)
    assert {free.axis for free in done.free} == {"y"}


def test_the_drift_is_bounded_by_the_stage_and_its_own_axes():
    """The drift of a path is estimated better than by its prior; fixed coordinates stay fixed."""
    stage = StagePrior((0.01, 0.01, 0.0), (0.0, 0.0, 0.0), (0.1, 0.1, 0.0))
    done, motion = registered(hills, 0, stage, nominal_grid(4, 1, 5.0, 5.0))
    drawn = 0.1 * np.random.default_rng(0).standard_normal(27)[-3:-1]
    assert np.abs(done.drift_mm[:2] - drawn).max() < 0.04
    assert (done.drift_sigma_mm[:2] < 0.03).all()
    assert (done.motion[:, 2:] == 0.0).all()
    assert np.abs(done.motion - motion).max() < 0.02


def test_an_element_is_exact_on_a_quadratic_surface():
    def bowl(x, y):
        return 0.05 * x**2 - 0.02 * x * y + 0.1 * y, 0.1 * x - 0.02 * y, 0.1 - 0.02 * x

    elements = surface_elements(patch_of(np.eye(4), bowl, 0, SMALL, sigma_mm=1e-9))
    at = elements.centres_mm + 0.3 * PITCH_MM
    values = values_at(elements, np.arange(len(at)), at)
    z, by_x, by_y = bowl(*at.T)
    np.testing.assert_allclose(values.z_mm, z, atol=1e-6)  # points are in single precision
    np.testing.assert_allclose(values.slopes, np.column_stack([by_x, by_y]), atol=1e-5)


def test_the_height_of_an_element_is_exact_on_a_cubic_surface():
    def saddle(x, y):
        by_x, by_y = 0.009 * x**2 - 0.01 * x * y, 0.006 * y**2 - 0.005 * x**2
        return 0.003 * x**3 - 0.005 * x**2 * y + 0.002 * y**3, by_x, by_y

    elements = surface_elements(patch_of(np.eye(4), saddle, 0, SMALL, sigma_mm=1e-9))
    at = elements.centres_mm + 0.5 * PITCH_MM
    values = values_at(elements, np.arange(len(at)), at)
    np.testing.assert_allclose(values.z_mm, saddle(*at.T)[0], atol=1e-6)


def test_the_estimate_without_noise_has_no_bias_that_adds_up_to_a_drift():
    """Steps of 33 1/3 pixels: elements are compared a third of a pixel from their centre."""
    stage = StagePrior((1e-3, 1e-3, 0.0), (0.0, 0.0, 0.0), (0.1, 0.1, 0.0))
    nominal = nominal_grid(4, 1, 5.0, 5.0)
    T = nominal.copy()  # no error of the stage: the drift is 0
    patches = [surface_elements(patch_of(at, hills, 0, SMALL, sigma_mm=1e-4)) for at in T]
    assert np.abs(register(patches, nominal, stage).drift_mm[:2]).max() < 1e-4


def test_windows_over_a_step_are_left_out():
    def step(x, y):
        return np.where(x > 0.05, 0.2, 0.0), 0 * x, 0 * x

    elements = surface_elements(patch_of(np.eye(4), step, 0, SMALL))
    near = np.abs(elements.centres_mm[:, 0] - 0.05) < 2 * PITCH_MM
    assert not near.any()


def test_patches_without_overlap_are_an_error():
    with pytest.raises(InputError, match="no two patches overlap"):
        registered(hills, 0, nominal=nominal_grid(2, 1, 40.0, 5.0))
    with pytest.raises(InputError, match="found 1 patch, allowed 2 to 300"):
        registered(hills, 0, nominal=nominal_grid(1, 1, 5.0, 5.0))
