"""The filter on relief: surfaces with known coordinates, noise of known size."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, gaussian_filter

from reconstruction.decoding._filter import gaussian_weights
from reconstruction.decoding.decode import DecodeOptions, Reason, decode
from reconstruction.patterns import PatternSet
from reconstruction.pipeline import Reconstruction, filter_bias
from reconstruction.rig.sensor import SensorNoise
from reconstruction.triangulation import triangulate

PATTERNS = PatternSet(1280, 720, steps=8)
SENSOR = SensorNoise(0.17, 6.2, 64.0, 4095.0)
ROWS, COLS = 240, 320
UNFILTERED = DecodeOptions(filter_taps=0)
# On the coat of the paper's rig: mm per camera pixel at full resolution, projector pixels per mm
# sideways (25 degrees) and upwards.
PIXEL_MM, ACROSS_PX_PER_MM, UP_PX_PER_MM = 0.0148, 5.8, 2.9
SLOPE = np.tan(np.radians(53.0))


@pytest.fixture
def noisy(synthesise):
    """Return a function that makes frames of a coat with shot and read noise, 12 bit."""

    def frames(column, lines, contrast=1.0, seed=5):
        clean = synthesise(PATTERNS, column, lines, mean_dn=0.0, amplitude_dn=900.0)
        clean = 1100.0 + contrast * clean
        noise = np.random.default_rng(seed).normal(size=clean.shape)
        noise *= np.sqrt(SENSOR.variance_dn2(clean) - 1.0 / 12.0)
        return np.rint(clean + noise).astype(np.uint16)

    return frames


def relief_mm(name, x_mm, y_mm):
    """Return heights: slopes up to 53 degrees, a texture of 12 um with 0.15 mm, or both."""
    steep = SLOPE / (2 * np.pi / 4.0) * np.sin(2 * np.pi * x_mm / 4.0) * np.cos(y_mm / 2.0)
    pitch_mm = x_mm[0, 1] - x_mm[0, 0]
    rough = np.random.default_rng(2).normal(size=x_mm.shape)
    rough = gaussian_filter(rough, 0.15 / 2.0 / pitch_mm, mode="wrap")
    texture = 0.012 * rough / rough.std()
    return {"flat": 0.0 * x_mm, "steep": steep, "texture": texture, "both": steep + texture}[name]


def coordinates(name, binning):
    """Return projector columns and rows of the pixel centres."""
    row, col = np.mgrid[0:ROWS, 0:COLS].astype(float)
    x_mm, y_mm = binning * PIXEL_MM * col, binning * PIXEL_MM * row
    column = 40.0 + ACROSS_PX_PER_MM * x_mm + UP_PX_PER_MM * relief_mm(name, x_mm, y_mm)
    return column, 40.0 + 6.3 * y_mm


def error_over_sigma(axis, truth, where):
    relative = ((axis.coordinate_px - truth) / np.maximum(axis.sigma_px, 1e-9))[where]
    return 1.4826 * np.median(np.abs(relative - np.median(relative)))


@pytest.mark.parametrize("binning", [1, 2, 4])
@pytest.mark.parametrize("name", ["flat", "steep", "texture", "both"])
def test_sigma_is_the_error_on_relief(noisy, name, binning):
    """Expected: within 0.85 and 1.15, the statistical error of 77,000 correlated pixels is 0.02."""
    column, lines = coordinates(name, binning)
    stack = noisy(column, lines)
    decoded, single = (decode(stack, PATTERNS, SENSOR, options) for options in (None, UNFILTERED))
    assert decoded.valid.sum() == single.valid.sum()
    assert error_over_sigma(single.column, column, single.valid) == pytest.approx(1.0, abs=0.03)
    assert 0.85 <= error_over_sigma(decoded.column, column, decoded.valid) <= 1.15


def test_filter_takes_no_relief_for_the_sake_of_noise(noisy):
    """Expected: never worse than the single pixel, three times better on the steep relief."""
    for name, most in (("steep", 0.4), ("both", 1.0)):
        column, lines = coordinates(name, 4)
        stack = noisy(column, lines)
        error = [
            np.std(decode(stack, PATTERNS, SENSOR, options).column.coordinate_px - column)
            for options in (None, UNFILTERED)
        ]
        assert error[0] <= most * error[1]


def test_sigma_has_no_bias_on_a_plane(noisy):
    """Expected: the Gaussian's own noise gain, times the sigma of the single pixel, within 2 %."""
    column, lines = coordinates("flat", 2)
    stack = noisy(column, lines)
    decoded, single = (decode(stack, PATTERNS, SENSOR, options) for options in (None, UNFILTERED))
    inner = np.s_[8:-8, 8:-8]
    gain = np.sum(gaussian_weights(8, 1.5).astype(float) ** 2)
    result = np.sqrt(np.mean(decoded.column.sigma_px[inner] ** 2))
    expected = gain * np.sqrt(np.mean(single.column.sigma_px[inner] ** 2))
    assert result == pytest.approx(expected, rel=0.02)
    assert np.mean(decoded.column.bias_share > 0.5) < 0.02


