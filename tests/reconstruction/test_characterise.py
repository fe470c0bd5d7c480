"""Camera and projector from captures: against the numbers that the captures were made with."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from reconstruction.characterise import (
    FitLimits,
    NoiseSamples,
    UncertainValue,
    dark_of,
    fit_projector,
    photon_transfer,
    prnu_of,
    samples_of_pairs,
    sparkle_of,
)
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

TRUE = SensorNoise(0.17, 6.2, 64.0, 4095.0)
STATED = SensorNoise(0.12, 9.0, 64.0, 4095.0)
FINE = 32


def recorded(clean, seed):
    rng = np.random.default_rng(seed)
    electrons = rng.poisson((clean - TRUE.black_level_dn).clip(0.0) / TRUE.gain_dn_per_e)
    read = TRUE.read_noise_e * rng.normal(size=clean.shape)
    dn = TRUE.black_level_dn + TRUE.gain_dn_per_e * (electrons + read)
    return np.rint(dn).clip(0, 4095).astype(np.uint16)


def shown(patterns, column_px, row_px, gamma, blur_px):
    """Return frames, 0 to 1; by a Gaussian filter on a grid 32 times finer than a pixel."""
    frames = []
    for frame in patterns.frames:
        light = (patterns.profile(frame) / 255.0) ** gamma
        fine = gaussian_filter1d(np.repeat(light, FINE), blur_px * FINE, mode="nearest")
        at_px = (np.arange(fine.size) + 0.5) / FINE - 0.5
        frames.append(np.interp(row_px if frame.axis == "row" else column_px, at_px, fine))
    return np.stack(frames)


def test_pairs_give_gain_and_read_noise():
    """Poisson light from black to 3000 DN, twice. Expected: within three uncertainties, below 1 %.

    Light that drifts by 2 % between the two has no effect.
    """
    clean = TRUE.black_level_dn + np.linspace(0.0, 3000.0, 12)[:, None, None] * np.ones((90, 120))
    drifted = TRUE.black_level_dn + 1.02 * (clean - TRUE.black_level_dn)
    for second in (clean, drifted):
        samples = samples_of_pairs(recorded(clean, 1), recorded(second, 2), TRUE)
        result = photon_transfer(samples, STATED)
        assert result.gain_dn_per_e.uncertainty < 0.01 * TRUE.gain_dn_per_e
        assert abs(result.gain_dn_per_e.value - 0.17) < 3.0 * result.gain_dn_per_e.uncertainty
        assert abs(result.read_noise_e.value - 6.2) < 3.0 * result.read_noise_e.uncertainty
        assert result.read_noise_e.uncertainty < 0.3
        assert 0.3 < result.chi2_per_bin < 2.0


def test_uncertainty_of_the_line_is_its_spread():
    """Setup: 200 lines through 20,000 normal samples each. Expected: 95 % within 1.96, +- 5 %."""
    rng, off = np.random.default_rng(3), []
    for _ in range(200):
        mean = rng.uniform(64.0, 3500.0, 20_000)
        square = TRUE.variance_dn2(mean) * rng.chisquare(1, mean.size)
        result = photon_transfer(NoiseSamples(mean, square), TRUE)
        gain, read = result.gain_dn_per_e, result.read_noise_e
        off.append((gain.value - 0.17) / gain.uncertainty)
        if read is not None:
            off.append((read.value - 6.2) / read.uncertainty)
    assert 0.90 < np.mean(np.abs(off) < 1.96) <= 0.99


def test_a_line_needs_light_and_samples():
    few = NoiseSamples(np.full(10, 500.0), np.ones(10))
    with pytest.raises(InputError, match="10 samples"):
        photon_transfer(few, TRUE)
    dark = NoiseSamples(np.full(9000, 500.0), np.ones(9000))
    with pytest.raises(InputError, match="equally bright"):
        photon_transfer(dark, TRUE)
    with pytest.raises(InputError, match="same sequence"):
        samples_of_pairs(np.zeros((2, 4, 4)), np.zeros((3, 4, 4)), TRUE)
    with pytest.raises(InputError, match="is none"):
        UncertainValue(float("nan"), 0.0)


def moved_texture(rng):
    """Two captures of a scene with 10 % of texture that moved: their variance is the texture's."""
    light = np.linspace(0.0, 3000.0, 12)[:, None, None] * np.ones((90, 120))
    clean = [64.0 + light * (1.0 + 0.1 * rng.normal(size=light.shape)).clip(0.0) for _ in range(2)]
    return recorded(clean[0], 1), recorded(clean[1], 2)


