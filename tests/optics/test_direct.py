"""The bare specimen on its stage: metal balls against stock Mitsuba, and invalid requests."""

import numpy as np
import pytest
from scipy import stats

from reconstruction.errors import InputError
from twin.config import load_experiment
from twin.optics.light import light_tables, pattern_set

RUNS = 6
SMALL = {
    "modality": "direct_fpp",
    "projector.width_px": 320,
    "projector.height_px": 180,
    "camera.width_px": 40,
    "camera.height_px": 30,
    "camera.pixel_pitch_um": {"value": 216.0, "source": "test"},
    "patterns.steps": 3,
    "patterns.axes": ["column"],
}


def direct(roughness=0.4, **settings):
    metal = {"specimen.material.roughness": {"value": roughness, "source": "test"}}
    return load_experiment("examples/slab_balls", SMALL | metal | settings)


@pytest.mark.parametrize("roughness", [0.4, 0.2], ids=["rough", "polished"])
def test_metal_balls_on_a_stage_equal_the_stock_path_tracer(mi, roughness):
    """Setup: two joined steel balls on a matte stage, one phase frame, 6 runs of each renderer.

    `rough` metal is connected to the projector, light off `polished` metal is traced as photons.
    Stock counts every reflection: its limit is high enough, and the stage's albedo is 0.35.
    Expected: Welch's t per pixel exceeds its 1 % quantile on 1 % of the pixels, the means agree
    within 4 standard errors and 0.2 %.
    """
    from twin.optics import stock
    from twin.optics.direct import direct_scene
    from twin.optics.rig import perspective_sensor
    from twin.optics.scene import rig_of
    from twin.pipeline import Memory, render_bare

    settings = {"render.samples": 256, "render.bounce_paths": 1, "render.bounces": 6}
    settings["render.photons"] = 500_000
    experiment = direct(roughness, **settings)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    index = patterns.index("phase", "column").start + 1
    memory = Memory()  # the specimen is loaded once
    runs = [experiment.model_copy(update={"seed": seed}) for seed in range(RUNS)]
    ours = np.stack([render_bare(run, memory=memory).frames[index] for run in runs])
    rig = rig_of(experiment)
    tables = light_tables(experiment.projector, patterns)
    canvas = stock.canvas_for(rig, "projector", texels_per_px=16)
    texture = stock.frame_texture(patterns.frames[index], index, rig, tables, canvas)
    shapes = {shape.id(): shape for shape in direct_scene(experiment).scene.shapes()}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 8, "rr_depth": 9},
            "emitter": stock.emitter_dict(texture, rig, canvas),
            "sensor": perspective_sensor(rig.camera.pinhole, rig.camera.T_world_from_device, 512),
            **shapes,
        },
        optimize=False,
    )
    theirs = np.stack([stock.render_frame(scene, seed) for seed in range(RUNS)])
    both_errors = np.hypot(stats.sem(ours, axis=0), stats.sem(theirs, axis=0))
    # 16 x 16 fixed points miss up to 1/32 of a pixel on edges; the photon map blurs by 0.06 mm.
    t = (ours.mean(axis=0) - theirs.mean(axis=0)) / np.hypot(both_errors, 4e-3 * theirs.mean())
    assert np.mean(np.abs(t) > stats.t.ppf(0.995, RUNS - 1)) < 0.03
    error = np.sqrt(np.sum(both_errors**2)) / both_errors.size
    assert abs(ours.mean() - theirs.mean()) < 4 * error + 2e-3 * theirs.mean()


def test_bright_end_is_stable_between_seeds(mi):
    """No fireflies: 99.99th percentiles of the white frame agree within 10 %, default samples."""
    from twin.pipeline import Memory, render_bare

    film = {"camera.width_px": 300, "camera.height_px": 220, "patterns.steps": 3}
    fine = film | {"camera.pixel_pitch_um": {"value": 29.0, "source": "test"}}
    experiment = direct(0.1, **fine)
    white = pattern_set(experiment.projector, experiment.patterns).index("white").start
    memory = Memory()
    runs = [experiment.model_copy(update={"seed": seed}) for seed in (1, 2)]
    first, second = (
        np.percentile(render_bare(run, memory=memory).frames[white], 99.99) for run in runs
    )
    assert first == pytest.approx(second, rel=0.1)


def test_truth_distinguishes_specimen_and_stage(mi):
    from twin.optics.direct import AIR_GAP_MM
    from twin.pipeline import render_bare

    truth = render_bare(direct(**{"render.samples": 1, "render.bounce_paths": 1})).truth
    z_mm = truth.points_world_mm[..., 2]
    assert truth.measured.any()
    assert not truth.measured.all()
    assert z_mm[truth.measured].max() <= 1e-3
    np.testing.assert_allclose(z_mm[~truth.measured], -8.0 - AIR_GAP_MM, atol=1e-3)


def test_same_seed_same_bytes(mi):
    from twin.pipeline import render_bare

    experiment = direct(0.1, **{"render.photons": 50_000})
    first, second = (render_bare(experiment).frames for _ in range(2))
    for frame, repeated in zip(first, second, strict=True):
        np.testing.assert_array_equal(frame, repeated)


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("examples/starter", {}, "specimen.material: found none for"),
        ("examples/slab_balls", {"render.engine": "stock"}, "render.engine: found 'stock'"),
        ("paper/brick", {"projector.aperture_mm": 4.0}, "projector.aperture_mm: found 4"),
    ],
)
def test_unsupported_specimens_are_rejected(mi, name, settings, message):
    from twin.pipeline import render_bare

    with pytest.raises(InputError, match=message):
        render_bare(load_experiment(name, SMALL | settings))


def test_another_pose_of_the_rig_uses_the_same_kernels(mi):
    """Expected: every kernel of the second rig is in the cache, whatever its numbers."""
    import drjit as dr

    from twin.pipeline import Memory, render_bare

    first = load_experiment("examples/gauges", SMALL)
    moved = {"projector.pose.polar_deg": 21.5, "camera.pose.standoff_mm": 240.0}
    second = load_experiment("examples/gauges", SMALL | moved)
    before = render_bare(first, memory=Memory()).frames[0]
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        after = render_bare(second, memory=Memory()).frames[0]
        history = dr.kernel_history([dr.KernelType.JIT])
    assert len(history) > 0
    assert [kernel["hash"] for kernel in history if not kernel["cache_hit"]] == []
    assert not np.array_equal(before, after)


def test_nothing_is_traced_where_nothing_is_reflected_again():
    """Expected: matte parts without bounces have no indirect light; polished ones always have."""
    from twin.optics.session import renderer_session

    with renderer_session():
        from twin.pipeline import trace

    for settings, has_light in (
        ({"render.bounces": 0}, False),
        ({"render.bounces": 1}, True),
        ({"render.bounces": 0, "roughness": 0.05}, True),
    ):
        roughness = settings.pop("roughness", 0.4)
        experiment = direct(roughness, **settings)
        geometry = trace.load_bare(experiment)
        indirect = trace.bounces_of(experiment, geometry, None, {})
        assert (indirect is not None) == has_light
