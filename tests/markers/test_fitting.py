"""Centres of dots: closed-form derivatives, and errors beside their stated uncertainty."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from reconstruction.markers.fitting import _Dot, fit_dots


def test_derivatives_equal_differences():
    """Expected: central differences of the light, step 1e-5: 1e-8."""
    y, x = np.random.default_rng(0).uniform(-12.0, 12.0, (2, 200))
    p = np.array([0.3, -0.2, np.log(7.0), 0.1, -0.2, 0.1, 0.6, 1.1, 0.01, -0.02])
    derivatives = _Dot(p, y, x).derivatives()
    for k in range(p.size):
        step = np.zeros(p.size)
        step[k] = 1e-5
        change = (_Dot(p + step, y, x).light - _Dot(p - step, y, x).light) / 2e-5
        np.testing.assert_allclose(derivatives[:, k], change, atol=1e-8)


def test_centres_without_noise_are_exact(before, dots_px):
    """Expected: the pixel's area is in the image, not in the model, but symmetric: 1e-3 px."""
    dots = fit_dots(before, dots_px + 0.4, 4.5, 22.0)
    np.testing.assert_allclose(dots.centres_px, dots_px, atol=1e-3)


def test_an_ellipse_has_the_centre_of_its_disc(make_image, dots_px):
    """Setup: dots stretched by a press to a ratio of the half axes of 1.2^2."""
    image = make_image(dots_px, stretch=1.2)
    dots = fit_dots(image, dots_px, 4.5, 22.0)
    np.testing.assert_allclose(dots.centres_px, dots_px, atol=2e-3)
    np.testing.assert_allclose(dots.radius_px, 4.5, rtol=0.01)


def test_errors_are_those_stated(before, dots_px, with_noise):
    """Setup: 6 images with noise of 4 levels. Expected: RMS of error over sigma, 35 dots and two
    coordinates each, so 420 numbers: 1 to 0.035, and the stated autocorrelation is near that of
    white noise; 0.9 to 1.1. Twice the noise gives twice the sigma.
    """
    over = []
    for seed in range(6):
        dots = fit_dots(with_noise(before, seed, 4.0), dots_px, 4.5, 22.0)
        over.append((dots.centres_px - dots_px) / dots.sigma_px)
    assert np.sqrt(np.mean(np.square(over))) == pytest.approx(1.0, abs=0.1)
    loud = fit_dots(with_noise(before, 7, 8.0), dots_px, 4.5, 22.0)
    ratio = np.median(loud.sigma_px) / np.median(dots.sigma_px)
    assert ratio == pytest.approx(2.0, rel=0.15)


def test_sigma_contains_correlated_noise(before, dots_px, with_noise):
    """Setup: noise averaged over 3 x 3 pixels, as after demosaicing. Expected as above."""
    from scipy.ndimage import uniform_filter

    over = []
    for seed in range(6):
        noise = uniform_filter(with_noise(np.zeros_like(before), seed, 6.0), 3)
        dots = fit_dots(before + noise, dots_px, 4.5, 22.0)
        over.append((dots.centres_px - dots_px) / dots.sigma_px)
    assert np.sqrt(np.mean(np.square(over))) == pytest.approx(1.0, abs=0.15)


def test_places_without_a_dot_and_dots_cut_by_the_border_have_no_fit(make_image):
    image = make_image([[30.0, 30.0], [3.0, 60.0]], (64, 80))
    dots = fit_dots(image, np.array([[30.0, 30.5], [3.0, 60.0], [45.0, 60.0]]), 4.5, 22.0)
    assert len(dots.centres_px) == 1
    assert KDTree(dots.centres_px).query([30.0, 30.0])[0] < 0.01
