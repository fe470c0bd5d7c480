"""Splines, graded cells, stretches and the sheet's validity, computed by hand."""

import numpy as np
import pytest

from twin.mechanics.sheet.splines import SplineLine, graded_line, subdivided
from twin.mechanics.sheet.surface import faces_of
from twin.mechanics.validity import assess_sheet, max_slope_deg, sheet_height_error_mm

LINE = SplineLine(np.arange(6.0))
GRADED = SplineLine(np.array([0.0, 1.0, 3.0, 4.0]))


def test_a_quadratic_spline_in_the_middle_of_a_cell():
    """1/8, 3/4, 1/8 of the functions 2, 3, 4; slopes -1/2, 0, 1/2; bends 1, -2, 1."""
    place = np.array([2.5])
    for derivative, known in enumerate(([0.125, 0.75, 0.125], [-0.5, 0.0, 0.5], [1.0, -2.0, 1.0])):
        result = LINE.matrix(place, derivative)
        np.testing.assert_allclose(result, [[0.0, 0.0, *known, 0.0, 0.0]], atol=1e-12)


def test_a_spline_at_its_ends_and_on_wider_cells():
    """Open ends: only the first function is 1 at 0. At the knot 1 of widths 1 and 2 the two that
    meet have the shares 2/3 and 1/3 (knots 0 0 0 1 3 4: (3 - 1) / (3 - 0)).
    """
    np.testing.assert_allclose(GRADED.matrix(np.array([0.0, 4.0]))[:, [0, -1]], np.eye(2))
    np.testing.assert_allclose(
        GRADED.matrix(np.array([1.0])), [[0, 2 / 3, 1 / 3, 0, 0]], atol=1e-12
    )
    np.testing.assert_allclose(GRADED.greville, [0.0, 0.5, 2.0, 3.5, 4.0])
    places = np.linspace(0.0, 4.0, 17)
    np.testing.assert_allclose(GRADED.matrix(places) @ GRADED.greville, places)
    np.testing.assert_allclose(GRADED.matrix(places).sum(axis=1), 1.0)
    np.testing.assert_allclose(GRADED.matrix(places, 1) @ GRADED.greville, 1.0)


def test_two_gauss_points_a_cell_integrate_cubics():
    """The integral of x^3 from 0 to 4 is 64; the weights add up to 4."""
    points, weights = GRADED.points, GRADED.weights
    assert weights.sum() == pytest.approx(4.0)
    assert np.sum(weights * points**3) == pytest.approx(64.0)
    np.testing.assert_allclose(GRADED.table[:, :, 0].sum(axis=-1), 1.0)


def test_a_spline_through_anothers_values():
    """A straight line remains straight, on any cells."""
    result = LINE.interpolated_from(SplineLine(np.array([0.0, 2.0, 5.0])))
    np.testing.assert_allclose(result @ [0.0, 1.0, 3.5, 5.0], LINE.greville, atol=1e-12)


def test_cells_are_parted_evenly():
    result = subdivided(np.array([0.0, 1.0, 3.0]), np.array([2, 4]))
    np.testing.assert_allclose(result, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])


def test_cells_grow_by_a_fifth_of_the_distance():
    """Cells of 0.1 mm to 1 mm from the middle, then 0.1 + 0.2 d wide: 5 ln(1 + 2 d) of them.

    Over 4.0 mm 10.99, so 11 a side; over 4.02 mm 11.01, so 12. Where rim and widest cell are as
    narrow as the middle, all are alike.
    """
    for end_mm, per_side in ((5.0, 11), (5.02, 12)):
        line = graded_line((-end_mm, end_mm), (-1.0, 1.0), 0.1, 2.0, 2.0)
        assert line.cells == 20 + 2 * per_side
        np.testing.assert_allclose(line.edges, -line.edges[::-1], atol=1e-12)
        assert (line.edges[0], line.edges[-1]) == pytest.approx((-end_mm, end_mm))
    even = graded_line((-2.0, 2.0), (-1.0, 1.0), 0.1, 0.1, 0.1)
    np.testing.assert_allclose(np.diff(even.edges), 0.1)


