"""Plane clear layers against closed forms: Snell, Fresnel, conservation of flux, reciprocity.

The references are written in float64 from the textbook formulas and share no code with the tracer.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh

from reconstruction.errors import InputError
from tests.optics.scenes import coated_scene
from twin.config import load_experiment
from twin.config.layers import Layer, Medium, media_of

GEL_AND_WINDOW = (Medium(7.0, 1.52, 0.0), Medium(4.0, 1.41, 0.0))
WINDOW_OVER_AIR = (Medium(8.0, 1.6, 0.0), Medium(5.0, 1.0, 0.0))
ABSORBING = (Medium(9.0, 1.5, 0.02), Medium(5.0, 1.7, 0.05))
THICK = (Medium(90.0, 1.3, 0.0), Medium(60.0, 2.2, 0.001), Medium(30.0, 1.5, 0.0))
STACKS = [GEL_AND_WINDOW, WINDOW_OVER_AIR, ABSORBING, THICK]


@pytest.fixture(scope="module")
def experiment():
    """The paper's rig with a matte coat and few, large pixels."""
    return load_experiment(
        "examples/slab_balls",
        {
            "camera.width_px": 120,
            "camera.height_px": 92,
            "camera.pixel_pitch_um": {"value": 72.0, "source": "test"},
            "coating.flake_fraction": 0.0,
        },
    )


@pytest.fixture(scope="module")
def rig(mi, experiment):
    from twin.optics.scene import rig_of

    return rig_of(experiment)


def stack_of(media):
    from twin.optics.layers import LayerStack

    return LayerStack(media)


def ways_mm(media, source_mm, z_mm):
    """Return the vertical distance in air and in every medium."""
    tops = [medium.top_mm for medium in media]
    return [source_mm - tops[0], *-np.diff(tops), tops[-1] - z_mm]


def tangent_in_air(media, ways, r_mm):
    """Bisect Snell's law along the whole path for the angle in air; float64."""
    low, high = np.zeros_like(r_mm), np.full_like(r_mm, 1e4)
    for _ in range(100):
        tangent = (low + high) / 2
        sine = np.sin(np.arctan(tangent))
        indices = [1.0, *(medium.ior for medium in media)]
        reach = sum(d * np.tan(np.arcsin(sine / n)) for d, n in zip(ways, indices, strict=True))
        low, high = np.where(reach < r_mm, tangent, low), np.where(reach < r_mm, high, tangent)
    return tangent


def transmittance(media, ways, sine):
    """Fresnel's amplitude formulas, interface by interface, and Beer-Lambert along the slant."""
    indices = [1.0, *(medium.ior for medium in media)]
    s_light = p_light = np.ones_like(sine)
    for n, m in pairwise(indices):
        i, j = np.arcsin(sine / n), np.arcsin(sine / m)
        flux = m * np.cos(j) / (n * np.cos(i))
        s_light = s_light * flux * (2 * n * np.cos(i) / (n * np.cos(i) + m * np.cos(j))) ** 2
        p_light = p_light * flux * (2 * n * np.cos(i) / (m * np.cos(i) + n * np.cos(j))) ** 2
    depth = sum(
        medium.absorption_per_mm * d / np.cos(np.arcsin(sine / medium.ior))
        for medium, d in zip(media, ways[1:], strict=True)
    )
    return (s_light + p_light) / 2 * np.exp(-depth)


def camera_rays(mi, rig, angles_deg):
    """Rays from 200 mm above z = 0, inclined towards +x."""
    angle = np.deg2rad(np.asarray(angles_deg, float))
    down = mi.Vector3f(np.sin(angle), 0.0 * angle, -np.cos(angle))
    return mi.Ray3f(mi.Point3f(0.0, 0.0, 200.0), down)


def points_seen(rig, count=4000):
    """Return points below the layers in the projector's image, (3, point) float32."""
    rng = np.random.default_rng(1)
    x_mm, y_mm = rng.uniform(-60, 60, (2, count))
    z_mm = rng.uniform(-1.0, 1.0, count)
    points = np.float32([x_mm, y_mm, z_mm])
    points[:2, 0] = rig.projector.T_world_from_device[:2, 3]  # straight below the pinhole
    return points


