"""The largest value of an axis at which all conditions are met, against its closed form."""

import pytest
from pydantic import ValidationError

from reconstruction.errors import InputError
from tests.study.synthetic import Fake
from twin.cli import run
from twin.config import vary
from twin.report.study import write_study
from twin.report.study_limits import limit_sections, limit_sentences, limit_verdicts
from twin.study.axis_limit import axis_limits
from twin.study.checks import check_figures
from twin.study.measuring import NOMINAL_CONDITIONS, CaseResult
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.table import read_table
from twin.study.workers import local_workers

RATE = {"path": "coating.base_albedo", "name": "rate_mm_s", "values": [0.1, 0.2, 0.4, 0.8]}
PERIOD = {"path": "patterns.period_px", "name": "period", "values": [10.0, 20.0]}
LIMIT = {"value": "z_rmse_um", "at_most": 5.0}


class Rising(Fake):
    """Error period x rate, um; seed 8 is 1 um worse; no result at an albedo of 0.8, period 10."""

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        rate, period = experiment.coating.base_albedo, experiment.patterns.period_px
        if (rate, period) == (0.8, 10.0):
            raise InputError("motion: found too fast")
        error_um = rate * period + (1.0 if experiment.seed == 8 else 0.0)
        return CaseResult({"z_rmse_um": error_um, "square": error_um**2, "warnings": []})


@pytest.fixture
def limits_of(study_of, base, tmp_path):
    def make(*axes, **keys):
        keys = {"constraint": (LIMIT,), "limit_axis": "rate_mm_s"} | keys
        record = StudyRecord(study_of(*axes, **keys), base.model_copy(update={"seed": 7}))
        sweep(record, tmp_path / "out", local_workers(1), make_measurer=Rising)
        return read_table(tmp_path / "out")

    return make


def test_the_limit_of_a_linear_figure_is_that_of_its_line(limits_of):
    """Error 20 rate = 5 at a rate of 0.25, between the levels 0.2 and 0.4; 8 rate is 4 at 0.4."""
    slow, fast = sorted(axis_limits(limits_of(RATE, PERIOD)), key=lambda limit: limit.value or 1.0)
    assert (slow.settings, slow.met, slow.missed) == ({"period": 20.0}, 0.2, 0.4)
    assert slow.value == pytest.approx(0.25, rel=1e-12)
    assert slow.condition == "z_rmse_um <= 5"
    assert (fast.settings, fast.met, fast.missed, fast.value) == ({"period": 10.0}, 0.4, 0.8, None)
    assert fast.condition == "no result: motion: found too fast"


def test_the_limit_of_a_convex_figure_is_on_the_safe_side(limits_of):
    """Square (20 rate)^2 = 25 at 0.25; the chord from 0.2 (16) to 0.4 (64) crosses at 0.2375."""
    square = {"value": "square", "at_most": 25.0}
    (limit,) = axis_limits(limits_of(RATE, PERIOD | {"values": [20.0]}, constraint=(square,)))
    assert limit.value == pytest.approx(0.2375, rel=1e-12)


def test_of_several_conditions_the_first_that_is_missed_counts(limits_of):
    bounds = (LIMIT, {"value": "square", "at_most": 20.0})
    (limit,) = axis_limits(limits_of(RATE, PERIOD | {"values": [20.0]}, constraint=bounds))
    assert limit.condition == "square <= 20"
    assert limit.value == pytest.approx(0.2 + 0.2 * 4.0 / 48.0)


def test_every_repeat_has_to_meet_the_conditions(limits_of):
    """The worse repeat, 20 rate + 1, is 5 at 0.2: the level itself."""
    (limit,) = axis_limits(limits_of(RATE, PERIOD | {"values": [20.0]}, repeats=2))
    assert (limit.met, limit.value) == (0.2, pytest.approx(0.2))


def test_limits_outside_the_levels_and_below_a_second_limit(limits_of):
    """All levels meet 100 um, none meets 1 um, and a lower limit is missed by slow rates."""
    one = PERIOD | {"values": [20.0]}
    (all_met,) = axis_limits(limits_of(RATE, one, constraint=({**LIMIT, "at_most": 100.0},)))
    assert (all_met.met, all_met.missed, all_met.value) == (0.8, None, None)
    none_met = limits_of(RATE, one, constraint=({**LIMIT, "at_most": 1.0},))
    assert limit_sentences(none_met) == ["period 20 px: rate below 0.1 mm/s (z_rmse_um <= 1)"]
    lower = {"value": "z_rmse_um", "at_least": 3.0}
    (again,) = axis_limits(limits_of(RATE, one, constraint=(lower,)))
    assert (again.met, again.met_again) == (None, (0.2, 0.4, 0.8))


def test_page_and_command_state_the_limits(limits_of, tmp_path, capsys):
    """The verdict of a study without objectives is the design of the largest rate."""
    table = limits_of(RATE, PERIOD)
    page = write_study(tmp_path / "out").read_text()
    assert '<section id="limits">' in page
    assert "Up to which rate are all conditions met?" in page
    assert (tmp_path / "out" / "figures" / "limits.png").is_file()
    sentence = "period 20 px: rate 0.25 mm/s, between 0.2 and 0.4 mm/s (z_rmse_um <= 5)"
    assert limit_sentences(table)[-1] == sentence
    assert run(["sweep", "best", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert sentence in printed
    assert "Build this: rate 0.4 mm/s, period 10 px" in printed


def test_a_study_without_the_key_keeps_its_page(limits_of):
    table = limits_of(RATE, PERIOD, limit_axis=None, objectives=({"metric": "z_rmse_um"},))
    assert "limit_axis" not in table.record.study.model_dump()
    assert not axis_limits(table)
    assert not limit_verdicts(table)
    assert not [*limit_sections(table)]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"limit_axis": "mix"}, "found 'mix', allowed the heading of an axis with two or more"),
        ({"sampling": {"method": "sobol", "count": 4}}, "needs sampling.method = 'grid'"),
    ],
)
def test_the_axis_needs_numbers_and_a_grid(study_of, keys, message):
    with pytest.raises(ValidationError, match=message):
        study_of(RATE, **({"limit_axis": "rate_mm_s"} | keys))


def test_the_axis_needs_a_condition(study_of, base):
    record = StudyRecord(study_of(RATE, limit_axis="rate_mm_s"), base)
    with pytest.raises(InputError, match="study without a condition, allowed with one"):
        check_figures(record, record.cases().run)


def test_figures_of_motion_exist_if_a_case_moves(study_of, base):
    """The base is at rest, and the second case moves."""
    still = vary(base, {"camera.exposure_ms": 10.0})
    rates = {"path": "motion.z_mm_s", "values": [0.0, 0.1]}
    record = StudyRecord(study_of(rates, metrics=("moved_px",)), still)
    check_figures(record, record.cases().run)
