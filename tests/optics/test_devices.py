"""The Dr.Jit devices equal the decoder's pinhole model, distortion included."""

import cv2
import numpy as np
import pytest

from reconstruction.calibration import Pinhole

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

    device = getattr(rig_of(load_experiment("paper/two_balls", LENSES[name])), name)
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