@pytest.mark.parametrize("media", STACKS)
def test_radiance_straight_up_is_reduced_by_fresnel(mi, rig, media):
    """Normal incidence: T = prod 4 n m / (n + m)^2, and 1 / n^2 from the wider cone in air."""
    indices = [1.0, *(medium.ior for medium in media)]
    fresnel = np.prod([4 * n * m / (n + m) ** 2 for n, m in pairwise(indices)])
    depth = sum(
        m.absorption_per_mm * d for m, d in zip(media, ways_mm(media, 200.0, 0.0)[1:], strict=True)
    )
    sight = stack_of(media).refract(camera_rays(mi, rig, [0.0]))
    expected = fresnel * np.exp(-depth) / media[-1].ior ** 2
    assert np.array(sight.transmission(mi.Float(media[-1].top_mm)))[0] == pytest.approx(
        expected, rel=1e-6
    )


@pytest.mark.parametrize("media", STACKS)
def test_oblique_rays_follow_snell_and_fresnel(mi, rig, media):
    """Up to 80 degrees: place on z = 0, direction and transmittance of every ray."""
    angles = np.arange(0.0, 81.0, 5.0)
    sine = np.sin(np.deg2rad(angles))
    sight = stack_of(media).refract(camera_rays(mi, rig, angles))
    way_mm = sight.ray.o.z / -sight.ray.d.z
    points = np.array(sight.ray(way_mm))
    ways = ways_mm(media, 200.0, 0.0)
    indices = [1.0, *(medium.ior for medium in media)]
    reach = sum(d * np.tan(np.arcsin(sine / n)) for d, n in zip(ways, indices, strict=True))
    np.testing.assert_allclose(points[0], reach, rtol=2e-6, atol=1e-5)
    np.testing.assert_allclose(points[2], 0.0, atol=1e-5)
    np.testing.assert_allclose(np.array(sight.ray.d)[0], sine / indices[-1], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(np.array(sight.ray.d), axis=0), 1.0, atol=1e-6)
    expected = transmittance(media, ways, sine) / indices[-1] ** 2
    np.testing.assert_allclose(np.array(sight.transmission(way_mm)), expected, rtol=2e-5)


def test_a_window_shifts_the_ray_sideways(mi, rig):
    """One slab of thickness d in air: the ray remains parallel, offset by d (tan i - tan j)."""
    media, angle = WINDOW_OVER_AIR, np.deg2rad(35.0)
    sight = stack_of(media).refract(camera_rays(mi, rig, [35.0]))
    point = np.array(sight.ray(sight.ray.o.z / -sight.ray.d.z))[0, 0]
    inside = np.arcsin(np.sin(angle) / 1.6)
    shift_mm = 3.0 * (np.tan(angle) - np.tan(inside))
    assert 200.0 * np.tan(angle) - point == pytest.approx(shift_mm, abs=3e-5)
    assert np.array(sight.ray.d)[0, 0] == pytest.approx(np.sin(angle), abs=1e-6)


def test_one_interface_transmits_as_mitsubas_own_fresnel(mi, rig):
    angles = np.arange(0.0, 86.0, 5.0)
    sight = stack_of((Medium(4.0, 1.41, 0.0),)).refract(camera_rays(mi, rig, angles))
    reflected = mi.fresnel(mi.Float(np.cos(np.deg2rad(angles))), 1.41)[0]
    expected = (1.0 - np.array(reflected)) / 1.41**2
    np.testing.assert_allclose(np.array(sight.transmittance), expected, rtol=1e-5)


def test_upward_rays_have_no_hit(mi, rig):
    sight = stack_of(GEL_AND_WINDOW).refract(camera_rays(mi, rig, [90.0, 120.0]))
    np.testing.assert_array_equal(np.array(sight.transmission(mi.Float(10.0))), 0.0)


