"""All generated specimens: sound meshes, and closed forms where there are any."""

from math import cos, pi, sqrt

import numpy as np
import pytest
from pydantic import ValidationError

from twin.config.specimen_base import Specimen
from twin.optics.surfaces.conductor import Conductor
from twin.optics.surfaces.dielectric import Dielectric
from twin.specimens import bodies, height_above_lowest, shape_of
from twin.specimens.kinds import nut
from twin.specimens.kinds.ball import Ball
from twin.specimens.kinds.bar import Bar
from twin.specimens.kinds.bars import Bars
from twin.specimens.kinds.bear import Bear, bear_level_mm, drawn_bear
from twin.specimens.kinds.brick import Brick
from twin.specimens.kinds.fingerprint import Fingerprint, ridges_mm
from twin.specimens.kinds.group import Group
from twin.specimens.kinds.nut import Nut
from twin.specimens.kinds.rod import Rod
from twin.specimens.kinds.rods import Rods
from twin.specimens.kinds.step import Step
from twin.specimens.kinds.t_bolt import TBolt
from twin.specimens.kinds.two_balls import TwoBalls
from twin.specimens.kinds.v_groove import VGroove

SPECIMENS: list[Specimen] = [
    Nut(yaw_deg=20),
    Nut(thread_mm=4, pitch_mm=0.7, across_flats_mm=7, height_mm=3.2, countersink_mm=4.4),
    TBolt(tilt_deg=3),
    TBolt(facing="head"),
    Brick(),
    Brick(studs_x=4, height_mm=3.2, edge_radius_mm=0.0),
    Bear(yaw_deg=-30),
    Rods(),
    Rods(diameters_mm=(1.99,), tilt_deg=2),
    Bar(),
    Bar(edge_radius_mm=0.0, yaw_deg=10, tilt_deg=1),
    Bars(),
    Fingerprint(length_x_mm=4, length_y_mm=3, minutiae=2),
    Fingerprint(length_x_mm=3, length_y_mm=3, pattern="whorl", dome_radius_mm=8),
    Step(),
    Step(height_mm=0.3, edge_radius_mm=0.3),
    Step(edge_radius_mm=0.0),
    VGroove(yaw_deg=90),
]
# Facets with a smaller height are needles with normals dominated by rounding.
LEAST_HEIGHT_MM = 1e-5


@pytest.mark.parametrize("specimen", SPECIMENS, ids=lambda s: s.kind)
def test_mesh_is_one_sound_body(specimen: Specimen) -> None:
    mesh = shape_of(specimen).mesh(-2.5)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.volume > 0
    assert mesh.bounds[1, 2] == pytest.approx(-2.5, abs=1e-6)
    longest = mesh.edges_unique_length[mesh.faces_unique_edges].max(axis=1)
    assert (2 * mesh.area_faces / longest).min() > LEAST_HEIGHT_MM
    assert np.isfinite(mesh.face_normals).all()


@pytest.mark.parametrize("specimen", [*SPECIMENS, TwoBalls()], ids=lambda s: s.kind)
def test_it_stands_on_its_bottom(specimen: Specimen) -> None:
    shape = shape_of(specimen)
    assert shape.bottom_mm == pytest.approx(shape.mesh(0.0).bounds[0, 2], abs=0.01)


@pytest.mark.parametrize("specimen", SPECIMENS, ids=lambda s: s.kind)
def test_foremost_point_is_zero_within_the_outline(specimen: Specimen) -> None:
    # Lines off the symmetry planes, where rods meet their neighbours' heights.
    x, y = np.linspace(-18.03, 18.01, 602), np.linspace(-12.02, 12.03, 402)
    height = height_above_lowest(specimen, x, y)
    assert 0 <= height.min() < 5e-3
    x_low, x_high, y_low, y_high = shape_of(specimen).bounds_mm()
    rows, cols = np.nonzero(np.isfinite(height))
    assert x_low <= x[cols].min() < x[cols].max() <= x_high
    assert y_low <= y[rows].min() < y[rows].max() <= y_high
    outline = shape_of(specimen).mesh(0.0).bounds[:, :2].T.ravel()
    np.testing.assert_allclose(outline, (x_low, x_high, y_low, y_high), atol=5e-3)


