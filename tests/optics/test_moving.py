"""Frames of a moving scene against scenes at rest, and a moving plane against its closed form."""

from pathlib import Path

import numpy as np
import pytest
from scipy.special import j0

from reconstruction.errors import InputError
from tests.oracles.moving_frames import at_rest, exposure_times_s, frame_of_instants
from twin.config import load_experiment
from twin.optics.frame_times import frame_times_s, row_delay_s
from twin.optics.rig import true_calibration
from twin.optics.session import renderer_threads
from twin.optics.time_paths import coefficients, moment_places

DISC = Path(__file__).with_name("disc_on_stage.toml")
SLAB = "examples/slab_balls"
SMALL = {
    "camera.binning": 4,
    "camera.width_px": 320,
    "camera.height_px": 240,
    "camera.exposure_ms": 2.8,
    "camera.frame_rate_hz": 130.0,
    "patterns.steps": 3,
    "patterns.axes": ["column"],
}
# The centre is out of view: rays are lost between its thin facets, of a scene at rest, too.
PLANE = {"specimen.diameter_mm": 60.0, "specimen.height_mm": 1.0, "specimen.x_mm": 18.0}
SEAMLESS = 0.995


def moving(specimen=None, **keys):
    """Return the disc, or another specimen; two underscores stand for a dot in a key."""
    keys = {key.replace("__", "."): value for key, value in keys.items()}
    return load_experiment(DISC, (specimen or {}) | keys)


def rendered(experiment):
    """Return the stack of a bare specimen."""
    from twin.pipeline import render_bare

    return render_bare(experiment)


def rms(image):
    return float(np.sqrt(np.mean(np.square(image))))


def white_of(stack):
    """Return the mean light of the brightest frame of the lit pixels."""
    brightest = np.max(stack.frames, axis=0)
    return float(brightest[brightest > 0].mean())


def plane_column_px(calibration, z_mm):
    """Return the projector column at the centre of every camera pixel on the plane z."""
    camera, pose = calibration.camera, calibration.T_world_from_cam
    pixels = np.stack(np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px)), -1)
    slopes = camera.unproject(pixels.reshape(-1, 2))
    rays = np.column_stack([slopes, np.ones(len(slopes))]) @ pose[:3, :3].T
    points = pose[:3, 3] + rays * ((z_mm - pose[2, 3]) / rays[:, 2])[:, None]
    from_world = np.linalg.inv(calibration.T_world_from_proj)
    seen = points @ from_world[:3, :3].T + from_world[:3, 3]
    return calibration.projector.project(seen)[:, 0]


def test_a_plane_moving_along_z_has_the_coordinates_of_the_closed_form(mi):
    """Every pixel at three times: intersection of its ray with the plane z = v t, projected."""
    from twin.optics.moving_pixels import Lanes
    from twin.optics.moving_specimen import MovingSpecimen
    from twin.optics.scene import rig_of
    from twin.pipeline import trace

    experiment, times_s = moving(PLANE, motion__z_mm_s=8.0), (-0.1, 0.0, 0.07)
    scene = MovingSpecimen(
        trace.load_bare(experiment).scene, rig_of(experiment), experiment.motion, 1
    )
    lanes = Lanes(np.arange(80 * 60, dtype=np.uint32), 80, 1)
    traced = scene.trace(lanes.rays(np.repeat(np.array(times_s)[:, None], 80 * 60, axis=1)))
    column_px = traced.column_px.reshape(3, -1)
    calibration = true_calibration(experiment)
    for number, time_s in enumerate(times_s):
        error_px = np.abs(column_px[number] - plane_column_px(calibration, 8.0 * time_s))
        assert np.mean(error_px < 1e-3) > SEAMLESS
    shift_px = plane_column_px(calibration, 0.56) - plane_column_px(calibration, -0.8)
    assert np.abs(shift_px).min() > 3.0


