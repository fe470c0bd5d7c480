"""Steppings for motion: frames, noise, lost frames, windows of a longer capture; 1-bit fringes."""

import numpy as np
import pytest

from reconstruction.decoding.decode import DecodeOptions, Reason, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.reduction.binomial import binomial_weights, cyclic_windows
from reconstruction.rig.projected_light import ProjectorResponse, blurred
from reconstruction.rig.sensor import SensorNoise
from tests.reconstruction.conftest import ramps
from tests.reconstruction.moving import moving_frames, ramp

RAW = DecodeOptions(filter_taps=0)
PER_RAD = 18.0 / (2.0 * np.pi)


@pytest.mark.parametrize(
    ("steps", "stepping"),
    [(6, "quarter_pairs"), (8, "quarter_pairs"), (7, "cyclic"), (7, "windowed")],
)
def test_both_axes_decode_exactly(quiet_sensor, synthesise, cover, steps, stepping):
    patterns = PatternSet(1280, 720, steps=steps, stepping=stepping)
    column, row = cover(30, 400, patterns)
    stack = synthesise(patterns, column, row).astype(np.float32)
    decoded = decode(stack, patterns, quiet_sensor, RAW)
    assert decoded.valid.all()
    np.testing.assert_allclose(decoded.column.coordinate_px, column, atol=1e-3)
    np.testing.assert_allclose(decoded.row.coordinate_px, row, atol=1e-3)


@pytest.mark.parametrize(
    ("steps", "stepping"),
    [(6, "quarter_pairs"), (8, "quarter_pairs"), (5, "cyclic"), (6, "cyclic"), (7, "windowed")],
)
def test_sigma_is_the_spread_of_noisy_coordinates(steps, stepping):
    """Setup: 20,000 pixels with shot and read noise. Expected: within 2 %, 5 sigma of the test."""
    patterns = PatternSet(1280, 720, steps=steps, stepping=stepping, axes=("column",))
    columns, sensor = ramp(100, 200), SensorNoise(0.5, 5.0, 0.0, 1e5)
    frames = moving_frames(patterns, columns, 0.0)
    noise = np.random.default_rng(5).normal(0.0, 1.0, frames.shape)
    frames = (frames + noise * np.sqrt(0.5 * frames + 6.25)).astype(np.float32)
    decoded = decode(frames, patterns, sensor, RAW)
    axis, valid = decoded.column, decoded.valid
    normalised = ((axis.coordinate_px - columns) / np.where(valid, axis.sigma_px, 1.0))[valid]
    assert valid.mean() > 0.99
    assert normalised.std() == pytest.approx(1.0, abs=0.025)


def test_binomial_weights_are_those_of_the_five_steps_of_hariharan():
    np.testing.assert_allclose(binomial_weights(5), [0.5, 1.0, 1.0, 1.0, 0.5])
    for frames in range(4, 12):
        weights = binomial_weights(frames)
        for first in range(4):
            assert weights[first::4].sum() == pytest.approx(1.0)
    with pytest.raises(InputError, match="found 3; needed are 4 or more"):
        binomial_weights(3)


def test_compensation_gain_of_each_order(quiet_sensor):
    """Setup: 0.4 rad per frame. Expected: each further frame divides the ripple by 1 / tan(0.2)."""
    ripples = []
    for steps in (4, 5, 6, 7):
        patterns = PatternSet(1280, 720, steps=steps, stepping="cyclic", axes=("column",))
        columns = ramp(6, 400)
        stack = moving_frames(patterns, columns, 0.4 * PER_RAD)
        decoded = decode(stack, patterns, quiet_sensor, RAW)
        ripples.append(np.abs(decoded.column.coordinate_px - columns)[decoded.valid].max())
    gains = np.divide(ripples[:-1], ripples[1:])
    np.testing.assert_allclose(gains, 1.0 / np.tan(0.2), rtol=0.03)


