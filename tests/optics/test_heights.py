"""Rays over heights: every hit against all facets in double precision, and Mitsuba's tree."""

from dataclasses import replace

import numpy as np
import pytest

from tests.optics.scenes import coated_scene
from twin.config import load_experiment
from twin.optics.height_grid import height_grid

PITCH_MM = 0.05
HALF_MM = 4.0, 3.0
RAYS = 120


def spike(x, y):
    return 2.0 * np.exp(-2.0 * (x**2 + y**2))


def terraces(x, y):
    return 0.8 * (np.hypot(x + 2.5, y) < 1.0) + 0.5 * (np.hypot(x + 3.5, y - 2.0) < 0.5)


def rough(x, y):
    return 0.01 * np.random.default_rng(3).normal(size=x.shape)


def plane(x, y):
    return 0.0 * x + 0.25


RELIEFS = {"spike": spike, "terraces": terraces, "rough": rough, "plane": plane}
LEAST_SHARE = {"spike": 0.5, "terraces": 0.4, "rough": 0.3, "plane": 0.999}
"""Least share of rays with a certain Newton hit; rays near steep facets are marched."""


@pytest.fixture(scope="module", params=RELIEFS)
def sheet(mi, request, grid_face):
    """Return a face, its heights and a scene of this face only."""
    from twin.optics.heights import MarchedHeights
    from twin.optics.scene import CoatedScene

    face = grid_face(
        RELIEFS[request.param], lambda x, y: (0.0 * x, 0.0 * y), *HALF_MM, pitch_mm=PITCH_MM
    )
    scene = CoatedScene(face, {"type": "diffuse"})
    return request.param, face, MarchedHeights.of_grid(height_grid(face)), scene


def distance_to_facets_mm(face, start_mm, direction):
    """Distance to the nearest of all facets, infinite without a hit: Moller and Trumbore 1997."""
    corners = face.vertices.astype(np.float32).astype(np.float64)[face.faces]
    first, u_side, v_side = (
        corners[:, 0],
        corners[:, 1] - corners[:, 0],
        corners[:, 2] - corners[:, 0],
    )
    nearest_mm = np.full(len(start_mm), np.inf)
    for k, (start, way) in enumerate(zip(start_mm, direction, strict=True)):
        across, offset = np.cross(way, v_side), start - first
        volume = np.sum(u_side * across, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.sum(offset * across, axis=-1) / volume
            offset_cross_u = np.cross(offset, u_side)
            v, t = offset_cross_u @ way / volume, np.sum(v_side * offset_cross_u, axis=-1) / volume
            inside = (np.minimum(u, v) >= -1e-9) & (u + v <= 1.0 + 1e-9) & (t > 1e-4)
        nearest_mm[k] = t[inside].min(initial=np.inf)
    return nearest_mm


def rays_from_above():
    """Rays (ray, xyz) towards points on and outside the sheet, from 10 mm above, most oblique."""
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(RAYS, 3))
    direction[:, 2] = -0.3 - 2.0 * np.abs(direction[:, 2])
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    target = np.column_stack([rng.uniform(-1.1, 1.1, (RAYS, 2)) * HALF_MM, np.zeros(RAYS)])
    start = target - direction * (10.0 / -direction[:, 2:])
    return start.astype(np.float32).astype(np.float64), direction.astype(np.float32).astype(float)


def test_the_first_hit_is_that_of_all_facets(mi, sheet):
    """Rays at 1 to 82 degrees off the vertical, some past the border.

    Expected: the nearest of all facets in double precision, to float32's resolution of the
    distance; certain Newton hits agree with it.
    """
    name, face, heights, scene = sheet
    start, direction = rays_from_above()
    expected = distance_to_facets_mm(face, start, direction)
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(direction.T))
    has_hit = np.isfinite(expected)
    assert 0.5 * RAYS < has_hit.sum() < 0.95 * RAYS
    hit = heights.first_hit(scene.shape, ray)
    np.testing.assert_array_equal(hit.is_valid().numpy(), has_hit)
    np.testing.assert_allclose(hit.t.numpy()[has_hit], expected[has_hit], atol=3e-5)
    point = hit.compute_surface_interaction(ray).p.numpy().T[has_hit]
    np.testing.assert_allclose(point, (start + expected[:, None] * direction)[has_hit], atol=3e-5)
    met, at_once = heights.newton_hit(ray)
    sure = at_once.numpy()
    assert not (sure & ~has_hit).any()
    np.testing.assert_allclose(met.t.numpy()[sure], expected[sure], atol=3e-5)
    assert sure.sum() > LEAST_SHARE[name] * has_hit.sum()


def test_a_free_ray_meets_no_facet(mi, sheet):
    """From points of the sheet, upward at 1 to 82 degrees off the vertical.

    Expected: no ray that `is_free` returns intersects a facet.
    """
    name, face, heights, scene = sheet
    start, direction = rays_from_above()
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(direction.T))
    hit = heights.first_hit(scene.shape, ray).compute_surface_interaction(ray)
    valid = hit.is_valid()
    up = direction[::-1] * [1.0, 1.0, -1.0]
    free = heights.is_free(hit.p, mi.Vector3f(up.T), valid).numpy()
    start = hit.p.numpy().T.astype(np.float64) + 1e-5 * np.array([0.0, 0.0, 1.0])
    assert np.isinf(distance_to_facets_mm(face, start[free], up[free])).all()
    assert free.sum() > LEAST_SHARE[name] * valid.numpy().sum()


