"""All ways to number the fringes: exactness, edges under blur, and the predicted order errors."""

import numpy as np
import pytest

from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise

HIERARCHICAL = {"code": "hierarchical", "further_periods_px": (1300.0, 150.0)}
# Unambiguous over 1472 px: where the range ends at the image, noise wraps at its borders.
HETERODYNE = {
    "code": "heterodyne",
    "period_px": 1472 / 70,
    "further_periods_px": (1472 / 64, 1472 / 59),
}
MICRO = {"code": "micro", "further_periods_px": (15.5, 15.76, 16.45, 20.4, 20.72)}
ALL_CODES = [
    {"code": "gray"},
    {"code": "complementary_gray"},
    {"code": "shifted_gray"},
    {"code": "quaternary_gray"},
    HIERARCHICAL,
    HETERODYNE,
    {"code": "heterodyne", "period_px": 36.0, "further_periods_px": (37.0,)},
    MICRO,
    MICRO | {"further_periods_px": (*MICRO["further_periods_px"], 14.6, 17.1, 19.2, 21.9, 22.5)},
    HIERARCHICAL | {"further_periods_px": (1300.0, *(1300.0 * 0.62**n for n in range(1, 9)))},
]


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("change", ALL_CODES, ids=lambda change: change["code"])
@pytest.mark.parametrize("steps", [3, 4])
def test_every_code_decodes_exactly_up_to_the_image_border(quiet_sensor, synthesise, change, steps):
    """Setup: noise-free, pixels from the first to the last border of the projector image."""
    patterns = PatternSet(1280, 720, steps=steps, **change)
    column, row = np.meshgrid(np.linspace(-0.45, 1279.45, 900), np.linspace(-0.45, 719.45, 60))
    stack = synthesise(patterns, column, row).astype(np.float32)
    options = DecodeOptions(filter_taps=0, max_order_error=0.5)
    decoded = decode(stack, patterns, quiet_sensor, options)
    assert decoded.valid.mean() > 0.999
    assert rms((decoded.column.coordinate_px - column)[decoded.valid]) <= 1e-4
    assert rms((decoded.row.coordinate_px - row)[decoded.valid]) <= 1e-4


@pytest.mark.parametrize("period_px", [4.0, 5.5, 9.0, 17.3, 40.0])
@pytest.mark.parametrize("code", ["complementary_gray", "shifted_gray"])
def test_edge_safe_codes_with_any_period(quiet_sensor, synthesise, code, period_px):
    patterns = PatternSet(400, 300, period_px=period_px, steps=5, code=code)
    column, row = np.meshgrid(np.linspace(-0.45, 399.45, 901), np.linspace(-0.45, 299.45, 31))
    stack = synthesise(patterns, column, row).astype(np.float32)
    decoded = decode(stack, patterns, quiet_sensor, DecodeOptions(filter_taps=0))
    assert decoded.valid.mean() > 0.999
    assert np.max(np.abs((decoded.column.coordinate_px - column)[decoded.valid])) < 1e-3


@pytest.mark.parametrize("blur_px", [0.5, 3.0])
@pytest.mark.parametrize("code", ["complementary_gray", "shifted_gray"])
def test_edge_safe_codes_stand_blur_and_noise(synthesise, cover, code, blur_px):
    """Setup: modulation 90, noise 6 DN, blur to 3 px. Expected: no order error at all."""
    patterns = PatternSet(1280, 720, code=code)
    column, row = cover(100, 900, patterns)
    stack = synthesise(patterns, column, row, mean_dn=120.0, amplitude_dn=90.0, blur_px=blur_px)
    stack += np.random.default_rng(3).normal(0.0, 6.0, stack.shape)
    sensor = SensorNoise(1.0, 6.0, 1000.0, 2000.0)
    # Without the doubt of single bits: the rule itself must hold.
    options = DecodeOptions(filter_taps=0, gray_sigmas=0.0, max_order_error=1.0)
    decoded = decode(stack.astype(np.float32) + 1e-3, patterns, sensor, options)
    assert decoded.valid.mean() > 0.999
    assert np.max(np.abs((decoded.column.coordinate_px - column)[decoded.valid])) < 3.0
    assert np.max(np.abs((decoded.row.coordinate_px - row)[decoded.valid])) < 3.0


