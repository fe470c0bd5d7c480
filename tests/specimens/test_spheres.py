"""Specimens of balls: height field, mesh and apexes have the same geometry, in world axes."""

import numpy as np
import pytest
import trimesh

from twin.config.models import Specimen
from twin.specimens import height_above_lowest, shape_of
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.two_balls import TwoBalls

X = np.linspace(-10, 10, 201)
Y = np.linspace(-8, 8, 161)

SPECIMENS = [
    Ball(x_mm=1.5, y_mm=-2.0, diameter_mm=6.0),
    TwoBalls(),
    TwoBalls(x_mm=0.5, y_mm=1.0, yaw_deg=30.0, tilt_deg=8.0),
    TwoBalls(separation_mm=6.0, tilt_deg=-5.0, yaw_deg=-120.0),
    TwoBalls(diameter_mm=4.0, separation_mm=6.0),
]


def at(specimen: Specimen, x_mm: float, y_mm: float) -> float:
    return float(height_above_lowest(specimen, np.array([x_mm]), np.array([y_mm]))[0, 0])


def test_ball_height_is_the_exact_sphere() -> None:
    height = height_above_lowest(Ball(), X, Y)
    r = np.hypot(X, Y[:, None])
    np.testing.assert_array_equal(np.isfinite(height), r <= 4)
    inside = r <= 4
    np.testing.assert_allclose((4 - height[inside]) ** 2 + r[inside] ** 2, 16, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("x_mm", "y_mm"), [(3.0, 0.0), (0.0, 3.0), (-2.0, 1.0)])
def test_rows_run_along_y_and_columns_along_x(x_mm: float, y_mm: float) -> None:
    height = height_above_lowest(Ball(x_mm=x_mm, y_mm=y_mm), X, Y)
    row, col = np.unravel_index(height.argmin(), height.shape)
    assert (X[col], Y[row]) == pytest.approx((x_mm, y_mm), abs=1e-9)


def test_positive_tilt_lifts_the_ball_at_plus_x() -> None:
    specimen = TwoBalls(tilt_deg=10.0)
    across, fall = 4 * np.cos(np.deg2rad(10)), 8 * np.sin(np.deg2rad(10))
    assert at(specimen, across, 0) == pytest.approx(0, abs=1e-12)
    assert at(specimen, -across, 0) == pytest.approx(fall, abs=1e-12)


def test_yaw_turns_x_towards_y() -> None:
    specimen = TwoBalls(yaw_deg=90.0, tilt_deg=10.0, x_mm=1.0, y_mm=2.0)
    across = 4 * np.cos(np.deg2rad(10))
    assert at(specimen, 1.0, 2.0 + across) == pytest.approx(0, abs=1e-12)
    assert at(specimen, 1.0, 2.0 - across) > 1.3


@pytest.mark.parametrize("specimen", SPECIMENS)
def test_foremost_point_is_zero_and_nothing_lies_before_it(specimen: Specimen) -> None:
    assert height_above_lowest(specimen, X, Y).min() >= 0
    apexes = shape_of(specimen).spheres()
    assert max(ball.apex_z_mm for ball in apexes) == 0
    for ball in apexes:
        assert at(specimen, ball.x_mm, ball.y_mm) == pytest.approx(-ball.apex_z_mm, abs=1e-12)


@pytest.mark.parametrize("specimen", SPECIMENS)
def test_mesh_is_one_watertight_body_in_the_same_pose(specimen: Specimen) -> None:
    mesh = shape_of(specimen).mesh(-2.5)
    assert mesh.is_watertight
    assert mesh.body_count == 1
    assert mesh.volume > 0
    assert mesh.bounds[1, 2] == pytest.approx(-2.5, abs=5e-4)
    facing = mesh.vertices[mesh.vertices[:, 2] > -2.5 - 1.5]
    for x, y, z in facing[:: len(facing) // 40]:
        assert -2.5 - at(specimen, x, y) == pytest.approx(z, abs=5e-4)
    x_low, x_high, y_low, y_high = shape_of(specimen).bounds_mm()
    np.testing.assert_allclose(
        mesh.bounds[:, :2].T.ravel(), (x_low, x_high, y_low, y_high), atol=2e-3
    )


def test_overlapping_balls_have_the_volume_of_the_union() -> None:
    radius, distance = 4.0, 6.0
    cap = np.pi * (radius - distance / 2) ** 2 * (2 * radius + distance / 2) / 3
    union = 2 * 4 / 3 * np.pi * radius**3 - 2 * cap
    mesh: trimesh.Trimesh = shape_of(TwoBalls(separation_mm=distance)).mesh(0.0)
    assert mesh.volume == pytest.approx(union, rel=5e-4)
