"""Decoded figures computed by hand: where the image ends, the sigma of a pixel, three steps."""

import numpy as np
import pytest

from reconstruction.decoding.decode import DecodeOptions, Reason, decode
from reconstruction.patterns import PatternSet
from reconstruction.rig.sensor import SensorNoise

UNFILTERED = DecodeOptions(filter_taps=0)


def decoded_at(synthesise, patterns, column_px, row_px, sensor, **levels):
    stack = synthesise(patterns, np.atleast_2d(column_px), np.atleast_2d(row_px), **levels)
    return decode(stack.astype(np.float32), patterns, sensor, UNFILTERED)


@pytest.mark.parametrize("axis", ["column", "row"])
def test_the_image_ends_half_a_pixel_beyond_its_last_centre(quiet_sensor, synthesise, axis):
    """100 pixels: -0.45 and 99.45 are on the image, -0.55 and 99.55, and one pixel beyond, not."""
    patterns = PatternSet(100, 100)
    places = np.array([0.0, 99.0, -0.45, 99.45, -0.55, 99.55, -1.0, 100.0])
    middle = np.full(places.shape, 30.0)
    both = (places, middle) if axis == "column" else (middle, places)
    result = decoded_at(synthesise, patterns, *both, quiet_sensor)
    inside = [True] * 4 + [False] * 4
    assert result.valid[0].tolist() == inside
    assert (result.mask_reason[0, 4:] == Reason.OUTSIDE_PROJECTOR).all()


def test_the_sigma_of_a_coordinate(synthesise):
    """0.2 DN/e-, read noise 5 e-, 120 DN of which 20 are black: 1 + 20 + 1/12 DN^2, 4.5917 DN.

    Over a modulation of 100 DN and 18 steps sqrt(2 / 18) 0.045917 = 0.015306 rad; a period of 18 px
    is 2 pi: 0.043847 px.
    """
    patterns = PatternSet(100, 100)
    sensor = SensorNoise(0.2, 5.0, 20.0, 4095.0)
    result = decoded_at(synthesise, patterns, 30.0, 40.0, sensor, mean_dn=120.0, amplitude_dn=100.0)
    for axis in (result.column, result.row):
        assert axis.sigma_px[0, 0] == pytest.approx(0.043847, rel=1e-3)
        assert axis.mean_dn[0, 0] == pytest.approx(120.0, rel=1e-3)
        assert axis.modulation_dn[0, 0] == pytest.approx(100.0, rel=1e-3)


def test_residual_of_a_disturbed_frame():
    """One frame of 18 is 9 DN too high: the fit takes 3 / 18 of it along, 81 (1 - 3 / 18) are left.

    Over 18 - 3 degrees of freedom: sqrt(4.5) DN. The mean rises by 0.5 DN.
    """
    patterns = PatternSet(100, 100)
    shift = np.array(
        [patterns.phase_of(frame)[1] for frame in patterns.frames if frame.kind == "phase"]
    )
    stack = np.full((len(patterns.frames), 1, 1), 120.0, np.float32)
    first = patterns.index("phase", "column").start
    turn = 2 * np.pi * (5.0 / 18.0 + shift[:18])
    stack[first : first + 18, 0, 0] = 120.0 + 80.0 * np.cos(turn)
    stack[first + 7] += 9.0
    result = decode(stack, patterns, SensorNoise(0.2, 5.0, 0.0, 4095.0), UNFILTERED)
    assert result.column.residual_dn[0, 0] == pytest.approx(4.5**0.5, rel=2e-3)
    assert result.column.mean_dn[0, 0] == pytest.approx(120.5, rel=1e-3)


def test_a_frame_that_errs_moves_the_phase_by_its_share():
    """16 steps of 120 + 80 cos(90 deg + t): z = sum I exp(-i t) = 640 i.

    9 DN more at t = 90 deg make it 631 i, 9 DN more at 180 deg as well 631 i - 9.
    """
    patterns = PatternSet(100, 100, period_px=18.0, steps=16)
    stack = np.full((len(patterns.frames), 1, 1), 120.0, np.float32)
    stack[patterns.index("white").start], stack[patterns.index("black").start] = 220.0, 20.0
    first = patterns.index("phase", "column").start
    n = np.arange(16)
    for at in (first, patterns.index("phase", "row").start):
        stack[at : at + 16, 0, 0] = 120.0 + 80.0 * np.cos(0.5 * np.pi + 2 * np.pi * n / 16)
    stack[first + 4] += 9.0
    result = decode(stack, patterns, SensorNoise(0.2, 5.0, 0.0, 4095.0), UNFILTERED)
    assert result.column.phase_rad[0, 0] == pytest.approx(0.5 * np.pi, abs=1e-4)
    assert result.column.modulation_dn[0, 0] == pytest.approx(80.0 - 9.0 / 8.0, rel=1e-3)
    stack[first + 8] += 9.0
    result = decode(stack, patterns, SensorNoise(0.2, 5.0, 0.0, 4095.0), UNFILTERED)
    assert result.column.phase_rad[0, 0] == pytest.approx(0.5 * np.pi + 9.0 / 631.0, abs=2e-4)


@pytest.mark.parametrize(("word", "bits"), [(5, (1, 1, 1)), (6, (1, 0, 1)), (7, (1, 0, 0))])
def test_words_end_with_the_image(quiet_sensor, synthesise, word, bits):
    """100 px hold 6 periods of 18, words 0 to 5; Gray code of 5, 6 and 7: 111, 101, 100.

    Word 5 at 5 px of its period is 95 px; a word that nobody shows makes the order uncertain.
    """
    patterns = PatternSet(100, 60, code="gray")
    stack = synthesise(patterns, np.full((1, 1), 5.0), np.full((1, 1), 20.0)).astype(np.float32)
    stack[patterns.index("gray", "column"), 0, 0] = np.where(bits, 220.0, 20.0)
    result = decode(stack, patterns, quiet_sensor, UNFILTERED)
    if word == 5:
        assert result.column.coordinate_px[0, 0] == pytest.approx(95.0, abs=1e-3)
    else:
        assert result.mask_reason[0, 0] == Reason.ORDER_UNCERTAIN