def test_words_of_the_shifted_code_check_each_other(quiet_sensor, synthesise, cover):
    """Setup: the coarsest bit of both axes is wrong everywhere. Expected: all pixels masked.

    Why: the complementary code notices a wrong bit only where the word must agree with the phase.
    """
    valid = {}
    for code in ("complementary_gray", "shifted_gray"):
        patterns = PatternSet(1280, 720, code=code)
        column, row = cover(40, 900, patterns)
        stack = synthesise(patterns, column, row).astype(np.float32)
        for axis in ("column", "row"):
            coarsest = patterns.index("gray", axis).start
            stack[coarsest] = 240.0 - stack[coarsest]
        decoded = decode(stack, patterns, quiet_sensor, DecodeOptions(filter_taps=0))
        valid[code] = decoded.valid.mean()
    assert valid["shifted_gray"] < 0.001
    assert valid["complementary_gray"] > 0.03


def noisy(patterns, synthesise, noise_dn, seed=4, shape=(250, 400)):
    row, col = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
    column = 40.0 + (patterns.width_px - 80.0) * (col + 0.3 * row / shape[0]) / shape[1]
    lines = 40.0 + (patterns.height_px - 80.0) * (row + 0.3 * col / shape[1]) / shape[0]
    stack = synthesise(patterns, column, lines, mean_dn=500.0, amplitude_dn=100.0)
    stack += np.random.default_rng(seed).normal(0.0, noise_dn, stack.shape)
    sensor = SensorNoise(1.0, noise_dn, 2000.0, 5000.0)
    options = DecodeOptions(filter_taps=0, max_phase_sigma_rad=1.0, max_order_error=1.0)
    decoded = decode(stack.astype(np.float32), patterns, sensor, options)
    return column, decoded


@pytest.mark.parametrize(
    ("change", "noise_dn"),
    [
        ({"code": "hierarchical", "period_px": 18.0, "further_periods_px": (1300.0,)}, 3.0),
        ({"code": "hierarchical", "period_px": 18.0, "further_periods_px": (1300.0, 400.0)}, 8.0),
        ({"code": "heterodyne", "period_px": 41.0, "further_periods_px": (42.35,)}, 6.0),
        (HETERODYNE, 12.0),
        (MICRO | {"steps": 3}, 9.0),
    ],
    ids=["2 levels", "3 levels", "2 near", "3 near", "single images"],
)
def test_predicted_order_errors_are_the_counted_ones(synthesise, change, noise_dn):
    """Setup: 100,000 pixels, so noisy that 0.1 to 20 % err. Expected: within a factor of 1.5.

    Why: the same number also separates good pixels from bad ones: of those predicted worse than the
    median, nearly all errors must be. Phase sigma is 0.017 to 0.07 rad; from 0.1 rad on the noise
    of the modulation itself makes the prediction too large.
    """
    patterns = PatternSet(1280, 720, **({"steps": 6} | change))
    column, decoded = noisy(patterns, synthesise, noise_dn)
    axis = decoded.column
    unwrapped = decoded.valid
    is_wrong = np.abs(axis.coordinate_px - column) > 0.5 * patterns.period_px
    counted = np.mean(is_wrong[unwrapped])
    predicted = float(axis.order_error[unwrapped].mean())
    assert unwrapped.mean() > 0.95
    assert 1e-3 < counted < 0.2
    assert counted / 1.5 < predicted < counted * 1.5
    worse = axis.order_error > np.median(axis.order_error)
    assert np.mean(worse[unwrapped & is_wrong]) > 0.9


@pytest.mark.parametrize("blur_px", [0.0, 0.3, 0.7])
def test_predicted_order_errors_of_plain_gray_are_not_too_few(synthesise, blur_px):
    """Setup: three steps, phase sigma 0.08 rad: 0.23 px, more than the edges of the bits are wide.

    Expected: with sharp edges, where noise carries phases over borders, the counted errors within a
    factor of 1.3; with blur the levels of the bits settle most of them, and the prediction is
    an upper bound, as the width of the edges is not known.
    """
    patterns = PatternSet(1280, 720, steps=3, code="gray", axes=("column",))
    row, col = np.mgrid[0:300, 0:600].astype(float)
    column = 40.0 + 1.9 * col + 0.013 * row
    stack = synthesise(patterns, column, row, mean_dn=500.0, amplitude_dn=100.0, blur_px=blur_px)
    stack += np.random.default_rng(4).normal(0.0, 10.0, stack.shape)
    sensor = SensorNoise(1e-3, 1e4, 0.0, 5000.0)
    options = DecodeOptions(filter_taps=0, max_phase_sigma_rad=1.0, max_order_error=1.0)
    axis = decode(stack.astype(np.float32), patterns, sensor, options).column
    unwrapped = axis.sigma_px > 0.0
    is_wrong = np.abs(axis.coordinate_px - column) > 9.0
    counted = np.mean(is_wrong[unwrapped])
    predicted = float(axis.order_error[unwrapped].mean())
    assert unwrapped.mean() > 0.99
    if blur_px == 0.0:
        assert counted > 5e-3
        assert counted / 1.3 < predicted < counted * 1.3
    else:
        assert counted <= predicted < 0.02
        assert counted < 5e-3