@pytest.mark.parametrize("edge_mm", [0.0, 0.2])
@pytest.mark.parametrize("studs", [(2, 2), (4, 2), (1, 2)])
def test_brick_volume(studs: tuple[int, int], edge_mm: float) -> None:
    """Block less cavity, plus studs (rounded by Pappus' rule) and tubes."""
    brick = Brick(studs_x=studs[0], studs_y=studs[1], edge_radius_mm=edge_mm)
    outer = np.array([8.0 * studs[0] - 0.2, 8.0 * studs[1] - 0.2])
    inner, depth = outer - 3.0, 8.6
    # Area that the rounding removes from the stud's profile, and the offset of its centroid.
    corner = (1 - pi / 4) * edge_mm**2
    inset = edge_mm * (1 - (1 / 6) / (1 - pi / 4))
    stud = pi * 2.4**2 * 1.7 - corner * 2 * pi * (2.4 - inset)
    tube_outer = (8 * sqrt(2) - 4.8) / 2
    tube = pi * (tube_outer**2 - 2.4**2) * depth
    tubes = (studs[0] - 1) * (studs[1] - 1)
    exact = outer.prod() * 9.6 - inner.prod() * depth + np.prod(studs) * stud + tubes * tube
    assert shape_of(brick).mesh(0.0).volume == pytest.approx(exact, rel=2e-4)


def test_brick_is_studs_above_a_flat_roof() -> None:
    height = height_above_lowest(Brick(), np.array([-4.0, 0.0, 4.0]), np.array([-4.0, 0.0]))
    np.testing.assert_allclose(height, [[0, 1.7, 0], [1.7, 1.7, 1.7]], atol=1e-6)


def _rounded_block(sides_mm: tuple[float, float, float], r: float) -> float:
    """Volume of a ball of radius r swept over a block (Steiner's formula)."""
    a, b, c = (side - 2 * r for side in sides_mm)
    return a * b * c + 2 * r * (a * b + b * c + c * a) + pi * r**2 * (a + b + c) + 4 / 3 * pi * r**3


def test_rods_volume_and_heights() -> None:
    """Cylinders with rounded ends, the plate, and the cement beads below the rods."""
    rods = Rods()
    radii = np.array(rods.diameters_mm) / 2
    edge, length, bead = rods.edge_radius_mm, rods.length_mm, rods.bead_mm
    core = radii - edge
    # Straight part, and two rounded ends: integral of pi (core + sqrt(e^2 - t^2))^2 over t.
    ends = 2 * pi * (core**2 * edge + core * pi * edge**2 / 2 + 2 * edge**3 / 3)
    cylinders = pi * radii**2 * (length - 2 * edge) + ends
    half = bead / 2
    cusp = bead * radii - half * np.sqrt(radii**2 - half**2) - radii**2 * np.arcsin(half / radii)
    x_low, x_high, y_low, y_high = shape_of(rods).bounds_mm()
    plate = _rounded_block((x_high - x_low, y_high - y_low, rods.plate_mm), edge)
    exact = plate + (cylinders + cusp * (length - edge)).sum()
    assert shape_of(rods).mesh(0.0).volume == pytest.approx(exact, rel=2e-4)
    middles = np.array(rods.middles_mm)
    np.testing.assert_allclose(
        height_above_lowest(rods, middles, np.array([0.0]))[0], 7.23 - 2 * radii, atol=1e-8
    )
    # Off the middle rod's axis: the circle; in the gap and at the margin: the plate.
    x_mm = np.array([middles[1] + 1.0, middles[1] - radii[1] - 0.5, x_low + 0.2])
    circle = 7.23 - radii[1] - sqrt(radii[1] ** 2 - 1)
    heights = height_above_lowest(rods, x_mm, np.array([1.0]))[0]
    np.testing.assert_allclose(heights, [circle, 7.23, 7.23], atol=1e-6)


def test_bars_volume_and_heights() -> None:
    """Blocks minus the volume that rounding removes from upper edges and corners, on a plate.

    A quarter round takes (1 - pi / 4) r^2 of an edge; a corner (1 - pi / 6) r^3 of its r^3.
    """
    bars = Bars()
    widths, length, r = np.array(bars.widths_mm), bars.length_mm, bars.edge_radius_mm
    block = widths * length * bars.height_mm
    around = 2 * (widths + length - 4 * r)
    upright = 4 * (bars.height_mm - r)
    taken = (1 - pi / 4) * r**2 * (around + upright) + 4 * (1 - pi / 6) * r**3
    plate = _rounded_block((widths.sum() + 2 + 2, length + 2, bars.plate_mm), r)
    exact = plate + (block - taken).sum()
    assert shape_of(bars).mesh(0.0).volume == pytest.approx(exact, rel=2e-5)
    middles = np.array(bars.middles_mm)
    gaps = middles + widths / 2 + 0.5
    heights = height_above_lowest(bars, np.concatenate((middles, gaps)), np.array([0.1]))[0]
    np.testing.assert_allclose(heights, [0, 0, 0, 1.5, 1.5, 1.5], atol=1e-9)


