"""Dots printed on a coat in the frames of a fringe projection: reflectance, area, places, light."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.ndimage import maximum_filter, minimum_filter

from reconstruction.markers import find_pattern
from twin.config import load_experiment
from twin.config.lamps import Markers
from twin.mechanics.relief import MATERIAL_MM
from twin.optics.export import export_stock
from twin.optics.light import light_tables, pattern_set
from twin.pipeline import render

SMALL = {
    "projector.width_px": 320,
    "projector.height_px": 180,
    "camera.width_px": 160,
    "camera.height_px": 120,
    "camera.pixel_pitch_um": {"value": 54.0, "source": "test"},
    "render.samples": 25,
    "patterns.steps": 3,
}
DOTS = Markers(pitch_x_mm=2.4, pitch_y_mm=2.0, radius_mm=0.6, relative_albedo=0.2)
RUNS, SAMPLES = 12, 16


def with_dots(experiment, dots=DOTS):
    photometric = experiment.photometric.model_copy(update={"markers": dots})
    return experiment.model_copy(update={"photometric": photometric})


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("examples/slab_balls", SMALL)


@pytest.fixture(scope="module")
def flat(mi, experiment, plane):
    """Return the stacks on a flat coat without and with dots."""
    return render(experiment, plane), render(with_dots(experiment), plane)


def moved(face, displaced):
    """Return a copy of a face with material coordinates: place minus displacement (x, y)."""
    face = face.copy()
    x, y = face.vertices[:, :2].T
    material = np.stack(np.subtract((x, y), displaced(x, y)), axis=-1)
    face.vertex_attributes[MATERIAL_MM] = material
    return face


def test_a_dot_multiplies_every_frame_by_its_reflectance(flat):
    """Expected: the closed form r inside and 1 outside, 3e-4, in phase, Gray and white frames."""
    bare, dotted = flat
    x, y = np.moveaxis(bare.truth.points_world_mm[..., :2], -1, 0)
    away = [
        at - np.round(at / pitch) * pitch
        for at, pitch in ((x, DOTS.pitch_x_mm), (y, DOTS.pitch_y_mm))
    ]
    distance_mm, pixel_mm = np.hypot(*away), 1.5 * np.abs(np.diff(x[60])).max()
    inside, outside = (
        distance_mm < DOTS.radius_mm - pixel_mm,
        (distance_mm > DOTS.radius_mm + pixel_mm),
    )
    assert inside.sum() > 1000
    for before, after in zip(bare.frames, dotted.frames, strict=True):
        lit = before > 0.02 * bare.frames[-2].max()
        np.testing.assert_allclose((after / before)[inside & lit], DOTS.relative_albedo, rtol=3e-4)
        np.testing.assert_allclose((after / before)[outside & lit], 1.0, rtol=3e-4)


def test_the_dots_cover_their_area(flat, experiment):
    """Expected: over whole cells of the lattice, pi r^2 / pitch^2 of the coat, 1 %."""
    bare, dotted = flat
    white = pattern_set(experiment.projector, experiment.patterns).index("white", None).start
    share = (1.0 - dotted.frames[white] / bare.frames[white]) / (1.0 - DOTS.relative_albedo)
    points_mm = bare.truth.points_world_mm.astype(np.float64)
    down, right = np.gradient(points_mm, axis=(0, 1))
    area_mm2 = np.abs(np.cross(down, right)[..., 2])
    halves = 2.5 * DOTS.pitch_x_mm, 2.5 * DOTS.pitch_y_mm
    cells = (np.abs(points_mm[..., :2]) < halves).all(axis=-1)
    # Between the dots at the border of the cells the share is 0.
    covered = np.sum((share * area_mm2)[cells]) / (4.0 * halves[0] * halves[1])
    expected = np.pi * DOTS.radius_mm**2 / (DOTS.pitch_x_mm * DOTS.pitch_y_mm)
    assert covered == pytest.approx(expected, rel=0.01)


def test_dots_move_with_the_material(mi, experiment, plane):
    """Setup: a coat stretched by 4 % along x and displaced by 0.3 mm along y.

    Expected: in the white frame, centres at the displaced places, 0.05 px RMS.
    """
    from twin.optics.scene import coated_rig

    face = moved(plane, lambda x, y: (0.04 / 1.04 * x, 0.3 + 0.0 * y))
    dotted = with_dots(experiment)
    white = pattern_set(experiment.projector, experiment.patterns).index("white", None).start
    stack = render(dotted, face)
    centres_px = find_pattern(stack.frames[white].astype(np.float64)).dots.centres_px
    i, j = (k.ravel() for k in np.meshgrid(np.arange(-9, 10), np.arange(-9, 10)))
    places_mm = np.column_stack(
        [1.04 * DOTS.pitch_x_mm * i, DOTS.pitch_y_mm * j + 0.3, np.zeros(i.size)]
    )
    column, row, _ = coated_rig(dotted, face).camera.project(mi.Point3f(places_mm.T))
    expected = np.column_stack([np.array(row), np.array(column)])
    apart = np.linalg.norm(centres_px[:, None] - expected[None], axis=-1).min(axis=1)
    assert len(apart) >= 15
    assert np.sqrt(np.mean(apart**2)) < 0.05


def test_a_face_inside_one_dot_is_a_darker_coat(mi, experiment, bump):
    """Setup: one dot larger than a matte bump, and light that is reflected up to three times.

    Expected: the frames of a coat of reflectance r times the coat's without dots, to float32: the
    dot multiplies each reflection.
    """
    bright, dark = (
        load_experiment(
            "examples/slab_balls",
            SMALL | {"render.bounces": 2, "coating": {"kind": "matte", "base_albedo": albedo}},
        )
        for albedo in (0.8, 0.4)
    )
    whole = Markers(pitch_x_mm=120.0, pitch_y_mm=120.0, radius_mm=50.0, relative_albedo=0.5)
    stacks = render(with_dots(bright, whole), bump), render(dark, bump)
    scale = stacks[1].frames[0].max()
    for dotted, darker in zip(*(stack.frames for stack in stacks), strict=True):
        np.testing.assert_allclose(dotted, darker, rtol=2e-5, atol=1e-6 * scale)


def test_stock_mitsuba_renders_the_same_dots(mi, experiment, bump):
    """Setup: dots on a bump, displaced; stock Mitsuba with a bitmap of one cell on the material
    coordinates, 12 runs of one phase frame. Expected: per pixel Student's t; mean zero within
    its error.
    """
    from twin.optics import stock, stock_dots
    from twin.optics.materials import coated_mesh
    from twin.optics.one_trace import trace_stack
    from twin.optics.rig import perspective_sensor
    from twin.optics.scene import coated_rig, marched_scene

    face = moved(bump, lambda x, y: (0.3 * np.exp(-(x**2 + y**2) / 9.0), 0.02 * y))
    dotted = with_dots(experiment)
    rig = coated_rig(dotted, face)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    tables = light_tables(experiment.projector, patterns)
    scene = marched_scene(dotted, face, experiment.coating.bsdf())
    index = patterns.index("phase", "column").start
    ours = trace_stack(scene, rig, tables, 256)[index]
    bare = trace_stack(scene, replace(rig, dots=None), tables, 16)[index]
    canvas = stock.canvas_for(rig, "projector", texels_per_px=16)
    texture = stock.frame_texture(patterns.frames[index], index, rig, tables, canvas)
    bsdf = stock_dots.dotted(experiment.coating.bsdf(), stock_dots.cell_texture(DOTS))
    scene = stock.frame_scene(
        coated_mesh(face, bsdf, stock_dots.cell_coordinates(DOTS, face)),
        stock.emitter_dict(texture, rig, canvas),
        perspective_sensor(rig.camera.pinhole, rig.camera.T_world_from_device, SAMPLES),
    )
    runs = np.stack([stock.render_frame(scene, seed) for seed in range(RUNS)])
    error, mean = stats.sem(runs, axis=0), runs.mean(axis=0)
    tolerance = 5e-4 * mean.mean()  # bilinear canvas
    t = (ours - mean) / np.hypot(error, tolerance)
    assert np.mean(np.abs(t) > stats.t.ppf(1 - 0.005, RUNS - 1)) < 0.013
    mean_error = np.sqrt(np.sum(error**2)) / error.size
    assert abs((ours - mean).mean()) < 4 * mean_error + tolerance
    assert np.mean(ours < 0.5 * bare) > 0.1


def test_an_exported_scene_has_the_dots(mi, experiment, plane, tmp_path):
    """Expected of a white frame: 1 % of white in pixels without an edge, 0.1 % in the mean."""
    dotted = with_dots(experiment)
    face = moved(plane, lambda x, y: (0.5 + 0.0 * x, 0.03 * y))
    export_stock(dotted, face, tmp_path)
    patterns = pattern_set(experiment.projector, experiment.patterns)
    index = patterns.index("white", None).start
    name = patterns.frames[index].name
    scene = mi.load_file(str(tmp_path / "scene.xml"), frame=name, optimize=False)
    stock = np.asarray(mi.render(scene, spp=256))[:, :, 0]
    ours = render(dotted, face).frames[index]
    even = maximum_filter(ours, 3) - minimum_filter(ours, 3) < 0.05 * ours.max()
    assert even.mean() > 0.5
    np.testing.assert_allclose(stock[even], ours[even], atol=0.01 * ours.max())
    assert stock.mean() == pytest.approx(ours.mean(), rel=1e-3)
    shifted = render(dotted, plane).frames[index]
    assert np.abs(shifted - ours).max() > 0.5 * ours.max()


def test_dots_in_frames_of_the_stock_engine(mi, experiment, plane):
    """Expected: the stock engine's white frame has the dots: mean within 1 % of ours."""
    stock = load_experiment(
        "examples/slab_balls", SMALL | {"render.engine": "stock", "render.samples": 16}
    )
    index = pattern_set(stock.projector, stock.patterns).index("white", None).start
    theirs = render(with_dots(stock), plane).frames[index]
    ours = render(with_dots(experiment), plane).frames[index]
    assert theirs.mean() == pytest.approx(ours.mean(), rel=0.01)
    assert np.corrcoef(theirs.ravel(), ours.ravel())[0, 1] > 0.98
