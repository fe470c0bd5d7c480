"""Merged points of two cameras on planes and on a step, whose intersections have closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.arrays import Reason
from reconstruction.errors import InputError
from reconstruction.merging import CameraView, merge
from reconstruction.rig.calibration import Calibration, Pinhole
from reconstruction.triangulation import PointMap

CAMERA = Pinhole(80, 60, 900.0, 900.0, 39.5, 29.5)
PROJECTOR = Pinhole(320, 240, 700.0, 700.0, 159.5, 119.5)
SIDE_MM = 90.0


@pytest.fixture(scope="module")
def rigs(aim):
    """Two cameras at 90 mm to the left and to the right of the projector, 214 mm high."""
    projector = aim([0.0, 1.0, 250.0], [0.0, 0.0, 0.0])
    return [
        Calibration(CAMERA, PROJECTOR, aim([x, 1.0, 214.0], [0.0, 0.0, 0.0]), projector)
        for x in (-SIDE_MM, SIDE_MM)
    ]


def rays_of(rig):
    """Return directions of the camera's rays, (row, col, xyz), world frame, and its centre."""
    pixels = np.stack(np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px)), -1)
    rays = np.concatenate([CAMERA.unproject(pixels), np.ones((*pixels.shape[:2], 1))], axis=-1)
    T = rig.T_world_from_cam
    return rays @ T[:3, :3].T, T[:3, 3]


def at_height(rig, z_mm):
    rays, centre = rays_of(rig)
    return centre + rays * ((z_mm - centre[2]) / rays[..., 2])[..., np.newaxis]


def view_of(rig, points_mm, sigma_z_mm, valid=None):
    """Return a view whose points have an error along their rays, `sigma_z_mm` along z."""
    rays, _ = rays_of(rig)
    sigma = np.abs(rays / rays[..., 2:]) * sigma_z_mm
    reason = np.zeros(points_mm.shape[:2], np.uint8)
    reason[~(np.ones_like(reason, bool) if valid is None else valid)] = Reason.NO_POINT
    shown = (reason == 0)[..., np.newaxis]
    points = np.where(shown, points_mm, 0.0).astype(np.float32)
    return CameraView(
        PointMap(points, (sigma * shown).astype(np.float32), reason, rig.T_world_from_cam), rig
    )


def inner(image):
    return image[10:-10, 25:-25]


def test_points_are_the_weighted_mean_of_both_planes(rigs):
    """Planes 4 um apart, sigma 2 um and 1 um along z: weights 1 and 4."""
    merged = merge([view_of(rigs[0], at_height(rigs[0], 0.0), 0.002),
                    view_of(rigs[1], at_height(rigs[1], 0.004), 0.001)])  # fmt: skip
    for points in merged.maps:
        assert inner(points.points_world_mm[..., 2]) == pytest.approx(0.0032, abs=5e-5)
        assert inner(points.sigma_z_mm) == pytest.approx(
            np.sqrt(1 / (1 / 4 + 1)) * 1e-3 * 1.0 * merged.agreement.birge_ratio, rel=2e-3
        )
    ratio = 1.4826 * 4.0 / np.sqrt(5.0)
    assert merged.agreement.birge_ratio == pytest.approx(ratio, rel=2e-3)
    assert merged.agreement.offset_median_mm == pytest.approx(0.004, rel=1e-3)


def test_points_stay_on_their_rays(rigs):
    merged = merge(
        [view_of(rig, at_height(rig, z), 0.001) for rig, z in zip(rigs, (0.0, 0.001), strict=True)]
    )
    for points, rig in zip(merged.maps, rigs, strict=True):
        rays, centre = rays_of(rig)
        along = points.points_world_mm - centre
        across = np.cross(along, rays / np.linalg.norm(rays, axis=-1, keepdims=True))
        assert np.abs(across).max() < 2e-4


