"""Flakes that glint: error and sigma of the filtered coordinate, and masks of saturated glints."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, maximum_filter

from benchmarks.coat_decoder import (
    QUIET,
    SENSOR,
    FlakedCoat,
    capture,
    inner,
    sigma_um,
)
from reconstruction.compact import Half
from reconstruction.decoding import glints
from reconstruction.decoding._filter import gaussian_weights
from reconstruction.decoding._glints import GlintPixels, GlintScale, add_glint_rows
from reconstruction.decoding._rows import BIAS
from reconstruction.decoding.by_modulation import filter_phase
from reconstruction.decoding.decode import DecodeOptions, Reason, decode
from reconstruction.errors import InputError
from reconstruction.evaluate.fit import rms
from twin.config import decode_settings
from twin.pipeline.captures import options_of

COAT = FlakedCoat()
SHAPE = (120, 160)
UNIT = 2.0**-6


@pytest.fixture(scope="module")
def glinting():
    return capture(COAT, SHAPE)


@pytest.fixture(scope="module")
def plain():
    return capture(replace(COAT, light_share=0.0), SHAPE)


def normalised(taken, weights):
    """Return RMS of error over sigma."""
    decoded = taken.decoded(weights)
    return rms(taken.errors_um(decoded) / sigma_um(decoded.column, inner(decoded)))


@pytest.mark.parametrize("blur_um", [4.0, 8.0, 10.0])
def test_glints_do_not_pull_the_filter(blur_um):
    """Setup: footprints of 14 to 25 um, frames without camera noise.

    Expected: weighted by modulation 7 to 14 um, with equal weights at most 2 um.
    """
    taken = capture(replace(COAT, blur_um=blur_um), SHAPE)
    weighted, equal = (
        rms(taken.errors_um(taken.decoded(weights, QUIET))) for weights in ("modulation", "equal")
    )
    assert 7.0 < weighted < 14.0
    assert equal < 2.0


def test_equal_weights_cost_no_noise_on_a_plain_coat(plain):
    by_weights = [rms(plain.errors_um(plain.decoded(w))) for w in ("equal", "modulation")]
    assert by_weights[0] < 1.05 * by_weights[1]


@pytest.mark.parametrize("weights", ["equal", "modulation"])
def test_sigma_is_the_error_on_a_plain_coat(plain, weights):
    assert normalised(plain, weights) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("weights", ["equal", "modulation"])
def test_sigma_includes_the_error_by_glints(glinting, weights):
    assert normalised(glinting, weights) == pytest.approx(1.0, abs=0.1)


def test_sigma_of_single_glints_without_noise(glinting):
    """The sigma of the camera's noise would be 5 times too small; the stated one is not."""
    decoded = glinting.decoded("equal", QUIET)
    relative = glinting.errors_um(decoded) / sigma_um(decoded.column, inner(decoded))
    assert 0.5 < rms(relative) < 1.25


def test_only_saturated_pixels_are_masked():
    """Setup: three times the exposure, 1 % of the glints above full scale.

    Expected: no valid pixel has a wrong order, and each masked pixel or its neighbour is clipped.
    """
    taken = capture(COAT, SHAPE, exposure=3.0)
    decoded = taken.decoded("equal")
    off_px = np.abs(decoded.column.coordinate_px - taken.column_px)[decoded.valid]
    assert off_px.max() < 0.5
    is_clipped = taken.clean_dn.max(axis=0) > SENSOR.clipped_from_dn
    is_masked = decoded.mask_reason == Reason.SATURATED
    assert is_masked.sum() > 20
    assert np.all(is_clipped[is_masked])
    assert np.sum(~decoded.valid) < 1.2 * is_masked.sum()
    assert is_masked.sum() < 0.6 * is_clipped.sum()


def test_clipped_threshold_of_the_bits_masks_the_pixel(patterns, quiet_sensor, synthesise):
    """Setup: mean of the fringe above full scale, so that no Gray frame exceeds it."""
    column, row = np.full((9, 9), 365.0), np.full((9, 9), 185.0)
    for mean_dn, reason in ((250.0, Reason.VALID), (270.0, Reason.SATURATED)):
        stack = synthesise(patterns, column, row, mean_dn=mean_dn, amplitude_dn=0.9 * mean_dn)
        stack = np.clip(np.rint(stack), 0.0, 255.0).astype(np.float32)
        assert np.all(decode(stack, patterns, quiet_sensor).mask_reason == reason)


def grainy_modulation(s_px, contrast=0.1, fine=5):
    """Return modulations and their noise variance: white noise blurred by a footprint of s px."""
    rough = np.random.default_rng(3).normal(size=(200 * fine, 300 * fine))
    rough = gaussian_filter(rough, s_px * fine)[::fine, ::fine]
    modulation = (1.0 + contrast * rough / rough.std()).astype(np.float32)
    return modulation, np.full(rough.shape, 1e-6, np.float32)


def factor(modulation, noise):
    usable = np.ones(modulation.shape, bool)
    return glints.factor_of(*(glints._bends(modulation, noise, usable, k) for k in (1, 2)))


@pytest.mark.parametrize("s_px", [0.5, 0.65, 0.75])
def test_footprint_is_estimated_from_the_graininess(s_px):
    """Setup: weak Gaussian graininess. Expected: the factor of the footprint, within 15 %."""
    share = 1.0 - np.exp(-1.0 / s_px**2)
    expected = glints.DENOMINATOR * 0.25 * s_px**2 / share
    assert factor(*grainy_modulation(s_px)) == pytest.approx(expected, rel=0.15)


