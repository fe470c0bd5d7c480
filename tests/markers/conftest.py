"""Closed-form images of dark discs with a blurred rim under uneven light."""

import numpy as np
import pytest
from scipy.special import ndtr

SHAPE = (120, 160)
SPACING_PX = 22.0
RADIUS_PX, EDGE_PX, CONTRAST = 4.5, 0.9, 0.7
SUB = (np.arange(3) + 0.5) / 3 - 0.5


def draw(centres_px, shape=SHAPE, radius_px=RADIUS_PX, contrast=CONTRAST, stretch=1.0):
    """Return the mean light of each pixel over 3 x 3 places; `stretch`: ratio of the half axes."""
    row, col = np.indices(shape, dtype=float)
    total = np.zeros(shape)
    for down in SUB:
        for right in SUB:
            y, x = row + down, col + right
            light = 0.4 * (1 + 0.3 * (y / shape[0] - 0.5) - 0.2 * (x / shape[1] - 0.5) ** 2)
            for centre in centres_px:
                r = np.hypot((y - centre[0]) * stretch, (x - centre[1]) / stretch)
                light = light * (1 - contrast * ndtr((radius_px - r) / EDGE_PX))
            total += light
    return total / SUB.size**2


def lattice(shape=SHAPE, spacing_px=SPACING_PX, seed=3):
    """Return places on a lattice, each moved by up to half a pixel."""
    rows, cols = (np.arange(14.0, size - 12.0, spacing_px) for size in shape)
    places = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1).reshape(-1, 2)
    return places + np.random.default_rng(seed).uniform(-0.5, 0.5, places.shape)


def noisy(light, seed, levels=2.0):
    """Return the light as whole 8-bit levels with noise, over 255."""
    noise = np.random.default_rng(seed).normal(0.0, levels, light.shape)
    return np.round(255.0 * light + noise) / 255.0


@pytest.fixture(scope="session")
def dots_px():
    return lattice()


@pytest.fixture(scope="session")
def moved_px(dots_px):
    """Displacements of up to 0.37 spacings: a smooth field about the middle of the image."""
    local = dots_px - np.array(SHAPE) / 2
    near = np.exp(-np.sum(local**2, axis=1) / (2 * 40.0**2))[:, None]
    return (local / 40.0 * 0.21 + (0.3, 0.1)) * SPACING_PX * near


@pytest.fixture(scope="session")
def make_image():
    return draw


@pytest.fixture(scope="session")
def before(dots_px):
    return draw(dots_px)


@pytest.fixture(scope="session")
def after(dots_px, moved_px):
    return draw(dots_px + moved_px)


@pytest.fixture(scope="session")
def with_noise():
    return noisy


@pytest.fixture(scope="session")
def make_lattice():
    return lattice
