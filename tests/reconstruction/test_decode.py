import numpy as np
import pytest

from reconstruction.decoding.decode import DecodeOptions, Reason, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

UNFILTERED = DecodeOptions(filter_taps=0)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_noiseless_float_frames_decode_exactly(patterns, quiet_sensor, synthesise, cover):
    column, row = cover(120, 700, patterns)
    stack = synthesise(patterns, column, row).astype(np.float32)
    decoded = decode(stack, patterns, quiet_sensor, UNFILTERED)
    assert decoded.valid.all()
    assert rms(decoded.column.coordinate_px - column) <= 1e-4
    assert rms(decoded.row.coordinate_px - row) <= 1e-4


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_eight_bit_frames_decode_within_quantisation(
    patterns, quiet_sensor, synthesise, cover, dtype
):
    column, row = cover(120, 700, patterns)
    stack = np.rint(synthesise(patterns, column, row)).astype(dtype)
    decoded = decode(stack, patterns, quiet_sensor, UNFILTERED)
    assert decoded.valid.all()
    assert rms(decoded.column.coordinate_px - column) <= 0.004
    assert rms(decoded.row.coordinate_px - row) <= 0.004


@pytest.mark.parametrize("gamma", [1.1, 2.2])
def test_eighteen_steps_cancel_the_harmonics_of_a_response_curve(
    patterns, quiet_sensor, synthesise, cover, gamma
):
    """Setup: I^gamma, noise-free. Expected: < 0.1 mrad, as only harmonics 18 m +- 1 survive."""
    column, row = cover(60, 400, patterns)
    stack = (
        synthesise(patterns, column, row, mean_dn=0.5, amplitude_dn=0.45).clip(0.0, 1.0) ** gamma
        * 200.0
    )
    decoded = decode(stack.astype(np.float32), patterns, quiet_sensor, UNFILTERED)
    error_rad = (decoded.column.coordinate_px - column)[decoded.valid] * 2.0 * np.pi / 18.0
    assert decoded.valid.mean() > 0.99
    assert rms(error_rad) < 1e-4


def test_phase_grows_to_the_right_and_downwards(patterns, quiet_sensor):
    """Setup: camera pixel (col, row) = projector pixel (u, v), through `image` itself."""
    window = (slice(0, 90), slice(0, 120))
    stack = np.stack([patterns.image(frame)[window] for frame in patterns.frames])
    quiet = SensorNoise(0.0, 0.0, 0.0, 256.0)
    decoded = decode(stack, patterns, quiet, UNFILTERED)
    assert decoded.valid.all()
    row, col = np.mgrid[0:90, 0:120]
    np.testing.assert_allclose(decoded.column.coordinate_px, col, atol=0.01)
    np.testing.assert_allclose(decoded.row.coordinate_px, row, atol=0.01)
    assert decoded.column.phase_rad[0, 5] == pytest.approx(2.0 * np.pi * 5 / 18, abs=2e-3)
    assert np.all((decoded.row.phase_rad >= 0.0) & (decoded.row.phase_rad < 2.0 * np.pi))
    np.testing.assert_array_equal(
        decoded.column.order, np.rint((col * 2 * np.pi / 18 - decoded.column.phase_rad) / 2 / np.pi)
    )


@pytest.mark.parametrize("taps", [2, 5, 8])
def test_filter_does_not_shift_a_ramp(patterns, quiet_sensor, synthesise, taps):
    """Expected: an even filter with a fixed anchor would shift by half a pixel, 0.65 px here."""
    row, col = np.mgrid[0:60, 0:300].astype(float)
    column, lines = 20.0 + 1.3 * col, 30.0 + 1.1 * row
    stack = synthesise(patterns, column, lines).astype(np.float32)
    decoded = decode(stack, patterns, quiet_sensor, DecodeOptions(filter_taps=taps))
    assert decoded.valid.all()
    np.testing.assert_allclose(decoded.column.coordinate_px, column, atol=3e-4)
    np.testing.assert_allclose(decoded.row.coordinate_px, lines, atol=3e-4)


@pytest.mark.parametrize("blur_px", [0.5, 1.5, 3.0])
@pytest.mark.parametrize("noise_dn", [2.0, 6.0])
def test_complementary_bit_prevents_order_errors(patterns, synthesise, cover, blur_px, noise_dn):
    column, row = cover(100, 900, patterns)
    stack = synthesise(patterns, column, row, mean_dn=120.0, amplitude_dn=90.0, blur_px=blur_px)
    stack += np.random.default_rng(3).normal(0.0, noise_dn, stack.shape)
    sensor = SensorNoise(0.0 if noise_dn == 0 else 1.0, noise_dn, 1000.0, 2000.0)
    decoded = decode(stack.astype(np.float32), patterns, sensor, UNFILTERED)
    error = (decoded.column.coordinate_px - column)[decoded.valid]
    assert decoded.valid.mean() > 0.998
    assert np.max(np.abs(error)) < 3.0
    assert np.max(np.abs((decoded.row.coordinate_px - row)[decoded.valid])) < 3.0


