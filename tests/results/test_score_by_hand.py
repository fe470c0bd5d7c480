"""Scores of a handful of pixels, each figure computed by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from reconstruction.arrays import Reason
from reconstruction.errors import FitError
from reconstruction.photometric import HeightMap
from reconstruction.pipeline import Reconstruction
from reconstruction.triangulation import PointMap
from twin.config import load_experiment
from twin.optics.stack import Truth
from twin.results.balls import SphereScore, region_of, score_sphere
from twin.results.rods import RodSection, middle_of, section_of
from twin.results.score import (
    Scores,
    empty_warnings,
    in_world,
    metrics,
    order_warnings,
    score_heights,
    score_truth,
    wanted_pixels,
    wrong_orders,
)
from twin.shape import Sphere
from twin.specimens import shape_of

SHAPE = (2, 6)
# The first eight pixels have a point, ten are lit.
ERRORS_UM = [10, -10, 20, -20, 50, 40, -30, 100, 0, 0, 7, 7]
SIGMAS_UM = [10, 20, 10, 40, 25, 20, 30, 50, 0, 0, 1, 1]


def image(values, dtype=np.float64):
    return np.array(values, dtype).reshape(SHAPE)


def axis(coordinates_px, bias_share):
    return SimpleNamespace(coordinate_px=image(coordinates_px), bias_share=image(bias_share))


@pytest.fixture
def truth():
    """Two pixels are unlit, and three not on the specimen; the projector lights 100, 200."""
    lit, measured = np.arange(12) < 10, np.arange(12) < 9
    zero = np.zeros((*SHAPE, 3))
    return Truth(
        zero, zero, image([0.0] * 12), image([100.0] * 12), image([200.0] * 12),
        image(lit, bool), image(measured, bool),
    )  # fmt: skip


@pytest.fixture
def reconstruction():
    """Points with these errors of z; columns and rows of which five are off by half a period."""
    points, sigma = np.zeros((*SHAPE, 3)), np.zeros((*SHAPE, 3))
    points[..., 2], sigma[..., 2] = image(ERRORS_UM) / 1e3, image(SIGMAS_UM) / 1e3
    reason = image(np.where((np.arange(12) < 8) | (np.arange(12) > 9), 0, 1), np.uint8)
    columns = [108.9, 109.0, 91.0, 91.1, 100.0, 100.0, 118.0, 100.0, 118.0, 100.0, 118.0, 100.0]
    rows = [200.0, 200.0, 200.0, 200.0, 209.0, 191.5, 218.0, 191.0, 200.0, 200.0, 200.0, 200.0]
    decoded = SimpleNamespace(
        column=axis(columns, [1.0, 0.5, 0, 0, 0, 0, 0, 0.64, 1, 1, 1, 1]),
        row=axis(rows, [1.0] * 12),
        valid=reason == 0,
        axes=("column", "row"),
    )
    return Reconstruction(decoded, PointMap(points, sigma, reason, np.eye(4)))


@pytest.fixture
def fringes():
    return load_experiment("examples/slab_balls")


def test_ten_pixels(fringes, reconstruction, truth):
    """Errors 10, -10, 20, -20, 50, 40, -30, 100 um: sum 160, squares 16000.

    P95 of the sizes 10, 10, 20, 20, 30, 40, 50, 100: 0.65 of the way from 50 to 100. Over sigma 1,
    -1/2, 2, -1/2, 2, 2, -1, 2: median 1.5, their median distance from it is 1/2. Bias: variances
    100, 400 and 2500 um^2 by shares 1, 0.5 and 0.64 make 1900 um^2 of eight pixels.
    """
    scored = score_truth(fringes, reconstruction, truth)
    assert (scored.points, scored.lit_pixels) == (8, 10)
    assert (scored.completeness, scored.good_share) == (0.8, 0.7)
    assert scored.z_bias_um == pytest.approx(20.0)
    assert scored.z_rmse_um == pytest.approx(2000.0**0.5)
    assert scored.z_p95_um == pytest.approx(82.5)
    assert scored.sigma_z_median_um == pytest.approx(22.5)
    assert scored.error_over_sigma == pytest.approx(1.4826 * 0.5)
    assert scored.filter_bias_um == pytest.approx((1900.0 / 8) ** 0.5)
    assert scored.filter_bias_share == 2 / 8


def test_wrong_orders_are_half_a_period_off(fringes, reconstruction, truth):
    """Period 18 px: off by 9 in column (two), in row (two), and in both (one); 8.9 is right.

    Pixels without a point, or that must have none, do not count.
    """
    assert fringes.patterns.period_px == 18.0
    assert wrong_orders(fringes, reconstruction, truth) == 5
    reconstruction.decoded.valid[:] = False
    assert wrong_orders(fringes, reconstruction, truth) is None


def test_wrong_orders_that_make_the_error_are_a_warning(fringes, reconstruction, truth):
    """Of eight points five are wrong. The others err by 10, -20 and 40 um: 26.46 um RMS.

    With them 44.7 um, less than twice as much. With 1000 um for 100 in one of them 354.6 um: so a
    ball on a white stage had 3.9 mm RMS by 42 of 4486 points, without a warning.
    """
    assert order_warnings(fringes, reconstruction, truth) == []
    reconstruction.point_map.points_world_mm[1, 1, 2] = 1.0
    (line,) = order_warnings(fringes, reconstruction, truth)
    assert line == (
        "5 of 8 points have a wrong fringe order and make most of the z error: 354.6 um RMS, 26.46 "
        "without them"
    )
    bare = load_experiment("examples/slab_balls", {"modality": "direct_fpp"})
    (line,) = order_warnings(bare, reconstruction, truth)
    assert "stage and specimen throw on each other" in line


def test_a_measurement_without_a_point_is_a_warning(fringes, reconstruction, truth):
    """Of ten lit pixels seven are saturated, three dark. An exposure of 1000 s had no warning."""
    assert empty_warnings(fringes, reconstruction, truth) == []
    reasons = reconstruction.point_map.mask_reason
    reasons.flat[:10] = [Reason.SATURATED] * 7 + [Reason.DARK] * 3
    (line,) = empty_warnings(fringes, reconstruction, truth)
    assert line.startswith("no point was measured, 70% of the pixels: saturated; ")
    assert "camera.exposure_ms" in line
    nowhere = replace(truth, lit=np.zeros(SHAPE, bool))
    (line,) = empty_warnings(fringes, reconstruction, nowhere)
    assert line.startswith("no pixel shows the lit surface")


def test_a_bare_specimen_ought_to_be_seen_wherever_it_is(fringes, reconstruction, truth):
    """Direct FPP: nine pixels show the specimen, lit or not; eight of them have a point."""
    bare = load_experiment("examples/slab_balls", {"modality": "direct_fpp"})
    assert wanted_pixels(bare, truth).sum() == 9
    assert score_truth(bare, reconstruction, truth).completeness == pytest.approx(8 / 9)
    assert wanted_pixels(fringes, truth).sum() == 10


def height_map(heights_mm, pitch_mm):
    z = np.array(heights_mm, np.float32)
    return HeightMap(z, np.zeros((2, *z.shape), np.float32), np.zeros(z.shape, np.uint8), pitch_mm)


def test_a_height_map_lies_about_the_origin():
    """3 x 4 pixels of 0.5 mm: x from -0.75 to 0.75, y from 0.5 at the top to -0.5."""
    points = in_world(height_map(np.arange(12.0).reshape(3, 4), 0.5))
    np.testing.assert_allclose(points[1, :, 0], [-0.75, -0.25, 0.25, 0.75])
    np.testing.assert_allclose(points[:, 2, 1], [0.5, 0.0, -0.5])
    assert points[2, 3].tolist() == [0.75, -0.5, 11.0]


def test_heights_of_four_pixels_in_the_field():
    """True 0, 1, 2, 3 mm, found 0, 0.5, 1.5, 1: slope 2 / 5; errors 0, -0.5, -0.5, -2 mm.

    Two pixels at the field's ends count, two beyond it do not.
    """
    lamps = load_experiment("examples/gelsight_ball")
    half_x, half_y = lamps.photometric.field_x_mm / 2, lamps.photometric.field_y_mm / 2
    x = np.array([[-half_x, 0.0, 0.0, half_x, half_x + 1e-3, 0.0]])
    y = np.array([[0.0, half_y, -half_y, 0.0, 0.0, -half_y - 1e-3]])
    true = np.stack([x, y, np.array([[0.0, 1.0, 2.0, 3.0, 9.0, 9.0]])], axis=-1)
    every, none = np.ones((1, 6), bool), np.zeros((1, 6))
    truth = Truth(true, true, none, none, none, every, every)
    scored = score_heights(lamps, height_map([[0.0, 0.5, 1.5, 1.0, 0.0, 0.0]], 1.0), truth)
    against = scored.against_truth
    assert (against.points, against.wanted_pixels, against.completeness) == (4, 4, 1.0)
    assert against.height_scale == pytest.approx(0.4)
    assert against.z_bias_um == pytest.approx(-750.0)
    assert against.z_rmse_um == pytest.approx(1e3 * np.sqrt(4.5 / 4))
    assert against.good_share == 0.25
    flat = truth.points_world_mm.copy()
    flat[..., 2] = 1.0
    level = Truth(flat, true, none, none, none, every, every)
    heights = height_map([[0.0, 0.5, 1.5, 1.0, 0.0, 0.0]], 1.0)
    assert score_heights(lamps, heights, level).against_truth.height_scale is None


def test_the_region_of_a_ball_is_a_disc():
    """Ball at (1, 2), 0.5 mm: points at 0.3, 0.4 count, at 0.4, 0.4 or unusable do not."""
    ball = SimpleNamespace(x_mm=1.0, y_mm=2.0)
    offsets = [(0.5, 0.0), (0.0, -0.5), (0.3, 0.4), (0.4, 0.4), (-0.501, 0.0), (0.0, 0.501), (0, 0)]
    points = np.array([[[1.0 + x, 2.0 + y, 0.0] for x, y in offsets]])
    usable = np.array([[True] * 6 + [False]])
    region = region_of(ball, points, usable, 0.5 + 1e-9)
    assert region.tolist() == [[True, True, True, False, False, False, False]]


def test_figures_of_a_ball():
    """Points 4.1 mm round a ball of 4 mm, the true face 4.05: error 0.1 mm, no residuals."""
    rng = np.random.default_rng(3)
    away = rng.normal(size=(1, 40, 3))
    away /= np.linalg.norm(away, axis=2, keepdims=True)
    ball = Sphere(0.0, 0.0, 4.0, 4.0)
    roi = np.ones((1, 40), bool)
    sphere = score_sphere(2, ball, roi, 4.1 * away, 4.05 * away)
    figures = metrics(Scores(_against_nothing(), (sphere,), ("ball 1: nothing",)))
    assert figures["sphere_2_points"] == 40
    assert figures["sphere_2_abs_radius_error_mm"] == pytest.approx(0.1)
    assert figures["sphere_2_radius_mm"] == pytest.approx(4.1)
    assert figures["sphere_2_true_face_radius_mm"] == pytest.approx(4.05)
    assert figures["sphere_2_algebraic_radius_mm"] == pytest.approx(4.1)
    assert figures["sphere_1_radius_mm"] is None
    assert isinstance(sphere, SphereScore)
    few = np.arange(40)[None] < 4
    with pytest.raises(FitError, match="4 points leave no residual"):
        score_sphere(1, ball, few, 4.1 * away, 4.05 * away)
    assert score_sphere(1, ball, few | (np.arange(40) == 4), 4.1 * away, 4.05 * away).measured


def _against_nothing():
    from twin.results.score import TruthScore

    return TruthScore(0, None, None, None, None, None)


def test_a_rod_lies_where_its_pose_says():
    rod = {"kind": "rods", "diameters_mm": [2.0], "x_mm": 0.7, "y_mm": -0.4}
    middle = middle_of(shape_of(load_experiment("examples/slab_balls", {"specimen": rod}).specimen))
    assert middle == pytest.approx((0.7, -0.4))


def test_a_section_averages_its_length_in_bins():
    """Bins of 0.05 mm about the middle (1, 2): three points each make a mean, two are a gap.

    Points 1.001 mm along the rod are not in a length of 2 mm, those at 1.0 are. A mean height is
    at the mean of its points' places.
    """
    across = [0.0, 0.01, -0.02, 0.0, 0.05, 0.06, 0.1, 0.1, 0.11]
    along = [0.0, 1.0, -1.0, 1.001, 0.0, 0.0, 0.5, -0.5, 0.0]
    heights = [1.0, 2.0, 6.0, 99.0, 5.0, 5.0, 7.0, 8.0, 9.0]
    points = np.column_stack([np.add(1.0, across), np.add(2.0, along), heights])
    section = section_of(points, 2.0, (1.0, 2.0))
    np.testing.assert_allclose(section.s_mm, [-0.01 / 3, 0.31 / 3], atol=1e-12)
    np.testing.assert_allclose(section.z_mm, [3.0, 8.0])


def test_valleys_are_the_lowest_points_on_both_sides_of_the_crest():
    """The crest is sought in the middle half: a higher rim at the end is none."""
    z = np.zeros(41)
    z[20], z[15], z[30], z[0], z[40] = 1.0, -0.2, -0.1, 3.0, 2.0
    section = RodSection(np.arange(-20.0, 21.0) * 0.1, z)
    assert section.valleys() == (15, 30)
    with pytest.raises(FitError, match="19 positions with points, 20 needed"):
        RodSection(np.arange(19.0), np.zeros(19)).valleys()