def test_a_bright_neighbour_does_not_draw_the_mean(noisy):
    """Setup: flakes, contrast from pixel to pixel between 0.4 and 1, on a tilted plane.

    Expected: only the noise of the camera; the phasor weighs with the contrast and would be wrong
    by 0.2 px. Sigma includes that the light of flakes is off the pixel's centre, here it is not.
    """
    column, lines = coordinates("flat", 4)
    contrast = np.random.default_rng(8).uniform(0.4, 1.0, column.shape)
    stack = noisy(column, lines, contrast)
    decoded, single = (decode(stack, PATTERNS, SENSOR, options) for options in (None, UNFILTERED))
    error_px = (decoded.column.coordinate_px - column)[8:-8, 8:-8]
    gain = np.sum(gaussian_weights(8, 1.5).astype(float) ** 2)
    noise_px = gain * np.sqrt(np.mean(single.column.sigma_px[8:-8, 8:-8] ** 2))
    assert np.std(error_px) == pytest.approx(noise_px, rel=0.05)
    assert error_over_sigma(decoded.column, column, decoded.valid) < 1.0


def test_holes_and_borders_do_not_shift_a_slope(synthesise):
    """Setup: noise-free plane of 1.3 px per pixel with holes.

    Expected: the plane everywhere, but for the four neighbours of each hole, masked EDGE.
    """
    row, col = np.mgrid[0:60, 0:90].astype(float)
    column, lines = 20.0 + 1.3 * col, 30.0 + 1.1 * row
    stack = synthesise(PATTERNS, column, lines).astype(np.float32)
    dark = np.random.default_rng(4).random(column.shape) < 0.03
    stack[:, dark] = 3.0
    decoded = decode(stack, PATTERNS, SensorNoise(0.0, 0.0, 0.0, 255.0))
    expected = np.where(binary_dilation(dark), int(Reason.EDGE), int(Reason.VALID))
    expected[dark] = Reason.DARK
    np.testing.assert_array_equal(decoded.mask_reason, expected)
    error_px = (decoded.column.coordinate_px - column)[decoded.valid]
    np.testing.assert_allclose(error_px, 0.0, atol=3e-4)


def test_sigma_next_to_holes_is_that_of_the_pairs_left(noisy):
    """Setup: 64 exposures of a plane with holes. Expected: spread over sigma is 1 next to them."""
    column, lines = (image[:48, :64] for image in coordinates("flat", 1))
    dark = np.random.default_rng(4).random(column.shape) < 0.02
    adjacent = binary_dilation(dark, iterations=3) & ~binary_dilation(dark)
    result, sigma = [], []
    for seed in range(64):
        stack = noisy(column, lines, seed=seed)
        stack[:, dark] = 64
        axis = decode(stack, PATTERNS, SENSOR).column
        result.append(axis.coordinate_px)
        sigma.append(axis.sigma_px)
    ratio = np.std(result, axis=0, ddof=1)[adjacent] / np.mean(sigma, axis=0)[adjacent]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)


def test_a_wrong_fringe_order_does_not_spread(noisy):
    """Setup: one pixel a period off. Expected: its neighbours keep their error below 6 sigma."""
    column, lines = (image[:40, :40].copy() for image in coordinates("flat", 1))
    truth = column.copy()
    column[20, 20] += PATTERNS.period_px
    axis = decode(noisy(column, lines), PATTERNS, SENSOR).column
    off = np.abs(axis.coordinate_px - truth) / axis.sigma_px
    off[20, 20] = 0.0
    assert off.max() < 6.0


def test_bands_and_patches_leave_no_trace(noisy, monkeypatch):
    column, lines = coordinates("both", 2)
    stack = noisy(column, lines)
    stack[:, np.random.default_rng(1).random(column.shape) < 0.01] = 64
    expected = decode(stack, PATTERNS, SENSOR)
    for rows in (7, 1000):
        monkeypatch.setattr("reconstruction.decoding._filter.BAND_ROWS", rows)
        result = decode(stack, PATTERNS, SENSOR)
        np.testing.assert_array_equal(result.column.coordinate_px, expected.column.coordinate_px)
        np.testing.assert_array_equal(result.column.sigma_px, expected.column.sigma_px)


def test_bias_is_estimated_without_truth(noisy, calibration, surface, project):
    """Expected: a share of points on texture near the noise, next to none on a smooth bump."""
    observed = project(calibration, surface(calibration))
    shares = []
    for rough_px in (0.0, 0.02):
        rough = gaussian_filter(np.random.default_rng(3).normal(size=observed.shape[:2]), 1.2)
        column = observed[..., 0] + rough_px * rough / rough.std()
        decoded = decode(noisy(column, observed[..., 1]), PATTERNS, SENSOR)
        result = Reconstruction(decoded, triangulate(decoded, calibration))
        valid = result.point_map.valid
        sigma_mm = result.point_map.sigma_z_mm[valid]
        bias_um, share = filter_bias(result, "column", valid, sigma_mm)
        assert bias_um >= 0.0
        shares.append(share)
    assert shares[0] < 0.1 < shares[1]