@pytest.mark.parametrize("media", STACKS)
def test_projector_pixels_are_those_of_snells_law(mi, rig, media):
    """Newton in float32 against 100 bisections in float64: better than 1e-3 px, all angles."""
    points = points_seen(rig)
    arrival = stack_of(media).arrive(rig.projector, 1.0, mi.Point3f(*points))
    pose = rig.projector.T_world_from_device
    offset = points[:2].astype(float) - pose[:2, 3, None]
    r_mm = np.hypot(*offset)
    ways = ways_mm(media, pose[2, 3], points[2].astype(float))
    tangent = tangent_in_air(media, ways, r_mm)
    sideways = offset / np.maximum(r_mm, 1e-12) * tangent
    in_air = np.stack([*sideways, -np.ones_like(tangent)], axis=-1) @ pose[:3, :3]
    expected = rig.projector.pinhole.project(in_air)
    pixels = np.stack([np.array(arrival.column_px), np.array(arrival.row_px)], axis=-1)
    assert np.abs(pixels - expected).max() < 1e-3
    sine = np.sin(np.arctan(tangent)) / media[-1].ior
    np.testing.assert_allclose(np.array(arrival.direction)[2], np.sqrt(1 - sine**2), atol=1e-6)


@pytest.mark.parametrize("media", STACKS)
def test_light_paths_are_reversible(mi, rig, media):
    """A pixel's ray hits a point; the light from that pinhole to the point has that pixel.

    Reciprocity: opposite directions, and the same transmittance both ways. Irradiance over that
    of the undisturbed formula E1 (r / t)^2 / (axial^3 r'(t) cos) is the transmittance.
    """
    x_px, y_px = (axis.ravel().astype(float) for axis in np.meshgrid([3, 60, 110], [2, 45, 90]))
    layers = stack_of(media)
    sight = layers.refract(rig.camera.ray(mi.Float(x_px), mi.Float(y_px)))
    way_mm = sight.ray.o.z / -sight.ray.d.z
    arrival = layers.arrive(rig.camera, 1.0, sight.ray(way_mm))
    np.testing.assert_allclose(np.array(arrival.column_px), x_px, atol=1e-3)
    np.testing.assert_allclose(np.array(arrival.row_px), y_px, atol=1e-3)
    np.testing.assert_allclose(np.array(arrival.direction), -np.array(sight.ray.d), atol=2e-6)
    clear = stack_of(tuple(Medium(m.top_mm, m.ior, 0.0) for m in media))
    lossless = clear.refract(rig.camera.ray(mi.Float(x_px), mi.Float(y_px)))
    absorbed = np.array(sight.transmission(way_mm)) / np.array(lossless.transmission(way_mm))
    without = np.array(clear.arrive(rig.camera, 1.0, sight.ray(way_mm)).irradiance)
    np.testing.assert_allclose(np.array(arrival.irradiance) / without, absorbed, rtol=1e-5)


@pytest.mark.parametrize("media", STACKS)
def test_the_flux_through_the_layers_is_conserved(mi, rig, experiment, media):
    """Setup: irradiance of the coat's plane, integrated with a window smooth in projector pixels.

    Expected: each projector pixel sends the same flux (a DLP fills a flat screen); incident is that
    flux times its transmittance, summed with the same window: 0.1 %.
    Why: the geometry factor (r / t)^2 / r'(t) / cos is right for all angles or the sum is not.
    """
    step_mm = 0.5
    side = np.arange(-180.0, 180.0, step_mm)
    x_mm, y_mm = (axis.ravel() for axis in np.meshgrid(side, side))
    arrival = stack_of(media).arrive(
        rig.projector, rig.irradiance_at_1mm, mi.Point3f(x_mm, y_mm, 0.0 * x_mm)
    )
    width, height = rig.projector.pinhole.width_px, rig.projector.pinhole.height_px

    def window(column_px, row_px):
        """Return sin^2 arches that end smoothly at the image's edge."""
        u, v = (column_px + 0.5) / width, (row_px + 0.5) / height
        inside = (u > 0) & (u < 1) & (v > 0) & (v < 1)
        return inside * np.sin(np.pi * u) ** 2 * np.sin(np.pi * v) ** 2

    facing_up = np.array(arrival.irradiance) * np.array(arrival.direction)[2]
    weight = window(np.array(arrival.column_px), np.array(arrival.row_px))
    arrived_mw = np.sum(weight * facing_up, dtype=float) * step_mm**2
    column_px, row_px = np.meshgrid(np.arange(0.0, width, 4) + 1.5, np.arange(0.0, height, 4) + 1.5)
    pixels = np.stack([column_px.ravel(), row_px.ravel()], axis=-1)
    in_device = np.column_stack([rig.projector.pinhole.unproject(pixels), np.ones(len(pixels))])
    in_world = in_device @ rig.projector.T_world_from_device[:3, :3].T
    sine = np.hypot(in_world[:, 0], in_world[:, 1]) / np.linalg.norm(in_world, axis=1)
    ways = ways_mm(media, rig.projector.T_world_from_device[2, 3], 0.0)
    sent = window(*pixels.T) * transmittance(media, ways, sine)
    expected_mw = experiment.projector.flux_mw * sent.mean()
    assert arrived_mw == pytest.approx(expected_mw, rel=1e-3)


