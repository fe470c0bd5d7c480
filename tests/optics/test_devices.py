"""The Dr.Jit devices equal the decoder's pinhole model, distortion included."""

import cv2
import numpy as np
import pytest

from reconstruction.rig.calibration import Pinhole
from tests.optics.scenes import coated_scene

DISTORTED = (-0.12, 0.05, 1e-3, -2e-3, 0.01)


@pytest.fixture
def device(mi):
    from twin.optics.devices import Device

    pose = np.eye(4)
    pose[:3, 3] = [3.0, -2.0, 250.0]
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pinhole = Pinhole(1280, 720, 1536.0, 1530.0, 639.5, 719.5, DISTORTED)
    return Device(pinhole, pose)


def test_project_equals_the_reference(mi, device):
    rng = np.random.default_rng(2)
    points = rng.uniform([-60, -60, -5], [60, 60, 5], (500, 3))
    x_px, y_px, axial_mm = device.project(mi.Point3f(points.T))
    in_device = (points - device.T_world_from_device[:3, 3]) @ device.T_world_from_device[:3, :3]
    wanted = device.pinhole.project(in_device)
    # float32 resolves 1280 px to 1e-4 px
    np.testing.assert_allclose(np.array(x_px), wanted[:, 0], atol=5e-4)
    np.testing.assert_allclose(np.array(y_px), wanted[:, 1], atol=5e-4)
    np.testing.assert_allclose(np.array(axial_mm), in_device[:, 2], rtol=1e-6)


def test_ray_and_projection_are_inverse(mi, device):
    rng = np.random.default_rng(3)
    pixels = rng.uniform([0, 0], [1280, 720], (500, 2))
    ray = device.ray(mi.Float(pixels[:, 0]), mi.Float(pixels[:, 1]))
    x_px, y_px, _ = device.project(ray(mi.Float(200.0)))
    np.testing.assert_allclose(np.array(x_px), pixels[:, 0], atol=2e-3)
    np.testing.assert_allclose(np.array(y_px), pixels[:, 1], atol=2e-3)


@pytest.mark.parametrize("k1", [-0.25, -0.1, 0.1, 0.2])
def test_every_ray_of_a_wide_lens_meets_its_pixel(mi, k1):
    """Setup: image to 0.72 of the focal length, 0.94 of the largest image with k1 = -0.25.

    Expected: the ray, distorted in double precision, is back on its pixel within 1e-4 px.
    """
    from twin.optics.devices import Device

    pinhole = Pinhole(320, 240, 277.0, 277.0, 159.5, 119.5, (k1, 0.0, 1e-3, -2e-3, 0.0))
    pixels = np.stack(np.meshgrid(np.arange(-0.5, 320), np.arange(-0.5, 240)), -1).reshape(-1, 2)
    ray = Device(pinhole, np.eye(4)).ray(mi.Float(pixels[:, 0]), mi.Float(pixels[:, 1]))
    assert (np.array(ray.maxt) > 0.0).all()
    back = pinhole.project(np.array(ray.d, np.float64).T)
    assert np.abs(back - pixels).max() < 1e-4


FOLDING = (-0.5, 0.1, 0.0, 0.0, 0.0)
"""r (1 - 0.5 r^2 + 0.1 r^4) increases to 0.6 at r = 1, decreases, and increases from r = 1.41."""


def test_pixels_beyond_the_fold_have_no_ray(mi):
    from twin.optics.devices import Device

    pinhole = Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5, FOLDING)
    pixels = np.stack(np.meshgrid(np.arange(160.0), np.arange(120.0)), axis=-1).reshape(-1, 2)
    ray = Device(pinhole, np.eye(4)).ray(mi.Float(pixels[:, 0]), mi.Float(pixels[:, 1]))
    radius = np.hypot(*(pixels - (79.5, 59.5)).T) / 100.0
    np.testing.assert_array_equal(np.array(ray.maxt) > 0.0, radius < 0.6)
    assert np.isfinite(np.array(ray.d)).all()


def test_points_beyond_the_fold_are_on_no_image(mi):
    """Setup: directions up to r = 2; those from 1 on would fold back onto the image."""
    from twin.optics.devices import Device

    radius = np.linspace(0.0, 2.0, 400)
    pinhole = Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5, FOLDING)
    points = mi.Point3f(200.0 * radius, 0.0, 200.0)
    x_px, y_px, _ = Device(pinhole, np.eye(4)).project(points)
    on_image = (np.array(x_px) < 160.0) & (np.array(x_px) > 0.0) & (np.array(y_px) > 0.0)
    np.testing.assert_array_equal(on_image, radius < 1.0)
    assert np.isfinite(np.array(x_px)).all()


