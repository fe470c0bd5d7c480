import numpy as np
import pytest

from reconstruction.calibration.response import apply_response, correct_gamma, estimate_gamma
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

SENSOR = SensorNoise(0.0, 0.0, 0.0, 255.0)
UNFILTERED = DecodeOptions(filter_taps=0)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def gamma_stack(synthesise, cover, steps, gamma):
    """Return patterns, truth and frames 10 + 200 light^gamma of a full-range projector."""
    patterns = PatternSet(1280, 720, steps=steps)
    column, row = cover(60, 400, patterns)
    light = synthesise(patterns, column, row, mean_dn=0.5, amplitude_dn=0.5)
    return patterns, column, 10.0 + 200.0 * light.clip(0.0, 1.0) ** gamma


@pytest.mark.parametrize("gamma", [0.8, 1.0, 1.1, 2.2])
@pytest.mark.parametrize("steps", [5, 6, 18])
def test_gamma_from_two_harmonics(synthesise, cover, steps, gamma):
    """Expected: within 1 % of the true gamma, with noise that is not taken for a harmonic."""
    patterns, _, stack = gamma_stack(synthesise, cover, steps, gamma)
    stack += np.random.default_rng(1).normal(0.0, 2.0, stack.shape)
    sensor = SensorNoise(1.0, 2.0, 500.0, 1000.0)
    assert estimate_gamma(stack, patterns, sensor) == pytest.approx(gamma, rel=0.01)


@pytest.mark.parametrize("steps", [3, 4])
def test_corrected_frames_lose_the_ripple(synthesise, cover, steps):
    """Setup: gamma 2.2, noise-free. Expected: from 205 (N = 3) or 7.5 mrad to below 0.01 mrad."""
    patterns, column, stack = gamma_stack(synthesise, cover, steps, 2.2)
    mrad_per_px = 1e3 * 2.0 * np.pi / 18.0
    raw = decode(stack.astype(np.float32), patterns, SENSOR, UNFILTERED)
    linear = decode(correct_gamma(stack, patterns, 2.2), patterns, SENSOR, UNFILTERED)
    before = rms((raw.column.coordinate_px - column)[raw.valid]) * mrad_per_px
    after = rms((linear.column.coordinate_px - column)[linear.valid]) * mrad_per_px
    assert before > (100.0 if steps == 3 else 5.0)
    assert linear.valid.mean() > 0.999
    assert after < 0.02


def test_estimate_needs_five_steps_and_fringes(patterns):
    with pytest.raises(InputError, match="at least 5"):
        estimate_gamma(np.zeros((16, 4, 4)), PatternSet(64, 64, steps=4), SENSOR)
    with pytest.raises(InputError, match="no unsaturated pixel"):
        estimate_gamma(np.full((53, 4, 4), 7.0), patterns, SENSOR)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_response_table_makes_a_root_camera_linear(dtype):
    """Setup: a camera that records 16 sqrt(light); table light = (DN / 16)^2."""
    light = np.arange(0.0, 225.0).reshape(1, 15, 15)
    recorded = 16.0 * np.sqrt(light)
    recorded = recorded.astype(dtype) if dtype is np.float32 else np.rint(recorded).astype(dtype)
    linear = apply_response(recorded, (np.arange(256) / 16.0) ** 2)
    assert linear.dtype == np.float32
    # Half a level times the slope: sqrt(light) / 16.
    np.testing.assert_allclose(linear, light, atol=15.0 / 16.0 + 1e-6)


@pytest.mark.parametrize(
    ("table", "message"),
    [([0.0, 1.0, 1.0], "rising"), ([[0.0, 1.0]], "rising"), ([0.0, 1.0], "ends at 1")],
)
def test_bad_tables_are_rejected(table, message):
    with pytest.raises(InputError, match=message):
        apply_response(np.full((1, 2, 2), 2, np.uint8), table)
