"""Frames of a pixel that are clipped, lost or not finite are left out of its fit."""

import numpy as np
import pytest

from reconstruction.decoding.decode import DecodeOptions, Reason, decode
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

UNFILTERED = DecodeOptions(filter_taps=0)
MRAD_PER_PX = 1e3 * 2.0 * np.pi / 18.0


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def clipped_stack(patterns, synthesise, cover, excess, shape=(60, 400)):
    """Return truth and an 8-bit stack with fringe peaks that exceed full scale by `excess`."""
    column, row = cover(*shape, patterns)
    half = 127.5 * excess
    stack = synthesise(patterns, column, row, mean_dn=half, amplitude_dn=half)
    return column, row, np.rint(np.clip(stack, 0.0, 255.0)).astype(np.float32)


@pytest.mark.parametrize("excess", [1.2, 1.5])
def test_phase_of_clipped_fringes(patterns, quiet_sensor, synthesise, cover, excess):
    """Setup: 18 steps, peak clipped at 1.5x (7 of 18 frames), 8 bit. Expected: <= 1 mrad RMS."""
    column, row, stack = clipped_stack(patterns, synthesise, cover, excess)
    decoded = decode(stack, patterns, quiet_sensor, UNFILTERED)
    assert decoded.valid.all()
    assert rms(decoded.column.coordinate_px - column) * MRAD_PER_PX <= 1.0
    assert rms(decoded.row.coordinate_px - row) * MRAD_PER_PX <= 1.0
    np.testing.assert_allclose(decoded.column.modulation_dn, 127.5 * excess, rtol=0.02)
    # Only quantisation is left: 1 / sqrt(12).
    assert rms(decoded.column.residual_dn) == pytest.approx(np.sqrt(1.0 / 12.0), rel=0.1)


def test_clipped_fringes_without_leaving_out(synthesise, cover):
    """Why: shows the use of exclusion. Setup: clipping not known; 9 steps, as 18 hide it.

    Expected: 14.5 mrad RMS, that of a cut cosine in exact arithmetic.
    """
    patterns = PatternSet(1280, 720, steps=9)
    column, _, stack = clipped_stack(patterns, synthesise, cover, 1.5)
    decoded = decode(stack, patterns, SensorNoise(0.0, 0.0, 0.0, 256.0), UNFILTERED)
    error_mrad = rms((decoded.column.coordinate_px - column)[decoded.valid]) * MRAD_PER_PX
    assert error_mrad == pytest.approx(14.5, rel=0.03)


@pytest.mark.parametrize("taps", [0, 5])
def test_sigma_of_clipped_fringes_is_their_spread(synthesise, taps):
    """Setup: read noise only, peaks clipped at 1.5x. Expected: sigma within 2 %.

    Why: fewer frames, all on one side of the circle, give a worse phase.
    """
    patterns = PatternSet(1280, 720)
    # Read noise of 2 DN; levels from 254.5 DN count as clipped.
    sensor = SensorNoise(1e-4, 2e4, 0.0, 267.0)
    row, col = np.mgrid[0:300, 0:500].astype(float)
    column, lines = 20.0 + 0.13 * col + 0.01 * row, 30.0 + 0.14 * row
    stack = synthesise(patterns, column, lines, mean_dn=191.0, amplitude_dn=191.0)
    stack += np.random.default_rng(5).normal(0.0, 2.0, stack.shape)
    # Cut by the clean level: a cut that depends on the noise would bias the rest.
    phase = slice(0, 2 * patterns.steps)
    clean = synthesise(patterns, column, lines, mean_dn=191.0, amplitude_dn=191.0)[phase]
    stack[phase][clean > 245.0] = 255.0
    decoded = decode(stack.astype(np.float32), patterns, sensor, DecodeOptions(filter_taps=taps))
    predicted = 2.0 / np.sqrt(sensor.variance_dn2(191.0)) * decoded.column.sigma_px
    spread = np.std((decoded.column.coordinate_px - column)[decoded.valid])
    assert sensor.clipped_from_dn == 254.5
    assert decoded.valid.mean() > 0.9
    assert rms(predicted[decoded.valid]) == pytest.approx(spread, rel=0.02)


