"""Nonlinear projectors: the ripple is subtracted, its uncertainty is in sigma."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.special import gammaln, ndtri

from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.decoding.ripple import NODES, ripple_of
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise

FINE, BLUR_PX = 32, 0.7
UNFILTERED = DecodeOptions(filter_taps=0)
SENSOR = SensorNoise(0.17, 6.2, 64.0, 4095.0)


def shown(patterns, column_px, row_px, gamma, blur_px=BLUR_PX):
    """Return frames (frame, row, col) of levels raised to gamma and blurred, 0 to 1.

    By a Gaussian filter on a grid 32 times finer than a pixel: independent of the code.
    """
    frames = []
    for frame in patterns.frames:
        light = (patterns.profile(frame) / 255.0) ** gamma
        fine = gaussian_filter1d(np.repeat(light, FINE), blur_px * FINE, mode="nearest")
        at_px = (np.arange(fine.size) + 0.5) / FINE - 0.5
        frames.append(np.interp(row_px if frame.axis == "row" else column_px, at_px, fine))
    return np.stack(frames)


def recorded(clean, seed, sensor=SENSOR):
    noise = np.random.default_rng(seed).normal(size=clean.shape)
    dn = clean + noise * np.sqrt(sensor.variance_dn2(clean) - 1.0 / 12.0)
    return np.rint(dn).clip(0, 4095).astype(np.uint16)


def scene(rows=120, cols=700):
    row, col = np.mgrid[0:rows, 0:cols].astype(float)
    return 40.0 + 0.51 * col + 0.02 * row, 30.0 + 0.6 * row


@pytest.mark.parametrize("steps", [3, 4])
@pytest.mark.parametrize("gamma", [0.8, 1.2, 2.2])
def test_ripple_is_that_of_the_harmonics(steps, gamma):
    """Closed form: B_m = 1 / (Gamma(g + m + 1) Gamma(g - m + 1)) of cos(phi / 2)^(2 g).

    N steps see z = sum over k of B_(1 + k N) H exp(i k N phi) and the true phasor; H is the
    transfer of pixel box and Gaussian for a harmonic. 8-bit levels add 2 mrad.
    """
    period_px = 36.0
    patterns = PatternSet(1296, 720, steps=steps, period_px=period_px)
    table = ripple_of(patterns, ProjectorResponse(gamma=gamma, blur_px=BLUR_PX)).error_rad[0, 0]
    m = 1 + steps * np.arange(-6, 7)
    n = np.abs(m)
    sign = np.where(gamma - n + 1 > 0, 1.0, (-1.0) ** np.floor(gamma - n + 1))
    size = (
        sign
        * np.exp(-gammaln(gamma + n + 1) - gammaln(gamma - n + 1))
        * np.isfinite(gammaln(gamma - n + 1))
    )
    remaining = np.sinc(m / period_px) * np.exp(-0.5 * (2 * np.pi * BLUR_PX * m / period_px) ** 2)
    true = 2 * np.pi * np.arange(2048) / 2048
    phasor = (size * remaining * np.exp(1j * np.outer(true, m))).sum(axis=1)
    error = np.angle(phasor * np.exp(-1j * true))
    wanted = np.interp(2 * np.pi * np.arange(NODES) / NODES, true + error, error, period=2 * np.pi)
    assert np.sqrt(np.mean(wanted**2)) > (3e-3 if steps == 4 else 3e-2)
    # Twice for the half percent of blur and box between the nodes.
    np.testing.assert_allclose(table[:NODES], wanted, atol=4e-3)
    assert table[NODES] == table[0]


def test_a_linear_projector_has_no_ripple_and_no_correction():
    patterns = PatternSet(1280, 720, steps=3)
    column, row = scene(20)
    stack = recorded(100.0 + 3000.0 * shown(patterns, column, row, 1.0), 1)
    linear = decode(stack, patterns, SENSOR, UNFILTERED)
    known = ProjectorResponse(blur_uncertainty_px=0.0)
    same = decode(stack, patterns, SENSOR, UNFILTERED, response=known)
    # 8-bit levels: their own ripple of some mrad is taken off as well.
    both = linear.valid & same.valid
    assert both.mean() > 0.99
    moved = np.abs(same.column.coordinate_px - linear.column.coordinate_px)[both]
    assert moved.max() < 0.02
    assert moved.max() > 0.0


@pytest.mark.parametrize("gamma", [1.15, 2.2])
@pytest.mark.parametrize("steps", [3, 4])
@pytest.mark.parametrize("taps", [0, 8])
def test_errors_agree_with_sigma(steps, gamma, taps):
    """Expected: normalised errors of a known response have a mean square of 1 within 8 %.

    Without it the three-step ripple is tens of sigmas.
    """
    patterns = PatternSet(1280, 720, steps=steps, axes=("column",))
    column, row = scene()
    stack = recorded(100.0 + 3000.0 * shown(patterns, column, row, gamma), 2)
    options = DecodeOptions(filter_taps=taps)
    response = ProjectorResponse(gamma=gamma, blur_px=BLUR_PX, blur_uncertainty_px=0.0)
    known = decode(stack, patterns, SENSOR, options, response=response).column
    blind = decode(stack, patterns, SENSOR, options).column
    inside = np.s_[12:-12, 12:-12]

    def chi2(axis):
        normalised = ((axis.coordinate_px - column) / np.maximum(axis.sigma_px, 1e-9))[inside]
        return float(np.mean(normalised[axis.sigma_px[inside] > 0.0] ** 2))

    assert chi2(known) == pytest.approx(1.0, abs=0.08 if taps == 0 else 0.15)
    assert chi2(blind) > (1.5 * chi2(known) if steps == 3 else 0.9)


def test_uncertainty_of_gamma_is_in_sigma():
    """Setup: 24 projectors, gamma off by normal quantiles of unit variance; light without noise.

    Expected: the mean square of the errors is sigma squared within 10 %: the errors are linear in
    gamma but for 5 %, and quantiles leave no sampling.
    """
    patterns = PatternSet(360, 100, steps=3, axes=("column",))
    column, row = np.meshgrid(np.linspace(60.0, 240.0, 181), [10.0])
    sensor = SensorNoise(1e-4, 1.0, 0.0, 4095.0)
    quantiles = ndtri((np.arange(24) + 0.5) / 24)
    squares, variances = [], []
    for true_gamma in 1.5 + 0.05 * quantiles / quantiles.std():
        stack = (100.0 + 3000.0 * shown(patterns, column, row, true_gamma)).astype(np.float32)
        response = ProjectorResponse(1.5, 0.05, BLUR_PX, 0.0)
        decoded = decode(stack, patterns, sensor, UNFILTERED, response=response).column
        squares.append((decoded.coordinate_px - column) ** 2)
        variances.append(decoded.sigma_px.astype(float) ** 2)
    assert np.mean(squares) == pytest.approx(np.mean(variances), rel=0.1)
    # It follows the ripple: large where its waves are, small between them.
    by_pixel = [np.mean(values, axis=0).ravel() for values in (squares, variances)]
    assert np.corrcoef(*by_pixel)[0, 1] > 0.9


def test_two_periods_of_one_scene_agree():
    """Setup: three steps, gamma 1.3, periods of 18 and 26 px. Expected: chi-square 1 within 5 %."""
    column, row = scene()
    response = ProjectorResponse(1.3, 0.0, BLUR_PX, 0.0)
    result = []
    for seed, period_px in enumerate((18.0, 26.0)):
        patterns = PatternSet(1280, 720, steps=3, period_px=period_px, axes=("column",))
        stack = recorded(100.0 + 3000.0 * shown(patterns, column, row, 1.3), seed)
        result.append(decode(stack, patterns, SENSOR, UNFILTERED, response=response).column)
    first, second = result
    both = (first.sigma_px > 0.0) & (second.sigma_px > 0.0)
    variance = first.sigma_px.astype(float) ** 2 + second.sigma_px.astype(float) ** 2
    step = first.coordinate_px.astype(float) - second.coordinate_px
    assert both.mean() > 0.99
    assert np.mean(step[both] ** 2 / variance[both]) == pytest.approx(1.0, abs=0.05)


def test_three_steps_have_more_noise_where_their_light_is():
    """Shot noise only, A = B: (2 / 3 B^2) (K A - K B / 2 cos 3 phi), 0.5 to 1.5 of its mean."""
    patterns = PatternSet(1280, 720, steps=3, axes=("column",))
    phases_deg = np.array([0.0, 30.0, 60.0])
    column = np.tile(360.0 + phases_deg / 360.0 * 18.0, (20000, 1))
    clean = np.zeros((len(patterns.frames), *column.shape))
    for k, frame in enumerate(patterns.frames):
        x = column / 18.0
        if frame.kind == "phase":
            clean[k] = 1000.0 + 900.0 * np.cos(2 * np.pi * (x + frame.index / 3.0))
        else:
            levels = patterns.profile(frame)
            clean[k] = 100.0 + 1800.0 * (levels[np.rint(column).astype(int)] > 127)
    sensor = SensorNoise(0.2, 1.0, 0.0, 4095.0)
    stack = recorded(clean, 5, sensor)
    result = decode(stack, patterns, sensor, UNFILTERED).column
    spread_px = np.std(
        result.phase_rad.astype(float) - np.deg2rad(phases_deg) % (2 * np.pi), axis=0
    )
    wrapped = (result.phase_rad[:, 0].astype(float) + np.pi) % (2 * np.pi) - np.pi
    spread_px[0] = np.std(wrapped)
    predicted_rad = result.sigma_px.mean(axis=0) * 2 * np.pi / 18.0
    np.testing.assert_allclose(predicted_rad, spread_px, rtol=0.02)
    assert predicted_rad[2] / predicted_rad[0] == pytest.approx(np.sqrt(1450.5 / 550.5), rel=0.02)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gamma": 0.0}, "gamma"),
        ({"gamma_uncertainty": -1.0}, "gamma_uncertainty"),
        ({"blur_px": float("nan")}, "blur_px"),
        ({"curve": (0.0, 0.5, 0.4, 1.0)}, "rise"),
        ({"curve": (0.0, 1.0), "gamma": 1.2}, "either"),
        ({"curve": "0 1"}, "list"),
    ],
)
def test_responses_that_cannot_be_are_rejected(change, message):
    with pytest.raises(InputError, match=message):
        ProjectorResponse(**change)


def test_a_curve_that_is_a_power_law_is_one():
    levels = np.arange(0, 256, dtype=np.uint8)
    curve = tuple(((np.arange(256) / 255.0) ** 1.7).tolist())
    by_curve = ProjectorResponse(curve=curve).light(levels)
    np.testing.assert_allclose(by_curve, ProjectorResponse(gamma=1.7).light(levels), atol=1e-12)