def test_a_clipped_frame_is_omitted_with_all_frames_of_its_shift():
    """Setup: frame 1 of 6 is clipped at one pixel. Expected: coordinate right, sigma larger."""
    patterns = PatternSet(1280, 720, steps=6, stepping="cyclic", axes=("column",))
    columns, sensor = ramp(6, 100), SensorNoise(0.1, 1.0, 4.0, 255.0)
    frames = moving_frames(patterns, columns, 0.0)
    frames[1, 3, 50] = 255.0
    decoded = decode(frames, patterns, sensor, RAW)
    axis = decoded.column
    assert decoded.valid[3, 50]
    assert axis.coordinate_px[3, 50] == pytest.approx(columns[3, 50], abs=1e-3)
    assert axis.sigma_px[3, 50] > 1.1 * axis.sigma_px[3, 49]
    frames[:3, 3, 60] = 255.0
    assert decode(frames, patterns, sensor, RAW).mask_reason[3, 60] == Reason.SATURATED


def test_windows_of_a_longer_capture_follow_the_motion(quiet_sensor):
    """Setup: 15 cyclic frames, 0.5 px per frame, windows of 6. Expected: ten reliefs in step."""
    patterns = PatternSet(1280, 720, steps=6, stepping="cyclic", axes=("column",))
    long = PatternSet(1280, 720, steps=15, stepping="cyclic", axes=("column",))
    columns = ramp(6, 100)
    stack = moving_frames(long, columns, 0.5)
    results = []
    for window, shown in cyclic_windows(stack[:15], stack[15:], patterns):
        decoded = decode(window, shown, quiet_sensor, RAW)
        results.append(np.mean((decoded.column.coordinate_px - columns)[decoded.valid]))
    np.testing.assert_allclose(results, 0.5 * (np.arange(10) + 2.5 - 7.0), atol=0.003)
    both = PatternSet(1280, 720, steps=6, stepping="cyclic")
    with pytest.raises(InputError, match="one axis and one period"):
        next(cyclic_windows(stack[:15], stack[15:], both))
    with pytest.raises(InputError, match="found 5 cyclic and 10 other frames"):
        next(cyclic_windows(stack[:5], stack[15:], patterns))


@pytest.mark.parametrize(
    ("code", "periods_px"),
    [("heterodyne", (36.0, 37.0)), ("hierarchical", (18.0, 1300.0)), ("micro", (18, 15.5, 20.4))],
)
@pytest.mark.parametrize("steps", [3, 4])
def test_few_steps_of_several_periods(quiet_sensor, synthesise, code, periods_px, steps):
    """Three or four steps with two or three frequencies, without Gray frames, end to end."""
    patterns = PatternSet(
        300, 200, periods_px[0], steps, code=code, further_periods_px=periods_px[1:], uniform=False
    )
    column, row = ramps(40, 200, patterns)
    decoded = decode(synthesise(patterns, column, row).astype(np.float32), patterns, quiet_sensor)
    assert len(patterns.frames) == 2 * (steps * 2 if code != "micro" else steps + 2)
    assert decoded.valid.mean() > 0.9
    error_px = (decoded.column.coordinate_px - column)[decoded.valid]
    assert np.abs(error_px).max() < 0.02


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"stepping": "hilbert"}, "stepping is 'hilbert'; allowed are equal, quarter_pairs"),
        ({"stepping": "quarter_pairs", "steps": 7}, "allowed are 6 to 1000, a multiple of 2"),
        ({"stepping": "cyclic", "steps": 3}, "allowed are 4 to 24"),
        ({"stepping": "windowed", "steps": 5}, "allowed are 6 to 24"),
        ({"stepping": "single", "steps": 3}, "allowed are 1 to 1"),
        ({"steps": 2}, "steps is 2"),
        ({"stepping": "cyclic", "steps": 0, "code": "gray"}, "with steps 0, without fringes"),
        (
            {"stepping": "cyclic", "code": "micro", "further_periods_px": (15.5, 20.4)},
            "with code 'micro', which needs 'equal'",
        ),
        ({"waveform": "round"}, "waveform is 'round'; allowed are sinusoidal, square"),
        ({"waveform": "square", "steps": 4}, "edges are not between pixels"),
    ],
)
def test_wrong_steppings_and_waveforms_are_errors(change, message):
    with pytest.raises(InputError, match=message):
        PatternSet(1280, 720, **change)