def test_a_few_edges_are_no_graininess():
    """Setup: steps of 30 % at two columns of a smooth image. Expected: no glints."""
    modulation, noise = grainy_modulation(0.0, contrast=1e-6)
    modulation[:, 100:] *= 1.3
    modulation[:, 203:] *= 0.7
    assert factor(modulation, noise) == 0.0


def test_noise_and_shading_are_no_graininess():
    modulation, noise = grainy_modulation(0.0, contrast=0.03)
    assert factor(modulation, noise) == pytest.approx(1 / 24, rel=0.2)
    assert factor(modulation, noise + np.float32(4e-4)) == 0.0
    assert factor(*grainy_modulation(0.0, contrast=0.005)) == 0.0
    assert factor(*grainy_modulation(1.0)) == factor(*grainy_modulation(3.0)) == 0.0
    assert factor(modulation[:, :2], noise[:, :2]) == 0.0
    modulation[:, ::7] = 0.0
    assert factor(modulation, noise) >= 0.0


def added_px2(column_px, modulation, reason=None, limit_px=9.0):
    """Return the variance that glints add, (row, col) px^2, for a factor of 1 / 24."""
    sigma = np.full((1, *modulation.shape), 2.0**-8, np.float32)
    reason = np.zeros(modulation.shape, np.uint8) if reason is None else reason
    maps = GlintPixels(
        column_px[None].astype(np.float32), Half.of(sigma * (reason == 0), UNIT).bits, reason,
        Half.of(modulation, 1.0).bits,
    )  # fmt: skip
    scale = GlintScale(
        np.float32(1 / 24), np.array([limit_px], np.float32),
        np.float32(UNIT / BIAS), np.float32(BIAS / UNIT),
    )  # fmt: skip
    add_glint_rows(0, len(reason), maps, scale)
    return np.square(Half(maps.sigma[0], UNIT).expand()) - np.square(sigma[0]) * (reason == 0)


def test_one_glint_by_hand():
    """Setup: plane of 2 px per column and 0.5 px per row; one pixel four times as bright.

    Expected: its neighbours along a row get (3/4)^2 / 24 times 2^2, those along a column 0.5^2.
    """
    row, col = np.mgrid[:7, :9].astype(float)
    modulation = np.ones((7, 9), np.float32)
    modulation[3, 4] = 4.0
    result = added_px2(2.0 * col + 0.5 * row, modulation)
    expected = np.zeros((7, 9))
    expected[3, [3, 5]] = 4.0 * 0.75**2 / 24.0
    expected[[2, 4], 4] = 0.25 * 0.75**2 / 24.0
    np.testing.assert_allclose(result, expected, rtol=2e-3, atol=1e-7)


def test_slope_at_a_hole_is_to_the_other_neighbour():
    """Setup: the brightest pixel is masked, and one pixel has a wrong order."""
    _, col = np.mgrid[:7, :9].astype(float)
    modulation, reason = np.ones((7, 9), np.float32), np.zeros((7, 9), np.uint8)
    modulation[3, 4], reason[3, 4] = 4.0, Reason.SATURATED
    column_px = 2.0 * col
    column_px[3, 6] += 18.0
    result = added_px2(column_px, modulation, reason)
    assert result[3, 3] == pytest.approx(4.0 * 0.75**2 / 24.0, rel=2e-3)
    assert result[3, 4] == 0.0
    # Both neighbours of this pixel are excluded.
    assert result[3, 5] == pytest.approx(0.0, abs=1e-7)


def test_bands_leave_no_trace(glinting, monkeypatch):
    expected = glinting.decoded("equal").column.sigma_px
    monkeypatch.setattr(glints, "BAND_ROWS", 7)
    np.testing.assert_array_equal(glinting.decoded("equal").column.sigma_px, expected)


def test_variance_is_propagated_with_the_weights():
    """200 draws of phase noise on glints. Expected: mean spread over sigma 1 +- 0.03."""
    rng, shape = np.random.default_rng(4), (24, 32)
    modulation = np.where(rng.random(shape) < 0.1, 8.0, 1.0).astype(np.float32)
    sigma = (0.02 / np.sqrt(modulation)).astype(np.float32)
    phase = (0.2 * np.arange(shape[1]) * np.ones((shape[0], 1))).astype(np.float32)
    usable, weights = np.ones(shape, bool), gaussian_weights(8, 1.5)
    usable[10:13, 12:15] = False
    lit, draws = modulation * usable, []
    for _ in range(200):
        noisy = phase + sigma * rng.standard_normal(shape).astype(np.float32)
        change, noise, _ = filter_phase(noisy, lit, sigma, usable, weights)
        draws.append((noisy + change)[usable])
    ratio = np.std(draws, axis=0) / np.sqrt(noise[usable])
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.03)
    far = maximum_filter(~usable, 3)[usable]
    assert np.mean(ratio[far]) == pytest.approx(1.0, abs=0.1)


def test_weights_are_a_key_of_the_experiment():
    settings = decode_settings(weights="modulation")
    assert options_of(settings).decode.weights == "modulation"
    assert "weights" not in decode_settings().model_dump()
    with pytest.raises(InputError, match="weights is 'median'; allowed are equal, modulation"):
        DecodeOptions(weights="median")
