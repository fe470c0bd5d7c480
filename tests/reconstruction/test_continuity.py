"""Jumps between neighbouring coordinates: few on right fringe orders, most places on wrong ones."""

import numpy as np
import pytest

from reconstruction.decoding.continuity import (
    DOUBTFUL_SHARE,
    DOUBTFUL_TURN,
    TURN_PX,
    jump_share,
    turned_share,
)

VALID = np.ones((120, 160), bool)


def coordinates(step_px=0.0):
    """Return a slope of 640 px with a hump and a part that is displaced."""
    row, col = np.mgrid[0:120, 0:160].astype(np.float32)
    hump = 10.0 * np.exp(-((row - 60) ** 2 + (col - 80) ** 2) / 400.0)
    is_part = (row > 30) & (row < 80) & (col > 40) & (col < 90)
    return (4.0 * col + hump + step_px * is_part).astype(np.float32)


def exchanged(x_px, period_px, bit):
    """Return the decoded coordinates with a bit and the next coarser one exchanged."""
    order = np.floor(x_px / period_px).astype(int)
    gray = order ^ order >> 1
    low, high = gray >> bit & 1, gray >> bit + 1 & 1
    word = gray & ~(3 << bit) | high << bit | low << bit + 1
    for shift in (8, 4, 2, 1):
        word ^= word >> shift
    return (x_px + period_px * (word - order)).astype(np.float32)


@pytest.mark.parametrize("step_px", [0.0, 5.0, 40.0, 200.0])
def test_steps_of_the_scene_are_no_doubt(step_px):
    share = jump_share(coordinates(step_px), VALID, 20.0, is_word=False)
    assert share < DOUBTFUL_SHARE
    assert (share == 0.0) == (step_px < 10.0)


@pytest.mark.parametrize("bit", range(4))
@pytest.mark.parametrize("along", ["rows", "columns"])
def test_exchanged_bits_are_a_doubt(bit, along):
    x_px = exchanged(coordinates(5.0), 20.0, bit)
    if along == "columns":
        x_px = np.ascontiguousarray(x_px.T)
    valid = np.ones(x_px.shape, bool)
    assert jump_share(x_px, valid, 20.0, is_word=False) > DOUBTFUL_SHARE


def test_single_wrong_pixels_words_and_empty_maps_are_no_doubt():
    rng = np.random.default_rng(1)
    x_px = coordinates()
    x_px[rng.random(x_px.shape) < 0.02] += 160.0
    assert jump_share(x_px, VALID, 20.0, is_word=False) < 0.2
    # Words of 8 px that the camera's pixels, of 4 px, show as steps.
    assert jump_share(np.floor(coordinates() / 8.0) * 8.0, VALID, 8.0, is_word=True) == 0.0
    assert jump_share(x_px, np.zeros_like(VALID), 20.0, is_word=False) == 0.0
    assert jump_share(x_px[:2, :2], VALID[:2, :2], 20.0, is_word=False) == 0.0


@pytest.mark.parametrize("turn_at", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("along", ["rows", "columns"])
def test_a_coordinate_that_turns_back_is_a_doubt(turn_at, along):
    """Words without their coarsest bit rise up to a column and fall behind it.

    Expected: the share of the pairs of pixels that are completely before the turn, or half of a
    pair: 160 columns have 152 pairs.
    """
    slope = np.broadcast_to(4.0 * np.arange(160, dtype=np.float32), VALID.shape)
    folded = np.abs(slope - 4.0 * 160 * turn_at)
    x_px, valid = (folded, VALID) if along == "rows" else (folded.T, VALID.T)
    expected = max(160 * turn_at - TURN_PX / 2, 0.0) / (160 - TURN_PX)
    share = turned_share(np.ascontiguousarray(x_px), valid)
    assert share == pytest.approx(min(expected, 1.0 - expected), abs=0.01)
    assert (share > DOUBTFUL_TURN) == (turn_at > 0.0)


@pytest.mark.parametrize("step_px", [0.0, 40.0, 200.0])
def test_steps_of_the_scene_do_not_turn_back(step_px):
    assert turned_share(coordinates(step_px), VALID) < DOUBTFUL_TURN
