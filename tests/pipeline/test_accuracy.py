"""The measuring chain in millimetres: the twin's errors without any noise, and with it."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.coat_light import drift_left_um
from reconstruction.evaluate.fit import fit_sphere
from reconstruction.pipeline import reconstruct
from twin.config import load_experiment, vary
from twin.optics.light import pattern_set
from twin.pipeline import measure, record
from twin.pipeline.captures import options_of
from twin.results.score import score, score_truth, wrong_orders

from .conftest import CENTRE, IDEAL
from .repeats import repeated_heights


def decoded(experiment, recording):
    return reconstruct(recording.capture, options_of(experiment.decode))


@pytest.fixture(scope="module")
def ideal(mi, pressed):
    """Noise-free, unfiltered, whole field at 484 x 366."""
    experiment = load_experiment("examples/slab_balls", IDEAL | {"camera.binning": 4})
    recording = record(experiment, pressed)
    return experiment, recording, decoded(experiment, recording)


def test_noise_free_height_is_right_to_a_tenth_of_a_micrometre(ideal):
    """Setup: no noise, no filter. Expected: 0.11 um RMS over the whole lit field."""
    experiment, recording, result = ideal
    scored = score_truth(experiment, result, recording.truth)
    assert scored.z_rmse_um <= 0.15
    assert scored.completeness > 0.9999


def test_noise_free_fringe_orders_are_all_right(ideal):
    experiment, recording, result = ideal
    assert wrong_orders(experiment, result, recording.truth) == 0


def test_radius_of_an_ideal_ball_cap(mi, ball_cap):
    """A rendered cap of a 4 mm ball: fitted radius within 0.4 um of 4 mm."""
    experiment = load_experiment("examples/slab_balls", IDEAL | CENTRE)
    recording = record(experiment, ball_cap)
    result = decoded(experiment, recording)
    points = result.point_map.points_world_mm[result.point_map.valid & recording.truth.lit]
    inside = np.hypot(points[:, 0], points[:, 1]) < 2.0
    fit = fit_sphere(points[inside].astype(np.float64))
    assert fit.radius_mm == pytest.approx(4.0, abs=4e-4)
    np.testing.assert_allclose(fit.centre_mm, [0.0, 0.0, -3.0], atol=4e-4)


@pytest.fixture(scope="module")
def default(mi, pressed):
    """Return the default camera, patterns and filter, middle of the field."""
    experiment = load_experiment("examples/slab_balls", CENTRE)
    return experiment, record(experiment, pressed)


def test_default_camera_makes_no_wrong_orders(default):
    experiment, recording = default
    result = decoded(experiment, recording)
    assert wrong_orders(experiment, result, recording.truth) == 0
    scored = score(experiment, result, recording.truth).against_truth
    assert scored.completeness == 1.0


def test_filter_leaves_sigma_right_on_a_steep_relief(default, pressed):
    """Setup: bumps with slopes up to 53 degrees, default camera and filter.

    Expected: error over sigma within 0.1 of 1 and nearly no point less than without the filter.
    With a Gaussian on the phasor it was 4.2.
    """
    experiment, _ = default
    x_mm, y_mm = np.arange(-12.0, 12.01, 0.03), np.arange(-10.0, 10.01, 0.03)
    height_mm = np.tan(np.radians(53.0)) * 2.0 / np.pi
    bumps_mm = height_mm * np.outer(np.cos(np.pi * y_mm / 2.75), np.sin(np.pi * x_mm / 2.0))
    face = replace(pressed, face_x_mm=x_mm, face_y_mm=y_mm, face_z_mm=bumps_mm)
    recording = record(experiment, face)
    filtered, single = (
        score_truth(case, decoded(case, recording), recording.truth)
        for case in (experiment, vary(experiment, {"decode.filter_taps": 0}))
    )
    assert 0.9 <= filtered.error_over_sigma <= 1.1
    assert filtered.completeness >= 0.97 * single.completeness
    assert filtered.z_rmse_um < 0.3 * single.z_rmse_um


@pytest.mark.parametrize("taps", [0, 8])
def test_predicted_sigma_z_is_the_actual_spread(default, taps):
    """Spread of z over 16 exposures of one rendering, per pixel, against the predicted sigma.

    Expected: 16 values spread by sqrt(14.339 / 15) = 0.9777 in the median (chi-square, 15 degrees
    of freedom), here to 0.8 %; and 95 % of the heights are within 1.96 sigma of their mean (its own
    scatter taken into account).
    """
    experiment, recording = default
    experiment = vary(experiment, {"decode.filter_taps": taps})
    heights, sigmas, valid = repeated_heights(experiment, recording)
    spread = np.std(heights, axis=0, ddof=1)[valid]
    ratio = spread / np.mean(sigmas, axis=0)[valid]
    assert valid.sum() > 10_000
    assert np.median(ratio) == pytest.approx(0.9777, abs=8e-3)
    error = (heights - np.mean(heights, axis=0))[:, valid] / np.sqrt(1 - 1 / 16)
    covered = np.abs(error) <= 1.96 * sigmas[:, valid]
    assert covered.mean() == pytest.approx(0.95, abs=4e-3)


def test_sampling_error_is_a_third_of_the_sensor_noise_at_most(default, pressed):
    """Default 2 x 2 sub-pixel grid against 16 x 16, in projector pixels, both noise-free."""
    experiment, recording = default
    ideal = vary(experiment, IDEAL)
    fine = vary(experiment, IDEAL | {"render.samples": 256})
    coarse, exact = (decoded(e, record(e, pressed)) for e in (ideal, fine))
    noisy = decoded(vary(experiment, {"decode.filter_taps": 0}), recording)
    both = coarse.decoded.valid & exact.decoded.valid & noisy.decoded.valid
    error_px = (coarse.decoded.column.coordinate_px - exact.decoded.column.coordinate_px)[both]
    sampling_px = float(np.sqrt(np.mean(error_px.astype(np.float64) ** 2)))
    sensor_px = float(np.median(noisy.decoded.column.sigma_px[both]))
    print(f"sampling error {sampling_px:.2e} px, sensor noise {sensor_px:.2e} px")
    assert sampling_px <= sensor_px / 3


def test_same_experiment_same_capture(default, pressed):
    experiment, recording = default
    again = record(experiment, pressed)
    assert recording.capture.stack.tobytes() == again.capture.stack.tobytes()


def test_patterns_of_projector_and_decoder_are_one(default):
    experiment, recording = default
    assert recording.capture.patterns == pattern_set(experiment.projector, experiment.patterns)


@pytest.mark.parametrize("emitter", ["projector", "spot"])
def test_stock_engine_gives_the_same_measurement(mi, emitter):
    """`render.engine = "stock"`: jitter noise, but the same surface to some micrometres."""
    tiny = {"camera.width_px": 160, "camera.height_px": 120, "camera.binning": 1}
    projector = {"projector.width_px": 320, "projector.height_px": 180, "patterns.steps": 6}
    wide = {"camera.pixel_pitch_um": {"value": 27.0, "source": "test"}}
    stock = {"render.engine": "stock", "render.samples": 16, "render.stock_emitter": emitter}
    experiment = load_experiment("examples/slab_balls", tiny | projector | wide | stock)
    figures = measure(experiment).figures
    assert figures["wrong_order_pixels"] == 0
    assert figures["z_rmse_um"] < 9.0  # 6.7 measured; a projector pixel is 0.65 mm here


def test_light_that_drifts_and_flickers_is_divided_out(default, pressed):
    """Drift of 1 % per fringe set, warm-up of 1 %, flicker of 0.5 %, on the rendered stack.

    Expected: at most 0.3 um RMS of z is left, of 2 um and more.
    """
    experiment, recording = default
    figures = drift_left_um(experiment, pressed, recording.radiance)
    assert figures["drift_uncorrected_um"] > 2.0
    assert figures["drift_left_um"] <= 0.3
