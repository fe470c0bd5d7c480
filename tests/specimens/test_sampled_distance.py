"""Signed distances sampled from meshes: against closed forms, for any order of queries."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from reconstruction.arrays import FloatArray
from twin.config.specimen_base import Specimen
from twin.shape import UNMOVED, Placement, SignedDistance
from twin.specimens import shape_of
from twin.specimens.distance import BallDistance, BoxDistance, distances_of
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.bars import Bars
from twin.specimens.kinds.bear import Bear
from twin.specimens.kinds.brick import Brick
from twin.specimens.kinds.fingerprint import Fingerprint
from twin.specimens.kinds.flat import Flat
from twin.specimens.kinds.grating import Grating
from twin.specimens.kinds.group import Group
from twin.specimens.kinds.nut import Nut
from twin.specimens.kinds.rods import Rods
from twin.specimens.kinds.step import Step
from twin.specimens.kinds.t_bolt import TBolt
from twin.specimens.kinds.v_groove import VGroove
from twin.specimens.meshes import MeshShape
from twin.specimens.sampled_distance import PITCH_MM, MeshDistance, SampledField
from twin.specimens.triangles import TriangleTree, unsigned_samples

REACH_MM = 0.4
MESHES: list[Specimen] = [
    Nut(yaw_deg=20),
    TBolt(tilt_deg=3),
    Brick(),
    Bear(yaw_deg=-30),
    Step(),
    VGroove(yaw_deg=90),
    Grating(),
    Fingerprint(length_x_mm=3, length_y_mm=3, dome_radius_mm=8),
]


def _near(body: SignedDistance, count: int, half_mm: float, inside_mm: float = 0.1) -> FloatArray:
    """Return points from just inside a body to the reach."""
    points = np.random.default_rng(1).uniform(-half_mm, half_mm, (count, 3))
    away = body.evaluate(points, REACH_MM)[0]
    return points[(away > -inside_mm) & (away < REACH_MM)]


def _sampled(specimen: Specimen) -> MeshDistance:
    return MeshDistance(shape_of(specimen).mesh(0.0), UNMOVED)


def _field(body: trimesh.Trimesh, pitch_mm: float = PITCH_MM) -> SampledField:
    return SampledField(TriangleTree.of(np.asarray(body.triangles)), pitch_mm)


def test_a_ball_of_facets_is_the_ball() -> None:
    """Chords of 0.035 mm are at most 0.2 um inside; facets tilt by 1 deg.

    1 deg over a cell of 0.05 mm is a curvature of 0.35 / mm; averaging over the small facets
    reduces it to 0.33 x.
    """
    exact = BallDistance((0.0, 0.0, 0.0), 1.0)
    body = MeshDistance(trimesh.creation.icosphere(5, 1.0), UNMOVED)
    points = _near(exact, 10000, 1.4)
    sampled, known = (of.evaluate(points, 1.0) for of in (body, exact))
    for value, closed_form, most in zip(sampled, known, (5e-4, 5e-3, 0.3), strict=True):
        np.testing.assert_allclose(value, closed_form, atol=most)


@pytest.mark.parametrize(("edge_mm", "most_mm"), [(0.2, 0.7e-3), (0.1, 1.2e-3)])
def test_a_rounded_punch_of_facets_is_the_punch(edge_mm: float, most_mm: float) -> None:
    """Facets of 6 deg are 0.3 um inside a radius of 0.2 mm.

    At the start of the edge's arc the curvature jumps by 1 / r: a cubic spline's error is about
    p^2 / 40 r there, 0.3 um at 0.2 mm and 0.6 um at 0.1 mm.
    """
    punch = Flat(diameter_mm=3.0, height_mm=2.0, edge_radius_mm=edge_mm)
    (exact,) = distances_of(shape_of(punch))
    points = _near(exact, 20000, 2.0, inside_mm=0.0)
    sampled, known = (body.evaluate(points, 1.0) for body in (_sampled(punch), exact))
    np.testing.assert_allclose(sampled[0], known[0], atol=most_mm)
    np.testing.assert_allclose(sampled[1], known[1], atol=0.08)
    assert np.quantile(np.abs(sampled[1] - known[1]), 0.9) < 5e-3


def test_a_block_keeps_its_edges_to_a_tenth_of_the_pitch() -> None:
    """Outside a sharp box: faces to the last digits, edges and corners where the curvature ends."""
    half = np.array([1.0, 1.5, 0.5])
    body = MeshDistance(trimesh.creation.box(2 * half), UNMOVED)
    points = np.random.default_rng(1).uniform(-2, 2, (30000, 3))
    over = np.abs(points) - half
    exact = np.linalg.norm(np.maximum(over, 0), axis=1)
    outside = (exact > 0) & (exact < REACH_MM)
    distance = body.evaluate(points, REACH_MM)[0]
    np.testing.assert_allclose(distance[outside], exact[outside], atol=0.1 * PITCH_MM)
    beside_edges = outside & ((over > -0.2).sum(axis=1) == 1)
    assert beside_edges.sum() > 1000
    np.testing.assert_allclose(distance[beside_edges], exact[beside_edges], atol=1e-12)
    inside = (over < -0.05).all(axis=1)
    assert (distance[inside] < -0.04).all()


def test_samples_are_the_distances_to_all_triangles() -> None:
    """No box with the nearest triangle is skipped."""
    mesh = trimesh.creation.icosphere(2, 0.9)
    mesh.apply_scale((1.0, 0.6, 0.3))
    cells = np.unique(np.random.default_rng(2).integers(-6, 6, (12, 3)), axis=0)
    samples = unsigned_samples(TriangleTree.of(np.asarray(mesh.triangles)), cells, 4, PITCH_MM)
    node = np.stack(np.meshgrid(*3 * (np.arange(4),), indexing="ij"), axis=-1)
    points = ((4 * cells[:, None, None, None] + node) * PITCH_MM).reshape(-1, 1, 3)
    count = len(mesh.triangles)
    known = [
        np.linalg.norm(
            trimesh.triangles.closest_point(mesh.triangles, np.repeat(point, count, axis=0))
            - point,
            axis=1,
        ).min()
        for point in points
    ]
    np.testing.assert_allclose(samples.ravel(), known, atol=1e-12)


def test_derivatives_are_the_differences_of_the_interpolant() -> None:
    body = _sampled(Nut(yaw_deg=20, tilt_deg=2))
    points = _near(body, 4000, 2.5)
    points = points[points[:, 0] > 0.5]  # a quarter of the thread
    points[:, 2] -= 0.1
    _, gradient, hessian = body.evaluate(points, 2.0)
    step_mm = 1e-5
    for axis, step in enumerate(step_mm * np.eye(3)):
        ahead, behind = (body.evaluate(points + side * step, 2.0) for side in (1, -1))
        slope, bend = ((a - b) / (2 * step_mm) for a, b in zip(ahead[:2], behind[:2], strict=True))
        np.testing.assert_allclose(slope, gradient[:, axis], atol=1e-6)
        # The third derivative jumps from cell to cell, by as much as 1 / pitch^2 at an edge.
        np.testing.assert_allclose(bend, hessian[:, axis], atol=step_mm / PITCH_MM**2)


def test_results_do_not_depend_on_the_order_of_queries() -> None:
    """Bricks are computed on demand, at any reach; the same point has the same bytes."""
    mesh = shape_of(Step(edge_radius_mm=0.1)).mesh(0.0)
    points = np.random.default_rng(3).uniform(-0.6, 0.6, (2000, 3))
    whole = _field(mesh).evaluate(points, REACH_MM, UNMOVED)
    bit_by_bit = _field(mesh)
    bit_by_bit.evaluate(points[::7], 1.3, UNMOVED)
    bit_by_bit.evaluate(points[-50:], 0.05, UNMOVED)
    order = np.random.default_rng(4).permutation(len(points))
    for part in np.array_split(order, 5):
        partial = bit_by_bit.evaluate(points[part], REACH_MM, UNMOVED)
        for values, expected in zip(partial, whole, strict=True):
            assert values.tobytes() == expected[part].tobytes()


def test_a_pose_turns_what_it_moves() -> None:
    nut = shape_of(Nut())
    turn = np.asarray(Rotation.from_euler("zyx", (25, 4, -3), degrees=True).as_matrix())
    pose = Placement(turn, np.array([0.4, -0.3, 0.2]))
    (still,), (moved,) = nut.distances(), nut.placed(pose).distances()
    points = np.random.default_rng(5).uniform((3, -1, -1), (6, 1, 0.3), (2000, 3))
    known, posed = still.evaluate(points, REACH_MM), moved.evaluate(pose.apply(points), REACH_MM)
    np.testing.assert_allclose(posed[0], known[0], atol=1e-12)
    np.testing.assert_allclose(posed[1], known[1] @ turn.T, atol=1e-10)
    np.testing.assert_allclose(posed[2], turn @ known[2] @ turn.T, atol=1e-8)


def test_poses_share_the_samples() -> None:
    (still,), (moved,) = shape_of(Nut()).distances(), shape_of(Nut(yaw_deg=30, x_mm=2)).distances()
    assert isinstance(still, MeshDistance)
    assert isinstance(moved, MeshDistance)
    assert still.body is moved.body


def test_a_nut_is_inside_where_there_is_steel() -> None:
    """Two flats are normal to y, two corners are on x; 10 mm across flats, thread M6 x 1."""
    (nut,) = distances_of(shape_of(Nut()))
    known = {
        (0.0, 4.9, -2.6): -0.1,  # under a flat
        (0.0, 5.1, -2.6): 0.1,  # outside the flat
        (0.0, 4.0, -0.07): -0.07,  # under the upper face
        (0.0, 4.0, 0.2): 0.2,  # above it
        (0.0, 0.0, -2.6): 1.0,  # the hole's axis: out of reach
        (5.75, 0.0, -0.1): 0.4,  # above the corner, over the chamfer: somewhere near
    }
    away, gradient, _ = nut.evaluate(np.array(list(known)), 1.0)
    np.testing.assert_allclose(away[:5], list(known.values())[:5], atol=1e-6)
    np.testing.assert_allclose(gradient[0], [0, 1, 0], atol=1e-6)
    # Chamfer of 30 deg from radius 4.67 on, slope tan 30; its normal tilts outwards by 30 deg.
    beyond = 5.75 - (10 / np.sqrt(3) - 1.1)
    assert away[5] == pytest.approx(
        (beyond * np.tan(np.pi / 6) - 0.1) * np.cos(np.pi / 6), abs=2e-3
    )
    np.testing.assert_allclose(gradient[5], [0.5, 0, np.sqrt(0.75)], atol=2e-2)


def test_a_thread_winds_inside_a_nut() -> None:
    """At half height of the 3 mm major and 2.46 mm minor radius steel and air alternate."""
    (nut,) = distances_of(shape_of(Nut()))
    z = np.linspace(-3.9, -1.3, 261)
    away = nut.evaluate(np.stack((0 * z + 2.72, 0 * z, z), axis=-1), 1.0)[0]
    turns = np.flatnonzero(np.diff(np.sign(away)))
    np.testing.assert_allclose(
        np.diff(z[turns])[::2] + np.diff(z[turns])[1::2][: len(turns) // 2], 1.0, atol=0.03
    )


@pytest.mark.parametrize("specimen", MESHES, ids=lambda s: s.kind)
def test_the_surface_is_where_the_distance_is_zero(specimen: Specimen) -> None:
    """Facets within 1.5 mm of first touch: 0 on them, +-0.05 mm off them away from edges."""
    surface = shape_of(specimen).mesh(0.0)
    points, facet = trimesh.sample.sample_surface(surface, 1500, seed=1)
    near_touch = points[:, 2] > -1.5
    points, normals = points[near_touch], surface.face_normals[facet[near_touch]]
    (body,) = distances_of(shape_of(specimen))
    on, above, below = (body.evaluate(points + t * normals, 1.0)[0] for t in (0.0, 0.05, -0.05))
    assert np.abs(on).max() < 0.3 * PITCH_MM
    assert np.median(np.abs(on)) < 1e-4
    assert np.median(np.abs(above - 0.05)) < 5e-4
    assert np.median(np.abs(below + 0.05)) < 5e-4
    assert np.mean((below < 0) & (above > 0)) > 0.9


def test_bodies_that_overlap_in_one_mesh_are_joined() -> None:
    """Points inside two bodies are inside; by parity they would be outside."""
    box = trimesh.creation.box((2, 2, 2))
    both = trimesh.util.concatenate([box, box.copy().apply_translation((0.7, 0.3, 0.4))])
    away = (
        MeshShape(both).distances()[0].evaluate(np.array([[0.4, 0.2, 0.1], [-1.2, 0, 0]]), 1.0)[0]
    )
    assert away[0] < 0
    assert away[1] == pytest.approx(0.2, abs=1e-9)


def test_an_inside_out_mesh_is_the_same_body() -> None:
    box = trimesh.creation.box((2, 2, 2))
    turned = trimesh.Trimesh(box.vertices, box.faces[:, ::-1], process=False)
    points = np.array([[0.0, 0.0, 1.1], [0.0, 0.0, 0.9]])
    distance = MeshDistance(turned, UNMOVED).evaluate(points, 1.0)[0]
    np.testing.assert_allclose(distance, [0.1, -0.1], atol=1e-9)


def test_groups_and_rods_give_all_their_bodies() -> None:
    group = shape_of(Group(parts={"a": Ball(x_mm=-3, diameter_mm=4), "b": Nut(x_mm=7)}))
    assert len(distances_of(group)) == 2
    bars = distances_of(shape_of(Bars()))
    assert all(isinstance(body, BoxDistance) for body in bars)
    points = np.array([[8.015 + 0.3, 0.0, -1.5 + 0.4], [Bars().middles_mm[1], 0.0, 0.1]])
    distances = [body.evaluate(points, 1.0)[0] for body in bars]
    # Right of the widest bar and above the plate; above the middle bar.
    assert distances[2][0] == pytest.approx(0.3, abs=1e-9)
    assert distances[3][0] == pytest.approx(0.4, abs=1e-9)
    assert distances[1][1] == pytest.approx(0.1, abs=1e-9)
    rods = Rods()
    bodies = distances_of(shape_of(rods))
    assert len(bodies) == 2 * len(rods.diameters_mm) + 1
    top = np.array([[rods.middles_mm[2], 0.0, 0.1]])
    nearest = min(float(body.evaluate(top, 1.0)[0][0]) for body in bodies)
    assert nearest == pytest.approx(0.1, abs=1e-9)