def reduced_noise(rng):
    """Noise of 1 DN at every level, as after noise reduction in a camera."""
    light = np.linspace(0.0, 3000.0, 12)[:, None, None] * np.ones((90, 120))
    return tuple(np.rint(64.0 + light + 1.3 * rng.normal(size=light.shape)) for _ in range(2))


def few_electrons(rng):
    """Full scale of 40 electrons: shot noise of a scene that no pixel has."""
    light_e = np.linspace(0.5, 25.0, 12)[:, None, None] * np.ones((90, 120))
    return tuple(64.0 + 100.0 * rng.poisson(light_e) for _ in range(2))


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        (moved_texture, r"differs by \d\d% \(RMS\) from a straight line, allowed 25%"),
        (reduced_noise, r"gain is .* DN/e-, allowed an uncertainty of up to 25%"),
        (few_electrons, r"full scale .* electrons, allowed 100 to 1e\+09"),
    ],
)
@pytest.mark.parametrize("seed", [3, 7, 10])
def test_a_line_that_no_sensor_has_is_no_gain(pair, message, seed):
    samples = samples_of_pairs(*pair(np.random.default_rng(seed)), TRUE)
    with pytest.raises(InputError, match=message) as caught:
        photon_transfer(samples, TRUE)
    assert "\n" not in str(caught.value)


def test_flat_frames_that_show_no_response_are_rejected():
    """Full pixels all read alike, so that their spread would be 0; a print is no even surface."""
    rng = np.random.default_rng(6)
    with pytest.raises(InputError, match=r"100\.0% of the pixels are saturated \(from 4088\.2 DN"):
        prnu_of(np.full((3, 90, 120), 4095), 64.0, clipped_from_dn=TRUE.clipped_from_dn)
    texture = 1.0 + 0.2 * rng.normal(size=(90, 120))
    flat = np.stack([recorded(64.0 + 1500.0 * texture, k) for k in range(3)])
    with pytest.raises(
        InputError, match=r"pixels differ by (19|20|21)\.\d%.*, allowed 10%; record"
    ):
        prnu_of(flat, 64.0, clipped_from_dn=TRUE.clipped_from_dn)


def test_dark_and_flat_frames():
    """Offsets of 2 e-, response of 0.8 %, light that decreases by 1/3 over the image."""
    rng = np.random.default_rng(5)
    offset_dn = 2.0 * 0.17 * rng.normal(size=(150, 200))
    response = 1.0 + 0.008 * rng.normal(size=(150, 200))
    dark = np.stack([recorded(64.0 + np.zeros((150, 200)), 20 + k) for k in range(6)]) + offset_dn
    result = dark_of(dark)
    assert abs(result.black_level_dn.value - 64.0) < 4.0 * result.black_level_dn.uncertainty
    assert result.noise_dn.value == pytest.approx(0.17 * 6.2, rel=0.02)
    assert result.dsnu_dn.value == pytest.approx(0.34, rel=0.05)
    fall = 1.0 - np.linspace(0.0, 0.33, 200)
    flat = np.stack([recorded(64.0 + 2500.0 * fall * response, 10 + k) for k in range(8)])
    prnu = prnu_of(flat, 64.0)
    # The mean square of the decreasing light is 1.013 times the square of their mean.
    assert prnu.value == pytest.approx(
        0.008 * np.sqrt(1.0 + np.var(fall) / fall.mean() ** 2), rel=0.04
    )
    with pytest.raises(InputError, match="at least 2"):
        dark_of(dark[:1])
    with pytest.raises(InputError, match="above black"):
        prnu_of(dark, 64.0)


