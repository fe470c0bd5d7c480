"""Press figures computed by hand: preload, films, rims, nodes, contact cells."""

import numpy as np
import pytest
import trimesh
from scipy import sparse

from twin.config.models import Elastomer, Film, Press
from twin.mechanics import PressError, press
from twin.mechanics.contact import _between_cells
from twin.mechanics.layer import BondedLayer, FreeSlab
from twin.mechanics.layouts import (
    Preload,
    coat_film,
    face_nodes,
    mirrored,
    preload_of,
    touched_at_nodes,
    weight_kpa,
    widened,
    wrapped,
)
from twin.mechanics.reference.taylor_hood import Facets
from twin.mechanics.reference.tetrahedra import count_estimate, graded_towards
from twin.mechanics.transfer import CoatFilm
from twin.specimens import shape_of
from twin.specimens.kinds.ball import Ball


def slab(**more):
    plain = {
        "thickness_mm": 2.0, "length_x_mm": 16.0, "length_y_mm": 16.0,
        "young_modulus_kpa": 100.0, "poisson_ratio": 0.25, "layout": "opposite_face",
    }  # fmt: skip
    return Elastomer.model_validate(plain | more)


def load(**more):
    return Press.model_validate({"control": "depth", "depth_mm": 0.5} | more)


def test_weight_and_back_pressure_of_a_free_slab():
    """1000 kg/m^3 by 2 mm: 9.80665 * 2e-3 = 0.0196133 kPa downwards, half of it on each face.

    Back pressure of 2 kPa pushes the coated face down as well; at 60 degrees half the weight acts.
    """
    heavy = slab(density_kg_m3=1000.0)
    assert weight_kpa(heavy, load(gravity_deg=0.0)) == pytest.approx(-0.0196133)
    assert weight_kpa(heavy, load(gravity_deg=60.0)) == pytest.approx(-0.0196133 / 2)
    assert weight_kpa(heavy, load(gravity_deg=180.0)) == pytest.approx(0.0196133)
    assert weight_kpa(heavy, load()) == 0.0
    result = preload_of(heavy, load(gravity_deg=0.0, back_pressure_kpa=2.0), 100.0)
    assert result.touched == pytest.approx(-0.0098067e-2, rel=1e-5)
    assert result.coated == pytest.approx(-2.0098067e-2, rel=1e-6)
    assert not preload_of(slab(), load(), 100.0)
    with pytest.raises(PressError, match="density"):
        weight_kpa(slab(), load(gravity_deg=0.0))


def test_a_film_relative_to_its_slab():
    """Shear moduli 2800 / (2 * 1.4) and 100 / (2 * 1.25) kPa: ratio 25; 0.05 of 2 mm: 0.025."""
    film = Film(thickness_mm=0.05, young_modulus_kpa=2800.0, poisson_ratio=0.4)
    result = coat_film(slab(film=film), 100.0)
    assert (result.share, result.shear_ratio) == (pytest.approx(0.025), pytest.approx(25.0))
    assert coat_film(slab(film=film), 200.0).shear_ratio == pytest.approx(12.5)
    assert coat_film(slab(), 100.0) is None


STIFF = CoatFilm(share=0.1, shear_ratio=50.0, poisson_ratio=0.49)


def composite_bending():
    """E* h^3 / 12 of two plies, per E* of the slab: thickness 1, of which 0.1 is 50 times as stiff.

    Neutral plane at (0.9 * 0.45 + 5 * 0.95) / 5.9 = 0.87373 from the touched face.
    """
    neutral = (0.9 * 0.45 + 50 * 0.1 * 0.95) / (0.9 + 50 * 0.1)
    cubes = [(z - neutral) ** 3 for z in (0.0, 0.9, 1.0)]
    return (cubes[1] - cubes[0]) / 3 + 50.0 * (cubes[2] - cubes[1]) / 3


@pytest.mark.parametrize(("film", "bending"), [(None, 1 / 12), (STIFF, composite_bending())])
def test_back_pressure_bends_slab_and_film_as_a_plate(film, bending):
    """Simply supported square plate: 0.0040624 p a^4 / D in its middle (Timoshenko, table 8).

    Here a = 120 h, D = E h^3 b / (1 - nu^2): shear adds some (h / a)^2. Pressure on either face
    does the same.
    """
    layer = FreeSlab(16, 16, 120.0, 120.0, 1.0, 0.49, film)
    expected_mm = 0.0040624 * 1e-9 * 120.0**4 * (1 - 0.49**2) / bending
    for preload in (Preload(coated=1e-9), Preload(touched=1e-9)):
        result = preload.deflection(layer)
        assert result[7:9, 7:9].max() < expected_mm
        assert result[7:9, 7:9].mean() == pytest.approx(expected_mm, rel=8e-3)
    both = Preload(touched=1e-9, coated=-1e-9).deflection(layer)
    assert np.abs(both).max() < 2e-3 * expected_mm
    node = layer.opposite_at_nodes(np.zeros((16, 16)), 16, 16, uniform_load=1e-9)
    assert node[8, 8] == pytest.approx(expected_mm, rel=6e-3)
    assert not Preload(1e-9, 1e-9).deflection(BondedLayer(16, 16, 9.0, 9.0, 1.0, 0.4)).any()


def test_a_coat_film_thins_by_its_own_modulus():
    """nu 0: an oedometer modulus of E. A quarter is film, twice as stiff: 3/4 + 1/8 = 0.875."""
    layer = BondedLayer(16, 16, 9.0, 9.0, 2.0, 0.0, CoatFilm(0.25, 2.0, 0.0))
    result = layer.deflect(np.full((16, 16), 0.01))
    np.testing.assert_allclose(result, 0.01 * 2.0 * 0.875, rtol=1e-9)


