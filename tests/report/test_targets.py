"""Cards at the head of a page: a missed target is never green, and is marked "missed"."""

from types import SimpleNamespace

import pytest

from twin.report.contact import _sensor
from twin.report.page import JudgedTarget, judged, target
from twin.results.figures import Figures

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


def test_the_worst_target_is_the_grade():
    targets = [target("a", met=True), target("b", met=False), JudgedTarget("c", "poor")]
    verdict = judged("?", "!", targets, ("d",))
    assert verdict.grade == "poor"
    assert verdict.reasons == ("a", "missed: b", "missed: c", "d")
    assert judged("?", "!", []).grade == "good"