def test_layers_of_air_change_nothing(mi, experiment, rig, bump):
    """Index 1: the refracted path is the straight one, to the rounding of float32."""
    from twin.optics.connection import see
    from twin.optics.devices import SubPixels

    scene, grid = coated_scene(experiment, bump), SubPixels.of_image(120, 92, 1)
    air = stack_of((Medium(8.0, 1.0, 0.0), Medium(3.0, 1.0, 0.0)))
    ray = rig.camera.ray(grid.x_px, grid.y_px)
    (hit, path), (hit_through, through) = (
        see(scene, replace(rig, layers=layers), ray) for layers in (None, air)
    )
    np.testing.assert_array_equal(np.array(through.lit), np.array(path.lit))
    assert np.array(path.lit).mean() > 0.9
    np.testing.assert_allclose(np.array(hit_through.p), np.array(hit.p), atol=1e-4)
    for name, atol in (("column_px", 5e-4), ("row_px", 5e-4), ("axial_mm", 1e-4)):
        np.testing.assert_allclose(
            np.array(getattr(through, name)), np.array(getattr(path, name)), atol=atol
        )
    np.testing.assert_allclose(np.array(through.weight), np.array(path.weight), rtol=2e-5)


def test_a_plane_in_a_gel_has_the_radiance_of_the_closed_form(mi, experiment, rig, plane):
    """L = T_camera / n^2 * albedo / pi * T_projector E, at the pixel that looks straight down."""
    from twin.optics.connection import see
    from twin.optics.scene import rig_of

    layers = {"gel": Layer(bottom_mm=0.0, thickness_mm=4.0, ior=1.41, absorption_per_mm=0.03)}
    layered = experiment.model_copy(update={"layers": layers})
    media, scene = media_of(layers), coated_scene(layered, plane)
    hit, path = see(scene, rig_of(layered), rig.camera.ray(mi.Float(59.5), mi.Float(45.5)))
    point, radiance = np.array(hit.p)[:, 0].astype(float), np.array(path.weight)[0]
    pose = rig.projector.T_world_from_device
    ways, offset = ways_mm(media, pose[2, 3], point[2]), point[:2] - pose[:2, 3]
    r_mm = np.hypot(*offset)

    def intensity_reach(tangent):
        sine = np.sin(np.arctan(tangent))
        return ways[0] * tangent + ways[1] * np.tan(np.arcsin(sine / 1.41))

    tangent = tangent_in_air(media, ways, np.array(r_mm))
    # numerical dr/dtheta instead of the derivative that the tracer uses
    angle, step = np.arctan(tangent), 1e-5
    growth = intensity_reach(np.tan(angle + step)) - intensity_reach(np.tan(angle - step))
    in_air = np.array([*(offset / r_mm * np.sin(angle)), -np.cos(angle)])
    intensity = rig.irradiance_at_1mm / (in_air @ pose[:3, 2]) ** 3
    irradiance = intensity * np.sin(angle) / r_mm / (growth / (2 * step))
    irradiance *= transmittance(media, ways, np.sin(angle))
    upwards = transmittance(media, ways_mm(media, 214.0, point[2]), np.array(0.0)) / 1.41**2
    expected = experiment.coating.base_albedo / np.pi * irradiance * upwards
    assert radiance == pytest.approx(expected, rel=2e-4)