def test_cells_at_a_held_rim_are_narrow():
    """0.1 mm at the rim too: over 4 mm 2 * 5 ln(1 + 2 * 2) = 16.09 cells, so 17 a side."""
    line = graded_line((-5.0, 5.0), (-1.0, 1.0), 0.1, 0.1, 2.0)
    assert line.cells == 20 + 2 * 17
    widest = graded_line((-5.0, 5.0), (-1.0, 1.0), 0.1, 0.1, 0.25)
    # 5 ln 2.5 = 4.58 up to 0.25 mm, 2.5 mm of these, and 4.58 down again: 19.16.
    assert widest.cells == 20 + 2 * 20


def test_principal_stretches():
    """Twice as long and half as wide; and a simple shear by 1: the golden ratio and its inverse."""
    along_x = np.array([[2.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    along_y = np.array([[0.0, 0.5, 0.0], [1.0, 1.0, 0.0], [0.0, 3.0, 0.0]])
    surface = np.stack((np.zeros((3, 3)), along_x, along_y), axis=1)[None]
    golden = (1 + 5**0.5) / 2
    expected = [[2.0, 0.5], [golden, 1 / golden], [3.0, 0.5]]
    np.testing.assert_allclose(faces_of(surface, 0.2).stretch[0], expected)


def test_faces_of_a_stretched_sheet():
    """Twice as long: half as thick, and each face is half of that from the middle surface."""
    surface = np.array([[[[1.0, 2.0, 3.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]])
    faces = faces_of(surface, 0.2)
    assert faces.thickness_mm[0, 0] == pytest.approx(0.1)
    np.testing.assert_allclose(faces.upper_mm[0, 0], [1.0, 2.0, 3.05])
    np.testing.assert_allclose(faces.lower_mm[0, 0], [1.0, 2.0, 2.95])


def test_slopes_within_a_contact():
    """0.1 mm up per 0.2 mm: 26.565 degrees; outside the outline, where a height field ends, 90."""
    height = 0.1 * np.arange(6.0) * np.ones((4, 1))
    contact = np.zeros((4, 6), bool)
    contact[1:3, 2:4] = True
    assert max_slope_deg(height, contact, 0.2) == pytest.approx(26.5650512)
    height[:, 4:] = np.inf
    assert max_slope_deg(height, contact, 0.2) == 90.0


def sheet(thickness_mm, bend_1_mm, **more):
    plain = {
        "depth_mm": 1.0, "radius_mm": 4.0, "deflection_mm": 0.5, "slope_deg": 30.0,
        "margin_to_rim_mm": 3.0, "cells_across": 100.0, "ridge_pitch_mm": None,
    }  # fmt: skip
    return assess_sheet(thickness_mm=thickness_mm, bend_1_mm=bend_1_mm, **plain | more)


def test_the_validity_of_a_sheet():
    """0.2 mm bent to 4 mm: 0.05 of its radius; 1 mm travel is 5 thicknesses, a quarter of R."""
    result = sheet(0.2, 0.25)
    assert result.depth_over_thickness == pytest.approx(5.0)
    assert result.depth_over_radius == pytest.approx(0.25)
    assert result.deflection_over_thickness == pytest.approx(2.5)
    assert result.height_error_mm == sheet_height_error_mm(0.2, 0.25)
    assert sheet_height_error_mm(0.4, 0.25) == pytest.approx(4 * sheet_height_error_mm(0.2, 0.25))
    assert result.warnings == ()
    thick = sheet(0.6, 0.5).warnings
    assert len(thick) == 1
    assert thick[0].startswith("the sheet is 0.30 of its radius of bending thick")
    assert "above 0.25" in thick[0]
    ridges = sheet(0.2, 0.25, ridge_pitch_mm=0.3, cells_across=3.0).warnings
    assert [line.split(":")[0].split(" ")[0] for line in ridges] == ["ridges", "the"]
