"""Points, levels and section of an object, small enough to be counted by hand."""

import numpy as np
import pytest

from reconstruction.errors import FitError
from reconstruction.evaluate.estimates import FittedDimension
from tests.results.test_object_score import experiment, score_of
from twin.results.measurands.step_height import levels
from twin.results.object_fits import require_determined
from twin.results.object_points import Heights, ObjectPoints
from twin.results.object_score import tolerance_of


def points_of(count, sigma_mm=None, together=1.0):
    some = np.zeros((count, 3))
    some[:, 2] = np.arange(count)
    sigma = None if sigma_mm is None else np.full(count, sigma_mm)
    return ObjectPoints(some, sigma, np.ones(count, bool), np.ones(count, bool), together)


@pytest.mark.parametrize(("count", "left", "together"), [(2500, 2500, 9.0), (5001, 1667, 3.0)])
def test_every_nth_point_is_enough(count, left, together):
    """5001 points are more than twice 2500: every third is left, and shares a third as much."""
    thinned = points_of(count, together=9.0).thinned()
    assert len(thinned.points_mm) == left
    assert thinned.together == together
    assert thinned.points_mm[1, 2] == count // left


def test_noise_of_a_mean_of_four():
    """Slopes of 1/4: independent 2 um / sqrt(4) = 1 um; pairs share an error: 1.41; all four: 2.

    Without a sigma the spread of the residuals (here 3 um) is one error common to all.
    """
    residuals = np.array([3.0, -3.0, 3.0, -3.0]) * 1e-3
    mean = FittedDimension(0.0, np.full(4, 0.25), residuals, np.ones(4, bool))
    noise_mm = [points_of(4, 2e-3, n).noise_mm(mean) for n in (1.0, 2.0, 99.0)]
    assert noise_mm == pytest.approx([1e-3, np.sqrt(2.0) * 1e-3, 2e-3])
    assert points_of(4).noise_mm(mean) == pytest.approx(3e-3)


def test_what_noise_leaves_open_by_more_than_its_points_extend_is_no_measurement():
    """A groove that the coat does not show had a width of some millimetres +- 524 m."""
    points_mm = np.array([[0.0, -1.0, 9.0], [3.0, 1.0, 0.0]])
    require_determined("width", 3.0, points_mm)
    with pytest.raises(FitError, match=r"^width: not determined, .* 3\.01 mm .* the 3 mm that"):
        require_determined("width", 3.01, points_mm)
    require_determined("coverage", 0.0, points_mm[:0])


def test_a_point_lies_in_the_nearest_cell():
    grid = Heights(np.array([1.0, 1.5, 2.0]), np.array([-1.0, -0.5]), np.zeros((2, 3)), 0.5)
    rows, cols = grid.cells_of(np.array([[1.26, -0.76], [0.0, 9.0], [1.7, -0.74]]))
    assert cols.tolist() == [1, 0, 1]
    assert rows.tolist() == [0, 1, 1]


def test_levels_of_a_ridge_of_five_cells():
    """Cells of 1 mm, ridge over 18 to 22: its middle is 3 from the edge, so W = 6 and W / 3 = 2.

    Kept are 19 to 21 of the ridge, and of the ground the cells 2 to 6 away: five cells a side.
    """
    z = np.zeros((4, 41))
    z[:, 18:23] = 0.1
    z[:, 0] = -np.inf
    upper, lower = levels(Heights(np.arange(41.0), np.arange(4.0), z, 1.0))
    assert np.flatnonzero(upper[2]).tolist() == [19, 20, 21]
    assert np.flatnonzero(lower[2]).tolist() == [*range(12, 17), *range(24, 29)]


def test_a_level_reaches_a_tenth_of_the_step():
    """Of a step of 1 mm: 0.09 mm below the top is upper, 0.11 mm is not, nor is it lower."""
    z = np.zeros((30, 60))
    z[:, :20], z[:, 20:24], z[:, 24:28] = 1.0, 0.91, 0.89
    upper, lower = levels(Heights(np.arange(60.0), np.arange(30.0), z, 1.0))
    # The upper level is 24 wide to its only edge: W = 48, and W / 3 = 16 of it is left out.
    assert np.flatnonzero(upper[0]).tolist() == list(range(9))
    # The ground is 32 wide to its edge: 16 of it are left out, and all beyond 48 of the ridge.
    assert np.flatnonzero(lower[0]).tolist() == list(range(43, 60))


def test_noise_of_a_width_is_that_of_its_cells_where_it_is_crossed():
    """Points at a pitch of 50 um in cells of 75 um, walls of a cell's slope, exact heights.

    Each crossing is known to 75 um / sqrt(12); both together to 30.6 um.
    """
    score = score_of(
        experiment({"kind": "bars", "widths_mm": [2.0, 3.0], "gap_mm": 2.0}), 0.0, 1e-9
    )
    assert score.figures["object_width_1_noise_um"] == pytest.approx(75.0 / np.sqrt(6.0), rel=1e-3)


FLAT = {"kind": "flat", "diameter_mm": 6.0}


def requests_of(quantity, **more):
    middle = {"x_mm": [-2.0, 2.0], "y_mm": [-2.0, 2.0]}
    return [{"name": "one", "quantity": quantity} | middle | more]


def test_deviation_and_form_of_a_flat_face():
    """Raised by 20 um and known to 3 um: deviation 20 um, known to 3 um over the root of n.

    Its form, after the best fit, is 0; half of it raised by 20 um more makes a band of 20 um.
    """
    plain = requests_of("deviation", alignment="none")
    raised = score_of(experiment(FLAT, measurand=plain), 0.02, 3e-3)
    (deviation,) = (q for q in raised.quantities if q.measurand.name == "one")
    assert deviation.value == pytest.approx(20.0, abs=1e-3)
    assert deviation.uncertainty.noise == pytest.approx(
        3.0 / np.sqrt(len(deviation.points_mm)), rel=1e-4
    )
    form = score_of(experiment(FLAT, measurand=requests_of("form")), 0.02, 3e-3)
    assert form.figures["object_one_um"] == pytest.approx(0.0, abs=1e-3)
    ripple = score_of(
        experiment(FLAT, measurand=requests_of("form")), 0.02 * (np.arange(241) % 2), 3e-3
    )
    assert ripple.figures["object_one_um"] == pytest.approx(20.0, abs=0.1)


def test_coverage_counts_pixels():
    score = score_of(experiment(FLAT, measurand=requests_of("coverage", at_least=0.9)), 0.0, 3e-3)
    (coverage,) = (q for q in score.quantities if q.measurand.name == "one")
    assert (coverage.value, coverage.decision) == (1.0, "within tolerance")
    assert coverage.margin == pytest.approx(0.1)


def test_limits_of_a_measurand():
    """Stated one way or the other: about the nominal, from below, from above, as a least share."""

    def limits(**stated):
        tolerance = tolerance_of(experiment(FLAT, measurand=requests_of(**stated)).measurand[0])
        return tolerance and (tolerance.lower, tolerance.upper)

    assert limits(quantity="step_height", plus_minus_um=3.0) == (-3.0, 3.0)
    assert limits(quantity="step_height", lower_um=-2.0) == (-2.0, np.inf)
    assert limits(quantity="form", upper_um=4.0) == (-np.inf, 4.0)
    assert limits(quantity="coverage", at_least=0.9) == (0.9, np.inf)
    assert limits(quantity="step_height") is None