def test_nodes_of_a_face():
    """0.5 mm at 0.05 mm: 11 nodes from rim to rim; 0.72 mm takes 15 intervals."""
    fine = load(relief_pitch_mm=0.05)
    np.testing.assert_allclose(face_nodes(0.5, fine), 0.05 * np.arange(-5.0, 6.0), atol=1e-15)
    assert face_nodes(0.72, fine).size == 16


def test_fields_go_on_beyond_both_rims():
    """Periodic: the values of one side continue on the opposite side. Odd: with changed sign."""
    field = np.arange(1.0, 31.0).reshape(5, 6)
    wide, (y, x) = wrapped(field, (np.arange(5.0), 0.5 * np.arange(6.0)))
    assert wide.shape == (13, 14)
    np.testing.assert_array_equal(wide[4, :4], field[0, 2:])
    np.testing.assert_array_equal(wide[4, -4:], field[0, :4])
    np.testing.assert_array_equal(wide[-4:, 4], field[:4, 0])
    np.testing.assert_allclose(y, np.arange(-4.0, 9.0))
    np.testing.assert_allclose(x[[0, -1]], [-2.0, 4.5])
    assert widened(np.array([1.0, 3.0])).tolist() == [-7, -5, -3, -1, 1, 3, 5, 7, 9, 11]
    odd = mirrored(field)
    np.testing.assert_array_equal(odd[4:-4, 4:-4], field)
    np.testing.assert_array_equal(odd[4:9, 3], -field[:, 0])
    np.testing.assert_array_equal(odd[4:9, -4], -field[:, -1])
    np.testing.assert_array_equal(odd[3, 4:10], -field[0])
    np.testing.assert_array_equal(odd[-4, 4:10], -field[-1])
    assert (odd[3, 3], odd[-4, -4], odd[3, -4]) == (field[0, 0], field[-1, -1], field[0, -1])


def test_between_cells_a_face_is_interpolated_but_never_below_the_specimen():
    """Cells of a plane, nodes between them: exact there; where the specimen is higher, its own."""
    cells = np.arange(-3.5, 4.0)
    plane = 0.1 * cells[None, :] - 0.02 * cells[:, None]
    nodes = np.linspace(-3.0, 3.0, 5)
    below = np.full((5, 5), -np.inf)
    result = touched_at_nodes(plane, (cells, cells), (nodes, nodes), below)
    np.testing.assert_allclose(result, 0.1 * nodes[None, :] - 0.02 * nodes[:, None], atol=1e-12)
    below[2, 3], below[0, 0] = 0.9, -0.9
    result = touched_at_nodes(plane, (cells, cells), (nodes, nodes), below)
    assert (result[2, 3], result[0, 0]) == (0.9, pytest.approx(-0.24))


def test_a_coarse_cell_lies_between_four_fine_ones():
    """Rows and columns 1 and 2 of every four: of eight columns (9 + 10 + 17 + 18) / 4 = 13.5."""
    result = _between_cells(np.arange(32.0).reshape(4, 8))
    assert result.tolist() == [[13.5, 17.5]]


def test_the_touched_coat_is_the_ball_at_its_nodes():
    """Gel on a window: within the contact the coat is on the ball at every node, to 0.6 um."""
    gel = slab(layout="contact_face", thickness_mm=3.0, poisson_ratio=0.45)
    pressing = load(depth_mm=0.3, solver_pitch_mm=0.25, relief_pitch_mm=0.05)
    ball = Ball(diameter_mm=8.0)
    result = press(ball, gel, pressing)
    height = shape_of(ball).height_above_lowest(result.face_x_mm, result.face_y_mm)
    residual = result.face_z_mm - (result.depth_mm - height)
    x, y = np.meshgrid(result.face_x_mm, result.face_y_mm)
    radius_mm = np.sqrt(result.contact.sum() * 0.25**2 / np.pi)
    inside = np.hypot(x, y) < 0.7 * radius_mm
    assert inside.sum() > 50
    assert residual.min() >= 0.0
    assert residual[inside].max() < 6e-4
    assert residual[np.hypot(x, y) > 1.3 * radius_mm].min() > 1e-3


def test_the_size_of_facets():
    """Ten equal triangles of edge 2 mm, sqrt(3) mm^2 each over three points, and ten of edge 6."""
    areas = np.repeat(np.sqrt(3.0) / 4 * np.repeat([4.0, 36.0], 10) / 3, 3)
    nodes = np.zeros((20, 6), np.int64)
    facets = Facets(nodes, np.zeros((60, 3)), areas, areas, sparse.csr_array((60, 6)))
    assert facets.size_mm == pytest.approx(2.0)


def test_how_many_tetrahedra_fill_a_cube():
    """Regular ones of edge 2 mm have 8 / (6 sqrt 2) = 0.94281 mm^3: 1728 mm^3 hold 1832.8."""
    result = count_estimate(trimesh.creation.box([12.0] * 3), lambda at: np.full(len(at), 2.0))
    assert result == pytest.approx(1832.8, rel=1e-4)


def test_cells_grow_away_from_a_zone():
    """0.2 mm at the zone, 0.35 mm more per mm: 0.9 mm at 2 mm; 1 mm at most."""
    sizing = graded_towards(np.zeros((1, 3)), 0.2, 1.0)
    result = sizing(np.array([[0.0, 0.0, 0.0], [0.0, 1.2, 1.6], [0.0, 0.0, 99.0]]))
    np.testing.assert_allclose(result, [0.2, 0.9, 1.0])