@pytest.mark.parametrize(
    ("steps", "axes", "code", "gamma", "blur_px"),
    [
        (8, ("column", "row"), "complementary_gray", 1.3, 0.7),
        (3, ("column",), "gray", 1.8, 0.9),
    ],
)
def test_a_capture_determines_gamma_blur_and_noise(steps, axes, code, gamma, blur_px):
    """Single capture, pixels without footprint. Expected: the true values.

    Blur includes 50 % of the footprint of pixels of this spacing.
    """
    patterns = PatternSet(640, 360, steps=steps, axes=axes, code=code)
    row, col = np.mgrid[0:90, 0:150].astype(float)
    column, lines = 40.0 + 0.61 * col + 0.13 * row, 30.0 + 0.7 * row + 0.1 * col
    clean = 100.0 + (2600.0 + 2.0 * col) * shown(patterns, column, lines, gamma, blur_px)
    stack = recorded(clean, 2)
    decoded = decode(stack, patterns, STATED, DecodeOptions(filter_taps=0))
    result = fit_projector(stack, patterns, STATED, decoded)
    assert abs(result.gamma.value - gamma) < 4.0 * result.gamma.uncertainty + 1e-4
    assert result.gamma.uncertainty < 0.003
    assert abs(result.blur_px.value - blur_px) < 3.0 * result.blur_px.uncertainty
    assert result.blur_px.uncertainty < 0.03
    assert result.chi2 == pytest.approx(1.0, abs=0.05)
    gain = result.noise.gain_dn_per_e
    assert gain.value == pytest.approx(0.17, abs=4.0 * gain.uncertainty)
    assert gain.uncertainty < 0.03 * 0.17
    np.testing.assert_allclose(result.light_dn.mean(), 2600.0 + 150.0, rtol=0.03)


def test_a_diamond_chip_determines_the_blur_in_columns():
    """A lens blur of 0.7 columns is 1.4 rows; the mirrors add boxes of 0.5 columns and of 1 row.

    The chip is a filter chain on a fine grid. Expected: 0.7 within three uncertainties, and noise
    as recorded; with the same frames taken as of square pixels the residuals are far above noise.
    """
    patterns = PatternSet(320, 480, steps=8, code="gray", pixel_ratio="diamond")
    row, col = np.mgrid[0:60, 0:90].astype(float)
    column, line = 30.0 + 0.61 * col + 0.13 * row, 30.0 + 1.4 * row + 0.1 * col
    light = np.stack([
        smeared(patterns, frame, line if frame.axis == "row" else column)
        for frame in patterns.frames
    ])  # fmt: skip
    stack, options = recorded(100.0 + 2600.0 * light, 2), DecodeOptions(filter_taps=0)
    fits = []
    for shape in (patterns, replace(patterns, pixel_ratio=1.0)):
        decoded = decode(stack, shape, STATED, options)
        fits.append(fit_projector(stack, shape, STATED, decoded, FitLimits(pixels=1000)))
    assert fits[0].chi2 == pytest.approx(1.0, abs=0.05)
    assert abs(fits[0].blur_px.value - 0.7) < 3.0 * fits[0].blur_px.uncertainty
    assert fits[0].blur_px.uncertainty < 0.05
    assert fits[1].chi2 > 1.5


def smeared(patterns, frame, place_px):
    """Return the light of a frame of a diamond chip at places (row, col), px, along its axis."""
    blur_px, smear_px = (1.4, 1.0) if frame.axis == "row" else (0.7, 0.5)
    fine = np.repeat(patterns.profile(frame) / 255.0, FINE)
    fine = uniform_filter1d(fine, round(smear_px * FINE), mode="nearest")
    fine = gaussian_filter1d(fine, blur_px * FINE, mode="nearest")
    return np.interp(place_px, (np.arange(fine.size) + 0.5) / FINE - 0.5, fine)


def test_a_second_fit_begins_where_the_response_puts_the_pixels():
    """Three steps at gamma 2.1: read as if it were 1, some pixels settle beyond a bit's edge.

    Expected: chi-square far above 1 at first; decoded with the estimate, 1; gamma within
    0.001. By image pixels as large as a projector's, so that many are near edges.
    """
    patterns = PatternSet(640, 360, steps=3, code="gray")
    row, col = np.mgrid[0:150, 0:240].astype(float)
    column, line = 60.0 + 1.9 * col + 0.013 * row, 40.0 + 1.7 * row + 0.017 * col
    clean = 150.0 + 2600.0 * shown(patterns, column, line, 2.1, 0.5)
    stack = recorded(clean, 3)
    options = DecodeOptions(filter_taps=0, max_order_error=0.1)
    first = fit_projector(stack, patterns, TRUE, decode(stack, patterns, TRUE, options))
    assert first.chi2 > 1.2
    again = decode(stack, patterns, TRUE, options, response=first.response())
    second = fit_projector(stack, patterns, TRUE, again)
    assert second.chi2 == pytest.approx(1.0, abs=0.05)
    assert second.gamma.value == pytest.approx(2.1, abs=0.001)
    assert abs(second.blur_px.value - 0.5) < 3.0 * second.blur_px.uncertainty


