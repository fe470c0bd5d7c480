"""Signed distances to specimens: against closed forms, and derivatives against differences."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from reconstruction.arrays import FloatArray
from twin.shape import SignedDistance
from twin.specimens import shape_of
from twin.specimens.distance import (
    BallDistance,
    BoxDistance,
    CylinderDistance,
    HalfSpace,
    RectangularInside,
    RoundInside,
    RoundWall,
    distances_of,
    frame_wall,
    plate,
)
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.flat import Flat
from twin.specimens.kinds.rod import Rod
from twin.specimens.kinds.two_balls import TwoBalls

STEP_MM = 1e-5
REACH_MM = 0.6


def _turn(seed: int) -> FloatArray:
    return np.asarray(Rotation.random(rng=np.random.default_rng(seed)).as_matrix())


def _cylinder(seed: int, edge_mm: float = 0.2) -> CylinderDistance:
    return CylinderDistance(np.array([0.3, -0.2, 0.1]), _turn(seed)[:, 2], 1.1, 1.5, edge_mm)


def _box(seed: int, edge_mm: float = 0.2) -> BoxDistance:
    return BoxDistance(np.array([0.1, 0.2, -0.3]), _turn(seed), np.array([0.9, 1.6, 0.7]), edge_mm)


BODIES: dict[str, Callable[[int], SignedDistance]] = {
    "ball": lambda seed: BallDistance((0.2, -0.1, 0.1 * seed), 1.3),
    "cylinder": _cylinder,
    "capsule": lambda seed: _cylinder(seed, 1.1),
    "sharp cylinder": lambda seed: _cylinder(seed, 0.0),
    "box": _box,
    "sharp box": lambda seed: _box(seed, 0.0),
    "half space": lambda seed: HalfSpace(tuple(_turn(seed)[0].tolist()), 0.4),
    "round wall": lambda seed: RoundWall(1.7),
}


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", BODIES)
def test_gradient_and_hessian_are_the_differences(name: str, seed: int) -> None:
    """Third derivatives are below 1 / 0.05^2 here: the error of differences is below 1e-7."""
    body = BODIES[name](seed)
    points = np.random.default_rng(seed).uniform(-2.5, 2.5, (4000, 3))
    away = body.evaluate(points, 10.0)[0]
    points = points[(away > 0.05) & (away < 0.5)]
    assert len(points) > 100
    _, gradient, hessian = body.evaluate(points, REACH_MM)
    for axis, step in enumerate(STEP_MM * np.eye(3)):
        ahead, behind = (body.evaluate(points + side * step, REACH_MM) for side in (1, -1))
        slope, bend = ((a - b) / (2 * STEP_MM) for a, b in zip(ahead[:2], behind[:2], strict=True))
        np.testing.assert_allclose(slope, gradient[:, axis], atol=1e-6)
        np.testing.assert_allclose(bend, hessian[:, axis], atol=1e-6)


@pytest.mark.parametrize("name", BODIES)
def test_distance_has_unit_slope_and_bends_across_it_only(name: str) -> None:
    points = np.random.default_rng(5).uniform(-2.5, 2.5, (4000, 3))
    away, gradient, hessian = BODIES[name](4).evaluate(points, 10.0)
    outside = away > 0
    np.testing.assert_allclose(np.linalg.norm(gradient[outside], axis=1), 1.0, atol=1e-9)
    along = np.einsum("npq,nq->np", hessian, gradient)[outside]
    np.testing.assert_allclose(along, 0.0, atol=1e-9)
    np.testing.assert_allclose(hessian, hessian.transpose(0, 2, 1), atol=1e-12)


@pytest.mark.parametrize("name", BODIES)
def test_beyond_the_reach_the_gradient_is_zero(name: str) -> None:
    points = np.random.default_rng(5).uniform(-4, 4, (20000, 3))
    whole, near = (BODIES[name](2).evaluate(points, reach) for reach in (100.0, REACH_MM))
    far = near[0] > REACH_MM
    assert far.any()
    assert not far.all()
    assert (whole[0][far] > REACH_MM).all()
    for all_of_it, part in zip(whole, near, strict=True):
        np.testing.assert_array_equal(part[~far], all_of_it[~far])
    assert not near[1][far].any()
    assert not near[2][far].any()


def test_rounded_cylinder_has_known_points() -> None:
    """Face, side, and the edge's arc at 45 degrees."""
    body = CylinderDistance(np.zeros(3), np.array([0.0, 0.0, 1.0]), 2.0, 1.0, 0.3)
    slant = 0.4 / np.sqrt(2)
    points = np.array([[0, 0, 1.2], [0, -2.1, 0.5], [1.7 + slant, 0, -0.7 - slant], [0, 0, 0.9]])
    away, gradient, hessian = body.evaluate(points, 1.0)
    np.testing.assert_allclose(away, [0.2, 0.1, 0.1, -0.1], atol=1e-12)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        gradient, [[0, 0, 1], [0, -1, 0], [half, 0, -half], [0, 0, 1]], atol=1e-12
    )
    # Round the edge 1 / 0.4; round the axis 1 / 2.1, and cos 45 deg over the reach of 1.98 mm.
    curvature = np.trace(hessian, axis1=1, axis2=2)
    np.testing.assert_allclose(curvature, [0, 1 / 2.1, 2.5 + half / (1.7 + slant), 0], atol=1e-12)


