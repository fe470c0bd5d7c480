"""Displacements between two closed-form images."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from reconstruction.errors import FitError, InputError
from reconstruction.markers import (
    DotStatus,
    MotionField,
    find_pattern,
    mean_motion,
    track,
)


def in_order(tracks, dots_px):
    return KDTree(dots_px).query(tracks.places_px)[1]


def test_displacements_beside_their_uncertainty(before, after, dots_px, moved_px, with_noise):
    """Setup: up to 0.37 spacings, noise of 2 levels, 6 pairs: 420 numbers.

    Expected: all dots tracked, RMS error below 0.05 px, error over sigma 0.85 to 1.15.
    """
    errors, over = [], []
    for seed in range(6):
        tracks = track(with_noise(before, 2 * seed), with_noise(after, 2 * seed + 1))
        assert tracks.tracked.all()
        assert len(tracks.status) == len(dots_px)
        off = tracks.moved_px - moved_px[in_order(tracks, dots_px)]
        errors.append(off)
        over.append(off / tracks.sigma_px)
    assert np.sqrt(np.mean(np.square(errors))) < 0.05
    assert 0.85 < np.sqrt(np.mean(np.square(over))) < 1.15


def test_a_slip_over_several_frames(make_image, make_lattice):
    """Setup: the lattice slips by 0.4 spacings per frame, to 1.2; dots move out of the image.

    Expected: with the frame before, the tracked dots have the slip to 0.05 px; for the last frame
    without it, the median error is more than half a spacing.
    """
    dots = make_lattice((100, 140))
    pattern, tracks = find_pattern(make_image(dots, (100, 140))), None
    for frame in (1, 2, 3):
        slip_px = np.array([0.0, 0.4 * 22.0 * frame])
        image = make_image(dots + slip_px, (100, 140))
        tracks = track(pattern, image, tracks)
        assert np.count_nonzero(tracks.tracked) >= 0.7 * len(pattern.dots.centres_px)
        np.testing.assert_allclose(tracks.moved_px[tracks.tracked] - slip_px, 0.0, atol=0.05)
    alone = track(pattern, image)
    assert np.abs(np.median(alone.moved_px[alone.tracked], axis=0) - slip_px).max() > 11.0
    with pytest.raises(InputError, match="from one pattern"):
        track(find_pattern(make_image(dots[:-1], (100, 140))), image, tracks)


def test_lost_and_wrong_dots_are_marked(make_image, before, dots_px, moved_px, with_noise):
    """Setup: one dot is gone, and one dot of those that hardly move is 0.33 spacings off.

    Expected: LOST with displacement 0; DOUBTFUL; all others tracked.
    """
    places = dots_px + moved_px
    gone, off = 16, 0
    places[off] += (5.0, 5.0)
    image = make_image(np.delete(places, gone, axis=0))
    tracks = track(find_pattern(before), with_noise(image, 5))
    number = in_order(tracks, dots_px)
    status = dict(zip(number.tolist(), tracks.status.tolist(), strict=True))
    assert status.pop(gone) == DotStatus.LOST
    assert status.pop(off) == DotStatus.DOUBTFUL
    assert set(status.values()) == {DotStatus.TRACKED}
    assert not tracks.moved_px[number == gone].any()
    assert not tracks.sigma_px[number == gone].any()


def test_an_image_without_dots_loses_all(before):
    tracks = track(before, np.full_like(before, 0.4))
    assert (tracks.status == DotStatus.LOST).all()


def test_images_of_two_sizes(before):
    with pytest.raises(InputError, match="shapes"):
        track(before, before[:-1])


def test_mean_motion_of_an_affine_field_is_exact():
    """Setup: displacement a + G x. Expected: the trace, the sum and the half difference of G."""
    places = np.random.default_rng(1).uniform(-5.0, 5.0, (20, 2))
    gradient = np.array([[0.02, -0.03], [0.05, 0.01]])
    moved = (places - places.mean(axis=0)) @ gradient.T + (0.3, -0.2)
    motion = mean_motion(places, moved)
    assert (motion.x_mm, motion.y_mm) == pytest.approx((0.3, -0.2))
    assert motion.divergence == pytest.approx(0.03)
    assert motion.shear == pytest.approx(0.02)
    assert motion.rotation_rad == pytest.approx(0.04)
    assert motion.rotation_sigma_rad < 1e-12


def test_mean_motion_is_beside_its_uncertainty():
    """Setup: no motion, noise of 0.01 mm, 400 draws. Expected: error over sigma 1 to 8 %."""
    rng = np.random.default_rng(2)
    places = rng.uniform(-5.0, 5.0, (40, 2))
    over = []
    for _ in range(400):
        m = mean_motion(places, rng.normal(0.0, 0.01, places.shape))
        over.append(
            (m.x_mm / m.x_sigma_mm, m.divergence / m.divergence_sigma,
             m.shear / m.shear_sigma, m.rotation_rad / m.rotation_sigma_rad)
        )  # fmt: skip
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(over), axis=0)), 1.0, atol=0.1)


@pytest.mark.parametrize("places", [np.zeros((3, 2)), np.outer(np.arange(9.0), [1.0, 2.0])])
def test_too_few_dots_have_no_mean_motion(places):
    with pytest.raises(FitError, match="tracked dots"):
        mean_motion(places, np.zeros_like(places))


def smooth(points_mm):
    x, y = points_mm.T
    near = 0.2 * np.exp(-((x - 1.0) ** 2 + y**2) / 8.0)
    return np.column_stack([0.05 + near, 0.02 * x - 0.5 * near])


def test_field_between_the_dots_is_beside_its_uncertainty():
    """Setup: a smooth field on 7 x 9 dots of 2.2 mm, errors of 2 um, 4 draws.

    Expected: within the dots, RMS error below 15 um for 200 um of displacement, and error over
    sigma 0.4 to 1.4: the field is one shape, not a draw from the assumed process. At the dots the
    measured values are met to three sigma.
    """
    rows, cols = np.indices((7, 9)).reshape(2, -1) - np.array([[3.0], [4.0]])
    dots = 2.2 * np.column_stack([cols, rows])
    points = np.random.default_rng(0).uniform(-6.0, 6.0, (300, 2))
    errors, over = [], []
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(0.0, 0.002, dots.shape)
        field = MotionField.of(dots, smooth(dots) + noise, np.full(dots.shape, 0.002))
        value, sigma = field.at(points)
        errors.append(value - smooth(points))
        over.append(errors[-1] / sigma)
        at_dots = field.at(dots)[0] - smooth(dots) - noise
        assert np.sqrt(np.mean(at_dots**2)) < 0.006
    assert np.sqrt(np.mean(np.square(errors))) < 0.015
    assert 0.4 < np.sqrt(np.mean(np.square(over))) < 1.4


def test_sigma_of_the_field_grows_away_from_the_dots():
    dots = 2.0 * np.indices((4, 4)).reshape(2, -1).T
    field = MotionField.of(dots, smooth(dots), np.full(dots.shape, 0.002))
    _, sigma = field.at(np.array([[2.0, 2.0], [7.0, 7.0], [12.0, 12.0]]))
    assert (np.diff(sigma, axis=0) > 0.0).all()


def test_a_field_needs_six_dots():
    with pytest.raises(FitError, match="at least 6"):
        MotionField.of(np.zeros((5, 2)), np.zeros((5, 2)), np.ones((5, 2)))