def test_the_decoded_coordinate_of_a_moving_plane_is_that_of_the_phases_of_its_frames(mi):
    """The 8 steps at their own times: I_k = cos(2 pi u(t_k) / p + 2 pi k / 8), each pixel."""
    import twin

    rate_mm_s, keys = 0.5, {"camera.noise": False, "decode.filter_taps": 0, "patterns.steps": 8}
    keys["decode.frame_gains"] = False  # which takes the motion for light that changes
    experiment = moving(PLANE, motion__z_mm_s=rate_mm_s, **keys)
    measured, calibration = twin.measure(experiment), true_calibration(experiment)
    times, frames = frame_times_s(experiment), measured.fringes.capture.patterns.frames
    middle_s = (times.start_s + times.duration_s / 2.0)[[f.kind == "phase" for f in frames]]
    turns = 2.0 * np.pi / experiment.patterns.period_px
    moved = [plane_column_px(calibration, rate_mm_s * at) * turns for at in middle_s]
    steps = 2.0 * np.pi * np.arange(8)[:, None] / 8.0
    phasor = np.sum(np.cos(np.array(moved) + steps) * np.exp(-1j * steps), axis=0)
    rest_px = plane_column_px(calibration, 0.0)
    shift_px = np.angle(phasor * np.exp(-1j * turns * rest_px)) / turns
    decoded_px = measured.fringes.reconstruction.decoded.column.coordinate_px.ravel()
    error_px = np.abs(decoded_px - rest_px - shift_px)[measured.points.valid.ravel()]
    assert np.median(np.abs(shift_px)) > 0.03
    assert np.mean(error_px < 4.5e-3) > SEAMLESS
    assert any("the specimen moves by" in line for line in measured.metrics["warnings"])
    assert measured.metrics["motion_moments"] == 3


@pytest.mark.parametrize("origin", ["sequence", "phase"])
def test_the_truth_is_that_of_the_stated_time_0(mi, origin):
    """A plane rises by v: phases measured dt before time 0 are lower by v dt; dt is 0 for "phase".

    The sequence is 8 phase frames, then Gray frames, white and black.
    """
    import twin

    rate_mm_s, keys = 0.5, {"camera.noise": False, "decode.filter_taps": 0, "patterns.steps": 8}
    keys |= {"decode.frame_gains": False, "timing.origin": origin}
    experiment = moving(PLANE, motion__z_mm_s=rate_mm_s, **keys)
    times, bias_um = frame_times_s(experiment), twin.measure(experiment).figures["z_bias_um"]
    middle_s = (times.start_s[:8] + times.duration_s[:8] / 2.0).mean()
    assert abs(middle_s) > 0.03 or origin == "phase"
    assert bias_um == pytest.approx(1e3 * rate_mm_s * middle_s, abs=0.4)


@pytest.mark.parametrize("frame", [0, 4])
def test_frames_equal_the_mean_of_scenes_at_rest(mi, frame):
    """A disc on its stage slides, rises, twists and rolls: meshes displaced, rig at rest."""
    experiment = moving(
        motion__x_mm_s=6.0, motion__z_mm_s=4.0, motion__twist_deg_s=40.0, motion__roll_deg_s=10.0
    )
    stack = rendered(experiment)
    assert stack.motion.crossed_share > 0.05
    expected = frame_of_instants(experiment, frame, stack.motion.exposure_nodes)
    assert rms(stack.frames[frame] - expected) < 2e-3 * white_of(stack)
    moved = rms(stack.frames[frame] - at_rest(experiment, 0.0).frames[frame])
    assert moved > 2e-2 * white_of(stack)


def test_light_between_surfaces_is_linear_in_time(mi):
    """One more reflection at disc and stage: blocks of 100 pixels, which average the noise."""
    experiment = moving(
        motion__x_mm_s=2.0, render__bounces=1, render__bounce_paths=16, render__samples=4
    )
    stack = rendered(experiment)
    expected = frame_of_instants(experiment, 1, stack.motion.exposure_nodes)
    blocks = (stack.frames[1] - expected).reshape(6, 10, 8, 10).mean(axis=(1, 3))
    assert rms(blocks) < 2e-3 * white_of(stack)
    assert stack.frames[1].mean() == pytest.approx(expected.mean(), rel=1e-3)


def test_rows_of_a_rolling_shutter_are_those_of_their_own_times(mi):
    experiment = moving(motion__x_mm_s=10.0, timing__readout="rolling", timing__line_time_us=15.0)
    stack = rendered(experiment)
    (time_s,), _ = exposure_times_s(experiment, 3, 1)
    for row in (5, 55):
        expected = at_rest(experiment, time_s + row * row_delay_s(experiment)).frames[3][row]
        assert rms(stack.frames[3][row] - expected) < 3e-3 * white_of(stack)