def test_the_shadow_in_a_gel_falls_along_the_refracted_light(mi, experiment, rig, plane):
    """A wall of 3 mm inside the gel: the length of its shadow follows from the angle in the gel.

    In air it would be 0.4 mm longer; a camera pixel is 0.24 mm.
    """
    from twin.optics.one_trace import trace_truth
    from twin.optics.scene import rig_of

    wall = trimesh.creation.box(extents=[0.5, 40.0, 6.0])
    wall.apply_translation([6.0, 0.0, 0.0])
    both = trimesh.util.concatenate([plane, wall])
    both.vertex_normals = np.concatenate([plane.vertex_normals, wall.vertex_normals])
    layers = {"gel": Layer(bottom_mm=0.0, thickness_mm=4.0, ior=1.41)}
    layered = experiment.model_copy(update={"layers": layers})
    truth = trace_truth(coated_scene(layered, both), rig_of(layered))
    media, edge = media_of(layers), np.array([5.75, 0.0, 3.0])
    pose = rig.projector.T_world_from_device
    r_mm = np.array(pose[0, 3] - edge[0])
    tangent = tangent_in_air(media, ways_mm(media, pose[2, 3], edge[2]), r_mm)
    inside = np.arcsin(np.sin(np.arctan(tangent)) / 1.41)
    tip_x_mm = edge[0] - edge[2] * np.tan(inside)
    row, lit = truth.points_world_mm[46], truth.lit[46]
    dark = row[(np.abs(row[:, 2]) < 0.01) & ~lit, 0]
    assert dark[dark < 5.7].min() == pytest.approx(tip_x_mm, abs=0.25)
    assert edge[2] * (tangent - np.tan(inside)) > 0.35


def test_truth_is_the_surface_behind_the_layers(mi, experiment, rig, bump):
    """Points are on the bump although camera rays are refracted; depth is that of the point."""
    from twin.optics.one_trace import trace_truth

    window = stack_of((Medium(12.0, 1.7, 0.0), Medium(2.0, 1.0, 0.0)))
    truth = trace_truth(coated_scene(experiment, bump), replace(rig, layers=window))
    x, y, z = (truth.points_world_mm[..., axis].astype(float) for axis in range(3))
    np.testing.assert_allclose(z, 0.8 * np.exp(-(x**2 + y**2) / 4.0), atol=3e-4)
    np.testing.assert_allclose(truth.depth_mm, 214.0 - z, atol=1e-4)
    # the outermost columns look out at 3.8 degrees: d (tan i - tan j) is 0.27 mm there
    edge = rig.camera.pinhole.unproject(np.array([0.0, 46.0]))[0] * (214.0 - z[46, 0])
    shift_mm = 10.0 * (1 - 1 / 1.7) * np.abs(edge) / 214.0
    assert x[46, 0] - edge == pytest.approx(shift_mm, rel=0.02)


def test_a_face_that_reaches_into_a_layer_is_rejected(mi, experiment, bump):

    layers = {"window": Layer(bottom_mm=0.5, thickness_mm=1.0, ior=1.5)}
    with pytest.raises(InputError, match=r"reaches z = 0\.8 mm, allowed below 0\.5 mm"):
        coated_scene(experiment.model_copy(update={"layers": layers}), bump)


def test_flakes_reflect_by_their_index_against_the_gel(mi, experiment):
    from twin.optics.scene import coating_in_layer

    layers = {"gel": Layer(bottom_mm=0.0, thickness_mm=4.0, ior=1.41)}
    coating = coating_in_layer(experiment.model_copy(update={"layers": layers}))
    assert coating.flake_ior == pytest.approx(experiment.coating.flake_ior / 1.41)
    assert coating.flake_extinction == pytest.approx(experiment.coating.flake_extinction / 1.41)
    assert coating_in_layer(experiment) == experiment.coating
