"""The Dr.Jit devices equal the decoder's pinhole model, distortion included."""

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
