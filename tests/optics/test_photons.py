"""Light through clear bodies: energy, a flat block against Snell and Fresnel, a ball against stock.

The scenes are built here from Mitsuba's own analytic shapes; z = 0 is the top of the body.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from twin.config import load_experiment
from twin.optics.light import light_tables, pattern_set

HEIGHT_MM, GAP_MM, STAGE_MM = 6.0, 0.02, 60.0
STAGE = {"type": "diffuse", "reflectance": {"type": "spectrum", "value": 0.5}}


@pytest.fixture(scope="module")
def experiment():
    return load_experiment(
        "examples/slab_balls",
        {
            "camera.width_px": 120,
            "camera.height_px": 92,
            "camera.pixel_pitch_um": {"value": 72.0, "source": "test"},
            "patterns.steps": 4,
        },
    )


@pytest.fixture(scope="module")
def rig(mi, experiment):
    from twin.optics.scene import rig_of

    return rig_of(experiment)


@pytest.fixture(scope="module")
def tables(experiment):
    return light_tables(
        experiment.projector, pattern_set(experiment.projector, experiment.patterns)
    )


def clear_scene(mi, body, absorption_per_mm=0.0):
    """Return scene and surfaces: a body on a matte stage, its top at z = 0."""
    from twin.optics.scene import Sharp, Surfaces

    place = mi.ScalarTransform4f().translate([0, 0, -HEIGHT_MM - GAP_MM])
    stage = {"type": "rectangle", "to_world": place.scale(STAGE_MM / 2), "bsdf": STAGE}
    scene = mi.load_dict({"type": "scene", "stage": stage, "body": body}, optimize=False)
    shapes = {shape.id(): shape for shape in scene.shapes()}
    return scene, Surfaces((Sharp(shapes["body"], absorption_per_mm),), shapes["stage"])


def block(mi, half_mm=12.0, ior=1.5):
    place = mi.ScalarTransform4f().translate([0, 0, -HEIGHT_MM / 2])
    return {
        "type": "cube",
        "to_world": place.scale([half_mm, half_mm, HEIGHT_MM / 2]),
        "bsdf": {"type": "dielectric", "int_ior": ior, "ext_ior": 1.0},
    }


def ball(roughness=0.0):
    kind = {"type": "roughdielectric", "alpha": roughness} if roughness else {"type": "dielectric"}
    return {
        "type": "sphere",
        "center": [0, 0, -HEIGHT_MM / 2],
        "radius": HEIGHT_MM / 2,
        "bsdf": {**kind, "int_ior": 1.5, "ext_ior": 1.0},
    }


@pytest.mark.parametrize("shape", ["block", "ball", "rough ball"])
def test_flux_is_conserved(mi, rig, shape):
    """Clear and lossless: `absorbed` is 0, the sent flux is deposited, escapes or is cut.

    `absorbed` is the sum of the losses of all events. Sampling a rough surface loses the light that
    its microfacets shade: a few per cent.
    """
    from twin.optics.photons import trace_photons

    body = {"block": block(mi), "ball": ball(), "rough ball": ball(0.1)}[shape]
    scene, surfaces = clear_scene(mi, body)
    balance = trace_photons(scene, surfaces, rig, count=100_000, seed=1).balance
    parts = balance.absorbed + balance.deposited + balance.escaped + balance.lost + balance.cut
    assert parts == pytest.approx(balance.sent, rel=1e-6)
    assert abs(balance.absorbed) < (0.03 if shape == "rough ball" else 1e-5) * balance.sent
    assert balance.cut < 0.01 * balance.sent
    assert balance.lost == 0.0


@pytest.mark.parametrize("events", [1, 2])
def test_flux_is_conserved_within_a_body_too(mi, rig, monkeypatch, events):
    """Setup: photons are cut after one and after two surfaces, most of them in the block.

    Expected: `cut` equals the sent flux. In the other transport mode it would be 1 / n^2 of it; at
    the exit from the body this factor cancels, so that no balance of complete paths detects it.
    """
    from twin.optics import photons

    monkeypatch.setattr(photons, "MOST_EVENTS", events)
    scene, surfaces = clear_scene(mi, block(mi))
    balance = photons.trace_photons(scene, surfaces, rig, count=20_000, seed=1).balance
    assert balance.cut + balance.escaped + balance.deposited == pytest.approx(
        balance.sent, rel=1e-5
    )
    assert balance.cut > 0.9 * balance.sent
    assert abs(balance.absorbed) < 1e-5 * balance.sent


def test_flux_sent_is_that_of_the_solid_angle(mi, rig):
    """A ball on the ray of the image centre: intensity E1 / cos^3 over its cone, by quadrature."""
    from twin.optics.photons import trace_photons

    scene, surfaces = clear_scene(mi, ball())
    balance = trace_photons(scene, surfaces, rig, count=400_000, seed=2).balance
    eye, axis = (rig.projector.T_world_from_device[:3, k] for k in (3, 2))
    towards = np.array([0.0, 0.0, -HEIGHT_MM / 2]) - eye
    distance = np.linalg.norm(towards)
    opening = np.arcsin(HEIGHT_MM / 2 / distance)
    side = np.cross(towards, axis) / np.linalg.norm(np.cross(towards, axis))
    basis = np.stack([side, np.cross(towards / distance, side), towards / distance])
    theta = (np.arange(400) + 0.5) / 400 * opening
    phi = (np.arange(64) + 0.5) / 64 * 2 * np.pi
    t, p = np.meshgrid(theta, phi, indexing="ij")
    rays = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1) @ basis
    intensity = rig.irradiance_at_1mm / (rays @ axis) ** 3
    flux = np.sum(intensity * np.sin(t)) * (opening / 400) * (2 * np.pi / 64)
    assert balance.sent == pytest.approx(flux, rel=1e-3)


def test_absorption_follows_beer_and_lambert(mi, rig):
    """A block above the stage: deposited flux is reduced by exp(-a d / cos), to first order."""
    from twin.optics.photons import trace_photons

    clear, dark = (
        trace_photons(*clear_scene(mi, block(mi), a), rig, count=200_000, seed=3).balance
        for a in (0.0, 0.02)
    )
    # Rays tilt by 16 degrees inside (25 outside); side walls lengthen a few paths.
    expected = np.exp(-0.02 * HEIGHT_MM / np.cos(np.arcsin(np.sin(np.deg2rad(25)) / 1.5)))
    assert dark.deposited / clear.deposited == pytest.approx(expected, abs=0.01)
    assert dark.absorbed > 0.9 * (1 - expected) * dark.sent


def test_map_holds_the_photons_flux(mi, rig, experiment, tables):
    from twin.optics.photons import map_photons, trace_photons

    photons = trace_photons(*clear_scene(mi, block(mi)), rig, count=100_000, seed=4)
    irradiance = map_photons(photons, tables)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    order = [*tables["column"].frames, *tables["row"].frames]
    white = order.index(patterns.index("white").start)
    assert irradiance.flux_mw(white) == pytest.approx(photons.balance.deposited, rel=2e-3)


def test_same_seed_same_photons(mi, rig):
    from twin.optics.photons import trace_photons

    scene, surfaces = clear_scene(mi, ball())
    first, second, reseeded = (
        trace_photons(scene, surfaces, rig, count=20_000, seed=seed) for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first.x_mm, second.x_mm)
    np.testing.assert_array_equal(first.flux_mw, second.flux_mw)
    assert not np.array_equal(first.x_mm, reseeded.x_mm)


@pytest.fixture(scope="module")
def through_block(mi, rig, tables):
    """Return frames through a clear block by photons, and by the Snell connection of layers."""
    from twin.config.layers import media_of
    from twin.config.models import Layer
    from twin.optics.bounces import Bounces
    from twin.optics.layers import LayerStack
    from twin.optics.one_trace import trace_stack
    from twin.optics.photons import StageLight, map_photons, trace_photons

    scene, surfaces = clear_scene(mi, block(mi))
    photons = trace_photons(scene, surfaces, rig, count=3_000_000, seed=7)
    light = StageLight(map_photons(photons, tables))
    bounces = Bounces(0, paths=8, seed=8, surfaces=surfaces, stage_light=light)
    sampled = trace_stack(scene, rig, tables, 16, bounces=bounces)

    bare = mi.load_dict({"type": "scene", "stage": stage_of(mi)}, optimize=False)
    glass = Layer(bottom_mm=-HEIGHT_MM, thickness_mm=HEIGHT_MM, ior=1.5)
    air = Layer(bottom_mm=-HEIGHT_MM - 5.0, thickness_mm=5.0, ior=1.0)
    layers = LayerStack(media_of({"glass": glass, "air": air}))
    solved = trace_stack(bare, replace(rig, layers=layers), tables, 16)
    return np.stack(sampled), np.stack(solved)


def stage_of(mi):
    place = mi.ScalarTransform4f().translate([0, 0, -HEIGHT_MM - GAP_MM])
    return {"type": "rectangle", "to_world": place.scale(STAGE_MM / 2), "bsdf": STAGE}


def test_fringes_behind_a_block_lie_where_snell_puts_them(through_block, experiment):
    """Photons and paths against the deterministic connection, phase by phase.

    Expected: the decoded phase agrees to 0.002 px in the mean and 0.03 px per pixel; the white
    frame is 0.3 % higher, due to two more reflections in the block; the map's blur has no effect.
    """
    patterns = pattern_set(experiment.projector, experiment.patterns)
    sampled, solved = through_block
    middle = np.s_[:, 30:62, 40:80]  # away from the block's edges
    white = patterns.index("white").start
    ratio = sampled[white][middle[1:]] / solved[white][middle[1:]]
    assert ratio.mean() == pytest.approx(1.003, abs=0.002)
    for axis in ("column", "row"):
        frames = patterns.index("phase", axis)
        turns = np.exp(-2j * np.pi * np.arange(patterns.steps) / patterns.steps)
        ours, theirs = (np.tensordot(turns, s[frames][middle], 1) for s in (sampled, solved))
        error_px = np.angle(ours * theirs.conj()) * experiment.patterns.period_px / (2 * np.pi)
        assert abs(error_px.mean()) < 0.002
        assert error_px.std() < 0.04


def test_no_ring_where_block_and_stage_meet(through_block, experiment):
    """Setup: the block is 0.02 mm above the stage; the stage behind it is uniformly lit.

    Expected: 3 % of photon noise, no pixel beyond five times that, and rows and columns, the means
    of 40 and 32 pixels, even to 0.8 %: a self-intersection makes rings and stripes.
    """
    white = pattern_set(experiment.projector, experiment.patterns).index("white").start
    sampled, solved = through_block
    ratio = sampled[white, 30:62, 40:80] / solved[white, 30:62, 40:80]
    assert np.abs(ratio - ratio.mean()).max() < 0.15
    assert ratio.std() < 0.035
    assert ratio.mean(axis=0).std() < 0.008
    assert ratio.mean(axis=1).std() < 0.008


def test_light_through_a_ball_equals_stock_with_a_small_lamp(mi):
    """Setup: a clear ball on the stage. Stock `path` reaches a disc lamp of 3 mm radius 60 mm away.

    The lamp's own mirror images in the ball, which a pinhole has no width for, are rendered
    separately on a black stage and subtracted.
    Expected: the image divided by that of the bare stage agrees in blocks of 10 x 10 pixels (2.4
    mm) within Student's t at 0.1 % over 6 runs of stock, plus 3 % of the caustic (the lamp's cosine
    against the projector's even field, the lamp's size, light reflected twice by the stage).
    With a pinhole stock shows the shadow black.
    """
    near = load_experiment("examples/slab_balls", NEAR)
    ours, bare_ours = white_with_and_without(mi, near)
    theirs, bare_theirs = lamp_with_and_without(mi, near, runs=6)
    relative = tiles(ours / bare_ours)
    runs = np.stack([tiles(image / bare_theirs) for image in theirs])
    mean = runs.mean(axis=0)
    error = np.hypot(stats.sem(runs, axis=0), 0.03 * mean.max() / stats.t.ppf(1 - 0.0005, 5))
    assert mean.max() > 5  # there is a caustic
    assert mean.min() < 0.4  # and a shadow
    assert np.abs((relative - mean) / error).max() < stats.t.ppf(1 - 0.0005, 5)


NEAR = {
    "camera.width_px": 60,
    "camera.height_px": 50,
    "camera.pixel_pitch_um": {"value": 72.0, "source": "test"},
    "camera.pose.polar_deg": {"value": 20.0, "source": "test"},
    "projector.pose.polar_deg": {"value": 0.0, "source": "test"},
    "projector.pose.standoff_mm": {"value": 60.0, "source": "test"},
    "projector.offset_percent": {"value": 0.0, "source": "test"},
    "patterns.steps": 3,
}


def tiles(image):
    rows, cols = image.shape
    return image.reshape(rows // 10, 10, cols // 10, 10).mean(axis=(1, 3))


def white_with_and_without(mi, experiment):
    from twin.optics.bounces import Bounces
    from twin.optics.one_trace import trace_stack
    from twin.optics.photons import StageLight, map_photons, trace_photons
    from twin.optics.scene import rig_of

    rig = rig_of(experiment)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns)
    scene, surfaces = clear_scene(mi, ball())
    light = StageLight(
        map_photons(trace_photons(scene, surfaces, rig, count=1_000_000, seed=9), tables)
    )
    bounces = Bounces(0, paths=8, seed=10, surfaces=surfaces, stage_light=light)
    white = patterns.index("white").start
    bare = mi.load_dict({"type": "scene", "stage": stage_of(mi)}, optimize=False)
    return (
        trace_stack(scene, rig, tables, 16, bounces=bounces)[white],
        trace_stack(bare, rig, tables, 16)[white],
    )


def lamp_with_and_without(mi, experiment, runs):
    """Images of stock with the ball, its mirror images of the lamp subtracted, and without it."""
    from twin.optics.rig import perspective_sensor
    from twin.optics.scene import rig_of

    camera = rig_of(experiment).camera
    place = mi.ScalarTransform4f().translate([0, 0, 60.0])
    black = stage_of(mi) | {"bsdf": {"type": "diffuse", "reflectance": 0.0}}

    def images(shapes, seeds):
        scene = {
            "type": "scene",
            # ball, ball, stage, ball, ball, lamp, and one reflection inside a ball
            "integrator": {"type": "path", "max_depth": 8, "rr_depth": 100},
            "lamp": {
                "type": "disk",
                "to_world": place.scale([3.0, 3.0, -1.0]),
                "emitter": {"type": "area", "radiance": {"type": "spectrum", "value": 1.0}},
            },
            "sensor": perspective_sensor(camera.pinhole, camera.T_world_from_device, 512),
        }
        loaded = mi.load_dict(scene | shapes)
        return [np.array(mi.render(loaded, seed=seed))[:, :, 0] for seed in seeds]

    mirrored = np.mean(images({"stage": black, "body": ball()}, range(200, 203)), axis=0)
    with_ball = images({"stage": stage_of(mi), "body": ball()}, range(runs))
    (bare,) = images({"stage": stage_of(mi)}, [100])
    return [image - mirrored for image in with_ball], bare
