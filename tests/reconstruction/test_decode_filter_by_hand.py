"""What the filter takes for relief and what for noise, one block at a time, computed by hand."""

import numpy as np
import pytest

from reconstruction.decoding._relief import (
    _find_shares,
    _predict_bias,
    _sum_five,
    _weigh_edge,
    _weigh_others,
    _weigh_own,
    _weigh_relief,
    add_variances,
    give_back,
    write_root,
    write_share,
)

# Coarse part half relief, fine part a quarter; noise of 8 px^2 over 4 pixels.
C, F, NOISE, COUNT = 0.5, 0.25, 8.0, 4.0


def lines(*values):
    return tuple(np.array(value, np.float32).reshape(-1) for value in values)


def test_shares_of_relief():
    """Of noise 8 the coarse part gets 1.8 * 0.5 * 8 = 7.2: of 14.4 half is relief, of 7 nothing.

    The fine part gets 0.25 * 8 and an extra of min(0.2, 0.3 (1 - 0.5)) = 0.15: 2.3 of 4.6; where
    there is no coarse relief 0.2, 2.4 of 9.6.
    """
    ratios = np.diag(np.array([1.0, 0.5, 0.25], np.float32))
    c, f = np.zeros(2, np.float32), np.zeros(2, np.float32)
    large, small, noise = lines([14.4, 7.0], [4.6, 9.6], [8.0, 8.0])
    _find_shares(large, small, noise, ratios, c, f)
    np.testing.assert_allclose(c, [0.5, 0.0], atol=1e-6)
    np.testing.assert_allclose(f, [0.5, 0.75], rtol=1e-6)


def test_bias_is_what_is_relief_and_not_given_back():
    """0.5^2 * 0.5 * 8 + 0.75^2 * 0.25 * 16 = 3.25, over 4 pixels; over none as over one."""
    out = np.zeros(2, np.float32)
    _predict_bias(*lines([8.0, 8.0], [16.0, 16.0], [C, C], [F, F], [COUNT, 0.0]), out)
    np.testing.assert_allclose(out, [3.25 / 4, 3.25])


def test_weights_of_a_pixel_and_of_those_around():
    """Own: (1 - 0.5 * 0.4 - 0.25 * 0.2)^2. Others: 1 - 2 (0.25 + 0.0625) + 0.1 + 0.025 + 0.0125
    = 0.5125 in all, less 0.1 of its own, by 8 / 4, and a bias of 0.05.
    """
    centre = np.array([1.0, 0.4, 0.2], np.float32)
    out = np.zeros(1, np.float32)
    _weigh_own(*lines(C, F), centre, out)
    assert out[0] == pytest.approx(0.5625)
    ratios = np.array([[1.0, 0.5, 0.25], [0.5, 0.4, 0.1], [0.25, 0.1, 0.2]], np.float32)
    _weigh_others(*lines(C, F, 0.1, NOISE, COUNT, 0.05), ratios, out)
    assert out[0] == pytest.approx(0.4125 * 2 + 0.05)
    _weigh_others(*lines(C, F, 0.6, NOISE, COUNT, 0.05), ratios, out)
    assert out[0] == pytest.approx(0.05)


def test_at_an_edge_the_larger_share_of_relief_counts():
    out = np.zeros(2, np.float32)
    _weigh_edge(*lines([C, 0.1], [F, 0.7], [NOISE] * 2, [COUNT] * 2), out)
    np.testing.assert_allclose(out, [1.0, 0.6], rtol=1e-6)


def test_lift_and_coarse_part_that_are_given_back():
    """1 - f of the lift, f - c of the coarse part: x + 0.75 * 2 - 0.25 * 4 = x + 0.5."""
    lift, coarse = np.zeros(1, np.float32), np.zeros(1, np.float32)
    _weigh_relief(*lines(C, F), lift, coarse)
    assert (lift[0], coarse[0]) == (0.75, -0.25)
    out = np.zeros(2, np.float32)
    x, usable = lines([10.0, 10.0], [1.0, 0.0])
    give_back(x, usable, *lines([2.0] * 2, [4.0] * 2, [0.75] * 2, [-0.25] * 2), out)
    assert out.tolist() == [10.5, 0.0]


def test_variances_add():
    """0.5 * 4 + 0.3 + (0.6 - 0.2) * 2 = 3.1; a gain below the full one adds nothing."""
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
