"""The coat's reflectance against closed forms, and sweeps of it on a loaded scene."""

import gc
from itertools import product

import numpy as np
import pytest

from reconstruction.errors import InputError
from tests.optics.scenes import coated_scene
from twin.config import load_experiment
from twin.optics.light import light_tables, pattern_set

ANGLES = np.deg2rad([0.0, 30.0, 60.0, 80.0])
MATTE, BINDERS = 1.0, (1.2, 1.4, 1.6)


@pytest.fixture(scope="module")
def experiment():
    return load_experiment(
        "examples/slab_balls",
        {
            "projector.width_px": 320,
            "projector.height_px": 180,
            "camera.width_px": 96,
            "camera.height_px": 72,
            "camera.pixel_pitch_um": {"value": 90.0, "source": "test"},
            "patterns.steps": 3,
            "patterns.period_px": 64,
            "patterns.code": "gray",
        },
    )


@pytest.fixture(scope="module")
def coated(experiment):
    """Return a builder of coatings that differ from the experiment's."""

    def build(albedo=0.4, flakes=0.15, binder=MATTE, roughness=0.1, flake_roughness=0.4):
        changes = {
            "base_albedo": albedo,
            "flake_fraction": flakes,
            "flake_roughness": flake_roughness,
            "binder_ior": binder,
            "binder_roughness": roughness,
        }
        return experiment.coating.model_copy(update=changes)

    return build


def tables_of(experiment):
    patterns = pattern_set(experiment.projector, experiment.patterns)
    return light_tables(experiment.projector, patterns)


def bsdf_of(mi, coating):
    return mi.load_dict(coating.bsdf())


def square(side):
    """Stratified points of the unit square, (side * side,) each."""
    u, v = np.meshgrid((np.arange(side) + 0.5) / side, (np.arange(side) + 0.5) / side)
    return u.ravel(), v.ravel()


def seen_at(mi, angles, points):
    """Hits with the camera direction tilted by each angle, `points` times."""
    hit, angle = mi.SurfaceInteraction3f(), np.repeat(angles, points)
    hit.wi = mi.Vector3f(np.sin(angle), 0.0 * angle, np.cos(angle))
    return hit


def sampled_reflectance(mi, bsdf, side=96):
    """Directional-hemispherical reflectance at `ANGLES`: mean weight of BSDF sampling."""
    u, v = (np.tile(axis, len(ANGLES)) for axis in square(side))
    lobe = np.random.default_rng(3).random(u.size)
    hit = seen_at(mi, ANGLES, side * side)
    _, weight = bsdf.sample(mi.BSDFContext(), hit, mi.Float(lobe), mi.Point2f(u, v), True)
    return np.array(weight[0]).reshape(len(ANGLES), -1).mean(axis=1)


def diffuse_reflectance(mi, bsdf, angles, side=48):
    """Directional-hemispherical reflectance of the diffuse part, by cosine-weighted quadrature."""
    u, v = (np.tile(axis, len(angles)) for axis in square(side))
    out, context = mi.warp.square_to_cosine_hemisphere(mi.Point2f(u, v)), mi.BSDFContext()
    context.type_mask = int(mi.BSDFFlags.DiffuseReflection)
    value = np.array(bsdf.eval(context, seen_at(mi, angles, side * side), out)[0])
    return (np.pi * value / np.array(out.z)).reshape(len(angles), -1).mean(axis=1)


def fresnel(cos_angle, ior):
    """Fresnel's reflectance of a dielectric from outside, unpolarised."""
    cos_inside = np.sqrt(1.0 - (1.0 - cos_angle**2) / ior**2)
    s = (cos_angle - ior * cos_inside) / (cos_angle + ior * cos_inside)
    p = (ior * cos_angle - cos_inside) / (ior * cos_angle + cos_inside)
    return 0.5 * (s**2 + p**2)


def saunderson(albedo, ior, angles):
    """Reflectance of pigment under a smooth binder, with all internal reflections.

    Saunderson (1942): (1 - F(angle)) (1 - F_in) albedo / (1 - albedo F_in), where the diffuse
    internal reflectance follows from the external one by 1 - F_in = (1 - F_out) / ior^2.
    """
    cosines = (np.arange(4000) + 0.5) / 4000
    leaves = (1.0 - np.mean(2.0 * cosines * fresnel(cosines, ior))) / ior**2
    enters = 1.0 - fresnel(np.cos(angles), ior)
    return enters * leaves * albedo / (1.0 - albedo * (1.0 - leaves))


