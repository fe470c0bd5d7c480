"""Light between surfaces against stock Mitsuba's path tracer, and against a closed form."""

import numpy as np
import pytest
import trimesh
from scipy import stats

from tests.optics.scenes import coated_scene
from twin.config import load_experiment
from twin.optics.light import light_tables, pattern_set

RUNS = 8


@pytest.fixture(scope="module")
def corner(grid_face):
    """Return a floor with a wall of 6 mm: light is reflected repeatedly in the corner."""
    floor = grid_face(lambda x, _: 0.0 * x, lambda x, _: (0.0 * x, 0.0 * x), pitch_mm=1.0)
    wall = trimesh.creation.box(extents=[1.0, 20.0, 6.0])
    wall.apply_translation([-3.0, 0.0, 3.0])
    both = trimesh.util.concatenate([floor, wall])
    # flat shading of the box: one normal per corner and face
    both.unmerge_vertices()
    both.vertex_normals = np.repeat(both.face_normals, 3, axis=0)
    return both


@pytest.fixture(scope="module")
def experiment():
    return load_experiment(
        "examples/slab_balls",
        {
            "projector.width_px": 320,
            "projector.height_px": 180,
            "camera.width_px": 40,
            "camera.height_px": 30,
            "camera.pixel_pitch_um": {"value": 216.0, "source": "test"},
            "coating.base_albedo": 0.8,
            "coating.flake_fraction": 0.3,
            "patterns.axes": ["column"],
        },
    )


@pytest.mark.parametrize("most", [1, 3])
def test_bounces_equal_the_stock_path_tracer(mi, experiment, corner, most):
    """Setup: rough metal flakes and white ink in a corner, one phase frame, 8 runs of each.

    Expected: Welch's t over the runs per pixel exceeds its 1 % quantile on 1 % of the pixels, and
    the two mean images agree within 4 standard errors.
    """
    from twin.optics import stock
    from twin.optics.bounces import Bounces
    from twin.optics.materials import coated_mesh
    from twin.optics.one_trace import trace_stack
    from twin.optics.rig import perspective_sensor
    from twin.optics.scene import rig_of

    rig = rig_of(experiment)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns)
    index = patterns.index("phase", "column").start + 5
    own_scene = coated_scene(experiment, corner)
    ours = np.stack(
        [
            trace_stack(
                own_scene,
                rig, tables, 256, bounces=Bounces(most, paths=1, seed=seed),
            )[index]
            for seed in range(RUNS)
        ]
    )  # fmt: skip
    direct = trace_stack(own_scene, rig, tables, 256)[index]
    canvas = stock.canvas_for(rig, "projector", texels_per_px=16)
    texture = stock.frame_texture(patterns.frames[index], index, rig, tables, canvas)
    scene = stock.frame_scene(
        coated_mesh(corner, experiment.coating.bsdf()),
        stock.emitter_dict(texture, rig, canvas),
        perspective_sensor(rig.camera.pinhole, rig.camera.T_world_from_device, 256),
        bounces=most,
    )
    theirs = np.stack([stock.render_frame(scene, seed) for seed in range(RUNS)])
    assert (ours.mean() - direct.mean()) > 0.02 * direct.mean()  # there is light to compare
    both_errors = np.hypot(stats.sem(ours, axis=0), stats.sem(theirs, axis=0))
    # Our direct part has no jitter noise, but 16 x 16 points miss up to 1/32 of a pixel on edges,
    # which 5 % of the pixels are: up to 1.6e-3 of the mean if all errors had the same sign.
    t = (ours.mean(axis=0) - theirs.mean(axis=0)) / np.hypot(both_errors, 1e-3 * theirs.mean())
    assert np.mean(np.abs(t) > stats.t.ppf(0.995, RUNS - 1)) < 0.025
    error = np.sqrt(np.sum(both_errors**2)) / both_errors.size
    assert abs(ours.mean() - theirs.mean()) < 4 * error + 1e-3 * theirs.mean()


def test_a_plane_reflects_nothing_onto_itself(mi, experiment, plane):
    from twin.optics.bounces import Bounces
    from twin.optics.one_trace import trace_stack
    from twin.optics.scene import rig_of

    rig, scene = rig_of(experiment), coated_scene(experiment, plane)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns)
    direct = trace_stack(scene, rig, tables, 4)
    with_bounces = trace_stack(scene, rig, tables, 4, bounces=Bounces(4, paths=4, seed=1))
    for without, bounced in zip(direct, with_bounces, strict=True):
        np.testing.assert_array_equal(without, bounced)