def test_rounded_edge_of_a_bar_is_an_arc() -> None:
    """Facets of 6 deg are within r (1 - cos 3 deg) = 0.14 um of an arc of 0.1 mm."""
    turn = np.deg2rad(np.array([20.0, 45.0, 70.0]))
    x = 4.81 / 2 - 0.1 + 0.1 * np.cos(turn)
    heights = height_above_lowest(Bar(), x, np.array([0.2]))[0]
    np.testing.assert_allclose(heights, 0.1 - 0.1 * np.sin(turn), atol=0.1 * (1 - cos(pi / 60)) * 3)


@pytest.mark.parametrize("pattern", ["loop", "whorl"])
def test_ridges_have_the_given_pitch_and_depth(pattern: str) -> None:
    """Slope of the ridges' height over the mean square of it: 2 pi / pitch for any phase."""
    print_ = Fingerprint(pattern=pattern, minutiae=0)
    step = 0.01
    x, y = np.meshgrid(np.arange(-9, 9, step), np.arange(-9, 9, step))
    z = ridges_mm(print_, x, y)
    assert z.max() - z.min() == pytest.approx(0.07, rel=1e-3)
    slope = np.hypot(*np.gradient(z, step))
    pitch = 2 * pi * np.sqrt((z**2).mean() / (slope**2).mean())
    assert pitch == pytest.approx(0.45, rel=0.01)


def test_minutiae_leave_the_pitch_and_end_ridges() -> None:
    """The phase winds once round each: the two sides of a path round it differ by one ridge."""
    plain, forked = (Fingerprint(minutiae=count) for count in (0, 30))
    x, y = np.meshgrid(np.arange(-9, 9, 0.02), np.arange(-9, 9, 0.02))
    heights = [ridges_mm(print_, x, y) for print_ in (plain, forked)]
    pitches = [
        2 * pi * np.sqrt((z**2).mean() / (np.array(np.gradient(z, 0.02)) ** 2).sum(axis=0).mean())
        for z in heights
    ]
    assert pitches[1] == pytest.approx(pitches[0], rel=0.03)
    crests = [(np.diff(np.sign(np.diff(z[450]))) < 0).sum() for z in heights]
    assert crests[0] != crests[1]


def test_a_fingerprint_is_its_seed() -> None:
    first, same, reseeded = (
        shape_of(Fingerprint(length_x_mm=3, length_y_mm=3, pattern_seed=seed)).mesh(0.0)
        for seed in (1, 1, 2)
    )
    assert first.vertices.tobytes() == same.vertices.tobytes()
    assert first.vertices.tobytes() != reseeded.vertices.tobytes()


def test_the_mesh_of_a_fingerprint_is_its_ridges_on_a_dome() -> None:
    """The error of chords is 1.2 um in ridges; a dome of 30 mm descends by just over r^2 / 2 R."""
    flat, domed = (
        Fingerprint(length_x_mm=6, length_y_mm=6, minutiae=3, dome_radius_mm=radius)
        for radius in (0.0, 30.0)
    )
    x = np.linspace(-2.9, 2.9, 101)
    grid_x, grid_y = np.meshgrid(x, x)
    ridges = ridges_mm(flat, grid_x, grid_y)
    heights = [-height_above_lowest(print_, x, x) for print_ in (flat, domed)]
    np.testing.assert_allclose(heights[0] - heights[0].max(), ridges - ridges.max(), atol=2e-3)
    dome = np.sqrt(30.0**2 - grid_x**2 - grid_y**2) - 30.0
    off = heights[1] - ridges - dome
    np.testing.assert_allclose(off, off.mean(), atol=2e-3)