@pytest.mark.parametrize("binder", [MATTE, *BINDERS])
def test_the_coat_reflects_no_more_than_it_receives(mi, coated, binder):
    """White furnace over the whole range; 2e-3 is the noise of 9216 samples of the lobe's choice.

    Expected besides: a matte coat without flakes reflects its albedo at every angle, and one under
    a binder less than Saunderson's value for a smooth binder plus the Fresnel reflectance.
    """
    corners = product([0.05, 0.5, 0.9], [0.0, 0.5], [0.02, 0.3], [0.05, 1.0])
    for albedo, flakes, roughness, flake_roughness in corners:
        if binder == MATTE and roughness != 0.02:
            continue
        coating = coated(albedo, flakes, binder, roughness, flake_roughness)
        reflectance = sampled_reflectance(mi, bsdf_of(mi, coating))
        assert np.all(reflectance <= 1.0 + 2e-3)
        assert np.all(reflectance > 0.0)
        if flakes == 0.0 and binder == MATTE:
            np.testing.assert_allclose(reflectance, albedo, rtol=1e-5)


def test_the_loss_of_a_rough_binder_is_as_documented(mi, coated):
    """White furnace on a white pigment, index 1.5, at `ANGLES`: the table of docs/coatings.md.

    0.9 %: rounding to whole per cents, and the noise of 9216 samples of the lobe's choice.
    """
    stated = {0.02: (3, 3, 2, 2), 0.1: (9, 9, 9, 12), 0.2: (20, 21, 22, 24), 0.3: (31, 31, 33, 36)}
    for roughness, percent in stated.items():
        white = bsdf_of(mi, coated(1.0, 0.0, 1.5, roughness))
        lost = 100.0 * (1.0 - sampled_reflectance(mi, white))
        np.testing.assert_allclose(lost, percent, atol=0.9)


@pytest.mark.parametrize("binder", BINDERS)
@pytest.mark.parametrize("albedo", [0.05, 0.5, 0.9])
def test_a_smooth_binder_darkens_the_pigment_by_saundersons_law(mi, coated, albedo, binder):
    """Expected: the closed form to 2.5 %, its own sharpest face of 0.02.

    Why 2.5 %: Mitsuba integrates the internal reflectance numerically (0.4 % off), which an albedo
    of 0.9 enlarges by up to 1 / (1 - albedo F_in) = 2.3 and the face's roughness adds to. Rougher
    faces only lose more: never brighter than the closed form by more than that quadrature's 0.5 %.
    """
    angles = ANGLES[:3]
    expected = saunderson(albedo, binder, angles)
    reflectance = [
        diffuse_reflectance(mi, bsdf_of(mi, coated(albedo, 0.0, binder, roughness)), angles)
        for roughness in (0.02, 0.1, 0.3)
    ]
    np.testing.assert_allclose(reflectance[0], expected, rtol=0.025)
    assert np.all(np.array(reflectance) <= 1.005 * expected)


@pytest.mark.parametrize("binder", [MATTE, *BINDERS])
def test_the_coat_is_reciprocal(mi, coated, binder):
    """f(wi, wo) = f(wo, wi) for 1000 pairs of directions up to 84 degrees, flakes included."""
    bsdf = bsdf_of(mi, coated(0.6, 0.3, binder))
    rng = np.random.default_rng(5)
    cosine, azimuth = rng.uniform(0.1, 1.0, (2, 1000)), rng.uniform(0, 2 * np.pi, (2, 1000))
    sine = np.sqrt(1 - cosine**2)
    first, second = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=1)

    def reflected(wi, wo):
        hit = mi.SurfaceInteraction3f()
        hit.wi = mi.Vector3f(wi)
        return np.array(bsdf.eval(mi.BSDFContext(), hit, mi.Vector3f(wo))[0]) / wo[2]

    np.testing.assert_allclose(reflected(first, second), reflected(second, first), rtol=2e-4)


