import dataclasses

import numpy as np
import pytest

from reconstruction import compiling
from reconstruction.decoding import decode as decode_module
from reconstruction.decoding._sum import find_noise
from reconstruction.decoding.decode import AxisDecode, Decoded, DecodeOptions, decode
from reconstruction.decoding.plan import make_plan
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise


@pytest.fixture(scope="module")
def patterns():
    return PatternSet(256, 192, steps=4)


@pytest.fixture(scope="module")
def stack(patterns, synthesise, cover):
    """220 rows with noise, holes and clipped pixels on both sides of every band border."""
    column, row = cover(220, 90, patterns)
    frames = synthesise(patterns, column, row, mean_dn=125.0, amplitude_dn=105.0)
    rng = np.random.default_rng(6)
    frames += rng.normal(0.0, 3.0, frames.shape)
    frames[:, rng.random((220, 90)) < 0.002] = 3.0
    frames[2, rng.random((220, 90)) < 0.02] = 255.0
    return frames.astype(np.float32)


SENSOR = SensorNoise(0.05, 40.0, 1.0, 250.0)


def fields(decoded: Decoded):
    names = [field.name for field in dataclasses.fields(AxisDecode)]
    axes = (decoded.column, decoded.row)
    return [decoded.mask_reason, *(getattr(axis, name) for axis in axes for name in names)]


@pytest.mark.parametrize("threads", [1, 3])
def test_result_is_the_same_on_any_number_of_threads(monkeypatch, patterns, stack, threads):
    """Expected: the same bytes, as the bands do not depend on the number of threads."""
    expected = decode(stack, patterns, SENSOR)
    monkeypatch.setattr(compiling, "threads", lambda: threads)
    for result, wanted in zip(
        fields(decode(stack, patterns, SENSOR)), fields(expected), strict=True
    ):
        np.testing.assert_array_equal(result, wanted)


@pytest.mark.parametrize("taps", [0, 2, 5, 8])
def test_bands_leave_no_trace(monkeypatch, patterns, stack, taps):
    """Setup: bands of 96 rows, of 7, and one band for all. Expected: the same bytes."""
    options = DecodeOptions(filter_taps=taps)
    expected = decode(stack, patterns, SENSOR, options)
    assert 0.1 < expected.valid.mean() < 1.0
    for rows in (7, 1000):
        monkeypatch.setattr(decode_module, "BAND_ROWS", rows)
        result = decode(stack, patterns, SENSOR, options)
        for actual, reference in zip(fields(result), fields(expected), strict=True):
            np.testing.assert_array_equal(actual, reference)


def test_kernels_and_sensor_share_the_noise_model(patterns, stack):
    """Expected: equal to single precision, dark, bright and below the black level."""
    sensor = SensorNoise(0.17, 6.2, 64.0, 4095.0)
    limits = make_plan(stack, patterns, sensor, DecodeOptions(), None).limits
    mean_dn = np.array([0.0, 64.0, 65.0, 500.0, 4000.0], np.float32)
    noise_dn, scale = np.zeros_like(mean_dn), np.ones_like(mean_dn)
    find_noise(mean_dn, scale, limits, noise_dn)
    expected = np.sqrt(sensor.variance_dn2(mean_dn.astype(float)))
    np.testing.assert_allclose(noise_dn, expected, rtol=1e-6)
