"""Stock Mitsuba as oracle: one `direct` render per frame equals the one-trace renderer.

Setup: a bump under the paper's rig with a coarse projector (so that every frame has structure),
off-axis principal point, rough flakes; camera and shadow rays are marched over its heights. Stock
Mitsuba renders each frame with its own `projector` or `spot` emitter, 24 independent runs of 16
jittered samples.
Expected: per pixel, (one-trace - mean of runs) / standard error follows Student's t with 15
degrees of freedom; the mean over all pixels is zero within its own error plus the canvas' bilinear
look-up (5e-4).
Why: both integrate the same radiance over the same pixel box; any difference in geometry, falloff,
BSDF, pattern or radiometry moves the t values.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from tests.optics.scenes import coated_scene
from twin.config import load_experiment
from twin.optics.light import light_tables, pattern_set

RUNS, SAMPLES = 24, 16
CASES = [
    ("projector", "phase", "column", 7),
    ("projector", "phase", "row", 3),
    ("projector", "gray", "row", 2),
    ("projector", "white", None, 0),
    ("projector", "black", None, 0),
    ("spot", "phase", "column", 7),
    ("spot", "gray", "row", 2),
]


@pytest.fixture(scope="module")
def experiment():
    return load_experiment(
        "examples/slab_balls",
        {
            "projector.width_px": 320,
            "projector.height_px": 180,
            "camera.width_px": 120,
            "camera.height_px": 92,
            "camera.pixel_pitch_um": {"value": 72.0, "source": "test"},
            "render.samples": 256,
        },
    )


@pytest.fixture(scope="module")
def one_trace(mi, experiment, bump):
    """The rig, the sequence and all frames of the one-trace renderer, 16 x 16 samples."""
    from twin.optics.one_trace import trace_stack
    from twin.optics.scene import coated_rig

    rig = replace(coated_rig(experiment, bump), shadows=True)
    assert rig.heights is not None
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns)
    scene = coated_scene(experiment, bump)
    return rig, patterns, tables, trace_stack(scene, rig, tables, experiment.render.samples)


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(map(str, case)))
def test_stock_mitsuba_renders_the_same_frame(experiment, one_trace, bump, case):
    from twin.optics import stock
    from twin.optics.materials import coated_mesh
    from twin.optics.rig import perspective_sensor

    emitter, kind, axis, number = case
    rig, patterns, tables, frames = one_trace
    index = patterns.index(kind, axis).start + number
    canvas = stock.canvas_for(rig, emitter, texels_per_px=16 if emitter == "projector" else 8)
    texture = stock.frame_texture(patterns.frames[index], index, rig, tables, canvas)
    scene = stock.frame_scene(
        coated_mesh(bump, experiment.coating.bsdf()),
        stock.emitter_dict(texture, rig, canvas),
        perspective_sensor(rig.camera.pinhole, rig.camera.T_world_from_device, SAMPLES),
    )
    runs = np.stack([stock.render_frame(scene, seed) for seed in range(RUNS)])

    error = stats.sem(runs, axis=0)
    tolerance = 5e-4 * runs.mean()  # bilinear canvas
    difference = frames[index] - runs.mean(axis=0)
    t = difference / np.hypot(error, tolerance)
    outside = np.mean(np.abs(t) > stats.t.ppf(1 - 0.005, RUNS - 1))
    assert outside < 0.013  # 1 % by definition of the quantile; binomial sd on 11040 pixels: 0.1 %
    # One ray in a million slips between two facets, in either renderer (float32): 1 of 256 samples
    # lost on a pixel is a difference of 0.4 %, however small the jitter's error is there.
    beyond = np.abs(t) > stats.t.ppf(1 - 0.5 * 1e-3 / t.size, RUNS - 1)
    assert beyond.sum() <= 3
    assert np.all(np.abs(difference[beyond]) < 3 / 256 * runs.max())
    mean_error = np.sqrt(np.sum(error**2)) / error.size
    assert abs(difference.mean()) < 4 * mean_error + tolerance