def test_the_exposure_is_integrated(mi):
    """At 200 mm/s a pixel moves by more than a projector pixel: 8 instants."""
    experiment = moving(PLANE, motion__z_mm_s=200.0, camera__frame_rate_hz=300.0)
    stack = rendered(experiment)
    assert stack.motion.exposure_nodes > 2
    expected = frame_of_instants(experiment, 2, 8)
    error = np.abs(stack.frames[2] - expected)
    assert np.mean(error < 1e-3 * white_of(stack)) > SEAMLESS
    one = np.abs(frame_of_instants(experiment, 2, 1) - expected)
    assert np.median(one) > 3e-3 * white_of(stack)


def test_fringes_of_a_plane_that_vibrates_fast_lose_the_contrast_of_bessel(mi):
    """4 periods per exposure: the modulation at each pixel is J0(2 pi A / p) times that at rest."""
    frequency_hz, amplitude_um = 4.0 / 2.8e-3, 1500.0
    shaken = {"motion.vibration.amplitude_um": amplitude_um}
    shaken |= {"motion.vibration.frequency_hz": frequency_hz}
    experiment = moving(PLANE | shaken)
    steps = np.exp(-2j * np.pi * np.arange(3) / 3.0)
    modulation, at_rest_modulation = (
        np.abs(np.tensordot(steps, np.array(rendered(case).frames[:3]), axes=1)).ravel()
        for case in (experiment, moving(PLANE))
    )
    calibration, half_mm = true_calibration(experiment), 1e-3 * amplitude_um
    span_px = plane_column_px(calibration, half_mm) - plane_column_px(calibration, -half_mm)
    expected = j0(np.pi * span_px / experiment.patterns.period_px)
    error = np.abs(modulation / at_rest_modulation - expected)
    assert 0.3 < np.median(expected) < 0.7
    assert np.mean(error < 4e-3) > SEAMLESS, np.percentile(error, [50, 90, 99])


def test_frames_of_a_fast_vibration_equal_the_mean_of_scenes_at_rest(mi):
    """A disc is shaken across the view by 6 periods in a sequence, 0.4 periods per exposure."""
    keys = {"motion.vibration.amplitude_um": 300.0, "motion.vibration.frequency_hz": 150.0}
    experiment = moving(keys | {"motion.vibration.direction": "x"})
    stack = rendered(experiment)
    expected = frame_of_instants(experiment, 1, 8)
    assert rms(stack.frames[1] - expected) < 4e-3 * white_of(stack)
    assert rms(stack.frames[1] - at_rest(experiment, 0.0).frames[1]) > 3e-2 * white_of(stack)


def test_zero_velocity_has_the_bytes_of_a_scene_at_rest(mi):
    at_zero = rendered(moving(motion__vibration__frequency_hz=9.0))
    for frame, other in zip(at_zero.frames, rendered(moving()).frames, strict=True):
        np.testing.assert_array_equal(frame, other)
    assert at_zero.motion is None


def test_any_number_of_threads_gives_the_same_bytes(mi):
    experiment = moving(motion__x_mm_s=6.0)
    with renderer_threads(1):
        first = rendered(experiment)
    second = rendered(experiment)
    for frame, other in zip(first.frames, second.frames, strict=True):
        np.testing.assert_array_equal(frame, other)
    assert first.motion == second.motion


def test_the_truth_is_that_of_the_middle(mi):
    experiment = moving(motion__x_mm_s=6.0, motion__z_mm_s=3.0)
    truth, expected = rendered(experiment).truth, rendered(moving()).truth
    np.testing.assert_array_equal(truth.points_world_mm, expected.points_world_mm)


def test_the_last_coefficient_bounds_the_error_of_a_smooth_function():
    """exp(t / 4) through 5 moments: the error is below the last coefficient, which is small."""
    places, fine = moment_places(5), np.linspace(-1.0, 1.0, 101)
    chebyshev = coefficients([np.array([np.exp(place / 4.0)]) for place in places])
    values = np.polynomial.chebyshev.chebval(fine, np.ravel(chebyshev))
    error = np.abs(values - np.exp(fine / 4.0)).max()
    assert error < abs(chebyshev[-1][0]) < 3e-5


