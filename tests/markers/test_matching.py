"""Assignment of moved dots: smooth fields, lost dots, false dots; the truth is known."""

import numpy as np
import pytest

from reconstruction.markers.matching import (
    UNASSIGNED,
    assign,
    deviation_from_neighbours,
    filled_from_neighbours,
)

SPACING_PX = 35.0


def moved(kind, local, amplitude, angle):
    reach = 2.0 * SPACING_PX
    near = np.exp(-np.sum(local**2, axis=1) / (2 * reach**2))[:, None]
    ahead = np.array([np.cos(angle), np.sin(angle)])
    field = {
        "slip": np.ones_like(local) * ahead,
        "shift": near * ahead,
        "radial": local / reach * near * np.exp(0.5),
        "twist": local[:, ::-1] * (1.0, -1.0) / reach * near * np.exp(0.5),
    }[kind]
    return amplitude * SPACING_PX * field


@pytest.mark.parametrize(
    ("kind", "amplitude"), [("slip", 0.5), ("shift", 0.5), ("radial", 0.5), ("twist", 0.5)]
)
def test_smooth_fields_of_half_a_spacing(kind, amplitude):
    """Setup: 10 patterns of 7 x 9 dots, a tenth lost, 3 false dots each, in random order.

    Expected: no dot is missed; a wrong partner only where a lost dot's place has a false one:
    at most one pattern in three.
    """
    wrong = missed = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        rows, cols = np.indices((7, 9)).reshape(2, -1) * SPACING_PX
        before = np.column_stack([rows, cols]) + rng.normal(0.0, 1.0, (63, 2))
        middle = before.mean(axis=0) + rng.uniform(-SPACING_PX, SPACING_PX, 2)
        true = before + moved(kind, before - middle, amplitude, seed)
        kept = rng.permutation(np.flatnonzero(rng.random(63) > 0.1))
        false = rng.uniform(before.min(axis=0), before.max(axis=0), (3, 2))
        truth = np.full(63, UNASSIGNED)
        truth[kept] = np.arange(len(kept))
        partner = assign(before, np.concatenate([true[kept], false]), SPACING_PX)
        wrong += np.count_nonzero((partner != truth) & (partner != UNASSIGNED))
        missed += np.count_nonzero((partner == UNASSIGNED) & (truth != UNASSIGNED))
    assert missed == 0
    assert wrong <= 3


def test_a_slip_of_two_spacings_from_the_frame_before():
    """Setup: 7 frames of a slip that increases by 0.4 spacings; 10 % lost in each.

    Expected: each frame, predicted by the frame before: the true assignment. The last frame without
    prediction: displacements that differ by a multiple of the spacing.
    """
    rng = np.random.default_rng(4)
    before = np.indices((7, 9)).reshape(2, -1).T * SPACING_PX + rng.normal(0.0, 1.0, (63, 2))
    expected = None
    for frame in range(1, 8):
        moved_px = np.array([0.28, 0.28]) * frame * SPACING_PX
        kept = np.flatnonzero(rng.random(63) > 0.1)
        truth = np.full(63, UNASSIGNED)
        truth[kept] = np.arange(len(kept))
        partner = assign(before, before[kept] + moved_px, SPACING_PX, expected)
        np.testing.assert_array_equal(partner, truth)
        known = partner != UNASSIGNED
        displacement = np.where(known[:, None], (before[kept] + moved_px)[partner] - before, 0.0)
        expected = filled_from_neighbours(before, displacement, known, SPACING_PX)
    alone = assign(before, before[kept] + moved_px, SPACING_PX)
    assert np.count_nonzero(alone == truth) < 10


def test_unknown_displacements_follow_from_neighbours():
    """Setup: an affine field without two dots. Expected: the field at these; else the nearest."""
    before = np.indices((5, 5)).reshape(2, -1).T * SPACING_PX
    field = before @ np.array([[0.02, -0.05], [0.03, 0.01]]) + 4.0
    known = np.ones(25, bool)
    known[[7, 12]] = False
    filled = filled_from_neighbours(before, np.where(known[:, None], field, 0.0), known, SPACING_PX)
    np.testing.assert_allclose(filled, field, atol=1e-9)
    far = np.concatenate([before, [[10.0 * SPACING_PX, 0.0]]])
    moved_px = np.concatenate([field, [[0.0, 0.0]]])
    filled = filled_from_neighbours(far, moved_px, np.append(np.ones(25, bool), False), SPACING_PX)
    np.testing.assert_array_equal(filled[25], field[20])


def test_no_dot_gets_two_partners_and_none_is_invented():
    before = np.indices((4, 4)).reshape(2, -1).T * SPACING_PX
    partner = assign(before, before[:5] + 3.0, SPACING_PX)
    assert partner.tolist() == [0, 1, 2, 3, 4] + [UNASSIGNED] * 11
    assert (assign(before, before[:0], SPACING_PX) == UNASSIGNED).all()


def test_a_displacement_unlike_its_neighbours_stands_out():
    """Setup: an affine field; one dot is off by 10 px. Expected: 10 px there, below 1 elsewhere."""
    before = np.indices((5, 5)).reshape(2, -1).T * SPACING_PX
    field = before @ np.array([[0.02, -0.05], [0.03, 0.01]]) + 4.0
    field[12, 0] += 10.0
    off = deviation_from_neighbours(before, field, np.ones(25, bool), SPACING_PX)
    assert off[12] == pytest.approx(10.0, rel=0.02)
    interior = [6, 7, 8, 11, 13, 16, 17, 18]
    assert off[interior].max() < 1.0
