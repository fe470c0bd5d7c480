"""Dots of unknown size in closed-form images."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from reconstruction.errors import FitError
from reconstruction.markers import covered_pixels, find_pattern, linear_light


@pytest.mark.parametrize("printed", [(2.5, 16.0, 0.6), (4.5, 22.0, 0.3), (8.0, 34.0, 0.8)], ids=str)
def test_size_contrast_and_spacing_are_estimated(make_image, make_lattice, with_noise, printed):
    """Expected: every dot, radius to 2 %, contrast to 0.02, spacing to 3 %."""
    radius_px, spacing_px, contrast = printed
    places = make_lattice(spacing_px=spacing_px)
    image = make_image(places, radius_px=radius_px, contrast=contrast)
    pattern = find_pattern(with_noise(image, 1, 1.0))
    distance, nearest = KDTree(places).query(pattern.dots.centres_px)
    assert sorted(nearest) == list(range(len(places)))
    assert distance.max() < 0.3
    assert pattern.radius_px == pytest.approx(radius_px, rel=0.02)
    assert pattern.contrast == pytest.approx(contrast, abs=0.02)
    assert pattern.spacing_px == pytest.approx(spacing_px, rel=0.03)


def test_the_brightness_of_the_image_has_no_effect(before):
    one, other = find_pattern(before), find_pattern(1e3 * before)
    np.testing.assert_allclose(one.dots.centres_px, other.dots.centres_px, atol=1e-6)


@pytest.mark.parametrize("levels", [1.0, 20.0])
def test_an_image_without_dots_is_an_error(make_image, with_noise, levels):
    bare = make_image(np.zeros((0, 2)))
    with pytest.raises(FitError, match=r"printed dots .*remove \[dots\]"):
        find_pattern(with_noise(bare, 2, levels))


@pytest.mark.parametrize("light", [1.0, 0.3])
def test_a_flat_image_is_an_error(light):
    with pytest.raises(FitError, match="found 0 printed dots"):
        find_pattern(np.full((60, 80), light))


def test_covered_pixels_are_those_of_the_dots(make_image, with_noise):
    """Setup: dots, two of them cut by the border, which are not in the pattern.

    Expected: all pixels within the radius are covered, none beyond the radius and 5 px.
    """
    places = np.array([[r, c] for r in (1.0, 23.0, 45.0, 67.0, 89.0) for c in (14.0, 40.0, 66.0)])
    image = with_noise(make_image(places, (100, 80)), 4)
    pattern = find_pattern(image)
    assert len(pattern.dots.centres_px) == len(places) - 3
    covered = covered_pixels(image, pattern)
    row, col = np.indices(image.shape)
    away = np.min([np.hypot(row - r, col - c) for r, c in places], axis=0)
    assert covered[away < 4.5].all()
    assert not covered[away > 9.5].any()


def test_light_is_the_mean_of_linear_channels():
    levels = np.array([[[255, 0, 51]]])
    assert linear_light(levels, 2.0)[0, 0] == pytest.approx((1 + 0 + 0.04) / 3)
