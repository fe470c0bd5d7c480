"""Cards at the head of a page: a missed target is never green, and is marked "missed"."""

from types import SimpleNamespace

import pytest

from reconstruction.evaluate.conformity import CombinedUncertainty
from twin.config import load_experiment
from twin.report.contact import _sensor
from twin.report.object import object_verdict
from twin.report.page import JudgedTarget, judged, target
from twin.results.figures import Figures
from twin.results.object_score import MeasuredQuantity
from twin.results.quantities import measurands_of

MET = {
    "wrong_order_pixels": 0,
    "completeness": 0.99,
    "error_over_sigma": 1.0,
    "saturated_share": 0.0,
    "filter_bias_share": 0.0,
    "filter_bias_um": 0.1,
    "z_rmse_um": 2.0,
}


def card(**figures):
    score = SimpleNamespace(against_truth=SimpleNamespace(points=9))
    return _sensor(SimpleNamespace(figures=Figures(MET | figures), score=score))


def test_all_targets_met():
    assert card().grade == "good"
    assert not any("missed" in line for line in card().reasons)


@pytest.mark.parametrize(
    ("missed", "grade"),
    [
        ({"wrong_order_pixels": 3}, "poor"),
        ({"completeness": 0.9}, "check"),
        ({"error_over_sigma": 1.4}, "check"),
        ({"error_over_sigma": None}, "check"),
        ({"saturated_share": 0.01}, "check"),
        ({"filter_bias_share": 0.3}, "check"),
    ],
)
def test_one_missed_target_is_not_good_and_says_missed(missed, grade):
    """The bias of the phase filter missed its target on a green card."""
    verdict = card(**missed)
    assert verdict.grade == grade
    assert [line.startswith("missed: ") for line in verdict.reasons].count(True) == 1


def object_card(value: float | None, u_um: float, points_um: float = 1.0, **settings):
    """Return the card of a ball of 4 mm that was measured as `value`."""
    case = load_experiment("examples/wrapped_balls", settings)
    (request, *_) = measurands_of(case)
    ball = MeasuredQuantity(
        request, 4.0, value, 4.1, CombinedUncertainty(u_um), None, None, "not touched" * (not value)
    )
    figures = {"object_rms_um": points_um, "object_p95_um": points_um, "object_coverage_share": 0.5}
    score = SimpleNamespace(quantities=(ball,))
    shown = {"experiment": case, "object": score, "figures": Figures(figures)}
    return object_verdict(SimpleNamespace(**shown, compensation=None))


def test_a_length_within_its_uncertainty_is_good():
    verdict = object_card(4.0005, 1.0)
    assert verdict.grade == "good"
    assert verdict.headline.startswith("radius 1: 4.0005")
    assert not any("missed" in line for line in verdict.reasons)


@pytest.mark.parametrize(
    ("value", "u_um", "points_um"), [(3.9711, 0.31, 1.0), (None, 0.3, 1.0), (4.0, 1.0, 60.0)]
)
def test_a_length_beyond_its_uncertainty_is_not_good(value, u_um, points_um):
    """2.9 um of error with U = 0.6 um was green, because the points deviate by less than 50 um."""
    verdict = object_card(value, u_um, points_um)
    assert verdict.grade == "check"
    assert [line.startswith("missed: ") for line in verdict.reasons].count(True) == 1


def test_the_worst_target_is_the_grade():
    targets = [target("a", met=True), target("b", met=False), JudgedTarget("c", "poor")]
    verdict = judged("?", "!", targets, ("d",))
    assert verdict.grade == "poor"
    assert verdict.reasons == ("a", "missed: b", "missed: c", "d")
    assert judged("?", "!", []).grade == "good"
