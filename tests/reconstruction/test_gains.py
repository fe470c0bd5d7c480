"""Relative light of the phase frames: ripple by drift in closed form, estimate and sigma."""

import dataclasses

import numpy as np
import pytest

from reconstruction import compiling
from reconstruction.decoding import decode as decode_module
from reconstruction.decoding.decode import AxisDecode, DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

SENSOR = SensorNoise(0.1, 6.0, 16.0, 4095.0)
QUIET = SensorNoise(1e-4, 0.0, 16.0, 4095.0)
SHAPE = 120, 160
UNFILTERED = DecodeOptions(filter_taps=0)
NEGLECTED = DecodeOptions(filter_taps=0, frame_gains=False)


def patterns_of(steps: int, **changes) -> PatternSet:
    return PatternSet(320, 240, period_px=20, steps=steps, **changes)


def stack_of(patterns, synthesise, cover, gains, *, sensor=SENSOR, seed=0, ambient_dn=0.0):
    """Return frames (float32) of a lamp with the relative light `gains`, with noise."""
    light = synthesise(patterns, *cover(*SHAPE, patterns), mean_dn=1000.0, amplitude_dn=950.0)
    above = light * np.asarray(gains)[:, None, None] + ambient_dn
    spread = np.sqrt(sensor.variance_dn2(above + 16.0) - 1.0 / 12.0)
    noise = spread * np.random.default_rng(seed).standard_normal(above.shape)
    return np.rint(above + 16.0 + noise).astype(np.float32)


def drifting(patterns, share: float):
    """Return a light that changes linearly by `share` of its mean over the steps of each set."""
    place = np.arange(len(patterns.frames)) % patterns.steps / (patterns.steps - 1)
    return 1.0 + share * (place - 0.5)


def errors_px(decoded, patterns, cover):
    """Return the errors of valid columns and rows by the phase, px."""
    column, row = cover(*SHAPE, patterns)
    errors = [
        (axis.coordinate_px - true)[decoded.valid]
        for axis, true in ((decoded.column, column), (decoded.row, row))
    ]
    # Without wrong orders, of which up to 1 % are allowed.
    return [error - 20.0 * np.rint(error / 20.0) for error in errors]


@pytest.mark.parametrize("steps", [4, 7, 18])
def test_ripple_of_a_linear_drift_is_that_of_the_closed_form(synthesise, cover, steps):
    """Ripple of N steps by a light that changes by d from the first to the last, neglected.

    sum n exp(i k t_n) = N / (exp(2 pi i k / N) - 1), so |E_k| = d N / (2 (N - 1) sin(pi k / N)).
    With RMS^2 = 2 / N^2 (|E_1|^2 (A / B)^2 + |E_2|^2 / 4): 5.2 mrad for d = 2 % and 18 steps.
    """
    patterns, drift = patterns_of(steps), 0.02
    stack = stack_of(patterns, synthesise, cover, drifting(patterns, drift), sensor=QUIET)
    first, second = (
        drift * steps / (2.0 * (steps - 1) * np.sin(np.pi * k / steps)) for k in (1, 2)
    )
    expected_rad = np.sqrt(2.0 / steps**2 * ((first * 1000.0 / 950.0) ** 2 + second**2 / 4.0))
    for error_px in errors_px(decode(stack, patterns, QUIET, NEGLECTED), patterns, cover):
        ripple_rad = 2.0 * np.pi / 20.0 * error_px.std()
        assert ripple_rad == pytest.approx(expected_rad, rel=0.05)
    gains = decode(stack, patterns, QUIET, UNFILTERED).gains
    np.testing.assert_allclose(gains.ripple_rad[:, 0], expected_rad, rtol=0.05)


