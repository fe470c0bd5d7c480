"""Shares of relief and noise in the filter, block by block, computed by hand."""

import numpy as np
import pytest

from reconstruction.decoding._chain import Unwrapping, unwrap_row
from reconstruction.decoding._lift import Smoothing, _invert, _scale
from reconstruction.decoding._order import Numbered
from reconstruction.decoding._relief import (
    _sum_five,
    _weigh_relief,
    add_variances,
    find_shares,
    make_blocks,
    predict_bias,
    restore_relief,
    weigh_blocks,
    weigh_edge,
    weigh_neighbours,
    weigh_own,
    write_root,
    write_share,
)
from reconstruction.decoding._rows import add, multiply
from reconstruction.decoding._sum import Limits, mark_dark, mark_low_modulation

# Coarse part half relief, fine part a quarter; noise of 8 px^2 over 4 pixels.
C, F, NOISE, COUNT = 0.5, 0.25, 8.0, 4.0


def lines(*values):
    return tuple(np.array(value, np.float32).reshape(-1) for value in values)


def test_shares_of_relief():
    """Of noise 8 the coarse part gets 1.8 * 0.5 * 8 = 7.2: of 14.4 50 % is relief, of 7 0 %.

    The fine part gets 0.25 * 8 and an extra of min(0.2, 0.3 (1 - 0.5)) = 0.15: 2.3 of 4.6; where
    there is no coarse relief 0.2, 2.4 of 9.6.
    """
    ratios = np.diag(np.array([1.0, 0.5, 0.25], np.float32))
    c, f = np.zeros(2, np.float32), np.zeros(2, np.float32)
    large, small, noise = lines([14.4, 7.0], [4.6, 9.6], [8.0, 8.0])
    find_shares(large, small, noise, ratios, c, f)
    np.testing.assert_allclose(c, [0.5, 0.0], atol=1e-6)
    np.testing.assert_allclose(f, [0.5, 0.75], rtol=1e-6)


def test_bias_is_the_relief_that_is_not_restored():
    """0.5^2 * 0.5 * 8 + 0.75^2 * 0.25 * 16 = 3.25, over 4 pixels; over none as over one."""
    out = np.zeros(2, np.float32)
    predict_bias(*lines([8.0, 8.0], [16.0, 16.0], [C, C], [F, F], [COUNT, 0.0]), out)
    np.testing.assert_allclose(out, [3.25 / 4, 3.25])


def test_weights_of_a_pixel_and_of_those_around():
    """Own: (1 - 0.5 * 0.4 - 0.25 * 0.2)^2. Others: 1 - 2 (0.25 + 0.0625) + 0.1 + 0.025 + 0.0125
    = 0.5125 in all, less 0.1 of its own, by 8 / 4, and a bias of 0.05.
    """
    centre = np.array([1.0, 0.4, 0.2], np.float32)
    out = np.zeros(1, np.float32)
    weigh_own(*lines(C, F), centre, out)
    assert out[0] == pytest.approx(0.5625)
    ratios = np.array([[1.0, 0.5, 0.25], [0.5, 0.4, 0.1], [0.25, 0.1, 0.2]], np.float32)
    weigh_neighbours(*lines(C, F, 0.1, NOISE, COUNT, 0.05), ratios, out)
    assert out[0] == pytest.approx(0.4125 * 2 + 0.05)
    weigh_neighbours(*lines(C, F, 0.6, NOISE, COUNT, 0.05), ratios, out)
    assert out[0] == pytest.approx(0.05)


def test_at_an_edge_the_larger_share_of_relief_counts():
    out = np.zeros(2, np.float32)
    weigh_edge(*lines([C, 0.1], [F, 0.7], [NOISE] * 2, [COUNT] * 2), out)
    np.testing.assert_allclose(out, [1.0, 0.6], rtol=1e-6)


