"""Distances and solids at points with known values."""

import numpy as np
import pytest
import trimesh

from twin.shape import UNMOVED
from twin.specimens import shape_of
from twin.specimens.distance import BallDistance, BoxDistance, HalfSpace, RoundWall
from twin.specimens.kinds.nut import Nut
from twin.specimens.sampled_distance import PITCH_MM, SampledField
from twin.specimens.triangles import Columns, TriangleTree, distances_mm

BOX = trimesh.creation.box([2.0, 3.0, 4.0])
# A point, and its distance from a box of half 1, 1.5 and 2.
PLACES = [
    ((0.0, 0.0, 2.5), 0.5),
    ((0.0, -2.25, 0.0), 0.75),
    ((1.3, 1.9, 0.0), 0.5),
    ((1.0 + 0.2, -1.5 - 0.3, 2.0 + 0.6), 0.7),
    ((0.0, 0.0, 0.0), -1.0),
    ((0.0, 1.25, 0.0), -0.25),
    ((-0.9, 1.45, -1.8), -0.05),
]


def places():
    points, known = zip(*PLACES, strict=True)
    return np.array(points), np.array(known)


def test_places_round_a_box():
    points, known = places()
    body = BoxDistance(np.zeros(3), np.eye(3), np.array([1.0, 1.5, 2.0]), 0.1)
    rounded = known.copy()
    # Round an edge and a corner of 0.1 mm: hypot(0.4, 0.5) - 0.1, and the root of 0.74 less 0.1.
    rounded[2:4] = 0.5403124, 0.7602325
    np.testing.assert_allclose(body.evaluate(points, 9.0)[0], rounded, atol=1e-7)
    tree = TriangleTree.of(np.asarray(BOX.triangles))
    np.testing.assert_allclose(distances_mm(tree, points), np.abs(known), atol=1e-12)


def test_a_sharp_edge_is_rounded_by_10_um_or_half_of_what_is_thin():
    """0.3 and 0.4 mm off an edge: hypot(0.31, 0.41) - 0.01; 4 um for a plate 16 um thick."""
    place = np.array([[1.3, 1.4, 0.0]])
    for half_mm, expected in ((1.0, 0.5040039), (0.008, 0.5016006)):
        body = BoxDistance(np.zeros(3), np.eye(3), np.array([1.0, 1.0, half_mm]), 0.0)
        assert body.evaluate(place, 9.0)[0][0] == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("pitch_mm", [0.3, 1.0, 2.5])
def test_inside_and_outside_of_a_box_by_columns(pitch_mm):
    points, known = places()
    low, count = np.full(2, -20), np.full(2, 40)
    columns = Columns.of(np.asarray(BOX.triangles), 1, pitch_mm, low, count)
    np.testing.assert_array_equal(columns.inside(points), known < 0)


@pytest.mark.parametrize("pitch_mm", [0.1, 0.4])
def test_inside_of_a_ball_of_small_facets_by_columns(pitch_mm):
    """Each cell lists only the facets above it: points of another cell would miss theirs."""
    ball = trimesh.creation.icosphere(4, 1.0)
    columns = Columns.of(np.asarray(ball.triangles), 1, pitch_mm, np.full(2, -20), np.full(2, 40))
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (2000, 3))
    away = np.linalg.norm(points, axis=1)
    clear = np.abs(away - 1.0) > 0.01
    np.testing.assert_array_equal(columns.inside(points)[clear], away[clear] < 1.0)


def test_points_exactly_at_the_reach_have_a_gradient():
    """Half a millimetre off each body, reach 0.5 mm: unit slopes; with a reach below, none."""
    bodies = [
        (BoxDistance(np.zeros(3), np.eye(3), np.ones(3), 0.0), (0.0, 0.0, 1.5), (0, 0, 1)),
        (BallDistance((0.0, 0.0, 0.0), 1.0), (0.0, -1.5, 0.0), (0, -1, 0)),
        (HalfSpace((1.0, 0.0, 0.0), 0.25), (0.75, 3.0, 3.0), (1, 0, 0)),
        (RoundWall(2.0), (0.0, 1.5, 7.0), (0, -1, 0)),
    ]
    for body, place, slope in bodies:
        away, gradient, _ = body.evaluate(np.array([place]), 0.5)
        assert away[0] == 0.5
        np.testing.assert_allclose(gradient[0], slope, atol=1e-12)
        assert not body.evaluate(np.array([place]), 0.4375)[1].any()


def test_a_sampled_box_is_known_to_the_end_of_its_reach():
    """Reach 0.6 mm: 1 um within it, on all six sides, the distance is 0.599 mm."""
    field = SampledField(TriangleTree.of(np.asarray(BOX.triangles)), PITCH_MM)
    half, sides = np.array([1.0, 1.5, 2.0]), np.vstack([np.eye(3), -np.eye(3)])
    for reach_mm in (0.6, 1.0):
        points = sides * (half + reach_mm - 1e-3)
        away, gradient, _ = field.evaluate(points, reach_mm, UNMOVED)
        np.testing.assert_allclose(away, reach_mm - 1e-3, atol=1e-9)
        np.testing.assert_allclose(gradient, sides, atol=1e-9)
        assert (
            field.evaluate(sides * (half + reach_mm + 0.1), reach_mm, UNMOVED)[0] >= reach_mm
        ).all()


def test_a_nut_is_countersunk_on_both_faces():
    """The hole in either face has the countersink's radius."""
    nut = Nut()
    mesh = shape_of(nut).mesh(0.0)
    low, high = mesh.bounds[:, 2]
    assert high - low == pytest.approx(nut.height_mm)
    for z in (low, high):
        rim = mesh.vertices[np.abs(mesh.vertices[:, 2] - z) < 1e-6]
        assert np.hypot(*rim.T[:2]).min() == pytest.approx(nut.countersink_mm / 2, rel=2e-3)
