"""Motion and timing as data: poses in closed form, times of frames, and rejected values."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from twin.config import ConfigError, digest, load_experiment, vary
from twin.config.instant import experiment_at
from twin.config.motion import Motion, Vibration
from twin.optics.frame_times import frame_times_s, row_delay_s, sequence_ends_s

BASE = "examples/gauges"
RATES = {"camera.exposure_ms": 5.0, "camera.frame_rate_hz": 100.0}


def moving(**keys):
    """Return the example with keys; two underscores stand for a dot."""
    return load_experiment(BASE, RATES | {k.replace("__", "."): v for k, v in keys.items()})


def test_at_rest_the_digest_is_that_of_an_experiment_without_the_tables():
    experiment = load_experiment(BASE)
    assert not {"motion", "timing"} & set(experiment.model_dump())
    assert digest(vary(experiment, {"motion.x_mm_s": 0.0})) == digest(experiment)
    assert digest(vary(experiment, {"motion.x_mm_s": 1.0})) != digest(experiment)


def test_pose_of_a_quarter_turn_and_of_a_quarter_period():
    """R_z(90) R_y(90) maps x to -z, y to -x and z to y; sin(2 pi f t) is 1 after 1 / (4 f)."""
    shaken = Vibration(amplitude_um=20.0, frequency_hz=2.0, direction="y")
    motion = Motion(x_mm_s=3.0, twist_deg_s=90.0, roll_deg_s=90.0, vibration=shaken)
    pose = motion.pose_at(1.0)
    np.testing.assert_allclose(
        pose[:3, :3] @ np.eye(3), [[0, -1, 0], [0, 0, 1], [-1, 0, 0]], atol=1e-12
    )
    np.testing.assert_allclose(pose[:3, 3], [3.0, 0.0, 0.0], atol=1e-12)  # two whole periods
    np.testing.assert_allclose(motion.shift_mm(0.125), [0.375, 0.02, 0.0], atol=1e-12)
    np.testing.assert_array_equal(motion.pose_at(0.0), np.eye(4))


def test_a_press_at_an_instant_has_the_travel_and_the_place_of_that_time():
    experiment = load_experiment(
        "examples/slab_balls",
        {"motion.z_mm_s": 2.0, "motion.twist_deg_s": 90.0, "specimen.x_mm": 1.0},
    )
    later = experiment_at(experiment, 0.1)
    assert later.press.depth_mm == pytest.approx(experiment.press.depth_mm + 0.2)
    assert later.specimen.yaw_deg == pytest.approx(experiment.specimen.yaw_deg + 9.0)
    place = later.specimen.x_mm, later.specimen.y_mm
    assert place == pytest.approx((np.cos(np.deg2rad(9.0)), np.sin(np.deg2rad(9.0))))
    assert not later.motion.moves
    with pytest.raises(InputError, match=r"motion.z_mm_s: the travel is -0\.05 mm"):
        experiment_at(experiment, -0.4)


def test_a_press_of_prescribed_force_has_no_press_rate():
    experiment = load_experiment(
        "examples/slab_balls",
        {"press.control": "force", "press.depth_mm": None, "press.force_n": 1.0}
        | {"motion.z_mm_s": 2.0},
    )
    with pytest.raises(InputError, match=r"allowed press\.control = 'depth'"):
        experiment_at(experiment, 0.1)


def test_frames_follow_the_slowest_of_exposure_camera_and_projector():
    start_s, duration_s = frame_times_s(moving())
    np.testing.assert_allclose(np.diff(start_s), 0.01, rtol=1e-12)
    np.testing.assert_allclose(duration_s, 0.005)
    assert start_s[0] == pytest.approx(-(start_s[-1] + 0.005))


def test_binary_frames_have_their_own_rate():
    experiment = moving(
        timing__pattern_rate_hz=50.0, timing__binary_rate_hz=100.0, patterns__axes=["column"]
    )
    steps = experiment.patterns.steps
    periods_s = np.diff(frame_times_s(experiment).start_s)
    np.testing.assert_allclose(np.sort(periods_s)[-steps:], 0.02)
    np.testing.assert_allclose(np.sort(periods_s)[:-steps], 0.01)


@pytest.mark.parametrize("rolling", [{}, {"timing.readout": "rolling", "timing.line_time_us": 6.0}])
def test_time_0_is_the_middle_of_the_phase_frames(rolling):
    """18 phase frames of 10 ms, then 10 others: in the middle row 85 ms and half an exposure."""
    keys = RATES | rolling | {"timing.origin": "phase", "patterns.axes": ["column"]}
    experiment = load_experiment(BASE, keys | {"camera.binning": 2})
    start_s, duration_s = frame_times_s(experiment)
    middle_row_s = (experiment.camera.height_px // 2 - 1) / 2 * row_delay_s(experiment)
    assert start_s[0] + middle_row_s == pytest.approx(-(17 * 0.0102 + 0.005) / 2, rel=0.05)
    phase_s = start_s[: experiment.patterns.steps] + middle_row_s
    assert phase_s[0] == pytest.approx(-(phase_s[-1] + duration_s[-1]))
    first_s, last_s = sequence_ends_s(experiment)
    assert first_s == start_s[0]
    assert last_s == pytest.approx(start_s[-1] + 0.005 + 2 * middle_row_s)


def test_without_phase_frames_time_0_is_the_middle_of_all_frames():
    words = {"patterns.steps": 0, "patterns.code": "gray", "patterns.period_px": 4.0}
    with pytest.raises(InputError, match=r"timing\.origin: found 'phase' and patterns\.steps = 0"):
        frame_times_s(load_experiment(BASE, RATES | words | {"timing.origin": "phase"}))


def test_the_middle_row_of_a_rolling_shutter_is_exposed_symmetrically():
    experiment = moving(timing__readout="rolling", timing__line_time_us=6.0, camera__binning=2)
    (start_s, duration_s), delay_s = frame_times_s(experiment), row_delay_s(experiment)
    assert delay_s == pytest.approx(12e-6)
    middle_s = (experiment.camera.height_px // 2 - 1) / 2 * delay_s
    assert start_s[0] + middle_s == pytest.approx(-(start_s[-1] + duration_s[-1] + middle_s))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"camera__exposure_ms": "auto"}, r"camera\.exposure_ms: found 'auto'"),
        ({"timing__pattern_rate_hz": 150.0}, r"timing\.pattern_rate_hz: found 150, allowed up to"),
        (
            {"timing__pattern_rate_hz": 100.0, "timing__trigger_delay_ms": 6.0},
            r"allowed up to 90\.9091: delay, exposure and readout take 11 ms",
        ),
    ],
)
def test_an_exposure_has_to_fit_in_its_frame(keys, message):
    with pytest.raises(InputError, match=message):
        frame_times_s(moving(**keys))


def test_a_line_time_belongs_to_a_rolling_readout():
    with pytest.raises(ConfigError, match="line_time_us: found 0 with readout = 'rolling'"):
        moving(timing__readout="rolling")


RELAXING = {"elastomer.relaxation": {"shares": [0.2], "times_s": [1.0]}}


def test_a_press_of_a_relaxing_elastomer_lasts_its_travel_over_its_rate():
    """Travel 0.75 mm at 0.5 mm/s: 1.5 s after the first contact; 0.2 s later 1.7 s."""
    experiment = load_experiment("examples/slab_ball", RELAXING | {"motion.z_mm_s": 0.5})
    assert experiment_at(experiment, 0.0).press.ramp_s == pytest.approx(1.5)
    later = experiment_at(experiment, 0.2).press
    assert (later.depth_mm, later.ramp_s) == pytest.approx((0.85, 1.7))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"motion.x_mm_s": 0.1}, "motion: found a slide, turn, vibration or retraction"),
        ({"motion.z_mm_s": -0.1}, "allowed a press of constant rate"),
        ({"motion.z_mm_s": 0.1, "motion.vibration.amplitude_um": 1.0}, "remove the other motions"),
        ({"motion.z_mm_s": 0.1, "press.hold_s": 2.0}, "press.hold_s: found 2 s with motion.z_mm_s"),
        ({"motion.z_mm_s": 0.1, "press.ramp_s": 2.0}, "press.ramp_s: found 2 s with motion.z_mm_s"),
    ],
)
def test_a_relaxing_elastomer_is_pressed_at_a_constant_rate_only(keys, message):
    experiment = load_experiment("examples/slab_ball", RELAXING | keys)
    with pytest.raises(InputError, match=message):
        experiment_at(experiment, 0.0)