def test_another_world_of_the_second_calibration_changes_nothing(rigs, aim):
    """The frames are joined by the projector's pose."""
    views = [view_of(rig, at_height(rig, 0.0), 0.001) for rig in rigs]
    T = np.linalg.inv(aim([3.0, -8.0, 40.0], [1.0, 0.0, 0.0]))
    rig, points = rigs[1], views[1].points
    other = Calibration(CAMERA, PROJECTOR, T @ rig.T_world_from_cam, T @ rig.T_world_from_proj)
    signed = np.copysign(points.sigma_xyz_mm, points.points_world_mm - rig.T_world_from_cam[:3, 3])
    turned = PointMap(
        (points.points_world_mm @ T[:3, :3].T + T[:3, 3]).astype(np.float32),
        np.abs(signed @ T[:3, :3].T).astype(np.float32),
        points.mask_reason,
        T @ points.T_world_from_cam,
    )
    here, there = merge(views), merge([views[0], CameraView(turned, other)])
    assert there.points_mm == pytest.approx(here.points_mm, abs=1e-4)
    assert there.agreement.shared_points == here.agreement.shared_points


def step_view(rig, height_mm=3.0):
    """CameraView a block over x > 0 on the ground; rays that meet its wall have no point."""
    top, ground = at_height(rig, height_mm), at_height(rig, 0.0)
    on_top = top[..., 0] > 0.0
    points = np.where(on_top[..., np.newaxis], top, ground)
    return view_of(rig, points, 0.001, on_top | (ground[..., 0] <= 0.0))


def test_shadows_are_filled_and_no_place_occurs_twice(rigs):
    """The right camera does not see the ground next to the wall: 3 mm of height, 90 of 214 mm."""
    left, right = (step_view(rig) for rig in rigs)
    merged = merge([right, left])
    hidden_mm = 3.0 * SIDE_MM / (214.0 - 3.0)
    ground = merged.points_mm[merged.points_mm[:, 2] < 1.0]
    in_shadow = (ground[:, 0] < -0.2) & (ground[:, 0] > -hidden_mm + 0.2)
    assert not np.any(
        right.points.valid
        & (np.abs(right.points.points_world_mm[..., 0] + hidden_mm / 2) < 0.4 * hidden_mm)
    )
    seen_left = left.points.points_world_mm[left.points.valid]
    expected = np.sum((seen_left[:, 0] < -0.2) & (seen_left[:, 0] > -hidden_mm + 0.2))
    assert in_shadow.sum() == expected > 50
    assert merged.agreement.contradicted_points == 0
    once = sum(v.points.valid.sum() for v in (left, right)) - merged.repeated[1].sum()
    assert len(merged.points_mm) == once


def test_points_that_another_camera_sees_through_are_left_out(rigs):
    false = at_height(rigs[0], 0.0)
    false[20:30, 35:45] = at_height(rigs[0], 1.5)[20:30, 35:45]
    views = view_of(rigs[0], false, 0.001), view_of(rigs[1], at_height(rigs[1], 0.0), 0.001)
    merged = merge(views)
    gone = views[0].points.valid & ~merged.kept[0]
    assert gone[22:28, 37:43].all()
    assert gone.sum() <= 100
    assert merged.points_mm[:, 2].max() < 1.6
    assert np.mean(merged.points_mm[:, 2] > 0.1) < 0.01


def test_calibrations_that_differ_enlarge_sigma(rigs):
    merged = merge([view_of(rigs[0], at_height(rigs[0], 0.0), 0.001),
                    view_of(rigs[1], at_height(rigs[1], 0.05), 0.001)])  # fmt: skip
    ratio = 1.4826 * 50.0 / np.sqrt(2.0)
    assert merged.agreement.birge_ratio == pytest.approx(ratio, rel=2e-3)
    assert inner(merged.maps[0].sigma_z_mm) == pytest.approx(1e-3 * ratio / np.sqrt(2.0), rel=5e-3)


def test_views_without_a_common_place_are_an_error(rigs, aim):
    view = view_of(rigs[0], at_height(rigs[0], 0.0), 0.001)
    with pytest.raises(InputError, match="found 1 view"):
        merge([view])
    far = replace(rigs[1], T_world_from_cam=aim([500.0, 1.0, 214.0], [490.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="no two cameras see the same place"):
        merge([view, view_of(far, at_height(far, 0.0), 0.001)])