def test_mean_of_near_periods_is_better_by_the_root_of_their_number(synthesise):
    """Expected: sigma as predicted within 2 %, and 1 / sqrt(3) of one period's."""
    patterns = PatternSet(1280, 720, steps=6, **HETERODYNE)
    column, decoded = noisy(patterns, synthesise, 3.0)
    spread = np.std((decoded.column.coordinate_px - column)[decoded.valid])
    assert decoded.valid.mean() > 0.9999
    assert rms(decoded.column.sigma_px[decoded.valid]) == pytest.approx(spread, rel=0.02)
    one_period_px = patterns.periods_px[1] / (2.0 * np.pi) * np.sqrt(2.0 / 6.0) * 3.0 / 100.0
    assert spread == pytest.approx(one_period_px / np.sqrt(3.0), rel=0.03)


@pytest.mark.parametrize("steps", [3, 4])
def test_sigma_of_single_images_is_the_spread(synthesise, steps):
    """Expected: within 2 %, and better than with the N steps only."""
    patterns = PatternSet(1280, 720, steps=steps, **MICRO)
    column, decoded = noisy(patterns, synthesise, 3.0)
    axis = decoded.column
    error = ((axis.coordinate_px - column) / axis.sigma_px)[decoded.valid]
    assert decoded.valid.mean() > 0.9999
    assert np.std(error) == pytest.approx(1.0, abs=0.02)
    steps_alone_px = 18.0 / (2.0 * np.pi) * np.sqrt(2.0 / steps) * 3.0 / 100.0
    assert rms(axis.sigma_px) < 0.75 * steps_alone_px


def test_light_between_surfaces_causes_no_error_of_single_images(synthesise):
    """Setup: every pixel also gets light of a wide patch 300 px aside. Expected: no order error.

    Why: its purpose (Gupta and Nayar 2012). Such light has no fringes left of these periods; a
    coarse period keeps its own, and the hierarchy that rests on it puts pixels on other fringes.
    """
    row, col = np.mgrid[0:40, 0:800].astype(float)
    column = 40.0 + 1.1 * col + 0.013 * row
    wrong = {}
    coarse = {"code": "hierarchical", "further_periods_px": (1300.0,)}
    for name, change in (("micro", MICRO), ("hierarchical", coarse)):
        patterns = PatternSet(1280, 720, steps=6, **change)
        direct = synthesise(patterns, column, row)
        # Mean over the patch: a box of 200 px, of which only long periods leave something.
        places = np.linspace(-100.0, 100.0, 81) + 300.0
        aside = np.mean([synthesise(patterns, column + x, row) for x in places], axis=0)
        stack = (direct + 0.5 * aside).astype(np.float32)
        sensor = SensorNoise(1.0, 0.05, 0.0, 1000.0)
        options = DecodeOptions(filter_taps=0, max_order_error=1.0)
        result = decode(stack, patterns, sensor, options).column.coordinate_px
        wrong[name] = np.mean(np.abs(result - column) > 9.0)
    assert wrong["micro"] == 0.0
    assert wrong["hierarchical"] > 0.3


