import numpy as np
import pytest

from reconstruction.rig.pinhole import NO_DISTORTION, Pinhole, distort
from reconstruction.triangulation._ray import Rays, lens_of, ray_row


def rays_of(camera, rows):
    """Return (row, col, xy) rays and where they were found, each row from the one before."""
    lens = lens_of(camera)
    bends = np.zeros((2, camera.width_px))
    rays = np.zeros((len(rows), 2, camera.width_px))
    result = np.zeros((len(rows), camera.width_px), np.bool_)
    for ray, known, row in zip(rays, result, rows, strict=True):
        ray_row(row, lens, Rays(ray[0], ray[1], bends[0], bends[1], known))
    return np.moveaxis(rays, 1, -1), result


@pytest.mark.parametrize(
    "distortion", [NO_DISTORTION, (-0.05, 0.1, 1e-4, -2e-4, 0.02), (-0.3, 0.12, 2e-3, 1e-3, 0.0)]
)
def test_rays_are_the_inverse_of_the_lens(distortion):
    """Setup: telephoto and wide angle, also distant rows. Expected: 1e-10 of `unproject`."""
    camera = Pinhole(160, 120, 110.0, 112.0, 77.0, 61.0, distortion)
    rows = [*range(50), 90, 20, 119]
    rays, result = rays_of(camera, rows)
    pixels = np.stack(np.meshgrid(np.arange(160), rows), axis=-1)
    assert result.all()
    assert np.max(np.abs(rays - camera.unproject(pixels))) < 1e-10


def test_beyond_a_fold_there_is_no_ray():
    """Setup: r (1 - 0.5 r^2) never exceeds 0.544. Expected: rays inside, none outside of it."""
    camera = Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5, (-0.5, 0.0, 0.0, 0.0, 0.0))
    rows = np.arange(120)
    rays, result = rays_of(camera, rows)
    pixels = np.stack(np.meshgrid(np.arange(160), rows), axis=-1)
    target = (pixels - (79.5, 59.5)) / 100.0
    radius = np.hypot(target[..., 0], target[..., 1])
    largest = np.sqrt(2.0 / 3.0) * 2.0 / 3.0
    assert result[radius < largest - 0.01].all()
    assert not result[radius > largest].any()
    back = np.stack(distort(rays[..., 0], rays[..., 1], camera.distortion), axis=-1)
    assert np.max(np.abs(back - target)[result]) < 1e-10
    # Of three solutions, the one that increases with the image radius.
    assert np.all(np.hypot(rays[..., 0], rays[..., 1])[result] < np.sqrt(2.0 / 3.0) + 1e-9)


@pytest.mark.parametrize("k1", [-0.25, -0.1, 0.1, 0.2])
def test_every_ray_of_a_wide_lens_meets_its_pixel(k1):
    """Setup: image to 0.72 of the focal length, 0.94 of the limit of k1 = -0.25.

    Expected: a ray for every pixel, back on it within 1e-9 px (1e-4 required).
    """
    camera = Pinhole(160, 120, 139.0, 139.0, 79.5, 59.5, (k1, 0.0, 1e-3, -2e-3, 0.0))
    rays, result = rays_of(camera, np.arange(120))
    assert result.all()
    ends = np.concatenate([rays, np.ones((120, 160, 1))], axis=-1)
    pixels = np.stack(np.meshgrid(np.arange(160), np.arange(120)), axis=-1)
    assert np.abs(camera.project(ends) - pixels).max() < 1e-9


def test_no_ray_is_from_behind_the_fold():
    """Setup: r (1 - 0.5 r^2 + 0.1 r^4) rises to 0.6 at r = 1, and again from 1.41 on.

    Expected: none of the rays that also meet a pixel there, but that no such lens has.
    """
    camera = Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5, (-0.5, 0.1, 0.0, 0.0, 0.0))
    rays, result = rays_of(camera, np.arange(120))
    pixels = np.stack(np.meshgrid(np.arange(160), np.arange(120)), axis=-1)
    radius = np.hypot(*np.moveaxis(pixels - (79.5, 59.5), -1, 0)) / 100.0
    np.testing.assert_array_equal(result, radius < 0.6)
    assert np.hypot(rays[..., 0], rays[..., 1])[result].max() < 1.0