def test_lift_and_coarse_part_that_are_given_back():
    """1 - f of the lift, f - c of the coarse part: x + 0.75 * 2 - 0.25 * 4 = x + 0.5."""
    lift, coarse = np.zeros(1, np.float32), np.zeros(1, np.float32)
    _weigh_relief(*lines(C, F), lift, coarse)
    assert (lift[0], coarse[0]) == (0.75, -0.25)
    out = np.zeros(2, np.float32)
    x, usable = lines([10.0, 10.0], [1.0, 0.0])
    restore_relief(x, usable, *lines([2.0] * 2, [4.0] * 2, [0.75] * 2, [-0.25] * 2), out)
    assert out.tolist() == [10.5, 0.0]


def test_variances_add():
    """0.5 * 4 + 0.3 + (0.6 - 0.2) * 2 = 3.1; a gain below the full one adds 0."""
    out = np.zeros(2, np.float32)
    variance, gain, own = lines([4.0] * 2, [0.6, 0.1], [0.5] * 2)
    add_variances(variance, gain, np.float32(0.2), own, *lines([0.3] * 2, [2.0] * 2), out)
    np.testing.assert_allclose(out, [3.1, 2.3], rtol=1e-6)
    root = np.zeros(2, np.float32)
    write_root(*lines([9.0, 4.0], [1.0, 0.0]), root)
    assert root.tolist() == [3.0, 0.0]


def test_a_share_is_kept_in_steps_of_a_255th():
    """0.3 of it: 76.5, rounded up; masked pixels and none at all: 0; all: 255."""
    share = np.zeros(4, np.uint8)
    write_share(*lines([0.3, 0.3, 0.0, 2.0], [1.0, 1.0, 1.0, 2.0], [1.0, 0.0, 1.0, 1.0]), share)
    assert share.tolist() == [77, 0, 0, 255]


def test_sums_of_five():
    out = np.zeros(2, np.float32)
    _sum_five(*lines([1, 2], [3, 4], [5, 6], [7, 8], [9, 11]), out)
    assert out.tolist() == [25.0, 31.0]


def test_a_block_sees_its_five_by_five():
    """Sums of 25 blocks of 2, 1, 0.5 and 4: 50, 25, 12.5 and 100; the middle one's weights from
    these, by the functions above: noise per pixel 0.125, bias per pixel over 100.
    """
    ratios = np.array([[1.0, 0.5, 0.25], [0.5, 0.4, 0.1], [0.25, 0.1, 0.2]], np.float32)
    centre = np.array([1.0, 0.4, 0.2], np.float32)
    weights = np.zeros(9, np.float32)
    smoothing = Smoothing(weights, ratios, centre, np.float32(9), np.float32(1), np.float32(1))
    blocks = make_blocks(20, 20)
    for part, value in enumerate((2.0, 1.0, 0.5, 4.0)):
        blocks.sums[part] = value
    weigh_blocks(2, smoothing, blocks)
    assert blocks.around[:, 2].tolist() == [50.0, 25.0, 12.5, 100.0]
    # Coarse: 1 - 1.8 * 0.4 * 12.5 / 50 = 0.82. Fine: extra 0.054, 1 - 1.054 * 0.2 * 12.5 / 25.
    c, f = 0.82, 1.0 - 1.054 * 0.1
    np.testing.assert_allclose(blocks.shares[:, 2], [c, f], rtol=1e-5)
    bias = ((1 - c) ** 2 * c * 50.0 + (1 - f) ** 2 * f * 25.0) / 100.0
    own = (1.0 - 0.4 * c - 0.2 * f) ** 2
    left = 1.0 - 2.0 * (0.5 * c + 0.25 * f) + 0.4 * c * c + 0.2 * c * f + 0.2 * f * f
    around = max(left - own, 0.0) * 0.125 + bias
    edge = 0.125 * (1.0 - max(c, f))
    expected = [1.0 - f, f - c, own, around, edge, bias]
    np.testing.assert_allclose(blocks.values[:, 2], expected, rtol=1e-4)
    np.testing.assert_allclose(blocks.spread[:, 8:12], np.repeat(blocks.values[:, 2:3], 4, axis=1))


def test_lines_are_added_multiplied_scaled_and_inverted():
    a, b, out = *lines([1.0, 2.0], [10.0, 20.0]), np.zeros(2, np.float32)
    add(a, b)
    assert b.tolist() == [11.0, 22.0]
    multiply(b, a)
    assert b.tolist() == [11.0, 44.0]
    _scale(b, np.float32(0.5), out)
    assert out.tolist() == [5.5, 22.0]
    (usable,) = lines([1.0, 0.0])
    _invert(b, usable)
    np.testing.assert_allclose(b, [1 / 11.0, 0.0])