@pytest.mark.parametrize("noise_dn", [2.0, 6.0])
@pytest.mark.parametrize("blur_px", [0.5, 1.5, 3.0])
def test_plain_gray_code_stands_blur_and_noise(synthesise, cover, blur_px, noise_dn):
    """Why: at a border errors of bit and phase differ; levels of two bits determine the border.

    Taken as read, 0.1 to 1.2 % of the pixels are a period off.
    """
    patterns = PatternSet(1280, 720, code="gray")
    column, row = cover(60, 900, patterns)
    stack = synthesise(patterns, column, row, mean_dn=120.0, amplitude_dn=90.0, blur_px=blur_px)
    stack += np.random.default_rng(3).normal(0.0, noise_dn, stack.shape)
    sensor = SensorNoise(1e-3, 1e3 * noise_dn, 0.0, 2000.0)
    decoded = decode(stack.astype(np.float32), patterns, sensor, UNFILTERED)
    assert decoded.valid.mean() > 0.998
    assert np.max(np.abs((decoded.column.coordinate_px - column)[decoded.valid])) < 3.0
    assert np.max(np.abs((decoded.row.coordinate_px - row)[decoded.valid])) < 3.0


@pytest.mark.parametrize("taps", [0, 8])
@pytest.mark.parametrize("steps", [5, 18])
def test_predicted_sigma_is_the_spread(synthesise, taps, steps):
    """Setup: shot and read noise, 12 bit, 240,000 pixels. Expected: sigma within 2 %."""
    patterns = PatternSet(1280, 720, steps=steps)
    sensor = SensorNoise(0.17, 6.2, 64.0, 4095.0)
    row, col = np.mgrid[0:400, 0:600].astype(float)
    column, lines = 20.0 + 0.11 * col + 0.02 * row, 30.0 + 0.12 * row
    clean = synthesise(patterns, column, lines, mean_dn=1100.0, amplitude_dn=900.0)
    noise = np.random.default_rng(11).normal(size=clean.shape)
    stack = np.rint(clean + noise * np.sqrt(sensor.variance_dn2(clean) - 1.0 / 12.0))
    decoded = decode(stack.astype(np.uint16), patterns, sensor, DecodeOptions(filter_taps=taps))
    for axis, truth in ((decoded.column, column), (decoded.row, lines)):
        spread = np.std((axis.coordinate_px - truth)[decoded.valid])
        assert rms(axis.sigma_px[decoded.valid]) == pytest.approx(spread, rel=0.02)


def test_mean_and_modulation_are_those_of_the_signal(patterns, quiet_sensor, synthesise, cover):
    column, row = cover(40, 300, patterns)
    stack = synthesise(patterns, column, row, mean_dn=120.0, amplitude_dn=80.0).astype(np.float32)
    decoded = decode(stack, patterns, quiet_sensor, UNFILTERED)
    np.testing.assert_allclose(decoded.column.mean_dn, 120.0, rtol=1e-5)
    np.testing.assert_allclose(decoded.row.modulation_dn, 80.0, rtol=1e-5)


def flat_capture(patterns, synthesise, shape=(30, 40)):
    """Return frames of a camera that looks at the middle of one half-period everywhere."""
    column = np.full(shape, 18.0 * 20 + 5.0)
    row = np.full(shape, 18.0 * 10 + 5.0)
    return synthesise(patterns, column, row).astype(np.float32)


def reason_after(patterns, synthesise, sensor, change, options=UNFILTERED):
    stack = flat_capture(patterns, synthesise)
    change(stack[:, 10, 10])
    decoded = decode(stack, patterns, sensor, options)
    others = np.delete(decoded.mask_reason.ravel(), 10 * 40 + 10)
    if options.filter_taps == 0:
        assert np.all(others == Reason.VALID)
    assert decoded.column.coordinate_px[10, 10] == 0.0 or decoded.valid[10, 10]
    return decoded.mask_reason[10, 10]


def test_dark_pixel(patterns, quiet_sensor, synthesise):
    def no_light(pixel):
        pixel[:] = 3.0

    assert reason_after(patterns, synthesise, quiet_sensor, no_light) == Reason.DARK


def test_low_modulation_pixel(patterns, quiet_sensor, synthesise):
    def no_fringes(pixel):
        pixel[:36] = 120.0

    assert reason_after(patterns, synthesise, quiet_sensor, no_fringes) == Reason.LOW_MODULATION
    strict = DecodeOptions(filter_taps=0, min_modulation_dn=50.0)

    def weak_fringes(pixel):
        pixel[:36] = 120.0 + 0.4 * (pixel[:36] - 120.0)

    assert reason_after(patterns, synthesise, quiet_sensor, weak_fringes) == Reason.VALID
    assert (
        reason_after(patterns, synthesise, quiet_sensor, weak_fringes, strict)
        == Reason.LOW_MODULATION
    )


