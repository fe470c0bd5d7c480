import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reconstruction.errors import InputError
from reconstruction.rig.calibration import Pinhole

DISTORTED = Pinhole(1936, 1464, 2200.0, 2210.0, 960.0, 735.0, (-0.12, 0.05, 1e-3, -5e-4, 0.01))


def test_projection_is_opencvs():
    points = np.random.default_rng(1).uniform([-60, -45, 180], [60, 45, 260], (500, 3))
    matrix = np.array([[2200.0, 0.0, 960.0], [0.0, 2210.0, 735.0], [0.0, 0.0, 1.0]])
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), matrix, np.array(DISTORTED.distortion)
    )
    np.testing.assert_allclose(DISTORTED.project(points), expected.reshape(-1, 2), atol=1e-9)


def test_axes_point_right_down_and_forward():
    device = Pinhole(101, 51, 100.0, 100.0, 50.0, 25.0)
    np.testing.assert_array_equal(device.project([0.0, 0.0, 10.0]), [50.0, 25.0])
    np.testing.assert_array_equal(device.project([1.0, 0.0, 10.0]), [60.0, 25.0])
    np.testing.assert_array_equal(device.project([0.0, 1.0, 10.0]), [50.0, 35.0])


@given(
    k1=st.floats(-0.2, 0.2),
    k2=st.floats(-0.1, 0.1),
    p1=st.floats(-2e-3, 2e-3),
    p2=st.floats(-2e-3, 2e-3),
    k3=st.floats(-0.05, 0.05),
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.5, 0.5),
)
def test_unproject_inverts_the_distortion(*, k1, k2, p1, p2, k3, x, y):
    device = Pinhole(1000, 800, 900.0, 900.0, 500.0, 400.0, (k1, k2, p1, p2, k3))
    observed = device.project([x, y, 1.0])
    np.testing.assert_allclose(device.unproject(observed), [x, y], atol=1e-10)


def test_unproject_keeps_the_shape():
    assert DISTORTED.unproject(np.zeros((3, 4, 2))).shape == (3, 4, 2)
    assert DISTORTED.project(np.ones((3, 4, 3))).shape == (3, 4, 2)


def test_a_folding_distortion_is_rejected():
    with pytest.raises(InputError, match="no inverse"):
        Pinhole(100, 100, 50.0, 50.0, 50.0, 50.0, (-1.0, 0.0, 0.0, 0.0, 0.0)).unproject([99, 50])


def test_a_solution_behind_the_fold_is_rejected():
    """The polynomial rises again there and reaches the pixel, at r = 2.19; the lens does not."""
    lens = Pinhole(500, 100, 100.0, 100.0, 249.5, 49.5, (-0.5, 0.1, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="no inverse"):
        lens.unproject([249.5 + 200.0, 49.5])


def test_corners_without_a_ray_are_drawn_where_the_field_ends():
    """Setup: r (1 - 0.5 r^2) ends at 0.544, at r = 0.816; the corners are at 0.5 and at 1."""
    inside = Pinhole(80, 60, 100.0, 100.0, 39.5, 29.5, (-0.5, 0.0, 0.0, 0.0, 0.0))
    wide = Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5, (-0.5, 0.0, 0.0, 0.0, 0.0))
    corners_px = [[-0.5, -0.5], [79.5, -0.5], [79.5, 59.5], [-0.5, 59.5]]
    np.testing.assert_allclose(inside.seen_corners(), inside.unproject(corners_px), atol=1e-12)
    ends = wide.seen_corners()
    np.testing.assert_allclose(np.hypot(*ends.T), np.sqrt(2.0 / 3.0), atol=0.03)
    np.testing.assert_allclose(np.sign(ends), [[-1, -1], [1, -1], [1, 1], [-1, 1]])


@pytest.mark.parametrize("point", [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, np.nan]])
def test_points_outside_or_behind_are_rejected(point):
    with pytest.raises(InputError, match="z <= 0"):
        DISTORTED.project(point)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width_px": 0}, "width_px"),
        ({"fx_px": 0.0}, "fx_px"),
        ({"cy_px": float("inf")}, "cy_px"),
        ({"distortion": (0.0,) * 4}, "distortion"),
        ({"distortion": (0.0, 0.0, 0.0, 0.0, "a")}, "distortion"),
    ],
)
def test_bad_intrinsics_are_named(change, message):
    good = {"width_px": 9, "height_px": 9, "fx_px": 9.0, "fy_px": 9.0, "cx_px": 4.0, "cy_px": 4.0}
    with pytest.raises(InputError, match=message):
        Pinhole(**(good | change))


def test_shapes_are_checked():
    with pytest.raises(InputError, match="shape"):
        DISTORTED.project([1.0, 2.0])
    with pytest.raises(InputError, match="shape"):
        DISTORTED.unproject([1.0, 2.0, 3.0])