@pytest.mark.parametrize("blur_px", [0.7, 1.5])
def test_blur_takes_the_more_of_a_finer_period(synthesise, blur_px):
    """Setup: blur that gives the finest single image 2 or 8 % less modulation than the coarsest.

    Expected: sigma equals the spread; with one modulation for all it would be 5 times as much.
    """
    patterns = PatternSet(1280, 720, steps=3, axes=("column",), **MICRO)
    row, col = np.mgrid[0:100, 0:600].astype(float)
    column = 40.0 + 1.9 * col + 0.013 * row
    stack = synthesise(patterns, column, row, amplitude_dn=100.0, blur_px=blur_px)
    stack += np.random.default_rng(4).normal(0.0, 0.5, stack.shape)
    # The model adds the rounding of whole numbers.
    sensor = SensorNoise(1e-6, 1e6 * np.sqrt(0.25 - 1.0 / 12.0), 0.0, 1000.0)
    decoded = decode(stack.astype(np.float32), patterns, sensor, DecodeOptions(filter_taps=0))
    axis = decoded.column
    assert decoded.valid.mean() > 0.99
    error = ((axis.coordinate_px - column) / axis.sigma_px)[decoded.valid]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1.0, abs=0.05)


def test_clipped_single_images_are_left_out(synthesise):
    """Setup: the brightest 15 % of the levels clip. Expected: orders right, sigma honest."""
    patterns = PatternSet(1280, 720, steps=6, axes=("column",), **MICRO)
    row, col = np.mgrid[0:100, 0:600].astype(float)
    column = 40.0 + 1.9 * col + 0.013 * row
    stack = synthesise(patterns, column, row, mean_dn=120.0, amplitude_dn=100.0)
    stack += np.random.default_rng(4).normal(0.0, 1.0, stack.shape)
    sensor = SensorNoise(1e-3, 1e3, 0.0, 205.0)
    clipped = np.minimum(stack, 205.0).astype(np.float32)
    decoded = decode(clipped, patterns, sensor, DecodeOptions(filter_taps=0))
    error = (decoded.column.coordinate_px - column)[decoded.valid]
    right = np.abs(error) < 9.0
    assert decoded.valid.mean() > 0.95
    assert np.mean(~right) < 1e-3
    sigma = decoded.column.sigma_px[decoded.valid]
    assert 0.9 < np.std(error[right] / sigma[right]) < 1.1


def test_a_response_does_not_go_with_single_images(quiet_sensor, synthesise, cover):
    patterns = PatternSet(1280, 720, **MICRO)
    stack = synthesise(patterns, *cover(8, 8, patterns)).astype(np.float32)
    with pytest.raises(InputError, match="micro"):
        decode(stack, patterns, quiet_sensor, response=ProjectorResponse(1.2))


def test_uncertain_orders_are_masked(synthesise):
    """Expected: with the default limit hardly any order error is left."""
    patterns = PatternSet(1280, 720, steps=6, code="hierarchical", further_periods_px=(1300.0,))
    column, loose = noisy(patterns, synthesise, 3.0)
    is_wrong = np.abs(loose.column.coordinate_px - column) > 9.0
    is_kept = loose.valid & (loose.column.order_error <= DecodeOptions().max_order_error)
    assert is_kept.mean() > 0.5
    assert np.mean(is_wrong[is_kept]) < 2e-3
    assert np.mean(is_wrong[loose.valid]) > 1e-2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"code": "morse"}, "morse"),
        ({"code": None}, "None"),
        ({"code": "hierarchical"}, "unambiguous over"),
        ({"code": "hierarchical", "further_periods_px": (1000.0,)}, "1000"),
        ({"code": "hierarchical", "further_periods_px": (1300.0, 12.0)}, "below all"),
        ({"code": "heterodyne"}, "one or two"),
        ({"code": "heterodyne", "further_periods_px": (17.0,)}, "decreasing beat"),
        ({"code": "heterodyne", "further_periods_px": (19.0,)}, "unambiguous over"),
        ({"further_periods_px": (19.0,)}, "leave it out"),
        ({"code": "micro", "further_periods_px": (19.0,)}, "two or more"),
        ({"code": "micro", "further_periods_px": (19.0, 17.0), "steps": 2}, "steps"),
        ({"code": "micro", "further_periods_px": (36.0, 9.0)}, "differ by only"),
        ({"code": "micro", "further_periods_px": (15.5, 20.4), "inverse": True}, "no bits"),
        ({"code": "hierarchical", "further_periods_px": (2.0,)}, "further_periods_px"),
        ({"code": "hierarchical", "further_periods_px": "1300"}, "further_periods_px"),
    ],
)
def test_codes_that_cannot_work_are_rejected(change, message):
    with pytest.raises(InputError, match=message):
        PatternSet(**({"width_px": 1280, "height_px": 720} | change))