def test_square_fringes_have_one_bit_and_their_edges_between_pixels():
    patterns = PatternSet(180, 90, steps=6, waveform="square", axes=("column",))
    for frame in patterns.frames[:6]:
        levels = patterns.profile(frame)
        assert set(levels) == {0, 255}
        assert levels.mean() == 127.5
    shifted = PatternSet(
        180, 90, 16.0, 4, waveform="square", axes=("column",), first_shifts_deg=(11.25,)
    )
    assert set(shifted.profile(shifted.frames[0])[:16]) == {0, 255}


def square_error(steps, blur_px, turns):
    """Return the phase error of N steps by the harmonics of a blurred square wave, to first order.

    Fourier series: B_m = (4 / (pi m)) sin(pi m / 2) exp(-(2 pi m s / p)^2 / 2) for odd m. N steps
    pass the harmonics k N - 1 and k N + 1, which rotate by +-k N phi.
    """
    error, first = 0.0, np.exp(-0.5 * (2.0 * np.pi * blur_px / 18.0) ** 2)
    for m in range(3, 60, 2):
        share = np.sin(np.pi * m / 2.0) / m
        share *= np.exp(-0.5 * (2.0 * np.pi * m * blur_px / 18.0) ** 2) / first
        if (m - 1) % steps == 0:
            error = error + share * np.sin((m - 1) * 2.0 * np.pi * turns)
        if (m + 1) % steps == 0:
            error = error - share * np.sin((m + 1) * 2.0 * np.pi * turns)
    return error


@pytest.mark.parametrize("blur_px", [1.0, 3.0])
@pytest.mark.parametrize("steps", [3, 6])
def test_phase_error_of_blurred_square_fringes(quiet_sensor, steps, blur_px):
    """Setup: 1-bit fringes of 18 px, Gaussian blur. Expected: the harmonics' error in closed form.

    With the response of the projector stated, the decoder removes 99 % of it.
    """
    patterns = PatternSet(360, 90, steps=steps, waveform="square", axes=("column",), code="gray")
    columns = np.linspace(60.0, 290.0, 900)[np.newaxis, :] * np.ones((4, 1))
    light = np.stack([patterns.profile(frame) / 255.0 for frame in patterns.frames], axis=1)
    stack = blurred(light, columns[0], blur_px).T[:, np.newaxis] * np.ones((4, 1)) * 200.0 + 20.0
    decoded = decode(stack.astype(np.float32), patterns, quiet_sensor, RAW)
    error_rad = (decoded.column.coordinate_px - columns) / PER_RAD
    expected = square_error(steps, blur_px, columns / 18.0)
    kept = decoded.valid & (np.abs(error_rad) < 1.0)
    assert kept.mean() > 0.9
    # The blurred pixel box is narrower than the continuous square by its own transfer: none, as
    # edges are between pixels. Second order in the amplitude remains.
    largest = np.abs(expected).max()
    np.testing.assert_allclose(error_rad[kept], expected[kept], atol=0.6 * largest**2 + 3e-4)
    response = ProjectorResponse(gamma=1.0, gamma_uncertainty=0.0, blur_px=blur_px)
    corrected = decode(stack.astype(np.float32), patterns, quiet_sensor, RAW, response=response)
    rest_rad = (corrected.column.coordinate_px - columns)[kept & corrected.valid] / PER_RAD
    assert np.abs(rest_rad).max() < 0.02 * largest + 1e-3