def test_neighbouring_rods_keep_their_gap() -> None:
    rods = Rods(diameters_mm=(2.0, 4.0), gap_mm=0.7)
    left, right = rods.middles_mm
    assert right - left == pytest.approx(1.0 + 0.7 + 2.0)
    assert left - 1.0 == pytest.approx(-(right + 2.0))


@pytest.mark.parametrize(("height_mm", "edge_mm"), [(0.5, 0.1), (0.5, 0.0), (0.3, 0.3)])
def test_step_volume_and_levels(height_mm: float, edge_mm: float) -> None:
    step = Step(height_mm=height_mm, edge_radius_mm=edge_mm)
    exact = 12 * (12 * 2.0 + 6 * height_mm - (1 - pi / 4) * edge_mm**2)
    assert shape_of(step).mesh(0.0).volume == pytest.approx(exact, rel=1e-6)
    heights = height_above_lowest(step, np.array([-3.0, -0.01, 0.5, 3.0]), np.array([0.1]))[0]
    np.testing.assert_allclose(heights, [height_mm, height_mm, 0, 0], atol=1e-9)


def test_rounded_edge_of_a_step_is_an_arc() -> None:
    """Facets of 2 degrees stay within r (1 - cos 1 deg) = 0.05 um of an arc of 0.3 mm, measured
    along the normal; vertically that is divided by the slope's cosine."""
    turn = np.deg2rad(np.array([20.0, 45.0, 70.0]))
    x = 0.3 - 0.3 * np.cos(turn)
    heights = height_above_lowest(Step(edge_radius_mm=0.3), x, np.array([0.2]))[0]
    np.testing.assert_allclose(
        heights, 0.3 - 0.3 * np.sin(turn), atol=0.3 * (1 - cos(pi / 180)) * 3
    )


@pytest.mark.parametrize("angle_deg", [60.0, 90.0, 140.0])
def test_v_groove_volume_and_flanks(angle_deg: float) -> None:
    groove = VGroove(angle_deg=angle_deg)
    half = np.deg2rad(angle_deg / 2)
    exact = 12 * (12 * 2.5 - 0.5**2 * np.tan(half))
    assert shape_of(groove).mesh(0.0).volume == pytest.approx(exact, rel=1e-9)
    x = np.array([0.0, 0.1, -0.2, 5.0])
    heights = height_above_lowest(groove, x, np.array([0.0]))[0]
    np.testing.assert_allclose(
        heights, [0.5, *(0.5 - x[1:3].__abs__() / np.tan(half)), 0], atol=1e-9
    )


def test_bear_lies_on_the_smooth_union() -> None:
    """Every vertex is on the level set to a nanometre; the bear is that drawing at its length."""
    drawn = drawn_bear(0.15)
    assert np.abs(bear_level_mm(np.asarray(drawn.vertices), 0.15)).max() < 1e-6
    bear = shape_of(Bear(length_mm=20.0)).mesh(0.0)
    assert bear.extents[1] == pytest.approx(20.0, abs=1e-9)
    assert bear.volume == pytest.approx(drawn.volume * (20 / drawn.extents[1]) ** 3, rel=1e-9)


def test_bear_turns_little_from_facet_to_facet() -> None:
    """Refraction needs smooth facets: median angle 2 deg; creases have more."""
    angle = np.rad2deg(shape_of(Bear()).mesh(0.0).face_adjacency_angles)
    assert np.median(angle) < 2
    assert np.quantile(angle, 0.9) < 6


def test_bear_has_a_face() -> None:
    """Nose foremost, muzzle lower, feet and belly within the reach of a press."""
    grid_x, grid_y = np.linspace(-5, 5, 201), np.linspace(-8, 8, 321)
    height = height_above_lowest(Bear(), grid_x, grid_y)
    row, col = np.unravel_index(height.argmin(), height.shape)
    assert abs(grid_x[col]) < 0.1
    assert 2 < grid_y[row] < 5
    reached = height < 0.75
    feet = reached & (grid_y[:, None] < -4) & (np.abs(grid_x) > 1.5)
    belly = reached & (np.abs(grid_y[:, None] + 2.5) < 1) & (np.abs(grid_x) < 1)
    assert feet.any()
    assert belly.any()


def test_bear_level_is_a_signed_distance_for_points_far_from_creases() -> None:
    """The eye is a ball of 0.5 mm: far from other parts its level is the distance to it."""
    outside = np.array([[1.35, 4.75, 2.4]]) + 0.9 * np.array([[0.0, 0.6, 0.8]])
    level = bear_level_mm(outside, blend_mm=0.02)
    assert level[0] == pytest.approx(0.4, abs=5e-3)
    assert bear_level_mm(np.array([0.0, -2.1, 0.0]), 0.02) < -2