VIBRATION = {"motion.vibration.amplitude_um": 60.0, "motion.vibration.frequency_hz": 4.0}
SHEET = {
    "specimen.kind": "ball",
    "press.relief_pitch_mm": 0.05,
    "press.solver_pitch_mm": 0.5,
    "press.depth_mm": 0.3,
    "press.back_pressure_kpa": 1.0,
    "elastomer.length_x_mm": 11.0,
    "elastomer.length_y_mm": 11.0,
    "coating.texture": {"rms_um": 3.0, "correlation_mm": 0.3},
}


def is_as_pressed_at_rest(experiment, frames, moments):
    """Compare frames with recordings of presses at rest, and the first one with that of time 0."""
    from twin.config.instant import experiment_at
    from twin.pipeline import take

    stack = take(experiment)[1].radiance
    assert stack.motion.moments == moments
    for frame in frames:
        times_s, _ = exposure_times_s(experiment, frame, 1)
        expected = take(experiment_at(experiment, times_s[0]))[1].radiance
        assert rms(stack.frames[frame] - expected.frames[frame]) < 2e-3 * white_of(stack)
    moved = rms(stack.frames[0] - take(experiment_at(experiment, 0.0))[1].radiance.frames[0])
    return moved > 1e-2 * white_of(stack)


@pytest.mark.parametrize(("motion", "moments"), [({"motion.z_mm_s": 4.0}, 3), (VIBRATION, 5)])
def test_a_pressed_face_is_that_of_its_own_travel(mi, motion, moments):
    """A ball pressed at 4 mm/s, or shaken by 60 um: frames against presses at rest."""
    keys = {"press.relief_pitch_mm": 0.05, "press.solver_pitch_mm": 0.16}
    experiment = load_experiment(SLAB, SMALL | keys | motion)
    assert is_as_pressed_at_rest(experiment, (0, 4), moments)


def test_a_wrapped_sheet_with_texture_is_that_of_its_own_travel(mi):
    """A ball pressed into a sheet of 0.2 mm at 2 mm/s; the texture moves with its material."""
    experiment = load_experiment("examples/wrapped_balls", SMALL | SHEET | {"motion.z_mm_s": 2.0})
    assert is_as_pressed_at_rest(experiment, (0,), 3)


@pytest.mark.parametrize(
    ("name", "keys", "message"),
    [
        ("paper/ball", {"modality": "direct_fpp"}, "found a clear or polished material of ball"),
        (SLAB, {"render.engine": "stock"}, "render.engine: found 'stock', allowed 'one_trace'"),
        (SLAB, {"motion.roll_deg_s": 1.0}, "motion.roll_deg_s: found 1, allowed 0 of a press"),
        (SLAB, {"elastomer.friction": "stick"}, "under an elastomer with friction"),
        (SLAB, {"timing.readout": "rolling", "timing.line_time_us": 1.0}, "allowed 'global'"),
        (SLAB, {"render.bounces": 1}, "render.bounces: found 1, allowed 0 for a moving press"),
        (SLAB, {"motion.time_s": 0.1}, "motion.time_s: found 0.1 with a press"),
        (SLAB, {"camera.exposure_ms": "auto"}, "camera.exposure_ms: found 'auto'"),
        (SLAB, {"motion.z_mm_s": 50.0}, "motion.z_mm_s: the travel is"),
        (
            SLAB,
            {"motion.vibration.amplitude_um": 1.0},
            "vibration.frequency_hz: found 50, 4.76 periods during the sequence, allowed up to 0.5",
        ),
        (
            DISC,
            {"motion.vibration.amplitude_um": 1.0},
            "vibration.frequency_hz: found 50, more than one period during the sequence, allowed",
        ),
    ],
)
def test_motions_that_are_not_supported_are_rejected(name, keys, message):
    from twin.optics.checks import check_renderable

    experiment = load_experiment(name, SMALL | {"motion.x_mm_s": 1.0} | keys)
    with pytest.raises(InputError, match=message):
        check_renderable(experiment)