@pytest.mark.parametrize("frame", [0, 17, 20, 35])
def test_one_clipped_frame_only_adds_noise(patterns, quiet_sensor, synthesise, frame):
    column, row = np.full((9, 9), 365.0), np.full((9, 9), 185.0)
    stack = synthesise(patterns, column, row).astype(np.float32)
    whole = decode(stack, patterns, quiet_sensor, UNFILTERED)
    stack[frame] = 255.0
    decoded = decode(stack, patterns, quiet_sensor, UNFILTERED)
    assert decoded.valid.all()
    np.testing.assert_allclose(decoded.column.coordinate_px, 365.0, atol=1e-4)
    np.testing.assert_allclose(decoded.row.coordinate_px, 185.0, atol=1e-4)
    axis, before = (decoded.column, whole.column) if frame < 18 else (decoded.row, whole.row)
    growth = axis.sigma_px / before.sigma_px
    assert np.all((growth >= 1.0 - 1e-6) & (growth < 1.1))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_frame_that_is_not_finite(patterns, quiet_sensor, synthesise, value):
    column, row = np.full((9, 9), 365.0), np.full((9, 9), 185.0)
    stack = synthesise(patterns, column, row).astype(np.float32)
    stack[4] = value
    quiet = SensorNoise(0.0, 0.0, 2.0, 255.0)
    decoded = decode(stack, patterns, quiet, UNFILTERED)
    assert decoded.valid.all()
    np.testing.assert_allclose(decoded.column.coordinate_px, 365.0, atol=1e-4)


@pytest.mark.parametrize("black_level_dn", [0.0, 5.0])
def test_lost_frame_is_left_out(patterns, synthesise, cover, black_level_dn):
    """Setup: the camera delivered one frame full of zeros. Expected: as if it did not exist."""
    column, row = cover(40, 300, patterns)
    stack = synthesise(patterns, column, row).astype(np.float32)
    stack[7] = 0.0
    sensor = SensorNoise(0.0, 0.0, black_level_dn, 255.0)
    decoded = decode(stack, patterns, sensor, UNFILTERED)
    assert decoded.valid.all()
    assert rms(decoded.column.coordinate_px - column) <= 1e-4


def test_three_frames_left_are_just_enough(quiet_sensor, synthesise):
    patterns = PatternSet(128, 128, steps=4)
    column, row = np.full((9, 9), 59.0), np.full((9, 9), 41.0)
    stack = synthesise(patterns, column, row).astype(np.float32)
    stack[1] = 255.0
    decoded = decode(stack, patterns, quiet_sensor, UNFILTERED)
    np.testing.assert_allclose(decoded.column.coordinate_px, 59.0, atol=1e-4)
    assert np.all(decoded.column.residual_dn == 0.0)
    stack[2] = 255.0
    decoded = decode(stack, patterns, quiet_sensor, UNFILTERED)
    assert np.all(decoded.mask_reason == Reason.SATURATED)


def test_residual_is_the_noise(patterns, synthesise, cover):
    """Expected: RMS over N - 3 degrees of freedom equals the noise, 3 DN, within 1 %."""
    column, row = cover(60, 500, patterns)
    stack = synthesise(patterns, column, row)
    stack += np.random.default_rng(2).normal(0.0, 3.0, stack.shape)
    sensor = SensorNoise(0.01, 300.0, 0.0, 1000.0)
    decoded = decode(stack.astype(np.float32), patterns, sensor, UNFILTERED)
    for axis in (decoded.column, decoded.row):
        assert rms(axis.residual_dn[decoded.valid]) == pytest.approx(3.0, rel=0.01)