def test_bodies_are_the_parts_in_place_with_their_materials() -> None:
    steel = Conductor(ior=2.9, extinction=2.9, roughness=0.1)
    clear = Dielectric(ior=1.5)
    group = Group(
        parts={
            "ball": Ball(x_mm=-5, diameter_mm=4, material=steel),
            "rod": Rod(x_mm=4, z_mm=-0.4, length_mm=6),
        },
        tilt_deg=3,
        material=clear,
    )
    ball, rod = bodies(group, touched_z_mm=-3.0)
    assert [(ball.name, ball.material), (rod.name, rod.material)] == [
        ("ball", steel),
        ("rod", clear),
    ]
    whole = shape_of(group).mesh(-3.0)
    assert ball.mesh.volume + rod.mesh.volume == pytest.approx(whole.volume, rel=1e-6)
    assert max(ball.mesh.bounds[1, 2], rod.mesh.bounds[1, 2]) == pytest.approx(-3.0, abs=2e-3)
    both = np.array([ball.mesh.bounds, rod.mesh.bounds])
    np.testing.assert_allclose(both[:, 0].min(axis=0), whole.bounds[0], atol=1e-6)


def test_overlapping_parts_stay_two_bodies() -> None:
    group = Group(parts={"a": Ball(x_mm=-1), "b": Ball(x_mm=1)})
    parts = bodies(group)
    assert [part.name for part in parts] == ["a", "b"]
    assert sum(part.mesh.volume for part in parts) > 1.2 * shape_of(group).mesh(0.0).volume


@pytest.mark.parametrize("specimen", [Ball(), Rods(), Nut(x_mm=1.0)], ids=lambda s: s.kind)
def test_any_other_kind_is_one_body(specimen: Specimen) -> None:
    (body,) = bodies(specimen, touched_z_mm=-2.0)
    assert body.name == specimen.kind
    assert body.material is None
    np.testing.assert_array_equal(body.mesh.vertices, shape_of(specimen).mesh(-2.0).vertices)


def test_same_specimen_same_bytes() -> None:
    """The level set and the booleans run in the library's own threads; order must not matter."""
    for cached, specimen in ((drawn_bear, Bear()), (nut._nut, Nut())):
        first = specimen.shape().surface
        cached.cache_clear()
        second = specimen.shape().surface
        assert first.vertices.tobytes() == second.vertices.tobytes()
        assert first.faces.tobytes() == second.faces.tobytes()


@pytest.mark.parametrize(
    ("model", "keys", "line"),
    [
        (Brick, {"stud_diameter_mm": 6.0}, "stud_diameter_mm: found 6, allowed at most 5.6"),
        (Brick, {"wall_mm": 5.0}, "wall_mm: found 5, allowed at most"),
        (Brick, {"studs_x": 0}, "greater than or equal to 1"),
        (Rods, {"bead_mm": 1.5}, "bead_mm: found 1.5, allowed at most 0.995"),
        (Rods, {"diameters_mm": ()}, "at least 1 item"),
        (Step, {"edge_radius_mm": 0.6}, "edge_radius_mm: found 0.6, allowed at most 0.5"),
        (VGroove, {"depth_mm": 6.0}, "opening: found 12, allowed at most 9.6"),
        (Bar, {"edge_radius_mm": 0.5}, "edge_radius_mm: found 0.5, allowed at most 0.375"),
        (Bars, {"widths_mm": ()}, "at least 1 item"),
        (Bars, {"plate_mm": 0.2}, "edge_radius_mm: found 0.1, allowed at most 0.05"),
        (Fingerprint, {"depth_mm": 0.15}, "depth_mm: found 0.15, allowed at most 0.135"),
        (Fingerprint, {"dome_radius_mm": 15}, "dome_radius_mm: found 15, allowed 0 or at least"),
        (Bear, {"length_mm": 100}, "less than or equal to 60"),
    ],
)
def test_impossible_dimensions_are_rejected(
    model: type[Specimen], keys: dict[str, object], line: str
) -> None:
    with pytest.raises(ValidationError, match="1 validation error") as caught:
        model.model_validate(keys)
    assert line in str(caught.value)
