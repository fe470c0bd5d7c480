"""Triangulation between two cameras on planes, with exact projector coordinates."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.arrays import Reason
from reconstruction.decoding import AxisDecode, Decoded
from reconstruction.errors import InputError
from reconstruction.rig.calibration import Calibration, Pinhole
from reconstruction.rig.layers import plane_layers
from reconstruction.stereo import DecodedView, triangulate_cameras
from reconstruction.triangulation import triangulate

CAMERA = Pinhole(80, 60, 900.0, 900.0, 39.5, 29.5, (-0.05, 0.02, 1e-4, -2e-4, 0.0))
PROJECTOR = Pinhole(1280, 960, 2800.0, 2800.0, 639.5, 479.5, (0.03, -0.01, 0.0, 1e-4, 0.0))
SIGMA_PX = 0.02


@pytest.fixture(scope="module")
def rigs(aim):
    projector = aim([0.0, 1.0, 250.0], [0.0, 0.0, 0.0])
    return [
        Calibration(CAMERA, PROJECTOR, aim([x, 1.0, 214.0], [0.0, 0.0, 0.0]), projector)
        for x in (-90.0, 90.0)
    ]


def plane_mm(rig, slope):
    """Return the points z = slope x at the camera's pixels, (row, col, xyz), world frame."""
    pixels = np.stack(np.meshgrid(np.arange(CAMERA.width_px), np.arange(CAMERA.height_px)), -1)
    rays = np.concatenate([CAMERA.unproject(pixels), np.ones((*pixels.shape[:2], 1))], axis=-1)
    T = rig.T_world_from_cam
    rays, centre = rays @ T[:3, :3].T, T[:3, 3]
    depth = (slope * centre[0] - centre[2]) / (rays[..., 2] - slope * rays[..., 0])
    return centre + rays * depth[..., np.newaxis]


def decoded_view(rig, slope, noise=None):
    """Decode the plane exactly, or with white noise of SIGMA_PX."""
    T = np.linalg.inv(rig.T_world_from_proj)
    at_px = PROJECTOR.project(plane_mm(rig, slope) @ T[:3, :3].T + T[:3, 3])
    if noise is not None:
        at_px = at_px + noise.normal(0.0, SIGMA_PX, at_px.shape)
    blank = np.zeros(at_px.shape[:2], np.float32)
    sigma = np.full_like(blank, SIGMA_PX)
    column, row = (
        AxisDecode(
            coordinate_px=at_px[..., axis].astype(np.float32),
            phase_rad=blank,
            order=blank.astype(np.int16),
            mean_dn=blank,
            modulation_dn=blank,
            sigma_px=sigma,
            residual_dn=blank,
            order_error=blank,
            bias_share=blank,
        )
        for axis in (0, 1)
    )
    return DecodedView(Decoded(column, row, blank.astype(np.uint8)), rig)


@pytest.mark.parametrize("slope", [0.0, 0.3])
def test_exact_coordinates_give_the_plane(rigs, slope):
    first, second = (decoded_view(rig, slope) for rig in rigs)
    alone = triangulate(first.decoded, rigs[0])
    points = triangulate_cameras(first, second, alone)
    inner = np.s_[8:-8, 15:-15]
    assert points.valid[inner].all()
    expected = plane_mm(rigs[0], slope)[inner]
    assert points.points_world_mm[inner] == pytest.approx(expected, abs=4e-4)


def test_a_wrong_projector_has_no_influence(rigs):
    """The focal length of the calibrated projector is 0.5 % too long."""
    wrong = [replace(rig, projector=replace(PROJECTOR, fx_px=1.005 * 2800.0)) for rig in rigs]
    views = [replace(decoded_view(r, 0.1), calibration=w) for r, w in zip(rigs, wrong, strict=True)]
    alone = triangulate(views[0].decoded, wrong[0])
    points = triangulate_cameras(*views, alone)
    inner = np.s_[8:-8, 15:-15]
    expected = plane_mm(rigs[0], 0.1)
    off_mm = np.abs(alone.points_world_mm - expected)[inner].max()
    assert off_mm > 0.05
    assert points.points_world_mm[inner] == pytest.approx(expected[inner], abs=4e-4)


def test_stated_sigma_is_the_scatter(rigs):
    """White noise in both images; interpolation between four pixels averages that of the second.

    Of uniform positions the mean of the squared weights along an axis is 2/3: variance 1 + 4/9 of
    one camera's, for which sigma states 2.
    """
    rng = np.random.default_rng(4)
    first, second = (decoded_view(rig, 0.1, rng) for rig in rigs)
    points = triangulate_cameras(first, second, triangulate(first.decoded, rigs[0]))
    inner = np.s_[8:-8, 15:-15]
    ok = points.valid[inner]
    error = (points.points_world_mm[..., 2] - plane_mm(rigs[0], 0.1)[..., 2])[inner][ok]
    ratio = np.sqrt(np.mean((error / points.sigma_z_mm[inner][ok]) ** 2))
    assert np.mean(ok) > 0.98
    assert ratio == pytest.approx(np.sqrt((1.0 + 4.0 / 9.0) / 2.0), rel=0.06)


def test_pixels_without_a_partner_have_no_point(rigs, aim):
    far = replace(rigs[1], T_world_from_cam=aim([90.0, 1.0, 214.0], [6.0, 0.0, 0.0]))
    first, second = decoded_view(rigs[0], 0.0), decoded_view(far, 0.0)
    points = triangulate_cameras(first, second, triangulate(first.decoded, rigs[0]))
    assert set(np.unique(points.mask_reason)) == {Reason.VALID, Reason.NO_POINT}
    assert points.points_world_mm[..., 0][points.valid].min() > -6.0


def test_missing_axis_and_layers_are_errors(rigs):
    first, second = (decoded_view(rig, 0.0) for rig in rigs)
    alone = triangulate(first.decoded, rigs[0])
    columns = replace(second, decoded=replace(second.decoded, axes=("column",)))
    with pytest.raises(InputError, match="patterns along both axes"):
        triangulate_cameras(first, columns, alone)
    layered = replace(second, calibration=replace(rigs[1], layers=plane_layers([(1.0, 1.5)])))
    with pytest.raises(InputError, match="clear layers"):
        triangulate_cameras(first, layered, alone)