def test_frames_that_determine_no_response_are_rejected():
    patterns = PatternSet(64, 64, steps=3, axes=("column",), period_px=64.0, uniform=False,
                          code="hierarchical")  # fmt: skip
    column, row = np.meshgrid(np.linspace(9.0, 54.0, 60), np.arange(20.0))
    stack = (100.0 + 2000.0 * shown(patterns, column, row, 1.0, 0.7)).astype(np.uint16)
    decoded = decode(stack, patterns, TRUE, DecodeOptions(filter_taps=0))
    with pytest.raises(InputError, match="do not determine"):
        fit_projector(stack, patterns, TRUE, decoded)


def test_a_gamma_at_the_end_of_its_range_is_none():
    """Seen with the square of its light, a projector of gamma 2.2 has 4.4, beyond 4."""
    patterns = PatternSet(640, 360, steps=8, code="complementary_gray")
    row, col = np.mgrid[0:60, 0:90].astype(float)
    column, line = 40.0 + 0.61 * col + 0.13 * row, 30.0 + 0.7 * row + 0.1 * col
    stack = recorded(100.0 + 2600.0 * shown(patterns, column, line, 2.2, 0.7) ** 2, 2)
    decoded = decode(stack, patterns, TRUE, DecodeOptions(filter_taps=0))
    with pytest.raises(
        InputError, match=r"does not converge: gamma 3\.\d+, allowed 0\.31 to 3\.99"
    ):
        fit_projector(stack, patterns, TRUE, decoded)


def white_frame(unevenness, seed=5):
    """Return a frame of slowly varying light, with an uneven coat, and its lit pixels."""
    row, col = np.mgrid[0:200, 0:300]
    slow = 900.0 + 400.0 * np.cos(row / 90.0) * np.cos(col / 120.0)
    lit = np.hypot(row - 100, col - 150) < 95
    clean = TRUE.black_level_dn + np.where(lit, slow * (1.0 + unevenness), 0.0)
    return recorded(clean, seed), lit


def test_an_even_coat_has_no_contrast_but_noise():
    """Noise is 1 % of the light here; the remainder is 0 within its uncertainty."""
    image, lit = white_frame(np.zeros((200, 300)))
    result = sparkle_of(image, TRUE, lit)
    assert result.contrast < 4.0 * result.uncertainty
    assert result.neighbours is None
    assert result.glints < 3e-4


@pytest.mark.parametrize(("grain_px", "neighbours"), [(0.0, 0.0), (0.8, 0.61)])
def test_contrast_of_a_grainy_coat(grain_px, neighbours):
    """3 % from pixel to pixel, or in grains; these keep their share except for the high-pass.

    After a Gaussian of 0.8 px neighbours share exp(-1 / (4 0.64)) = 0.68 of their variance.
    The mean over 49 pixels takes at most 4 pi 0.64 / 49 = 0.16 of the variance, and as much of the
    common part: (0.68 - 0.16) / (1 - 0.16).
    """
    uneven = np.random.default_rng(1).normal(size=(200, 300))
    if grain_px:
        uneven = gaussian_filter1d(gaussian_filter1d(uneven, grain_px, axis=0), grain_px, axis=1)
    image, lit = white_frame(0.03 * uneven / uneven.std())
    result = sparkle_of(image, TRUE, lit)
    remaining = 1.0 - 4.0 * np.pi * grain_px**2 / 49.0
    assert 0.03 * np.sqrt(remaining) * 0.97 < result.contrast < 0.03 * 1.02
    assert abs(result.neighbours - neighbours) < 0.05
    assert result.glints < 3e-4


def test_glints_are_counted():
    """1 % of the pixels are 50 % brighter: 5 % contrast, and nearly all are detected."""
    rng = np.random.default_rng(2)
    image, lit = white_frame(0.5 * (rng.random((200, 300)) < 0.01))
    result = sparkle_of(image, TRUE, lit)
    assert result.contrast == pytest.approx(0.05, rel=0.06)
    assert 0.008 < result.glints < 0.011


def test_too_little_coat_has_no_contrast():
    image, lit = white_frame(np.zeros((200, 300)))
    with pytest.raises(InputError, match="lit surroundings"):
        sparkle_of(image, TRUE, lit & (np.arange(300) < 72))
