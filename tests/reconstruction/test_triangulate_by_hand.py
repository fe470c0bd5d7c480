"""Triangulation that can be done on paper: two devices side by side, looking the same way."""

import numpy as np
import pytest

from reconstruction.arrays import Reason
from reconstruction.rig.calibration import Calibration, Pinhole
from reconstruction.rig.pinhole import fold_square
from reconstruction.triangulation import triangulate

from .test_triangulate import decoded_from

# A ray per pixel of 5 mrad either way; the projector is at (-10, -10, 0).
CAMERA = Pinhole(2, 2, 100.0, 100.0, 0.5, 0.5)
PROJECTOR = Pinhole(400, 400, 100.0, 100.0, 200.0, 200.0)
SIDE = np.array([[-1.0, 1.0], [-1.0, 1.0]])


def rig(shift=(10.0, 10.0, 0.0)):
    T = np.eye(4)
    T[:3, 3] = -np.array(shift)
    return Calibration(CAMERA, PROJECTOR, np.eye(4), T)


def observed(depth_mm, u_off=0.0, v_off=0.0):
    """Projector pixels of four points at one depth: 200 + 100 (+-0.005 + 10 / depth)."""
    u = 200.0 + 100.0 * (0.005 * SIDE + 10.0 / depth_mm)
    v = 200.0 + 100.0 * (0.005 * SIDE.T + 10.0 / depth_mm)
    return np.stack([u + u_off, v + v_off], axis=-1)


@pytest.mark.parametrize("use", ["column", "row", "both"])
def test_a_point_in_each_quadrant(use):
    """At 50 mm the rays are 0.25 mm off the axis: right is +x, down is +y."""
    result = triangulate(decoded_from(observed(50.0)), rig(), use)
    assert result.valid.all()
    expected = np.stack([0.25 * SIDE, 0.25 * SIDE.T, np.full((2, 2), 50.0)], axis=-1)
    np.testing.assert_allclose(result.points_world_mm, expected, atol=2e-5)


def test_sigmas_of_the_depth():
    """A pixel is 100 * 10 / 50^2 = 0.4 px per mm: 0.01 px are 0.025 mm, by both 0.0177 mm."""
    for use, sigma_mm in (("column", 0.025), ("row", 0.025), ("both", 0.025 / 2**0.5)):
        result = triangulate(decoded_from(observed(50.0)), rig(), use)
        np.testing.assert_allclose(result.sigma_z_mm, sigma_mm, rtol=1e-3)
        np.testing.assert_allclose(result.sigma_xyz_mm[..., 0], sigma_mm * 0.005, rtol=1e-3)


@pytest.mark.parametrize(("u_sigma_px", "edge_px"), [(0.01, 1.0707), (0.2, 2.0012)])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_epipolar_edge(u_sigma_px, edge_px, side):
    """One pixel and five sigmas of the difference: of the row, 0.01 px, and of the column's depth.

    That is as many pixels of the row as of the column here: 5 sqrt(0.01^2 + 0.2^2) = 1.0012.
    """
    for off_px, reason in ((edge_px - 0.005, Reason.VALID), (edge_px + 0.005, 7)):
        decoded = decoded_from(observed(50.0, v_off=side * off_px))
        decoded.column.sigma_px[:] = u_sigma_px
        result = triangulate(decoded, rig(), "column")
        assert (result.mask_reason == reason).all()
    assert Reason.EPIPOLAR_MISMATCH == 7


def test_rays_that_do_not_meet_in_front_have_no_point():
    """Left of 200 px by 20 px the projector's plane cuts the rays 50 mm behind the camera."""
    result = triangulate(decoded_from(observed(-50.0)), rig(), "column")
    assert (result.mask_reason == Reason.NO_POINT).all()
    assert not result.points_world_mm.any()


def test_a_projector_behind_the_camera():
    """8 mm behind: a point at 50 mm is at 58 mm of its depth, at 200 + 100 (0.25 + 10) / 58."""
    back = (10.0, 10.0, 8.0)
    pixels = 200.0 + 100.0 * (0.25 * np.stack([SIDE, SIDE.T], axis=-1) + 10.0) / 58.0
    result = triangulate(decoded_from(pixels), rig(back), "both")
    np.testing.assert_allclose(result.points_world_mm[..., 2], 50.0, atol=2e-5)


@pytest.mark.parametrize(
    ("distortion", "expected"),
    [
        ((-1.0 / 3.0, 0.0, 0.1, 0.1, 0.0), 1.0),
        ((0.0, -0.2, 0.0, 0.0, 0.0), 1.0),
        ((0.0, 0.0, 0.0, 0.0, -1.0 / 7.0), 1.0),
        ((-0.5, 0.04, 0.0, 0.0, 0.0), (1.5 - 1.45**0.5) / 0.4),
        ((0.1, 0.0, 0.0, 0.0, 0.0), np.inf),
    ],
)
def test_where_a_lens_folds(distortion, expected):
    """1 + 3 k1 s + 5 k2 s^2 + 7 k3 s^3 = 0 for s = r^2."""
    assert fold_square(distortion) == pytest.approx(expected)
