"""Phase error by motion in closed form, its prediction, and the phase rate from the frames."""

import numpy as np
import pytest
from scipy.stats import chi2

from reconstruction.arrays import Reason
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.motion.phase_rate import (
    motion_of,
    phase_error,
    predicted_motion_error,
    steps_of,
)
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise
from tests.reconstruction.moving import moving_frames, ramp

RAW = DecodeOptions(filter_taps=0, frame_gains=False)
PER_RAD = 18.0 / (2.0 * np.pi)
RATE = 0.1


def of(steps, stepping="equal"):
    return PatternSet(1280, 720, steps=steps, stepping=stepping, axes=("column",))


def closed_form(patterns):
    """Return |Q / P| of the module's docstring in closed form, see `phase_rate` and `binomial`."""
    steps = patterns.steps
    if patterns.stepping in {"cyclic", "windowed"}:
        return np.tan(RATE / 2.0) ** (steps - (3 if patterns.stepping == "cyclic" else 5))
    if patterns.stepping == "quarter_pairs":
        return np.tan(RATE / 2.0) * np.sin(RATE) / np.sin(4.0 * np.pi / steps + RATE)
    return np.sin(RATE / 2.0) / np.sin(2.0 * np.pi / steps + RATE / 2.0)


SEQUENCES = [(3,), (4,), (18,), (6, "quarter_pairs"), (36, "quarter_pairs"), (5, "cyclic")]


@pytest.mark.parametrize("sequence", [*SEQUENCES, (6, "cyclic"), (8, "cyclic"), (7, "windowed")])
def test_predicted_ripple_has_its_closed_form_and_is_that_of_the_decoder(quiet_sensor, sequence):
    """Setup: 0.1 rad per frame, noise-free. Expected: amplitude within 0.02 mrad, no bias."""
    patterns, columns = of(*sequence), ramp(8, 300)
    predicted = predicted_motion_error(RATE, steps_of(patterns))
    assert predicted.ripple_rad == pytest.approx(np.arcsin(closed_form(patterns)), rel=1e-9)
    assert predicted.bias_rad == pytest.approx(0.0, abs=1e-12)
    stack = moving_frames(patterns, columns, RATE * PER_RAD)
    decoded = decode(stack, patterns, quiet_sensor, RAW)
    error_rad = (decoded.column.coordinate_px - columns)[decoded.valid] / PER_RAD
    assert decoded.valid.mean() > 0.99
    assert np.abs(error_rad).max() == pytest.approx(predicted.ripple_rad, rel=2e-3, abs=2e-5)
    exact = phase_error(columns / PER_RAD, RATE, steps_of(patterns))
    np.testing.assert_allclose(error_rad, exact[decoded.valid], atol=2e-5)


@pytest.mark.parametrize("steps", [6, 7, 8, 11])
def test_windowed_weights_cancel_light_that_changes_linearly(steps):
    """Roots: sum a_n m_n e^(-i t_n) is 0, as the sum of a_n e^(-i t_n); not with binomial weights.

    Expected: these of docs/physics/phase.md, so that mean and modulation that are linear in time
    change no phase.
    """
    windowed, binomial = (steps_of(of(steps, name)) for name in ("windowed", "cyclic"))
    for of_steps, expected in ((windowed, 0.0), (binomial, 2.0 ** ((7 - steps) / 2.0))):
        turned = of_steps.weights * np.exp(-1j * of_steps.shifts_rad)
        assert abs(turned.sum()) < 1e-12
        assert abs((turned * of_steps.times).sum()) == pytest.approx(expected, abs=1e-12)
    for first in range(4):
        assert windowed.weights[first::4].sum() == pytest.approx(1.0)
    if steps == 7:
        np.testing.assert_allclose(windowed.weights * 4.0, [1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0])


def test_decoded_windowed_frames_are_free_of_linear_light(quiet_sensor):
    """Setup: no motion; mean and modulation change by 2 % of the amplitude per frame, 7 frames."""
    columns, errors_px = ramp(8, 300), {}
    for stepping in ("windowed", "cyclic"):
        patterns = of(7, stepping)
        stack = moving_frames(patterns, columns, 0.0)
        mean = stack[:7].mean()
        frame = np.arange(-3.0, 4.0)[:, np.newaxis, np.newaxis]
        stack[:7] = (stack[:7] - mean) * (1.0 + 0.02 * frame) + mean * (1.0 + 0.02 * frame)
        decoded = decode(stack, patterns, quiet_sensor, RAW)
        errors_px[stepping] = np.abs(decoded.column.coordinate_px - columns)[decoded.valid].max()
    assert errors_px["windowed"] < 5e-4
    assert errors_px["cyclic"] > 0.01


@pytest.mark.parametrize("steps", [3, 4, 18])
def test_a_changing_rate_shifts_the_mean(steps):
    """Expected: the mean of a n^2 / 2 over the frames, a (N^2 - 1) / 24, to second order in a."""
    acceleration = 1e-4
    predicted = predicted_motion_error(0.0, steps_of(of(steps)), acceleration)
    assert predicted.bias_rad == pytest.approx(acceleration * (steps**2 - 1) / 24.0, rel=1e-3)


def test_mean_shift_against_the_first_frame():
    """Expected: rate (N - 1) / 2, as the phase is that in the middle of the set."""
    for steps in (3, 4, 18):
        assert steps_of(of(steps)).times[0] * RATE == -RATE * (steps - 1) / 2.0


