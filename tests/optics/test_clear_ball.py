"""The image of the stage through a clear ball, against Snell and Fresnel only.

A pinhole on the axis of a ball lights the stage behind it symmetrically about the axis: light
between two angles is refracted twice and is incident on the ring between two radii. The radiance of
a camera ray follows from the same two refractions. Mitsuba's sphere on its plane stage; z = 0 is
the ball's top.
"""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.optics.test_photons import GAP_MM, HEIGHT_MM, NEAR, white_with_and_without
from twin.config import load_experiment

IOR, RADIUS_MM, LAMP_Z_MM = 1.5, HEIGHT_MM / 2, 60.0
CENTRE_MM = np.array([0.0, 0.0, -RADIUS_MM])
STAGE_Z_MM = -HEIGHT_MM - GAP_MM
# Blur by the photons' grid and the interpolation between its nodes (twin.optics.photons).
BLUR_MM = 0.06
SUB_PIXELS = 6


def refracted(ray, normal, ratio):
    """Return rays (n, 3) behind a face, and its transmittance for unpolarised light (n,).

    Parameters
    ----------
    normal : against the rays
    ratio : of the indices, before over behind
    """
    cos_in = -np.sum(ray * normal, axis=-1)
    cos_out = np.sqrt(1.0 - ratio**2 * (1.0 - cos_in**2))
    behind = ratio * ray + (ratio * cos_in - cos_out)[..., np.newaxis] * normal
    across = (ratio * cos_in - cos_out) / (ratio * cos_in + cos_out)
    within = (cos_in - ratio * cos_out) / (cos_in + ratio * cos_out)
    return behind, 1.0 - (across**2 + within**2) / 2.0


def through_the_ball(start_mm, ray):
    """Return places on the stage (n, 3), transmittances (n,), distance from the ball's middle."""
    to_start = start_mm - CENTRE_MM
    along = np.sum(to_start * ray, axis=-1)
    square = along**2 - np.sum(to_start**2, axis=-1) + RADIUS_MM**2
    half = np.sqrt(np.maximum(square, 0.0))
    entry = start_mm + (-along - half)[..., np.newaxis] * ray
    normal = (entry - CENTRE_MM) / RADIUS_MM
    inside, first = refracted(ray, normal, 1.0 / IOR)
    leave = entry - 2.0 * np.sum((entry - CENTRE_MM) * inside, axis=-1)[..., np.newaxis] * inside
    out, second = refracted(inside, -(leave - CENTRE_MM) / RADIUS_MM, IOR)
    way = (STAGE_Z_MM - leave[..., 2]) / out[..., 2]
    closest = np.where(square > 0, np.sqrt(np.maximum(RADIUS_MM**2 - square, 0.0)), np.inf)
    return leave + way[..., np.newaxis] * out, first * second, closest


def bare_irradiance(radius_mm):
    """Return the irradiance of a uniform field on the bare stage: the cosines cancel."""
    return np.full_like(radius_mm, 1.0 / (LAMP_Z_MM - STAGE_Z_MM) ** 2)


def stage_irradiance():
    """Return a map (y, x) of the irradiance behind the ball, blurred, and its axis in mm."""
    edge = np.arcsin(RADIUS_MM / (LAMP_Z_MM - CENTRE_MM[2]))
    angle = (np.arange(1_000_000) + 0.5) / 1e6 * edge
    ray = np.stack([np.sin(angle), 0.0 * angle, -np.cos(angle)], axis=-1)
    place, share, _ = through_the_ball(np.array([0.0, 0.0, LAMP_Z_MM]), ray)
    # Uniform over the plane: its intensity is proportional to 1 / cos^3.
    flux = np.cos(angle) ** -3 * share * np.sin(angle) * 2.0 * np.pi * (angle[1] - angle[0])
    rings = np.linspace(0.0, 8.0, 801)
    flux_by_ring, _ = np.histogram(np.abs(place[:, 0]), rings, weights=flux)
    middle = (rings[1:] + rings[:-1]) / 2
    density = flux_by_ring / (np.pi * (rings[1:] ** 2 - rings[:-1] ** 2))
    shadow_mm = (LAMP_Z_MM - STAGE_Z_MM) * np.tan(edge)
    density += np.where(middle > shadow_mm, bare_irradiance(middle), 0.0)
    axis = np.linspace(-6.0, 6.0, 1201)
    plane = np.interp(np.hypot(*np.meshgrid(axis, axis)), middle, density)
    return gaussian_filter(plane, BLUR_MM / (axis[1] - axis[0])), axis


def image_through_the_ball(experiment):
    """Return the image over that of the bare stage, and the rays' distances from the middle, mm."""
    from scipy.interpolate import RegularGridInterpolator

    from twin.optics.scene import rig_of

    camera = rig_of(experiment).camera
    lens, pose = camera.pinhole, np.asarray(camera.T_world_from_device)
    steps = (np.arange(SUB_PIXELS) + 0.5) / SUB_PIXELS - 0.5
    v, u = np.meshgrid(
        (np.arange(lens.height_px)[:, np.newaxis] + steps).ravel(),
        (np.arange(lens.width_px)[:, np.newaxis] + steps).ravel(),
        indexing="ij",
    )
    ray = np.stack([(u - lens.cx_px) / lens.fx_px, (v - lens.cy_px) / lens.fy_px, 1 + 0 * u], -1)
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True) @ pose[:3, :3].T
    start = pose[:3, 3]
    with np.errstate(invalid="ignore"):  # rays that pass the ball
        place, share, closest = through_the_ball(start, ray)
    irradiance, axis = stage_irradiance()
    at = RegularGridInterpolator((axis, axis), irradiance, bounds_error=False, fill_value=0.0)
    through = np.nan_to_num(share) * at(np.nan_to_num(place[..., 1::-1]))
    shape = (lens.height_px, SUB_PIXELS, lens.width_px, SUB_PIXELS)
    means = (grid.reshape(shape).mean(axis=(1, 3)) for grid in (through, closest))
    image, distance_mm = means
    return image / bare_irradiance(image), distance_mm


@pytest.mark.parametrize("polar_deg", [5.0, 8.0])
def test_the_stage_through_a_ball_follows_snell_and_fresnel(mi, polar_deg):
    """Setup: the camera looks through the ball's middle, into the caustic behind it.

    Expected: the mean over the rays within half the radius agrees to 2 %, medians of rings to
    4 %: photon noise, light reflected inside the ball and by the stage (1 % each), and the blur,
    which changes the caustic's edge by 10 % and is applied to the reference.
    """
    tilt = {"value": polar_deg, "source": "test", "range": [0.0, 20.0]}
    experiment = load_experiment("examples/slab_balls", NEAR | {"camera.pose.polar_deg": tilt})
    ours, bare = white_with_and_without(mi, experiment)
    expected, distance_mm = image_through_the_ball(experiment)
    ratio = ours / bare
    middle = distance_mm < RADIUS_MM / 2
    assert expected[middle].mean() > 5.0  # the caustic, not its shadow
    assert ratio[middle].mean() == pytest.approx(expected[middle].mean(), rel=0.02)
    for low_mm in (0.0, 0.5, 1.0):
        ring = (distance_mm >= low_mm) & (distance_mm < low_mm + 0.5)
        assert np.median(ratio[ring] / expected[ring]) == pytest.approx(1.0, abs=0.04)
