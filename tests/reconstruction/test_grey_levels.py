"""Quaternary Gray code: digits, thresholds, noise, and lists of frames."""

import numpy as np
import pytest

from reconstruction.capture.frame_arrangement import Arrangement, ListedFrame, ProjectorSize
from reconstruction.codes.quaternary_gray import NOMINAL, gray_digits, measured_levels, words_of
from reconstruction.decoding.decode import DecodeOptions, decode
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

CODE = {"code": "quaternary_gray", "steps": 6, "axes": ("column",)}
LOOSE = DecodeOptions(filter_taps=0, max_order_error=1.0, max_phase_sigma_rad=1.0)


def test_neighbouring_words_differ_by_one_level_of_one_digit():
    words = np.arange(4**5)
    digits = gray_digits(words, 5)
    assert np.array_equal(np.abs(np.diff(digits, axis=1)).sum(axis=0), np.ones(len(words) - 1))
    assert np.array_equal(words_of(digits), words)
    assert digits.min() == 0
    assert digits.max() == 3


def test_half_as_many_frames_as_bits():
    bits = PatternSet(1280, 720, code="complementary_gray").word_bits("column")
    assert PatternSet(1280, 720, code="quaternary_gray").word_bits("column") == (bits + 1) // 2


@pytest.mark.parametrize("gamma", [0.6, 1.0, 2.2])
@pytest.mark.parametrize("extra", [{}, {"uniform": False}, {"inverse": True}])
def test_levels_of_a_projector_that_is_not_linear(synthesise, gamma, extra):
    """Setup: blur 0.7 px, levels by a power law. Expected: no wrong order, few pixels masked."""
    patterns = PatternSet(1280, 720, **CODE | {"steps": 12}, **extra)
    column = np.linspace(4.0, 1275.0, 12_000).reshape(60, 200)
    stack = synthesise(patterns, column, column, mean_dn=0.5, amplitude_dn=0.5, blur_px=0.7)
    stack = 20.0 + 200.0 * np.clip(stack, 0.0, 1.0) ** gamma
    stack += np.random.default_rng(2).normal(0.0, 0.5, stack.shape)
    sensor = SensorNoise(1e-6, 5e5, 0.0, 400.0)
    decoded = decode(stack.astype(np.float32), patterns, sensor, DecodeOptions(filter_taps=0))
    error_px = np.abs(decoded.column.coordinate_px - column)[decoded.valid]
    assert decoded.valid.mean() > 0.97
    assert error_px.max() < 9.0


def test_predicted_order_errors_of_levels_are_the_counted_ones(synthesise):
    """Setup: a threshold is 2.7 sigma from its levels. Expected: within a factor of 1.5.

    With the default limit hardly any of the wrong orders is left.
    """
    patterns = PatternSet(1280, 720, **CODE)
    row, col = np.mgrid[0:200, 0:500].astype(float)
    column = 40.0 + 2.3 * col + 0.013 * row
    stack = synthesise(patterns, column, row, mean_dn=500.0, amplitude_dn=100.0)
    stack += np.random.default_rng(4).normal(0.0, 11.5, stack.shape)
    sensor = SensorNoise(1e-6, 11.5e6, 0.0, 5000.0)
    axis = decode(stack.astype(np.float32), patterns, sensor, LOOSE).column
    known = axis.sigma_px > 0.0
    is_wrong = known & (np.abs(axis.coordinate_px - column) > 9.0)
    counted, predicted = np.mean(is_wrong[known]), float(axis.order_error[known].mean())
    assert counted > 2e-3
    assert counted / 1.5 < predicted < counted * 1.5
    kept = known & (axis.order_error <= DecodeOptions().max_order_error)
    assert kept.mean() > 0.5
    assert np.mean(is_wrong[kept]) < 0.2 * counted


def test_levels_that_are_not_four_are_the_nominal_ones():
    rng = np.random.default_rng(1)
    few = np.array([[0.0, 1.0, 0.33]])
    two = rng.choice([0.0, 1.0], (3, 2000)) + rng.normal(0.0, 0.01, (3, 2000))
    assert np.array_equal(measured_levels(few), NOMINAL)
    assert np.array_equal(measured_levels(two), NOMINAL)
    four = rng.choice([0.0, 0.1, 0.4, 1.0], (3, 2000)) + rng.normal(0.0, 0.01, (3, 2000))
    np.testing.assert_allclose(measured_levels(four), [0.0, 0.1, 0.4, 1.0], atol=0.02)


def test_a_list_of_frames_states_the_code():
    expected = PatternSet(320, 240, 16.0, 4, code=CODE["code"], axes=("column",), uniform=False)
    shown = [
        ListedFrame(f"{frame.name}.png", frame.kind, "column", None, bit=frame.index)
        for frame in expected.frames[4:]
    ]
    phases = [ListedFrame(f"p{n}.png", "phase", "column", 16.0, 90.0 * n) for n in range(4)]
    size = ProjectorSize(320, 240)
    result = Arrangement([*shown, *phases], size, "reflected", CODE["code"])
    assert result.patterns == expected
    assert result.files[4:] == [frame.file for frame in shown]
    with pytest.raises(InputError, match="there are 2 Gray frames"):
        Arrangement([*shown[1:], *phases], size, "reflected", CODE["code"])