@pytest.mark.parametrize("device", ["camera", "projector"])
def test_beyond_the_fold_there_is_no_light(mi, plane, device):
    """Setup: devices so near and wide that their lens r (1 - 0.5 r^2) folds on the coat.

    Expected: pixels beyond the fold of either lens are dark, all others lit.
    """
    from dataclasses import replace

    from twin.config import load_experiment
    from twin.optics.light import light_tables, pattern_set
    from twin.optics.one_trace import trace_stack, trace_truth
    from twin.optics.scene import rig_of

    experiment = load_experiment(
        "examples/slab_balls", {"render.samples": 1, "projector.height_px": 1280}
    )
    folding, far = (-0.5, 0.0, 0.0, 0.0, 0.0), np.diag([1.0, -1.0, -1.0, 1.0])
    far[2, 3] = 14.137  # no ray along an edge of the mesh
    lenses = {name: folding if name == device else (0.0,) * 5 for name in ("camera", "projector")}
    rig = replace(
        rig_of(experiment),
        camera=_wide(Pinhole(80, 60, 50.0, 50.0, 39.5, 29.5, lenses["camera"]), far),
        projector=_wide(Pinhole(1280, 1280, 560.0, 560.0, 639.5, 639.5, lenses["projector"]), far),
    )
    scene = coated_scene(experiment, plane)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns)
    white = trace_stack(scene, rig, tables, 1)[patterns.index("white").start]
    truth = trace_truth(scene, rig)
    x, y = np.meshgrid((np.arange(80) - 39.5) / 50.0, (np.arange(60) - 29.5) / 50.0)
    fold = np.sqrt(2.0 / 3.0) * (2.0 / 3.0 if device == "camera" else 1.0)
    beyond = np.hypot(x, y) > fold
    assert 0.02 < beyond.mean() < 0.6
    assert not white[beyond].any()
    assert not truth.lit[beyond].any()
    assert (white[np.hypot(x, y) < 0.8 * fold] > 0.0).all()
    assert np.isfinite(white).all()


def _wide(pinhole, T_world_from_device):
    from twin.optics.devices import Device

    return Device(pinhole, T_world_from_device)


LENSES = {
    "camera": {"camera.distortion": [-0.12, 0.05, 1e-3, -2e-3, 0.01]},
    "projector": {
        "projector.offset_percent": 116.0,
        "projector.distortion": [0.03, -0.02, 8e-4, -1e-3, 0.005],
    },
}


@pytest.mark.parametrize("name", list(LENSES))
def test_the_whole_field_is_where_opencv_projects_it(mi, name):
    """Paper's devices with distortion, the projector also off-axis: 0.01 px, both directions.

    Field points at three distances, seen by `cv2.projectPoints` from the world frame.
    """
    from twin.config import load_experiment
    from twin.optics.scene import rig_of

    device = getattr(rig_of(load_experiment("examples/slab_balls", LENSES[name])), name)
    p, T_world_from_device = device.pinhole, device.T_world_from_device
    columns, rows = (
        np.linspace(-0.5, p.width_px - 0.5, 25),
        np.linspace(-0.5, p.height_px - 0.5, 19),
    )
    slopes = p.unproject(np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2))
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
    in_device = np.concatenate([z_mm * rays for z_mm in (190.0, 240.0, 310.0)])
    points = in_device @ T_world_from_device[:3, :3].T + T_world_from_device[:3, 3]
    seen_px = _opencv_pixels(points, device)

    x_px, y_px, axial_mm = (np.array(v, np.float64) for v in device.project(mi.Point3f(points.T)))
    np.testing.assert_allclose(np.stack([x_px, y_px], axis=-1), seen_px, atol=0.01)
    np.testing.assert_allclose(axial_mm, in_device[:, 2], rtol=1e-6)

    ray = device.ray(mi.Float(seen_px[:, 0]), mi.Float(seen_px[:, 1]))
    on_ray = np.array(ray(mi.Float(np.linalg.norm(in_device, axis=1)))).T.astype(np.float64)
    np.testing.assert_allclose(_opencv_pixels(on_ray, device), seen_px, atol=0.01)
    np.testing.assert_allclose(on_ray, points, atol=0.01 * 310.0 / p.fx_px)


def _opencv_pixels(points_world_mm, device):
    p, T_device_from_world = device.pinhole, np.linalg.inv(device.T_world_from_device)
    matrix = np.array([[p.fx_px, 0.0, p.cx_px], [0.0, p.fy_px, p.cy_px], [0.0, 0.0, 1.0]])
    turn, shift_mm = cv2.Rodrigues(T_device_from_world[:3, :3])[0], T_device_from_world[:3, 3]
    coefficients = np.array(p.distortion)
    return cv2.projectPoints(points_world_mm, turn, shift_mm, matrix, coefficients)[0].reshape(
        -1, 2
    )
