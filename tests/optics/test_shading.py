"""Shadows: no shadow rays for a relief that provably casts no shadow; shadows of steep reliefs."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_dilation, binary_erosion

from tests.optics.scenes import coated_scene
from twin.config import load_experiment
from twin.optics.height_grid import BLOCK, blocks_of, height_grid, shades_itself
from twin.optics.light import light_tables, pattern_set
from twin.optics.rig import true_calibration

SPIKE_MM = 6.0


def may_shade(face, source_mm):
    grid = height_grid(face)
    return grid is None or shades_itself(grid, source_mm)


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


@pytest.fixture(scope="module")
def source_mm(experiment):
    return true_calibration(experiment).T_world_from_proj[:3, 3]


def spike(x, y):
    return SPIKE_MM * np.exp(-(x**2 + y**2) / 2)


@pytest.fixture(scope="module")
def steep(grid_face):
    """Return a spike with flanks of up to 75 degrees; the projector is at 65 degrees."""
    return grid_face(spike, lambda x, y: (-x * spike(x, y), -y * spike(x, y)), pitch_mm=0.04)


@pytest.mark.parametrize("shape", [(2, 2), (9, 9), (10, 18), (21, 40)])
def test_blocks_have_the_extremes_of_their_cells(shape):
    """Expected: slopes of both facets of every cell by array arithmetic, bit for bit."""
    rng = np.random.default_rng(3)
    x, y = (np.cumsum(rng.uniform(0.01, 0.03, count)) for count in reversed(shape))
    z = rng.normal(0.0, 0.01, shape)
    blocks = blocks_of(np.stack([*np.meshgrid(x, y), z], axis=-1))
    along_x, along_y = np.diff(z, axis=1) / np.diff(x), np.diff(z, axis=0) / np.diff(y)[:, None]
    first = along_x[:-1] ** 2 + along_y[:, 1:] ** 2
    slopes = np.sqrt(np.maximum(first, along_x[1:] ** 2 + along_y[:, :-1] ** 2))
    for row, col in np.ndindex(blocks.tops_mm.shape):
        cells = slice(BLOCK * row, BLOCK * (row + 1)), slice(BLOCK * col, BLOCK * (col + 1))
        vertices = tuple(slice(of.start, of.stop + 1) for of in cells)
        assert blocks.steepest[row, col] == slopes[cells].max()
        assert blocks.tops_mm[row, col] == z[vertices].max()


def test_a_gentle_face_needs_no_shadow_rays(mi, experiment, bump):
    """Every frame is the same byte for byte, traced with shadow rays and without."""
    from twin.optics.one_trace import trace_stack
    from twin.optics.scene import coated_rig

    scene, rig = coated_scene(experiment, bump), coated_rig(experiment, bump)
    assert not rig.shadows
    tables = light_tables(
        experiment.projector, pattern_set(experiment.projector, experiment.patterns)
    )
    proven = trace_stack(scene, rig, tables, 4)
    traced = trace_stack(scene, replace(rig, shadows=True), tables, 4)
    assert max(frame.max() for frame in traced) > 0.0
    for unshadowed, expected in zip(proven, traced, strict=True):
        assert unshadowed.tobytes() == expected.tobytes()


def test_a_steep_face_keeps_its_shadow(mi, experiment, steep, source_mm):
    """Against a march on the formula, 8 mm towards the projector in steps of 30 um.

    Expected: the same pixels are dark, but for the one-pixel rim of the shadow: where light grazes
    the flank, the march's steps and the facets' chords of 1 um decide.
    """
    from twin.optics.one_trace import trace_truth
    from twin.optics.scene import coated_rig

    truth = trace_truth(coated_scene(experiment, steep), coated_rig(experiment, steep))
    points = truth.points_world_mm.astype(np.float64)
    way_mm = np.arange(0.02, 8.0, 0.03)
    towards = source_mm - points
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    at = points[..., None, :] + way_mm[:, None] * towards[..., None, :]
    dark = np.any(at[..., 2] < spike(at[..., 0], at[..., 1]) - 1e-3, axis=-1)
    core = binary_erosion(dark)
    assert core.sum() > 50
    assert not truth.lit[core].any()
    assert truth.lit[~binary_dilation(dark)].all()


def test_the_bound_is_sharp(grid_face):
    """A ramp z = s x is lit from (0, 0, h): the ray from its upper corner climbs least.

    That is (h - s x) / hypot(x, y) at the rectangle's corner; the proof fails at just that slope.
    """
    x_mm, y_mm, height_mm = 16.0, 12.5, 30.0
    limit = height_mm / (np.hypot(x_mm, y_mm) + x_mm)

    def ramp(slope):
        return grid_face(
            lambda x, _: slope * x, lambda x, _: (slope + 0.0 * x, 0.0 * x), pitch_mm=0.5
        )

    assert not may_shade(ramp(0.999 * limit), np.array([0.0, 0.0, height_mm]))
    assert may_shade(ramp(1.001 * limit), np.array([0.0, 0.0, height_mm]))


def test_one_steep_facet_is_found(plane, source_mm):
    """A vertex raised by five cells is detected, whichever facets of the cell it tilts."""
    assert not may_shade(plane, source_mm)
    cell_mm = 0.5
    for corner in ([0, 0], [1, 1], [0, 1]):
        raised = plane.copy()
        index = np.argmin(np.linalg.norm(raised.vertices[:, :2] - corner, axis=-1))
        raised.vertices[index, 2] = 5.0 * cell_mm
        assert may_shade(raised, source_mm)


def test_only_height_grids_are_proven(plane, source_mm):
    """A further body, a hole, a turned facet, a source below: shadows are traced."""
    wall = trimesh.creation.box(extents=[0.5, 40.0, 6.0])
    turned, hole, skewed = plane.copy(), plane.copy(), plane.copy()
    turned.faces[7] = turned.faces[7][::-1]
    hole.update_faces(np.arange(len(hole.faces)) != 7)
    skewed.vertices[5, 0] += 0.1
    for face in (trimesh.util.concatenate([plane, wall]), turned, hole, skewed, wall):
        assert may_shade(face, source_mm)
    assert may_shade(plane, np.array([0.0, 0.0, -100.0]))


FINE = {
    "camera.width_px": 100,
    "camera.height_px": 8,
    "camera.pixel_pitch_um": {"value": 1.0, "range": [1.0, 10.0], "source": "test"},
    "projector.pose.polar_deg": {"value": 65.0, "range": [0.0, 80.0], "source": "test"},
}
IN_AIR = np.tan(np.deg2rad(65.0))
IN_GEL = np.tan(np.arcsin(np.sin(np.deg2rad(65.0)) / 1.41))


@pytest.mark.parametrize(
    ("name", "tangent"), [("examples/slab_balls", IN_AIR), ("examples/gel_on_window", IN_GEL)]
)
def test_the_shadow_of_a_step_of_30_um(mi, grid_face, name, tangent):
    """Setup: light from +x, 65 degrees off the vertical; a plateau 30 um high at x > 0.

    Expected: dark behind it over 30 um tan 65 = 64 um in air; below a gel of 1.41 the light has the
    angle asin(sin 65 / 1.41) = 40 degrees, 25 um. Pixel pitch 3.3 um, width of the riser 2 um.
    """
    from twin.optics.one_trace import trace_truth
    from twin.optics.scene import coated_rig

    face = grid_face(
        lambda x, _: 0.03 * (x > 1e-9), lambda x, y: (0.0 * x, 0.0 * y),
        half_x_mm=0.3, half_y_mm=0.1, pitch_mm=0.002,
    )  # fmt: skip
    fine = load_experiment(name, FINE)
    rig = coated_rig(fine, face)
    assert rig.projector.T_world_from_device[0, 3] > 100.0
    truth = trace_truth(coated_scene(fine, face), rig)
    x, lit = truth.points_world_mm[4, :, 0], truth.lit[4]
    end = -0.03 * tangent
    assert x.min() < end - 0.02
    assert not lit[(x > end + 0.004) & (x < -0.001)].any()
    assert lit[(x < end - 0.004) | (x > 0.003)].all()
    assert 0 < (~lit).sum() < 0.5 * lit.size