def rays_from_anywhere():
    """Rays (ray, xyz) from within and around the sheet's box, in all directions."""
    rng = np.random.default_rng(2)
    start = rng.uniform(-1.2, 1.2, (RAYS, 3)) * [*HALF_MM, 1.0] + [0.0, 0.0, 0.3]
    direction = rng.normal(size=(RAYS, 3)) * [1.0, 1.0, 0.3]
    direction[:4] = [[1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return start.astype(np.float32).astype(np.float64), direction.astype(np.float32).astype(float)


def test_rays_from_anywhere_meet_the_sheet_where_its_facets_are(mi, sheet):
    """From above, below and the sides, along its axes and nearly horizontal; all are marched.

    Expected: the nearest of all facets. Along the plane and within rounding of an edge of the
    border both results are correct: rays that end within 1e-3 mm of it are left out.
    """
    _, face, heights, scene = sheet
    start, direction = rays_from_anywhere()
    expected = distance_to_facets_mm(face, start, direction)
    place = start + np.where(np.isfinite(expected), expected, 0.0)[:, None] * direction
    clear = np.abs(np.abs(place[:, :2]) - HALF_MM).min(axis=1) > 1e-3
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(direction.T))
    assert not heights.newton_hit(ray)[1].numpy()[expected == np.inf].any()
    hit, crossed = heights.first_hit(scene.shape, ray), heights.is_crossed(ray, mi.Bool(True))
    has_hit = np.isfinite(expected)
    assert has_hit.sum() > 0.1 * RAYS
    np.testing.assert_array_equal(hit.is_valid().numpy()[clear], has_hit[clear])
    np.testing.assert_array_equal(crossed.numpy()[clear], has_hit[clear])
    both = has_hit & clear
    np.testing.assert_allclose(hit.t.numpy()[both], expected[both], rtol=1e-4, atol=1e-4)
    tree = scene.ray_test(ray).numpy()
    assert (tree != has_hit)[clear].sum() <= 1


def test_a_ray_that_ends_before_the_sheet_meets_nothing(mi, sheet):
    _, _, heights, scene = sheet
    above, below = mi.Point3f(0.1, 0.1, 10.0), mi.Point3f(0.1, 0.1, -10.0)
    ended = mi.Ray3f(above, mi.Vector3f(0, 0, -1))
    ended.maxt = 5.0
    level = mi.Ray3f(above, mi.Vector3f(1, 0, 0))
    for ray in (ended, level):
        assert not heights.first_hit(scene.shape, ray).is_valid().numpy().any()
        assert not heights.is_crossed(ray, mi.Bool(True)).numpy().any()
    met = heights.first_hit(scene.shape, mi.Ray3f(below, mi.Vector3f(0, 0, 1)))
    assert met.is_valid().numpy().all()


def test_an_uneven_grid_has_no_heights(mi, plane):
    """Grid lines with an offset of half a cell: the tree is used."""
    from twin.optics.heights import MarchedHeights

    moved = plane.copy()
    x = moved.vertices[:, 0]
    moved.vertices[x == 0.5, 0] = 0.75
    assert MarchedHeights.of_grid(height_grid(plane)) is not None
    assert height_grid(moved) is not None
    assert MarchedHeights.of_grid(height_grid(moved)) is None


@pytest.fixture(scope="module")
def experiment():
    return load_experiment(
        "examples/slab_balls",
        {
            "projector.width_px": 320,
            "projector.height_px": 180,
            "camera.width_px": 100,
            "camera.height_px": 76,
            "camera.pixel_pitch_um": {"value": 54.0, "source": "test"},
            "patterns.steps": 3,
            "patterns.period_px": 64,
            "patterns.code": "gray",
        },
    )


@pytest.mark.parametrize("name", ["high spike", "high terraces"])
def test_traced_by_heights_as_by_the_tree(mi, experiment, grid_face, name):
    """A spike of 75 degrees and walls that cast shadows on the sheet, with the paper's rig.

    Expected: the lit pixels and their radiance are the same; positions agree to 1e-3 px of the
    projector. A ray in a million slips between two facets of the tree.
    """
    from twin.optics.one_trace import maps_of, trace_patches
    from twin.optics.scene import coated_rig

    def height(x, y):
        if name == "high spike":
            return 6.0 * np.exp(-(x**2 + y**2) / 2)
        return 0.8 * (np.hypot(x, y) < 3.0) + 0.5 * (np.hypot(x - 5.0, y) < 1.0)

    face = grid_face(height, lambda x, y: (0.0 * x, 0.0 * y), pitch_mm=0.05)
    scene, rig = coated_scene(experiment, face), coated_rig(experiment, face)
    assert rig.shadows
    assert rig.heights is not None
    marched, traced, unshaded = (
        maps_of(trace_patches(scene, variant, 4).evaluate(), rig.camera.pinhole)
        for variant in (rig, replace(rig, heights=None), replace(rig, shadows=False))
    )
    assert (unshaded.weight > 1.1 * traced.weight).sum() > 50
    np.testing.assert_array_equal(marched.lit, traced.lit)
    np.testing.assert_allclose(marched.weight, traced.weight, rtol=1e-4)
    np.testing.assert_allclose(marched.column_px, traced.column_px, atol=1e-3)
    np.testing.assert_allclose(marched.row_px, traced.row_px, atol=1e-3)