@pytest.mark.parametrize("code", ["complementary_gray", "hierarchical", "displaced_gray"])
@pytest.mark.parametrize("steps", [4, 5, 18])
def test_estimated_light_is_the_true_light(synthesise, cover, steps, code):
    """Setup: flicker of 1.5 % and camera noise. Expected: the light to 4 % of the flicker."""
    further = {"further_periods_px": (400.0,)} if code == "hierarchical" else {}
    patterns = patterns_of(steps, code=code, **further)
    light = 1.0 + 0.015 * np.random.default_rng(1).standard_normal(len(patterns.frames))
    stack = stack_of(patterns, synthesise, cover, light)
    neglected, decoded = (decode(stack, patterns, SENSOR, o) for o in (NEGLECTED, UNFILTERED))
    assert neglected.gains is None
    for k, axis in enumerate(("column", "row")):
        for j, frames in enumerate(patterns.step_sets(axis)[:1]):
            true = light[frames] / light[frames].mean()
            assert np.std(decoded.gains.relative[k, j] - true) < 6e-4
    before, after = (np.hstack(errors_px(d, patterns, cover)) for d in (neglected, decoded))
    assert np.square(after).mean() < np.square(before).mean()


def test_left_error_is_the_predicted_one(synthesise, cover):
    """RMS of the ripple that is left over its predicted sigma, 12 exposures. Expected: 1 +- 0.25.

    The difference from a decoder that is given the true light has no camera noise in common.
    """
    patterns = patterns_of(6, axes=("column",))
    true = drifting(patterns, 0.01)
    ratios = []
    for seed in range(12):
        stack = stack_of(patterns, synthesise, cover, true, seed=seed)
        decoded = decode(stack, patterns, SENSOR, UNFILTERED)
        steps = np.exp(1j * np.outer([1.0, 2.0], 2.0 * np.pi * np.arange(6) / 6))
        wrong = steps @ (decoded.gains.relative[0, 0] / (true[:6] / true[:6].mean()) - 1.0)
        ratios.append(np.square(np.abs(wrong)) / decoded.gains.variances[0])
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1.0, abs=0.25)


def test_left_ripple_is_in_sigma(synthesise, cover, monkeypatch):
    """Expected: sigma^2 grows by (2 / N^2) (var E_1 (A / B)^2 + var E_2 / 4), in px^2."""
    patterns = patterns_of(6, axes=("column",))
    stack = stack_of(patterns, synthesise, cover, drifting(patterns, 0.01))
    decoded = decode(stack, patterns, SENSOR)
    monkeypatch.setattr(decode_module, "widen", lambda smoothed, *_: smoothed)
    plain, gains = decode(stack, patterns, SENSOR).column, decoded.gains
    contrast2 = np.square((plain.mean_dn - gains.dark_dn[0, 0]) / plain.modulation_dn)
    added_rad2 = 2.0 / 36.0 * (contrast2 * gains.variances[0, 0] + gains.variances[0, 1] / 4.0)
    added_px2 = (20.0 / (2.0 * np.pi)) ** 2 * added_rad2
    where = decoded.valid
    grown_px2 = np.square(decoded.column.sigma_px) - np.square(plain.sigma_px)
    assert grown_px2[where].mean() == pytest.approx(added_px2[where].mean(), rel=0.03)
    shrunk = np.square(plain.sigma_px / decoded.column.sigma_px) * plain.bias_share
    np.testing.assert_allclose(decoded.column.bias_share[where], shrunk[where], atol=3.0 / 255.0)


@pytest.mark.parametrize("steps", [4, 18])
def test_steady_light_leaves_every_byte(synthesise, cover, steps):
    patterns = patterns_of(steps)
    for sensor in (SENSOR, QUIET):
        stack = stack_of(patterns, synthesise, cover, np.ones(len(patterns.frames)), sensor=sensor)
        decoded, expected = (
            decode(stack, patterns, sensor, DecodeOptions(frame_gains=on)) for on in (True, False)
        )
        assert decoded.gains is None
        for axis, same in ((decoded.column, expected.column), (decoded.row, expected.row)):
            for field in dataclasses.fields(AxisDecode):
                np.testing.assert_array_equal(getattr(axis, field.name), getattr(same, field.name))


def test_three_steps_do_not_determine_the_light(synthesise, cover):
    patterns = patterns_of(3)
    stack = stack_of(patterns, synthesise, cover, drifting(patterns, 0.05))
    assert decode(stack, patterns, SENSOR).gains is None