@pytest.mark.parametrize("frames", [range(16), range(20, 36), range(11)])
def test_pixel_with_too_few_good_frames(patterns, quiet_sensor, synthesise, frames):
    """Setup: 2 frames are left along one axis, or 7 neighbours: condition number 24."""

    def clip(pixel):
        pixel[list(frames)] = 255.0

    strict = DecodeOptions(filter_taps=0, max_condition=20.0)
    assert reason_after(patterns, synthesise, quiet_sensor, clip, strict) == Reason.SATURATED


def test_saturated_white_frame_does_no_harm(patterns, quiet_sensor, synthesise):
    def clip(pixel):
        pixel[51] = 255.0

    assert reason_after(patterns, synthesise, quiet_sensor, clip) == Reason.VALID


@pytest.mark.parametrize("bit", range(7))
def test_doubtful_gray_bit(patterns, quiet_sensor, synthesise, bit):
    def blur(pixel):
        pixel[36 + bit] = 120.1

    assert reason_after(patterns, synthesise, quiet_sensor, blur) == Reason.ORDER_UNCERTAIN


@pytest.mark.parametrize(("column_px", "frame"), [(360.2, 40), (359.8, 40), (368.8, 43)])
def test_the_bit_that_changes_here_may_be_doubtful(
    patterns, quiet_sensor, synthesise, column_px, frame
):
    """Setup: half-period 39 | 40 flips bit 4 of the word, 40 | 41 the complementary bit."""
    column, row = np.full((9, 9), column_px), np.full((9, 9), 100.0)
    stack = synthesise(patterns, column, row).astype(np.float32)
    stack[frame] = 120.1
    decoded = decode(stack, patterns, quiet_sensor, UNFILTERED)
    assert decoded.valid.all()
    np.testing.assert_allclose(decoded.column.coordinate_px, column, atol=1e-3)


def test_word_that_contradicts_the_phase(patterns, quiet_sensor, synthesise):
    def flip(pixel):
        pixel[43] = 240.0 - pixel[43]

    assert reason_after(patterns, synthesise, quiet_sensor, flip) == Reason.ORDER_UNCERTAIN


def test_word_beyond_the_last_period(patterns, quiet_sensor, synthesise):
    def shift(pixel):
        pixel[36:44] = [220, 20, 20, 20, 20, 20, 20, 20]  # word 255 of 143

    assert reason_after(patterns, synthesise, quiet_sensor, shift) == Reason.ORDER_UNCERTAIN


def test_pixel_that_looks_past_the_projector(quiet_sensor, synthesise):
    """Setup: the last period is cut at pixel 99; a scatterer shows phase beyond it."""
    patterns = PatternSet(100, 60)
    column, row = np.full((9, 9), 102.0), np.full((9, 9), 30.0)
    stack = synthesise(patterns, column, row).astype(np.float32)
    decoded = decode(stack, patterns, quiet_sensor, UNFILTERED)
    assert np.all(decoded.mask_reason == Reason.OUTSIDE_PROJECTOR)


@pytest.mark.parametrize("taps", [0, 8])
def test_masked_pixels_hold_zero_and_damaged_floats_are_masked(
    patterns, quiet_sensor, synthesise, taps
):
    stack = flat_capture(patterns, synthesise)
    stack[:, 4, 4] = np.nan
    stack[3, 5, 5] = np.nan
    decoded = decode(stack, patterns, quiet_sensor, DecodeOptions(filter_taps=taps))
    assert decoded.mask_reason[4, 4] == Reason.DARK
    assert decoded.mask_reason[5, 5] == Reason.VALID
    for axis in (decoded.column, decoded.row):
        for field in (axis.coordinate_px, axis.sigma_px, axis.order):
            assert np.all(field[~decoded.valid] == 0)
        for field in (axis.phase_rad, axis.mean_dn, axis.modulation_dn, axis.residual_dn):
            assert np.all(np.isfinite(field))


@pytest.mark.parametrize(
    ("stack", "message"),
    [
        (np.zeros((53, 8, 8)), "float64"),
        (np.zeros((52, 8, 8), np.uint16), "53 frames"),
        (np.zeros((53, 8), np.uint16), "53 frames"),
        (np.zeros((53, 0, 8), np.uint16), "53 frames"),
    ],
)
def test_wrong_stacks_are_rejected(patterns, quiet_sensor, stack, message):
    with pytest.raises(InputError, match=message):
        decode(stack, patterns, quiet_sensor)


@pytest.mark.parametrize(
    "change",
    [
        {"filter_taps": -1},
        {"filter_sigma_px": 0.0},
        {"min_modulation_dn": -1.0},
        {"max_phase_sigma_rad": 0.0},
        {"gray_sigmas": float("inf")},
        {"max_condition": 0.5},
        {"max_order_error": 1.5},
    ],
)
def test_wrong_options_are_named(change):
    with pytest.raises(InputError, match=next(iter(change))):
        DecodeOptions(**change)