def test_a_sweep_on_one_scene_equals_fresh_scenes(mi, experiment, coated, bump):
    """Matte, binder, binder, matte: every frame byte for byte, by patches traced once per coat."""
    from twin.optics.one_trace import trace_stack, trace_truth
    from twin.optics.scene import coated_rig

    coatings = [
        coated(albedo=0.05, flakes=0.5),
        coated(binder=1.4),
        coated(albedo=0.9, flakes=0.0, binder=1.6, roughness=0.3),
        coated(flake_roughness=0.2),
    ]
    from twin.pipeline import trace

    tables = tables_of(experiment)
    geometry = trace.load_face(experiment, bump)
    view = trace.view_of(experiment, geometry)
    for coating in coatings:
        changed = experiment.model_copy(update={"coating": coating})
        traced = trace.Traced(trace.patches_of(changed, geometry, view), None, tables)
        swept = trace.light(changed, geometry, view, traced, lambda _: None)
        scene, rig = coated_scene(changed, bump), coated_rig(changed, bump)
        fresh = trace_stack(scene, rig, tables, experiment.render.samples)
        for frame, expected in zip(swept.frames, fresh, strict=True):
            assert frame.tobytes() == expected.tobytes()
    truth = trace_truth(scene, rig)
    assert view.truth.points_world_mm.tobytes() == truth.points_world_mm.tobytes()
    assert view.truth.lit.tobytes() == truth.lit.tobytes()


@pytest.mark.parametrize("binder", [MATTE, 1.4])
def test_another_coating_needs_neither_geometry_nor_kernel(mi, experiment, coated, bump, binder):
    """Four coatings cause no new scene and no four kernels.

    Two kernels are allowed: a kernel calls every BSDF that is alive, and those of other tests may
    be deleted meanwhile. Coatings compiled in as literals would give four.
    """
    import drjit as dr

    from twin.optics.one_trace import trace_stack
    from twin.optics.scene import rig_of

    tables = tables_of(experiment)
    gc.collect()  # deleting a scene of another test meanwhile would change the kernels
    scene = coated_scene(
        experiment.model_copy(update={"coating": coated(0.3, binder=binder)}), bump
    )
    trace_stack(scene, rig_of(experiment), tables, 1)  # a scene's first trace has its own kernel
    kernels = []
    for albedo, flakes in ((0.3, 0.15), (0.05, 0.0), (0.7, 0.5), (0.9, 0.1)):
        coating = coated(albedo, flakes, binder, flake_roughness=0.1 + flakes)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(mi, "load_dict", None)  # loading raises an error
            scene.set_coating(coating)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            trace_stack(scene, rig_of(experiment), tables, 1)
            history = dr.kernel_history([dr.KernelType.JIT])
            kernels.append(tuple(entry["hash"] for entry in history))
    assert kernels[0]
    assert len(set(kernels)) <= 2


def test_export_writes_the_same_coat(mi, experiment, coated, plane, tmp_path):
    """The BSDF of the exported scene equals the renderer's at 500 pairs of directions."""
    from twin.optics.export import export_stock

    coating = coated(0.7, 0.2, 1.45, 0.2)
    export_stock(experiment.model_copy(update={"coating": coating}), plane, tmp_path)
    exported = mi.load_file(str(tmp_path / "scene.xml"), optimize=False).shapes()[0].bsdf()
    rng, hit = np.random.default_rng(7), mi.SurfaceInteraction3f()
    hit.wi = mi.warp.square_to_uniform_hemisphere(mi.Point2f(rng.random((2, 500))))
    out = mi.warp.square_to_uniform_hemisphere(mi.Point2f(rng.random((2, 500))))
    own, theirs = (
        np.array(bsdf.eval(mi.BSDFContext(), hit, out)[0])
        for bsdf in (bsdf_of(mi, coating), exported)
    )
    np.testing.assert_allclose(theirs, own, rtol=1e-6)


def test_a_binder_in_a_gel_is_at_least_as_dense(mi, experiment, coated):
    """In a gel of index 1.4: binder 1.4 has no interface, 1.3 is rejected, matte is unchanged."""
    from twin.config.layers import Layer
    from twin.optics.scene import coating_in_layer

    gel = {"gel": Layer(bottom_mm=0.0, thickness_mm=2.0, ior=1.4)}

    def in_gel(binder):
        changes = {"coating": coated(binder=binder), "layers": gel}
        return coating_in_layer(experiment.model_copy(update=changes)).binder_ior

    assert (in_gel(1.0), in_gel(1.4), in_gel(1.54)) == (1.0, 1.0, pytest.approx(1.1))
    with pytest.raises(InputError, match="binder_ior"):
        in_gel(1.3)
