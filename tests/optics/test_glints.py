"""Glints of discrete flakes against closed forms, explicit geometry and the smooth coat."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks._glints import (
    BruteForce,
    FlatCoat,
    cone_by_convolution,
    flat_face,
    glint_facets,
    glinting,
)
from reconstruction import compiling
from reconstruction.errors import InputError
from twin.config import ConfigError, digest, load_experiment, vary
from twin.mechanics import in_plane_displacement
from twin.mechanics.relief import MATERIAL_MM
from twin.optics.flakes import FlakeList, FlakeProcess
from twin.optics.glints import glint_maps
from twin.optics.pupil_cone import Cone
from twin.pipeline.memory import Memory
from twin.pipeline.press import press

SMALL = {
    "camera.width_px": 80,
    "camera.height_px": 60,
    "camera.pixel_pitch_um": 20.0,
    "patterns.steps": 3,
    "patterns.period_px": 64,
}
CELL_MM = 0.01
GLINTS = {
    "coating.glints.diameter_um": 15.0,
    "coating.glints.diameter_spread": 0.4,
    "coating.glints.facet_roughness": 0.03,
}


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("examples/slab_ball", SMALL | GLINTS)


@pytest.fixture(scope="module")
def coat():
    return FlatCoat(glint_facets(diameter_um=8.0, facet_roughness=0.06))


def white_maps(experiment, face):
    """Sums of the trace of a face as images, and the true surface."""
    from twin.pipeline import trace

    geometry = trace.load_face(experiment, face)
    view = trace.view_of(experiment, geometry)
    patches = trace.patches_of(experiment, geometry, view)
    return trace.maps_of_patches(patches, view), view.truth


class EvenTilts(FlakeProcess):
    """One flake per square cell; a quasi-random sequence (Roberts 2018) gives even tilts."""

    def within(self, extent_mm):
        low = np.floor(np.array(extent_mm[::2]) / CELL_MM).astype(int) - 1
        high = np.ceil(np.array(extent_mm[1::2]) / CELL_MM).astype(int) + 1
        x, y = (axis.ravel() for axis in np.meshgrid(*map(np.arange, low, high)))
        number = (x + 1000.0 * y)[:, None]
        share, turn = ((0.5 + number * [0.7548776662466927, 0.5698402909980532]) % 1.0).T
        slope, angle = self.alpha * np.sqrt(share / (1.0 - share)), 2.0 * np.pi * turn
        radius = np.full(x.size, self.median_mm)
        place = (x + 0.5) * CELL_MM, (y + 0.5) * CELL_MM
        flakes = np.stack([*place, radius, slope * np.cos(angle), slope * np.sin(angle)], axis=1)
        first, cols = np.arange(x.size + 1), int(high[0] - low[0])
        return FlakeList(flakes, first, tuple(low.tolist()), cols, CELL_MM, self.median_mm)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("facet_roughness", [0.04, 0.15, 0.2])
def test_the_mean_over_coats_is_that_of_the_smooth_coat(tilt_rad, facet_roughness):
    """Flakes whose tilts fill the distribution evenly, so that the mean has no random error: 0.2 %.

    2e-3: of the mean over the cone by 40 directions. Random flakes: `./run bench coat`.
    """
    facets = glint_facets(facet_roughness=facet_roughness)
    coat = FlatCoat(facets, tilt_rad=tilt_rad)
    radius_mm = CELL_MM * np.sqrt(facets.share / np.pi)
    process = EvenTilts(CELL_MM**-2, radius_mm, 0.0, facets.alpha, 0)
    cone = Cone.of(coat.camera, coat.projector, coat.scatter)
    light = glint_maps(process, facets.share, cone, coat.maps(0.1, 99))
    assert light.valid.all()
    assert np.mean(light.ratio) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize(("pitch_mm", "pixels"), [(0.01, 700), (0.03, 400), (0.09, 200)])
def test_the_contrast_is_that_of_a_compound_poisson_sum(coat, pitch_mm, pixels):
    """Three footprints, flakes smaller and larger than a pixel; 5 %, random error 1 to 2 %."""
    measured = np.std(coat.ratio(1, pitch_mm, pixels))
    assert measured == pytest.approx(coat.contrast(pitch_mm), rel=0.05)


def test_the_contrast_falls_with_the_apertures():
    """Pupils of 0.06 and 0.12 rad and flakes of 0.02: theory and renderer to 5 %."""
    facets = glint_facets(diameter_um=5.0, facet_roughness=0.02)
    contrasts = []
    for pupil in (0.005, 0.06, 0.12):
        coat = FlatCoat(facets, camera=pupil, projector=0.5 * pupil)
        contrasts.append(np.std(coat.ratio(0, 0.05, 160)))
        assert contrasts[-1] == pytest.approx(coat.contrast(0.05), rel=0.05)
    assert contrasts[0] > 1.3 * contrasts[1] > 1.3**2 * contrasts[2]


@pytest.mark.parametrize(
    ("aperture", "polar_deg"),
    [((16.0, 0.0), 25.0), ((8.0, 4.0), 25.0), ((2.8, 10.0), 25.0), ((8.0, 4.0), 70.0)],
)
@pytest.mark.usefixtures("mi")
def test_every_pixel_equals_explicit_facets(aperture, polar_deg):
    """Random points on pupils and flakes; the deviation is the random error of this geometry.

    0.15: the error is estimated from two halves, of which few bright flakes decide.
    """
    case = glinting(*aperture, 150, 7.5, polar_deg, facet_roughness=0.08)
    assert BruteForce(case, samples=40).rms_over_noise() == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("radii", [(0.02, 0.0), (0.05, 0.03), (0.1, 0.1)])
def test_the_cone_is_the_convolution_of_pupils_and_roughness(radii):
    """Against a two-dimensional convolution: 0.5 % of the peak; its integral is 1."""
    for scatter in (0.01, 0.1):
        cone = Cone.of(*radii, scatter)
        chords = np.linspace(0.0, cone.reach, cone.density.size)
        nodes, expected = cone_by_convolution(*radii, scatter)
        density = np.interp(nodes, chords, cone.density)
        np.testing.assert_allclose(density, expected, atol=5e-3 * expected.max())
        light = np.trapezoid(2.0 * np.pi * chords * cone.density, chords)
        assert light == pytest.approx(1.0, abs=1e-3)
        x, y, weights = cone.samples.T
        mean_square = np.trapezoid(2.0 * np.pi * chords**3 * cone.density, chords)
        assert np.sum(weights * (x**2 + y**2)) == pytest.approx(mean_square, rel=2e-3)


def test_flakes_cover_their_share_and_do_not_depend_on_the_region():
    """Share to 1 %, slopes of GGX; a part of the region has equal flakes.

    The median by area is 1.3 % smaller than stated, by the cut of the diameters: 2 %.
    """
    facets = glint_facets(diameter_spread=0.5)
    process = FlakeProcess.of(facets, 3)
    flakes = process.within((-10.0, 10.0, -10.0, 10.0)).flakes
    inside = flakes[np.all(np.abs(flakes[:, :2]) < 10.0, axis=1)]
    area = np.pi * inside[:, 2] ** 2
    assert area.sum() / 400.0 == pytest.approx(facets.share, rel=0.01)
    order = np.argsort(inside[:, 2])
    half = np.searchsorted(np.cumsum(area[order]), 0.5 * area.sum())
    assert 2e3 * inside[order[half], 2] == pytest.approx(15.0, rel=0.02)
    slopes = np.hypot(inside[:, 3], inside[:, 4])
    np.testing.assert_allclose(np.mean(slopes < facets.alpha), 0.5, atol=0.005)
    part = process.within((2.0, 3.0, -4.0, -3.5)).flakes
    assert {flake.tobytes() for flake in part} <= {flake.tobytes() for flake in flakes}


def test_a_region_that_ends_on_the_border_of_a_cell_includes_the_next_cell(coat):
    """The kernel reads the cell of the end of the region: without it, memory after the list."""
    process = FlakeProcess.of(coat.facets, 3)
    for number in range(5, 40):
        cell_mm = process.within((0.0, 1.0, 0.0, 1.0)).cell_mm
        end_mm = number * cell_mm - process.largest_mm
        flakes = process.within((0.0, end_mm, 0.0, end_mm))
        last = np.floor((end_mm + process.largest_mm) * (1.0 / cell_mm))
        assert last < flakes.low[0] + flakes.cols
        assert flakes.first.size > (last - flakes.low[1]) * flakes.cols


def test_one_seed_gives_the_same_bytes_with_any_number_of_threads(coat, monkeypatch):
    images = []
    for count in (1, 3):
        monkeypatch.setattr(compiling, "threads", lambda count=count: count)
        images.append(coat.ratio(5, 0.02, 150).tobytes())
    assert images[0] == images[1]
    assert images[0] != coat.ratio(6, 0.02, 150).tobytes()


def test_pixels_without_neighbours_keep_the_smooth_light(coat):
    """A hole and a single pixel: the single pixel has no footprint; all others are unchanged."""
    maps = coat.maps(0.03, 40)
    process, cone = FlakeProcess.of(coat.facets, 2), Cone.of(coat.camera, coat.projector, 0.12)
    whole = glint_maps(process, coat.facets.share, cone, maps)
    maps.valid[10:20, 10:20] = False
    maps.valid[15, 15] = True
    part = glint_maps(process, coat.facets.share, cone, maps)
    assert part.ratio[15, 15] == 1.0
    maps.valid[15, 15] = False
    np.testing.assert_array_equal(part.valid, maps.valid)
    np.testing.assert_allclose(part.ratio[maps.valid], whole.ratio[maps.valid], rtol=1e-2)


def test_the_projector_position_of_a_glint_is_that_of_the_flakes():
    """Large pixels, few flakes: positions within the pixel, weighted by their light of mean 0.

    The points of a flake are spread evenly over a pixel, with an SD of 1 / sqrt(12). Their mean has
    at most this SD.
    """
    coat = FlatCoat(glint_facets(diameter_um=20.0, diameter_spread=0.0, facet_roughness=0.03))
    maps = coat.maps(0.1, 150)
    process, cone = FlakeProcess.of(coat.facets, 2), Cone.of(coat.camera, coat.projector, 0.06)
    light = glint_maps(process, coat.facets.share, cone, maps)
    offset = (light.projector_px - maps.fields[..., 2:4]) / 0.1  # a column is 1 mm here
    assert np.abs(offset).max() <= 0.5
    assert np.all(offset[light.ratio == 0.0] == 0.0)
    weights = np.broadcast_to(light.ratio[..., None], offset.shape)
    spread = np.sqrt(np.average(offset**2, weights=weights))
    assert 0.2 < spread < 12**-0.5
    assert abs(np.average(offset, weights=weights)) < 0.02


def test_a_large_pixel_of_a_curved_coat_is_the_sum_of_its_small_pixels(mi, bump):
    """Pixels of 0.06 mm against 4 x 4 pixels each, on flanks of up to 25 degrees.

    The normal turns by up to the width of a flake's lobe inside a large pixel. Expected: light of
    the glints, and shift of the projector position, to 2 % RMS.
    """

    def traced(size, pitch_um, samples, glints=True):
        camera = {"width_px": size, "height_px": size, "pixel_pitch_um": pitch_um}
        settings = {f"camera.{name}": value for name, value in camera.items()}
        case = load_experiment(
            "examples/slab_ball", GLINTS | settings | {"render.samples": samples}
        )
        coating = case.coating if glints else case.coating.model_copy(update={"glints": None})
        return white_maps(case.model_copy(update={"coating": coating}), bump)[0]

    def summed(small):
        return small.reshape(60, 4, 60, 4).mean(axis=(1, 3))

    large, smooth = traced(60, 18.0, 16), traced(60, 18.0, 16, glints=False)
    small = traced(240, 4.5, 1)
    light, parts = large.weight - smooth.weight, summed(small.weight) - smooth.weight
    assert np.std(light - parts) < 0.02 * np.std(light)
    column = summed(small.weight * small.column_px) / summed(small.weight)
    shift = large.column_px - smooth.column_px
    assert np.std(large.column_px - column) < 0.02 * np.std(shift)


def test_glints_move_and_stretch_with_the_material(mi, experiment):
    """Material displaced by (0.4, -0.3) mm and stretched by 8 %: the brightest glints keep their
    material coordinates to a pixel.
    """
    face = flat_face()
    world = face.vertices[:, :2].astype(np.float64)
    places = []
    for material in (world, world - [0.4, -0.3], world / 1.08):
        moved = replace(face, vertex_attributes={MATERIAL_MM: material})
        maps, truth = white_maps(experiment, moved)
        at = truth.points_world_mm[..., :2].astype(np.float64)
        at = at - [0.4, -0.3] if material[0, 0] < world[0, 0] else at * material[0, 0] / world[0, 0]
        shown = np.max(np.abs(at), axis=-1) < 1.5
        places.append((at[shown], maps.weight[shown]))
    brightest = places[0][0][np.argsort(places[0][1])[-12:]]
    for at, weight in places[1:]:
        limit = np.quantile(weight, 0.97)
        for place in brightest:
            near = np.linalg.norm(at - place, axis=1) < 0.1
            assert weight[near].max() > limit


def test_flakes_of_a_pressed_face_have_the_displacement_of_its_material(mi, experiment):
    """Slab: world position less the displacement in the plane; 0.01 mm or more moves the flakes.

    A coat without the table loads the face without material coordinates.
    """
    from twin.pipeline.lit_frames import loaded

    coarse = {"press.relief_pitch_mm": 0.05, "press.solver_pitch_mm": 0.2}
    case = vary(experiment, coarse)
    face = press(case, Memory())
    u_x, u_y = in_plane_displacement(face.pressed, case.elastomer, case.press)
    grid = loaded(case, face, Memory()).value.face
    moved = grid.vertices[:, :2] - grid.vertex_attributes[MATERIAL_MM]
    assert np.hypot(u_x, u_y).max() > 0.01
    np.testing.assert_allclose(moved[:, 0], u_x.ravel(), atol=2e-6)
    np.testing.assert_allclose(moved[:, 1], u_y.ravel(), atol=2e-6)
    smooth = case.model_copy(update={"coating": case.coating.model_copy(update={"glints": None})})
    assert not loaded(smooth, face, Memory()).value.face.vertex_attributes


def test_a_smooth_coat_is_traced_without_glints(mi, experiment, bump):
    """Without the table, and without flakes: the digest and every frame are those of the blend."""
    from twin.pipeline import trace

    smooth = load_experiment("examples/slab_ball", SMALL)
    assert digest(smooth) != digest(experiment)
    without = experiment.model_copy(
        update={"coating": experiment.coating.model_copy(update={"glints": None})}
    )
    assert digest(without) == digest(smooth)
    bare = vary(experiment, {"coating.flake_fraction": 0.0})
    assert bare.coating.facets() is None
    geometry = trace.load_face(smooth, bump)
    view = trace.view_of(smooth, geometry)
    assert trace.patches_of(smooth, geometry, view).glints is None
    glinting_maps, smooth_maps = (white_maps(each, bump)[0] for each in (experiment, smooth))
    assert glinting_maps.weight.std() > 2.0 * smooth_maps.weight.std()


def test_pixels_traced_by_samples_have_the_same_glints(mi, experiment, bump):
    """All pixels by their mean position, and all by their samples: equal white frames, 1e-6.

    The fringes of both agree to 0.1 % of white: the error of a mean position.
    """
    from twin.optics.one_trace import trace_stack
    from twin.pipeline import trace

    geometry = trace.load_face(experiment, bump)
    view = trace.view_of(experiment, geometry)
    patches = trace.patches_of(experiment, geometry, view)
    tables = trace.tables_of(experiment, view)
    means, samples = (
        np.stack(
            trace_stack(geometry.scene, view.rig, tables, patches, smooth_within_px=limit)
        ).astype(np.float64)
        for limit in (100.0, -1.0)
    )
    white = means.max(axis=0)
    np.testing.assert_allclose(samples.max(axis=0), white, rtol=1e-6, atol=1e-6 * white.mean())
    assert np.abs(samples - means)[:, white > 0].max() < 1e-3 * white.max()


def test_pupils_shrink_in_a_gel_as_refraction_demands(mi):
    """Solid angle of a small pupil seen through a gel: against rays to points of the pupil, 3 %."""
    from twin.optics.connection import direction_to
    from twin.optics.glinting import refracted
    from twin.optics.scene import rig_of

    gel = {"bottom_mm": -1.0, "thickness_mm": 2.0, "ior": 1.41}
    layer = {f"layers.gel.{name}": value for name, value in gel.items()}
    rig = rig_of(load_experiment("examples/slab_ball", SMALL | GLINTS | layer))
    point = mi.Point3f([[2.0], [1.0], [0.0]])
    position = rig.projector.T_world_from_device[:3, 3]
    across = np.cross(position, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    directions = []
    for shift in (0.0 * across, across, np.cross(position / np.linalg.norm(position), across)):
        pose = rig.projector.T_world_from_device.copy()
        pose[:3, 3] += shift
        moved = replace(rig.projector, T_world_from_device=pose)
        directions.append(np.array(direction_to(rig, moved, point)).ravel())
    spanned = np.linalg.norm(np.cross(directions[1] - directions[0], directions[2] - directions[0]))
    in_air = 1.0 / np.sum((position - [2.0, 1.0, 0.0]) ** 2)
    assert refracted(rig, np.array(directions[0])) * in_air == pytest.approx(spanned, rel=0.03)


def test_what_stock_mitsuba_and_gradients_lack_is_an_error(mi, experiment, plane, tmp_path):
    from twin.optics.checks import check_stock
    from twin.optics.export import export_stock
    from twin.optics.gradients import trace_tangent
    from twin.optics.scene import rig_of

    with pytest.raises(InputError, match=r"coating\.glints"):
        check_stock(experiment)
    with pytest.raises(InputError, match=r"coating\.glints"):
        export_stock(experiment, plane, tmp_path)
    with pytest.raises(InputError, match=r"coating\.glints"):
        trace_tangent(None, rig_of(experiment), experiment, None, step=1.0)


def test_a_flake_is_smoother_than_the_coat():
    with pytest.raises(ConfigError, match="facet_roughness"):
        load_experiment("examples/slab_ball", GLINTS | {"coating.flake_roughness": 0.05})
