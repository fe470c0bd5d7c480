"""Dimensions and meshes of a few points, computed by hand."""

import numpy as np
import pytest

from reconstruction.evaluate.deviation import Deviations, normals_of
from reconstruction.evaluate.plane import bar_width, flatness, step_height
from reconstruction.evaluate.surface import surface_mesh
from reconstruction.triangulation import PointMap


def test_a_band_of_95_percent_moves_with_the_percent_round_its_ends():
    """Deviations 0 to 1000: the ends are 25 and 975, each moves as the mean of 21 next to it."""
    values = np.random.default_rng(1).permutation(np.arange(1001.0))
    estimate = Deviations(values, np.zeros((1001, 3)), 0.0, 0.0).form(np.ones(1001))
    assert estimate.value == pytest.approx(950.0)
    low, high = (values >= 15) & (values <= 35), (values >= 965) & (values <= 985)
    np.testing.assert_allclose(estimate.slope[low], -1 / 21)
    np.testing.assert_allclose(estimate.slope[high], 1 / 21)
    assert not estimate.slope[~(low | high)].any()


def test_a_root_mean_square_moves_with_each_deviation():
    """3 and -4 mm: 3.5355 mm; by 3 / (2 * 3.5355) per mm of the first, at half its slope."""
    estimate = Deviations(np.array([3.0, -4.0]), np.zeros((2, 3)), 0.0, 0.0).rms(
        np.array([0.5, 1.0])
    )
    assert estimate.value == pytest.approx(12.5**0.5)
    np.testing.assert_allclose(estimate.slope, [0.5 * 3 / (2 * 12.5**0.5), -4 / (2 * 12.5**0.5)])


def test_normals_are_the_slopes_of_the_distance():
    def ball(at):
        return np.linalg.norm(at, axis=1) - 1.0

    estimate = normals_of(np.array([[0.6, 0.0, 0.8], [0.0, -2.0, 0.0]]), ball)
    np.testing.assert_allclose(estimate, [[0.6, 0.0, 0.8], [0.0, -1.0, 0.0]], atol=1e-6)


@pytest.mark.parametrize(("longest_mm", "triangles"), [(4.95, 20), (5.05, 18)])
def test_triangles_five_times_as_long_as_the_typical_edge_are_cut(longest_mm, triangles):
    """Points of 1 mm pitch: ten squares; over a jump the diagonal of one is so long."""
    x, y = np.meshgrid(np.arange(11.0), [0.0, -1.0])
    z = np.where(x > 4.5, np.sqrt(longest_mm**2 - 2.0), 0.0)
    points = np.stack([x, y, z], axis=-1)
    whole = PointMap(points, np.zeros_like(points), np.zeros(x.shape, np.uint8), np.eye(4))
    assert len(surface_mesh(whole).triangles) == triangles
    assert len(surface_mesh(whole, 1.5).triangles) == 18


def test_a_step_between_two_edges():
    """Ridge from -3 to 3, W = 6: 0.5 high within +-1, ground from 5 to 9; points between and
    beyond are not used.
    """
    s = np.arange(-12.0, 12.01, 0.25)
    z = np.select([np.abs(s) <= 1.0, (np.abs(s) >= 5.0) & (np.abs(s) <= 9.0)], [0.5, 0.0], 7.0)
    assert step_height(s, z + 0.01 * s, -3.0, 3.0).height_mm == pytest.approx(0.5)
    assert step_height(s, z + 0.01 * s, -3.0, 3.0).rms_mm == pytest.approx(0.0, abs=1e-12)


def test_a_bar_at_a_fraction_of_its_height():
    """A trapezoid 4 wide on top and 8 at its foot: 6 at half its height, 5 at three quarters."""
    s = np.arange(-20.0, 20.01, 0.125)
    z = np.clip((4.0 - np.abs(s - 1.0)) / 2.0, 0.0, 1.0)
    for fraction, width_mm in ((0.5, 6.0), (0.75, 5.0)):
        estimate = bar_width(s, z, fraction)
        assert estimate.width_mm == pytest.approx(width_mm)
        assert (estimate.left_mm + estimate.right_mm) / 2 == pytest.approx(1.0)
        assert estimate.height_mm == 1.0


def test_flatness_of_four_corners():
    """Corners at +-1 and -+1 um of a square: no tilt, peak to valley 2 um, RMS 1 um."""
    points = np.array([[0, 0, 1e-3], [1, 0, -1e-3], [0, 1, -1e-3], [1, 1, 1e-3]])
    estimate = flatness(points)
    assert estimate.peak_to_valley_mm == pytest.approx(2e-3)
    assert estimate.rms_mm == pytest.approx(1e-3)
    np.testing.assert_allclose(estimate.plane.normal, [0.0, 0.0, 1.0], atol=1e-12)
