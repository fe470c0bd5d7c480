"""Light of the frames before the sensor: drift, flicker, stray light and glare."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from twin.camera import choose_exposure_ms, expose, sensor
from twin.camera.frame_light import lamp_gains, scattered
from twin.config import digest, load_experiment, vary

OFF = {
    "projector.drift_percent": 0.0,
    "projector.flicker_percent": 0.0,
    "camera.stray_percent": 0.0,
    "camera.glare_percent": 0.0,
    "camera.glare_width_percent": 10.0,
    "decode.frame_gains": True,
}
LAMP = {"projector.drift_percent": 2.0, "projector.flicker_percent": 0.5}


@pytest.fixture(scope="module")
def steady():
    return load_experiment("examples/slab_balls", {"camera.exposure_ms": 10.0})


@pytest.fixture(scope="module")
def image():
    """Return a dark image with bright rectangles, one of them in a corner, and texture."""
    pixels = 0.1 * np.random.default_rng(0).random((180, 240), dtype=np.float32)
    pixels[50:100, 100:160] += 1.0
    pixels[150:, 200:] += 3.0
    return pixels


def test_defaults_change_no_digest_and_no_frame(steady, image):
    assert digest(vary(steady, OFF)) == digest(steady)
    assert lamp_gains(steady, 53, 0) is None
    assert scattered(steady.camera, image) is image


def test_linear_drift_is_from_the_first_to_the_last_frame(steady):
    gains = lamp_gains(vary(steady, {"projector.drift_percent": -3.0}), 31, 0)
    np.testing.assert_allclose(gains, np.linspace(1.0, 0.97, 31), rtol=1e-7)


def test_exponential_drift_ends_at_its_percentage(steady):
    """Expected: a share 1 - exp(-1) over 1 - exp(-4) after one of four time constants."""
    changes = {"projector.drift_percent": 2.0, "projector.drift_frames": 10.0}
    gains = lamp_gains(vary(steady, changes), 41, 0)
    assert gains[-1] == pytest.approx(1.02, rel=1e-7)
    assert (gains[10] - 1.0) / 0.02 == pytest.approx(np.expm1(-1.0) / np.expm1(-4.0), rel=1e-4)


def test_flicker_has_its_standard_deviation_and_differs_between_trials(steady):
    flickering = vary(steady, {"projector.flicker_percent": 0.5})
    gains = np.stack([lamp_gains(flickering, 53, trial) for trial in range(40)])
    assert gains.std() == pytest.approx(0.005, rel=0.05)
    assert abs(np.corrcoef(gains[:, 0], gains[:, 1])[0, 1]) < 0.5
    np.testing.assert_array_equal(lamp_gains(flickering, 53, 3), gains[3])


@pytest.mark.parametrize("threads", [1, 3])
def test_frames_are_the_same_on_any_number_of_threads(steady, image, monkeypatch, threads):
    """Expected: the mean of frame n is g_n / g_0 times that of the first, and the same bytes."""
    changed = vary(steady, {**LAMP, "camera.glare_percent": 2.0})
    frames = [image * np.float32(1e-3)] * 9
    expected = expose(changed, frames, 0).stack
    monkeypatch.setattr(sensor, "threads", lambda: threads)
    np.testing.assert_array_equal(expose(changed, frames, 0).stack, expected)
    level_dn = expected.mean(axis=(1, 2)) - changed.camera.black_level_dn
    gains = lamp_gains(changed, 9, 0)
    np.testing.assert_allclose(level_dn / level_dn[0], gains / gains[0], rtol=1e-3)


@pytest.mark.parametrize("width_percent", [2.0, 10.0, 40.0])
def test_glare_is_the_gaussian_convolution_and_keeps_the_sum(steady, image, width_percent):
    """Expected: the convolution at full resolution, to 4 % of the brightest scattered light."""
    changes = {"camera.glare_percent": 10.0, "camera.glare_width_percent": width_percent}
    light = scattered(vary(steady, changes).camera, image)
    wide = gaussian_filter(image.astype(float), 0.01 * width_percent * 240, truncate=6.0)
    assert light.sum(dtype=float) == pytest.approx(image.sum(dtype=float), rel=1e-6)
    np.testing.assert_allclose(light, 0.9 * image + 0.1 * wide, atol=0.1 * 0.04 * wide.max())


def test_stray_light_is_a_constant_of_the_frames_mean(steady, image):
    light = scattered(vary(steady, {"camera.stray_percent": 4.0}).camera, image)
    np.testing.assert_allclose(light, 0.96 * image + 0.04 * image.mean(), rtol=1e-5)


def test_automatic_exposure_includes_scattered_light(image):
    """Setup: 20 % of stray light, and a small bright part. Expected: a longer exposure.

    Predictions and lamps, which choose the time without a recording, have the same time.
    """
    automatic = load_experiment("examples/slab_balls")
    stray = vary(automatic, {"camera.stray_percent": 20.0})
    times_ms = [expose(each, [image], 0).exposure_ms for each in (automatic, stray)]
    bright = np.percentile(image, 99.5)
    expected = bright / (0.8 * bright + 0.2 * image.mean(dtype=float))
    assert times_ms[1] / times_ms[0] == pytest.approx(expected, rel=1e-3)
    assert choose_exposure_ms(stray, image) == times_ms[1]
