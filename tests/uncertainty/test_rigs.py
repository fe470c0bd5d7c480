"""Rigs drawn from a calibration's covariance."""

import numpy as np
import pytest

from reconstruction.calibration.parameters import POSES, RigEstimate, pack
from twin.config import load_experiment
from twin.optics.rig import true_calibration
from twin.pipeline import measure
from twin.study.measuring import CaseMeasurer, Conditions, RigCovariance


@pytest.fixture(scope="module")
def rigs():
    """A covariance with strong correlations and with parameters that were held fixed."""
    rng = np.random.default_rng(3)
    scale = np.concatenate([np.full(4, 0.05), np.full(5, 1e-3)] * 2 + [[1e-5] * 3, [2e-3] * 3])
    mix = rng.normal(size=(POSES, 6))
    covariance = (mix @ mix.T / 6 + 0.1 * np.eye(POSES)) * np.outer(scale, scale)
    for fixed in (6, 7, 8, 15, 16, 17):
        covariance[fixed] = covariance[:, fixed] = 0.0
    return RigCovariance.of(covariance)


@pytest.fixture(scope="module")
def true():
    return true_calibration(load_experiment("examples/slab_balls"))


def vector_of(calibration):
    rig = RigEstimate(
        calibration.camera, calibration.projector, calibration.T_proj_from_cam, np.eye(4)[None]
    )
    return pack(rig)[:POSES]


def test_draws_have_the_covariance(rigs, true):
    """1000 draws: standard deviations within 4 standard errors, correlations within 0.13."""
    n, covariance = 1000, np.array(rigs.rows)
    vectors = np.array([vector_of(rigs.draw(true, 1, trial)) for trial in range(1, n + 1)])
    free = np.diag(covariance) > 0
    sigma = np.sqrt(np.diag(covariance))
    steps = vectors - vector_of(true)
    # Poses are chained through 4 x 4 matrices: fixed parameters change only by rounding.
    assert np.abs(steps[:, ~free]).max() < 1e-12
    np.testing.assert_allclose(steps[:, free].std(axis=0), sigma[free], rtol=4 / np.sqrt(2 * n))
    expected = covariance[np.ix_(free, free)] / np.outer(sigma[free], sigma[free])
    np.testing.assert_allclose(np.corrcoef(steps[:, free].T), expected, atol=0.13)


def test_trial_zero_is_the_true_rig_and_draws_repeat(rigs, true):
    assert rigs.draw(true, 1, 0) is true
    fourth = vector_of(rigs.draw(true, 1, 4))
    np.testing.assert_array_equal(fourth, vector_of(rigs.draw(true, 1, 4)))
    assert not np.array_equal(fourth, vector_of(rigs.draw(true, 1, 5)))


def test_a_drawn_rig_has_the_true_camera_pose(rigs, true):
    drawn = rigs.draw(true, 1, 2)
    np.testing.assert_array_equal(drawn.T_world_from_cam, true.T_world_from_cam)


def test_equal_covariances_share_a_worker_s_measurer(rigs):
    """They are compared by content: each batch has its own copy."""
    copy = RigCovariance.of(np.array(rigs.rows))
    assert copy == rigs
    assert hash(copy) == hash(rigs)


def test_a_trial_is_a_measurement_with_a_drawn_rig(mi):
    """With the true rig it equals a plain measurement; a rig larger by 1e-4 scales the radius."""
    small = {
        "camera.binning": 4,
        "press.solver_pitch_mm": 0.15,
        "press.relief_pitch_mm": 0.05,
        "render.samples": 1,
        "patterns.steps": 6,
    }
    experiment = load_experiment("examples/slab_balls", small)

    class Larger(RigCovariance):
        def draw(self, true, seed, trial):
            # Baseline and distances larger by 1e-4: every measured length is, too.
            larger = true.T_world_from_proj.copy()
            baseline = larger[:3, 3] - true.T_world_from_cam[:3, 3]
            larger[:3, 3] = true.T_world_from_cam[:3, 3] + 1.0001 * baseline
            return type(true)(true.camera, true.projector, true.T_world_from_cam, larger)

    measurer = CaseMeasurer(rigs=Larger(()))
    figures = measurer(experiment, Conditions(1, "boards/paper_dots", 1)).figures
    expected = measure(experiment, memory=measurer.memory, trial=1).figures
    assert figures["true_rig_sphere_1_radius_mm"] == expected["sphere_1_radius_mm"]
    assert figures["force_n"] == expected["force_n"]
    ratio = figures["sphere_1_radius_mm"] / figures["true_rig_sphere_1_radius_mm"]
    # The region of the fit is 1.5 mm in both scales: the radius increases by less than 1e-4.
    assert ratio == pytest.approx(1.0001, abs=7e-5)
