"""Decoded frames of a moving plane and ball: closed form of the error, prediction, compensation."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from tests.optics.test_moving import PLANE, SEAMLESS, SMALL, moving, plane_column_px, rms
from twin.config import load_experiment
from twin.config.instant import experiment_at
from twin.optics.frame_times import mean_times_s
from twin.optics.rig import true_calibration

SPEED_MM_S = 10.0
BALL = "examples/moving_ball"
CYCLIC = {"patterns.steps": 6, "patterns.stepping": "cyclic"}


def plane(**keys):
    """Return the plane at 10 mm/s towards the camera, 80 x 60 pixels, four steps."""
    return moving(PLANE | {"patterns.steps": 4}, motion__z_mm_s=SPEED_MM_S, **keys)


def coordinate_px(experiment):
    """Return the decoded columns, without noise and filter, and where they are valid."""
    import twin

    quiet = {"camera": {"noise": False}, "decode": {"filter_taps": 0}}
    changed = {
        name: getattr(experiment, name).model_copy(update=values) for name, values in quiet.items()
    }
    decoded = twin.measure(experiment.model_copy(update=changed)).fringes.reconstruction.decoded
    return decoded.column.coordinate_px.astype(float), decoded.valid


def ripple_px(experiment, reference_s):
    """Return the errors of the decoded columns against the scene at rest at one time."""
    moved_px, valid = coordinate_px(experiment)
    rested_px, known = coordinate_px(experiment_at(experiment, reference_s))
    return (moved_px - rested_px)[valid & known]


def phase_middle_s(experiment):
    """Return the middle of the phase frames, which come first."""
    return float(mean_times_s(experiment)[: experiment.patterns.steps].mean())


def test_the_error_of_a_moving_plane_is_that_of_the_closed_form(mi):
    """arg(1 + r exp(-2 i psi)), r = sin(e / 2) / sin(pi / 2 + e / 2), at every pixel.

    Why psi: the phasor Q of four steps at the times m_n turns by their mean shift, 135 degrees.
    Levels of 8 bits are rounded: 1 / sqrt(12) of them is 4.6e-3 px, three times that is allowed.
    """
    experiment = plane()
    times_s, calibration = mean_times_s(experiment)[:4], true_calibration(experiment)
    turns = 2.0 * np.pi / experiment.patterns.period_px
    first, last = (plane_column_px(calibration, SPEED_MM_S * at) for at in times_s[[0, 3]])
    rate, middle_px = turns * (last - first) / 3.0, (last + first) / 2.0
    share = np.sin(rate / 2.0) / np.sin(np.pi / 2.0 + rate / 2.0)
    psi = turns * middle_px + 0.75 * np.pi
    expected_px = np.angle(1.0 + share * np.exp(-2j * psi)) / turns
    decoded_px, valid = coordinate_px(experiment)
    rest_px = (decoded_px.ravel() - middle_px - expected_px)[valid.ravel()]
    assert np.abs(expected_px).max() > 0.09
    assert rms(rest_px) < 4.6e-3
    assert np.mean(np.abs(rest_px) < 14e-3) > SEAMLESS


def test_binomial_weights_and_an_encoder_remove_the_error(mi):
    """Expected: RMS error of four steps five times that of either."""
    steps, cyclic, encoder = (
        plane(),
        moving(PLANE | CYCLIC, motion__z_mm_s=SPEED_MM_S),
        plane(motion__encoder=True),
    )
    plain_px = rms(ripple_px(steps, phase_middle_s(steps)))
    assert plain_px > 0.06
    assert plain_px > 5.0 * rms(ripple_px(cyclic, phase_middle_s(cyclic)))
    assert plain_px > 5.0 * rms(ripple_px(encoder, 0.0))


def test_windowed_weights_remove_the_error_of_a_ball_that_moves_across_the_view(mi):
    """Its shading changes at each pixel. Expected: median error a fifth of that of four steps."""
    keys = {"motion.x_mm_s": SPEED_MM_S, "motion.z_mm_s": 0.0}
    median_px = {}
    for stepping, steps in (("equal", 4), ("windowed", 7)):
        shown = {"patterns.steps": steps, "patterns.stepping": stepping}
        experiment = load_experiment(BALL, SMALL | keys | shown)
        errors_px = ripple_px(experiment, phase_middle_s(experiment))
        median_px[stepping] = float(np.median(np.abs(errors_px)))
    assert median_px["equal"] > 5.0 * median_px["windowed"]


@pytest.mark.parametrize(
    ("keys", "least"), [({"motion.z_mm_s": 10.0}, 30.0), ({"motion.x_mm_s": 5.0}, 10.0)]
)
def test_predicted_errors_of_a_ball_are_the_actual_ones(mi, keys, least):
    """Expected: predicted over actual 0.8 to 1.25 (median), in the figures of the result."""
    import twin

    rest = {"motion.x_mm_s": 0.0, "motion.z_mm_s": 0.0, "patterns.steps": 4}
    figures = twin.measure(load_experiment(BALL, SMALL | rest | keys)).metrics
    assert 0.8 < figures["motion_predicted_over_actual"] < 1.25
    assert figures["motion_lag_rms_um"] > least
    assert figures["motion_error_rms_um"] > 0.03 * figures["motion_lag_rms_um"]


def test_the_residuals_of_a_moving_plane_predict_its_error(mi):
    import twin

    measured = twin.measure(plane(decode__motion_error=True))
    assert 0.95 < measured.metrics["motion_predicted_over_actual"] < 1.05
    stated = twin.measure(plane()).fringes.reconstruction.motion
    valid = measured.points.valid
    error_mm = measured.fringes.reconstruction.motion.error_z_mm[valid]
    assert rms(error_mm - stated.error_z_mm[valid]) < 0.1 * rms(error_mm)


def test_the_capture_of_a_stage_with_an_encoder_states_its_positions(mi):
    from twin.pipeline import take

    experiment = plane(motion__encoder=True, motion__encoder_surface_z_mm=0.5)
    _, recording = take(experiment)
    stage = recording.capture.stage
    expected_mm = SPEED_MM_S * mean_times_s(experiment)
    np.testing.assert_allclose(np.array(stage.positions_mm)[:, 2], expected_mm, rtol=1e-12)
    assert stage.reference_mm == (0.0, 0.0, 0.0)
    assert stage.surface_z_mm == 0.5
    with pytest.raises(InputError, match=r"motion.encoder: found true, allowed for a bare"):
        take(plane(motion__encoder=True, motion__twist_deg_s=1.0))