def test_light_of_the_room_is_not_scaled(synthesise, cover):
    """Setup: constant light of 300 DN in addition. Expected: its level, and no ripple."""
    patterns = patterns_of(8)
    stack = stack_of(
        patterns, synthesise, cover, drifting(patterns, 0.02), sensor=QUIET, ambient_dn=300.0
    )
    decoded = decode(stack, patterns, QUIET, UNFILTERED)
    # The black frame has 50 DN of the projector's light, 300 DN of the room's, 16 DN of the camera.
    np.testing.assert_allclose(decoded.gains.dark_dn, 316.0, atol=5.0)
    for error_px in errors_px(decoded, patterns, cover):
        assert 2.0 * np.pi / 20.0 * error_px.std() < 5e-4


@pytest.mark.parametrize("steps", [4, 5])
def test_light_without_a_black_frame(synthesise, cover, steps):
    patterns = patterns_of(steps, uniform=False)
    light = drifting(patterns, 0.02)
    stack = stack_of(patterns, synthesise, cover, light, sensor=QUIET)
    gains = decode(stack, patterns, QUIET, UNFILTERED).gains
    np.testing.assert_allclose(gains.relative[:, 0], [light[:steps]] * 2, atol=2e-4)
    np.testing.assert_allclose(gains.dark_dn, 16.0, atol=5.0)


def test_clipped_and_lost_frames_are_fitted_with_the_light(synthesise, cover):
    """Setup: 2 % of the pixels have one clipped frame. Expected: their ripple is removed, too."""
    patterns = patterns_of(8)
    stack = stack_of(patterns, synthesise, cover, drifting(patterns, 0.02), sensor=QUIET)
    damaged = np.random.default_rng(2).random(SHAPE) < 0.02
    stack[3, damaged], stack[11, damaged] = 4095.0, np.nan
    decoded = decode(stack, patterns, QUIET, UNFILTERED)
    column, _ = cover(*SHAPE, patterns)
    where = damaged & decoded.valid
    assert where.sum() > 0.9 * damaged.sum()
    error_px = (decoded.column.coordinate_px - column)[where]
    assert 2.0 * np.pi / 20.0 * error_px.std() < 6e-4  # 7 mrad without


def test_harmonics_of_the_projector_are_not_taken_for_light(synthesise, cover):
    """Setup: steady light, gamma 1.6, 2.3 fringes in view. Expected: no gains, the same ripple."""
    patterns = patterns_of(5, axes=("column",))
    stack = stack_of(patterns, synthesise, cover, np.ones(len(patterns.frames)))
    level = np.clip((stack - 66.0) / 1900.0, 0.0, 1.0) ** 1.6
    bent = (66.0 + 1900.0 * level)[:, :, :23]
    assert decode(np.ascontiguousarray(bent), patterns, SENSOR, UNFILTERED).gains is None


@pytest.mark.parametrize("threads", [1, 3])
def test_bytes_do_not_depend_on_the_number_of_threads(synthesise, cover, monkeypatch, threads):
    patterns = patterns_of(6)
    stack = stack_of(patterns, synthesise, cover, drifting(patterns, 0.01))
    expected = decode(stack, patterns, SENSOR)
    monkeypatch.setattr(compiling, "threads", lambda: threads)
    result = decode(stack, patterns, SENSOR)
    np.testing.assert_array_equal(result.gains.relative, expected.gains.relative)
    np.testing.assert_array_equal(result.column.coordinate_px, expected.column.coordinate_px)
    np.testing.assert_array_equal(result.row.sigma_px, expected.row.sigma_px)


def test_a_frame_of_another_pattern_is_no_light(synthesise, cover):
    """Setup: frame 2 of 6 is the white frame. Expected: its levels are not divided by a gain."""
    patterns = patterns_of(6)
    stack = stack_of(patterns, synthesise, cover, np.ones(len(patterns.frames)))
    stack[2] = stack[patterns.index("white")]
    gains = decode(stack, patterns, SENSOR, UNFILTERED).gains
    assert gains is None or np.all(gains.relative[0] == 1.0)


def test_option_is_true_or_false():
    with pytest.raises(InputError, match="frame_gains is 1; give true or false"):
        DecodeOptions(frame_gains=1)