def limits(**more):
    plain = dict.fromkeys(Limits._fields, 0.0) | {"max_phase_sigma_rad": 0.1} | more
    return Limits(**{name: np.float32(value) for name, value in plain.items()})


def test_least_modulation():
    """18 steps, 0.1 rad: sqrt(2 / 18) / 0.1 = 3.333 times the noise of 3 DN, 10 DN; of 6 DN 20.

    At least the required 12 DN; a saturated pixel keeps its reason.
    """
    modulation, noise = lines([9.9, 10.1, 19.9, 20.1, 1.0, np.nan], [3, 3, 6, 6, 3, 3])
    reason = np.array([0, 0, 0, 0, 3, 0], np.uint8)
    mark_low_modulation(18, limits(), modulation, noise, reason)
    assert reason.tolist() == [2, 0, 2, 0, 3, 2]
    reason[:] = 0
    requested = limits(min_modulation_dn=12.0)
    mark_low_modulation(18, requested, *lines([11.9, 12.1], [3, 3]), reason[:2])
    assert reason[:2].tolist() == [2, 0]


def test_white_and_black_must_differ():
    """Read noise 2 DN: sigma of a difference sqrt(2 (4 + 1/12)) = 2.858 DN, three of them 8.57."""
    white, black, scale = lines([108.5, 108.6, 91.0], [100.0] * 3, [1.0] * 3)
    reason = np.zeros(3, np.uint8)
    sensor = limits(read_noise_dn=2.0, dark_sigmas=3.0)
    mark_dark(white, black, scale, sensor, reason)
    assert reason.tolist() == [1, 0, 1]


def unwrapped(weights, periods_px, turns, sigma_rad):
    """Unwrap one pixel over an image of 50 px: coordinate, sigma, error."""
    chain = Unwrapping(np.array(weights), np.array(periods_px), np.array(periods_px), 50)
    phases = 2 * np.pi * np.array(turns, np.float32)[:, None]
    sigmas = np.array(sigma_rad, np.float32)[:, None]
    answer = Numbered(*np.zeros((3, 1), np.float32))
    unwrap_row(chain, phases, sigmas, sigmas, np.ones(1, np.float32), answer)
    return tuple(float(line[0]) for line in answer)


def test_one_period_over_the_whole_image():
    """100 px over an image of 50, centred in it: 0.3 turns are 30 px.

    0.2 turns of sigma are 20 px; the nearer end of the period, at 74.5, is 44.5 px off: the chance
    to be beyond is Q(2.225) = 0.01304. Half a turn below -25.5 px is 79 px further up.
    """
    x, sigma_px, error = unwrapped([[1.0]], [100.0], [0.3], [0.2 * 2 * np.pi])
    assert (x, sigma_px) == (pytest.approx(30.0), pytest.approx(20.0))
    assert error == pytest.approx(0.01304, rel=1e-3)
    assert unwrapped([[1.0]], [100.0], [0.9], [0.01])[0] == pytest.approx(-10.0)


def test_two_periods_are_weighed_together():
    """Turns 0.3 of 100 px and 0.52 of 20 px: 30 px, and 30.4 by the finer one with number 1.

    Equal sigmas of the phase: weights 1 : 25, (30 + 25 * 30.4) / 26 = 30.385 px.
    """
    chain = ([[1.0, 0.0], [0.0, 1.0]], [100.0, 20.0])
    x, sigma_px, error = unwrapped(*chain, [0.3, 0.52], [0.02, 0.02])
    assert x == pytest.approx(30.384615, rel=1e-6)
    assert sigma_px == pytest.approx(0.02 / (2 * np.pi) / np.sqrt(1 / 100.0**2 + 1 / 20.0**2))
    assert error < 1e-6
    # No information on any phase: 1/2 that the end was passed, two thirds for neighbours.
    assert unwrapped(*chain, [0.3, 0.5], [1e6, 1e6])[2] == 1.0
