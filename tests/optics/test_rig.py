"""Geometry of the rig: axes, aim and the projector's offset."""

import numpy as np
import pytest

from twin.config import load_experiment
from twin.optics.rig import true_calibration


def project(pinhole, T_world_from_device, point_world_mm):
    T_device_from_world = np.linalg.inv(T_world_from_device)
    return pinhole.project((T_device_from_world @ np.append(point_world_mm, 1.0))[:3])


@pytest.fixture(scope="module")
def rig():
    return true_calibration(load_experiment("examples/slab_balls"))


def test_camera_looks_down_with_x_right_and_y_up(rig):
    centre = project(rig.camera, rig.T_world_from_cam, [0.0, 0.0, 0.0])
    right = project(rig.camera, rig.T_world_from_cam, [1.0, 0.0, 0.0])
    back = project(rig.camera, rig.T_world_from_cam, [0.0, 1.0, 0.0])
    np.testing.assert_allclose(centre, [(1936 - 1) / 2, (1464 - 1) / 2], atol=1e-9)
    assert right[0] > centre[0]
    assert right[1] == pytest.approx(centre[1])
    assert back[1] < centre[1]
    assert back[0] == pytest.approx(centre[0])


def test_field_of_view_is_the_derived_one(rig):
    """rig_facts: 28.6 x 21.6 mm from 214 mm, about 15 um per pixel."""
    width_mm = rig.camera.width_px / rig.camera.fx_px * 214.0
    height_mm = rig.camera.height_px / rig.camera.fy_px * 214.0
    assert (width_mm, height_mm) == (pytest.approx(28.6, abs=0.1), pytest.approx(21.6, abs=0.1))


def test_projector_columns_grow_along_world_x(rig):
    columns = [
        project(rig.projector, rig.T_world_from_proj, [x_mm, 0.0, 0.0])[0] for x_mm in (-5, 0, 5)
    ]
    assert np.all(np.diff(columns) > 0)


def test_image_centre_hits_the_origin_although_the_axis_is_offset(rig):
    """100 % offset: the principal point is on the image's lower edge, the aim is unchanged."""
    assert rig.projector.cy_px == pytest.approx(720 - 0.5)
    aim = project(rig.projector, rig.T_world_from_proj, [0.0, 0.0, 0.0])
    np.testing.assert_allclose(aim, [(1280 - 1) / 2, (720 - 1) / 2], atol=1e-9)


def test_triangulation_angle_is_the_polar_angle(rig):
    camera, projector = rig.T_world_from_cam[:3, 3], rig.T_world_from_proj[:3, 3]
    cosine = camera @ projector / np.linalg.norm(camera) / np.linalg.norm(projector)
    assert np.degrees(np.arccos(cosine)) == pytest.approx(25.0)


@pytest.mark.parametrize("azimuth_deg", [-170.0, -90.0, 0.0, 60.0, 180.0])
def test_poses_are_rotations(azimuth_deg):
    experiment = load_experiment(
        "examples/slab_balls",
        {"projector.pose.azimuth_deg": azimuth_deg, "projector.pose.roll_deg": 12.0},
    )
    rotation = true_calibration(experiment).T_world_from_proj[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_binning_keeps_the_field_of_view():
    full = true_calibration(load_experiment("examples/slab_balls")).camera
    binned = true_calibration(load_experiment("examples/slab_balls", {"camera.binning": 2})).camera
    np.testing.assert_allclose(full.unproject([-0.5, -0.5]), binned.unproject([-0.5, -0.5]))
