"""Stock Mitsuba's `thinlens` as oracle of the depth of field.

Setup: a fringed plane in the focal plane and, 8 mm above it, the oblique edge of a second sheet,
before the plane in one half of the image and before no surface in the other: blur circles of 6 px,
occlusion within the lens, fringes out of focus.
Stock Mitsuba renders frames with `thinlens` and `direct`, 24 independent runs of 16 samples.
Expected: per pixel, (one-trace - mean of runs) / standard error follows Student's t with 23 degrees
of freedom; fitted to the runs, the radius of the lens is the stated one within its own error.
Why: the oracle draws points on its lens at random, the twin has a fixed set: a set that is unevenly
spread, correlated with the sub-pixel grid, or a wrong radius or focus moves the t values.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy import stats

from tests.optics.scenes import coated_scene
from twin.config import load_experiment
from twin.optics.light import light_tables, pattern_set

RUNS, SAMPLES, OURS = 24, 16, 576


@pytest.fixture(scope="module")
def experiment():
    return load_experiment(
        "examples/slab_balls",
        {
            "camera.depth_of_field": True,
            "camera.f_number": {"value": 2.8, "source": "test"},
            "camera.width_px": 80,
            "camera.height_px": 56,
            "camera.pixel_pitch_um": {"value": 36.0, "source": "test"},
            "projector.width_px": 320,
            "projector.height_px": 180,
            "patterns.period_px": {"value": 10.0, "source": "test"},
            "patterns.steps": 3,
            "patterns.code": "gray",
        },
    )


@pytest.fixture(scope="module")
def two_sheets(grid_face):
    """Return half a plane and an oblique sheet above its left part, towards the camera."""
    flat = (lambda x, _: (0.0 * x, 0.0 * x), 16.0, 12.5, 2.0)
    plane, sheet = (grid_face(lambda x, _, z=z: z + 0.0 * x, *flat) for z in (0.0, 8.0))
    plane.apply_translation([0.0, -12.5, 0.0])
    turn = trimesh.transformations.rotation_matrix(0.3, [0, 0, 1])
    turn[0, 3] = -16.0
    sheet.apply_transform(turn)
    both = trimesh.util.concatenate([plane, sheet])
    both.vertex_normals = np.tile([0.0, 0.0, 1.0], (len(both.vertices), 1))
    return both


@pytest.fixture(scope="module")
def coated_sheets(mi, experiment, two_sheets):
    """Return both sheets as a mesh for stock scenes."""
    from twin.optics.materials import coated_mesh

    return coated_mesh(two_sheets, experiment.coating.bsdf())


@pytest.fixture(scope="module")
def setting(mi, experiment, two_sheets):
    """Return the scene, the rig, the sequence and its light."""
    from twin.optics.scene import rig_of

    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns)
    return coated_scene(experiment, two_sheets), rig_of(experiment), patterns, tables


@pytest.fixture(scope="module")
def one_trace(setting):
    """Return all frames of the one-trace renderer, by the factor that its lens is larger."""
    from twin.optics.one_trace import trace_stack

    scene, rig, _, tables = setting

    def frames(scale):
        lens = replace(rig.camera.lens, radius_mm=scale * rig.camera.lens.radius_mm)
        return trace_stack(scene, replace(rig, camera=replace(rig.camera, lens=lens)), tables, OURS)

    return {scale: frames(scale) for scale in (1.0, 1.1)}


@pytest.mark.parametrize(("kind", "axis"), [("phase", "column"), ("white", None)])
def test_stock_thin_lens_renders_the_same_frame(setting, one_trace, coated_sheets, kind, axis):
    from twin.optics import stock
    from twin.optics.rig import perspective_sensor

    _, rig, patterns, tables = setting
    index = patterns.index(kind, axis).start
    canvas = stock.canvas_for(rig, "projector", texels_per_px=16)
    texture = stock.frame_texture(patterns.frames[index], index, rig, tables, canvas)
    pinhole, lens = rig.camera.pinhole, rig.camera.lens
    sensor = perspective_sensor(pinhole, rig.camera.T_world_from_device, SAMPLES, lens)
    assert sensor["type"] == "thinlens"
    scene = stock.frame_scene(
        coated_sheets,
        stock.emitter_dict(texture, rig, canvas),
        sensor,
    )
    runs = np.stack([stock.render_frame(scene, seed) for seed in range(RUNS)])

    ours, error = one_trace[1.0][index], stats.sem(runs, axis=0)
    # Bilinear canvas 5e-4; a pixel half on an edge is known to about 2 / 576 from 576 places.
    tolerance = 5e-4 * runs.mean() + 4e-3 * np.minimum(error / error.max(), 1.0) * runs.max()
    difference = ours - runs.mean(axis=0)
    t = difference / np.hypot(error, tolerance)
    assert np.mean(np.abs(t) > stats.t.ppf(1 - 0.005, RUNS - 1)) < 0.014  # 1 % and 3 binomial sd
    mean_error = np.sqrt(np.sum(error**2)) / error.size
    assert abs(difference.mean()) < 4 * mean_error + 5e-4 * runs.mean()
    # Least squares for the radius: difference = slope (1 - radius), slope by a lens 10 % larger.
    # All pixels weigh the same: where few rays hit, the runs' error is small because they missed.
    slope = (one_trace[1.1][index] - ours) / 0.1
    known = np.sum(slope**2)
    radius = 1.0 - np.sum(slope * difference) / known
    radius_error = np.sqrt(np.sum((slope * error) ** 2)) / known
    assert radius_error < 0.01
    assert abs(radius - 1.0) < 4 * radius_error