@pytest.mark.parametrize(
    "sequence", [(5,), (18,), (8, "quarter_pairs"), (8, "cyclic"), (8, "windowed")]
)
def test_rate_of_each_pixel_from_its_residuals(quiet_sensor, sequence):
    """Setup: rates from -0.1 to 0.1 rad per frame over the image. Expected: rate and error."""
    patterns, columns = of(*sequence), ramp(11, 200)
    rate = np.linspace(-0.1, 0.1, 11)[:, np.newaxis] * np.ones(columns.shape)
    stack = moving_frames(patterns, columns, rate * PER_RAD)
    decoded = decode(stack, patterns, quiet_sensor, RAW)
    motion = motion_of(stack, patterns, decoded, quiet_sensor)
    np.testing.assert_allclose(motion.rate_rad, rate, atol=1e-5)
    actual_px = decoded.column.coordinate_px - columns
    np.testing.assert_allclose(motion.error_px, actual_px, atol=1e-3)


def test_sigma_of_the_rate_is_that_of_noisy_frames():
    """Setup: 18 steps, 8,000 pixels. Expected: spread of rate / sigma 1 within 3 %, 4 sigma."""
    patterns, columns = of(18), ramp(40, 200)
    sensor = SensorNoise(0.5, 5.0, 0.0, 1e5)
    frames = moving_frames(patterns, columns, 0.05 * PER_RAD)
    noise = np.random.default_rng(1).normal(0.0, 1.0, frames.shape)
    frames = (frames + noise * np.sqrt(0.5 * frames + 6.25)).astype(np.float32)
    decoded = decode(frames, patterns, sensor, RAW)
    motion = motion_of(frames, patterns, decoded, sensor)
    normalised = (motion.rate_rad - 0.05) / motion.sigma_rad
    assert abs(normalised.mean()) < 0.05
    assert normalised.std() == pytest.approx(1.0, abs=0.03)


def test_four_steps_do_not_determine_the_rate_at_all_phases(quiet_sensor):
    """Expected: infinite sigma where the only residual does not depend on the rate."""
    patterns, columns = of(4), ramp(6, 400)
    stack = moving_frames(patterns, columns, 0.05 * PER_RAD)
    motion = motion_of(stack, patterns, decode(stack, patterns, quiet_sensor, RAW), quiet_sensor)
    phase = columns / PER_RAD
    near_zero = np.abs(np.sin(2.0 * (phase - 0.25 * np.pi))) < 1e-3
    assert motion.sigma_rad[near_zero].min(initial=np.inf) > 10.0 * np.median(motion.sigma_rad)


def test_motion_of_three_steps_is_an_error(quiet_sensor):
    patterns, columns = of(3), ramp(6, 100)
    stack = moving_frames(patterns, columns, 0.0)
    decoded = decode(stack, patterns, quiet_sensor, RAW)
    with pytest.raises(InputError, match="steps is 3: motion leaves no residual"):
        motion_of(stack, patterns, decoded, quiet_sensor)


@pytest.mark.parametrize("sequence", [(6,), (8, "quarter_pairs")])
def test_residuals_mask_pixels_in_motion_and_no_others(sequence):
    """Setup: the right half moves 0.2 rad per frame; noise. Expected: at most 0.1 % at rest.

    Why: residual^2 / sigma^2 is chi-square / (N - 3); beyond 5 sigma it is 6e-7 with one degree of
    freedom.
    """
    patterns, columns = of(*sequence), ramp(100, 200)
    moves = np.where(np.arange(200) < 100, 0.0, 0.2 * PER_RAD)
    frames = moving_frames(patterns, columns, moves)
    noise = np.random.default_rng(2).normal(0.0, 0.5, frames.shape)
    frames = (frames + noise * np.sqrt(0.5 * frames + 6.25)).astype(np.float32)
    sensor = SensorNoise(0.125, 10.0, 0.0, 1e5)
    plain = decode(frames, patterns, sensor, RAW)
    assert not np.any(plain.mask_reason == Reason.MOTION)
    options = DecodeOptions(filter_taps=0, frame_gains=False, max_residual_sigmas=5.0)
    decoded = decode(frames, patterns, sensor, options)
    moved = decoded.mask_reason == Reason.MOTION
    assert moved[:, :100].mean() < 1e-3
    assert moved[:, 100:].mean() > 0.5
    assert not decoded.column.coordinate_px[moved].any()


def test_share_of_masked_pixels_at_rest_is_that_of_chi_square():
    """Setup: six steps, limit 1.6 sigmas. Expected: P(chi-square of 3 > 3 x 1.6^2) = 5.3 %."""
    patterns, columns = of(6), ramp(100, 200)
    sensor = SensorNoise(0.5, 5.0, 0.0, 1e5)
    frames = moving_frames(patterns, columns, 0.0)
    noise = np.random.default_rng(3).normal(0.0, 1.0, frames.shape)
    frames = (frames + noise * np.sqrt(0.5 * 120.0 + 6.25)).astype(np.float32)
    options = DecodeOptions(filter_taps=0, frame_gains=False, max_residual_sigmas=1.6)
    decoded = decode(frames, patterns, sensor, options)
    moved = decoded.mask_reason == Reason.MOTION
    share = moved.sum() / (moved | decoded.valid).sum()
    assert decoded.valid.mean() > 0.9
    assert share == pytest.approx(chi2.sf(3 * 1.6**2, 3), rel=0.09)