def test_rounded_box_has_known_points() -> None:
    """Face, edge, corner, inside, and a face again in a turned frame."""
    body = BoxDistance(np.zeros(3), np.eye(3), np.array([1.0, 2.0, 3.0]), 0.2)
    third = 0.5 / np.sqrt(3)
    points = np.array(
        [
            [1.3, 0, 0],
            [0.8 + 0.3, 1.8 + 0.4, 0],
            [0.8 + third, -1.8 - third, 2.8 + third],
            [0.9, 0, 0],
        ]
    )
    away, _, hessian = body.evaluate(points, 1.0)
    np.testing.assert_allclose(away, [0.3, 0.3, 0.3, -0.1], atol=1e-12)
    np.testing.assert_allclose(
        np.trace(hessian, axis1=1, axis2=2), [0, 1 / 0.5, 2 / 0.5, 0], atol=1e-12
    )
    turned = BoxDistance(np.zeros(3), _turn(1), np.array([1.0, 2.0, 3.0]), 0.2)
    results = turned.evaluate(points @ _turn(1).T, 1.0)
    np.testing.assert_allclose(results[0], away, atol=1e-12)


def test_sharp_edges_are_rounded_by_ten_micrometres_and_no_more() -> None:
    """On the edge's bisector the surface is (sqrt 2 - 1) 10 um lower; faces do not move."""
    body = BoxDistance(np.zeros(3), np.eye(3), np.array([1.0, 2.0, 3.0]), 0.0)
    away = body.evaluate(np.array([[1.0, 2.0, 0.0], [1.0, 1.98, 0.0]]), 1.0)[0]
    np.testing.assert_allclose(away, [0.01 * (np.sqrt(2) - 1), 0.0], atol=1e-12)


def test_plate_and_frame_are_where_they_should_be() -> None:
    points = np.array([[9.0, -7.5, 0.5], [-10.5, 0.0, -0.2]])
    np.testing.assert_allclose(plate(-0.3).evaluate(points, 9.0)[0], [0.8, 0.1])
    walls = frame_wall(RectangularInside(10.0, 8.0))
    distances = np.array([wall.evaluate(points, 90.0)[0] for wall in walls])
    np.testing.assert_allclose(distances, [[1, 20.5], [19, -0.5], [15.5, 8], [0.5, 8]])
    inward = np.array([wall.evaluate(points, 90.0)[1].sum(axis=0) for wall in walls])
    np.testing.assert_allclose(inward, 2 * np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0]]))
    (around,) = frame_wall(RoundInside(10.0))
    np.testing.assert_allclose(around.evaluate(points, 90.0)[0], 10 - np.hypot(*points[:, :2].T))


def test_specimens_give_their_bodies_at_first_touch() -> None:
    """A crown or a face is below the origin; two balls are two bodies."""
    top = np.array([[0.0, 0.0, 0.25]])
    for specimen in (Ball(), Rod(yaw_deg=30), Flat(), Flat(edge_radius_mm=0.0)):
        (body,) = distances_of(shape_of(specimen))
        away, gradient, _ = body.evaluate(top, 1.0)
        np.testing.assert_allclose(away, 0.25, atol=1e-12)
        np.testing.assert_allclose(gradient, [[0, 0, 1]], atol=1e-12)
    left, right = distances_of(shape_of(TwoBalls(yaw_deg=90, x_mm=1.0)))
    assert left.evaluate(np.array([[1.0, -4.0, 0.1]]), 1.0)[0] == pytest.approx(0.1)
    assert right.evaluate(np.array([[1.0, 4.0, 0.1]]), 1.0)[0] == pytest.approx(0.1)


@pytest.mark.parametrize("threads", ["1", "2", "3"])
def test_results_do_not_depend_on_threads(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    points = np.random.default_rng(7).uniform(-2, 2, (20000, 3))
    known = _box(1).evaluate(points, REACH_MM)
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    for values, threaded in zip(known, _box(1).evaluate(points, REACH_MM), strict=True):
        assert values.tobytes() == threaded.tobytes()
