"""Rays over heights: every answer against all facets in double precision, and Mitsuba's tree."""

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
"""Of the rays, that are decided at once: those beside steep places are walked."""


@pytest.fixture(scope="module", params=RELIEFS)
def sheet(mi, request, grid_face):
    """Return a face, its heights and the scene of it alone."""
    from twin.optics.heights import MarchedHeights
    from twin.optics.scene import CoatedScene

    face = grid_face(
        RELIEFS[request.param], lambda x, y: (0.0 * x, 0.0 * y), *HALF_MM, pitch_mm=PITCH_MM
    )
    scene = CoatedScene(face, {"type": "diffuse"})
    return request.param, face, MarchedHeights.of_grid(height_grid(face)), scene


def way_to_facets_mm(face, start_mm, direction):
    """Way to the nearest facet of all, infinite where there is none: Moller and Trumbore 1997."""
    corners = face.vertices.astype(np.float32).astype(np.float64)[face.faces]
    first, one, other = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    found = np.full(len(start_mm), np.inf)
    for k, (start, way) in enumerate(zip(start_mm, direction, strict=True)):
        across, offset = np.cross(way, other), start - first
        volume = np.sum(one * across, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.sum(offset * across, axis=-1) / volume
            beside = np.cross(offset, one)
            v, t = beside @ way / volume, np.sum(other * beside, axis=-1) / volume
            inside = (np.minimum(u, v) >= -1e-9) & (u + v <= 1.0 + 1e-9) & (t > 1e-4)
        found[k] = t[inside].min(initial=np.inf)
    return found


def rays_from_above():
    """Rays (ray, xyz) towards places on the sheet and beside it, from 10 mm above, most oblique."""
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(RAYS, 3))
    direction[:, 2] = -0.3 - 2.0 * np.abs(direction[:, 2])
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    target = np.column_stack([rng.uniform(-1.1, 1.1, (RAYS, 2)) * HALF_MM, np.zeros(RAYS)])
    start = target - direction * (10.0 / -direction[:, 2:])
    return start.astype(np.float32).astype(np.float64), direction.astype(np.float32).astype(float)


def test_the_first_hit_is_that_of_all_facets(mi, sheet):
    """Rays at 1 to 82 degrees off the vertical, some past the border.

    Expected: what a search of all facets in double precision finds, to float32's resolution of the
    way; what is met at once is nothing else.
    """
    name, face, heights, scene = sheet
    start, direction = rays_from_above()
    expected = way_to_facets_mm(face, start, direction)
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(direction.T))
    seen = np.isfinite(expected)
    assert 0.5 * RAYS < seen.sum() < 0.95 * RAYS
    hit = heights.first_hit(scene.shape, ray)
    np.testing.assert_array_equal(hit.is_valid().numpy(), seen)
    np.testing.assert_allclose(hit.t.numpy()[seen], expected[seen], atol=3e-5)
    point = hit.compute_surface_interaction(ray).p.numpy().T[seen]
    np.testing.assert_allclose(point, (start + expected[:, None] * direction)[seen], atol=3e-5)
    met, at_once = heights.met_at_once(ray)
    sure = at_once.numpy()
    assert not (sure & ~seen).any()
    np.testing.assert_allclose(met.t.numpy()[sure], expected[sure], atol=3e-5)
    assert sure.sum() > LEAST_SHARE[name] * seen.sum()


def test_a_free_way_meets_no_facet(mi, sheet):
    """From points of the sheet, upward at 1 to 82 degrees off the vertical.

    Expected: no way that is called free meets a facet.
    """
    name, face, heights, scene = sheet
    start, direction = rays_from_above()
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(direction.T))
    hit = heights.first_hit(scene.shape, ray).compute_surface_interaction(ray)
    valid = hit.is_valid()
    up = direction[::-1] * [1.0, 1.0, -1.0]
    free = heights.is_free(hit.p, mi.Vector3f(up.T), valid).numpy()
    start = hit.p.numpy().T.astype(np.float64) + 1e-5 * np.array([0.0, 0.0, 1.0])
    assert np.isinf(way_to_facets_mm(face, start[free], up[free])).all()
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
    """From above, below and beside it, along its axes and nearly level; none is decided at once.

    Expected: what a search of all facets finds. Along the plane and within rounding of an edge of
    the border either answer is right: rays that end within 1e-3 mm of it are left out.
    """
    _, face, heights, scene = sheet
    start, direction = rays_from_anywhere()
    expected = way_to_facets_mm(face, start, direction)
    place = start + np.where(np.isfinite(expected), expected, 0.0)[:, None] * direction
    clear = np.abs(np.abs(place[:, :2]) - HALF_MM).min(axis=1) > 1e-3
    ray = mi.Ray3f(mi.Point3f(start.T), mi.Vector3f(direction.T))
    assert not heights.met_at_once(ray)[1].numpy()[expected == np.inf].any()
    hit, crossed = heights.first_hit(scene.shape, ray), heights.is_crossed(ray, mi.Bool(True))
    seen = np.isfinite(expected)
    assert seen.sum() > 0.1 * RAYS
    np.testing.assert_array_equal(hit.is_valid().numpy()[clear], seen[clear])
    np.testing.assert_array_equal(crossed.numpy()[clear], seen[clear])
    both = seen & clear
    np.testing.assert_allclose(hit.t.numpy()[both], expected[both], rtol=1e-4, atol=1e-4)
    tree = scene.ray_test(ray).numpy()
    assert (tree != seen)[clear].sum() <= 1


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
    """Lines half a cell off, on a grid all the same: the tree is used."""
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

    Expected: where light arrives, and how much, is the same; positions agree to 1e-3 px of the
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
        maps_of(trace_patches(scene, one, 4).evaluate(), rig.camera.pinhole)
        for one in (rig, replace(rig, heights=None), replace(rig, shadows=False))
    )
    assert (unshaded.weight > 1.1 * traced.weight).sum() > 50
    np.testing.assert_array_equal(marched.lit, traced.lit)
    np.testing.assert_allclose(marched.weight, traced.weight, rtol=1e-4)
    np.testing.assert_allclose(marched.column_px, traced.column_px, atol=1e-3)
    np.testing.assert_allclose(marched.row_px, traced.row_px, atol=1e-3)
