"""Which designs are best: only those that meet their constraints and tolerances."""

from functools import partial

import pytest

from tests.study.synthetic import Fake
from twin.cli import run
from twin.config import vary
from twin.config.study import Constraint, Objective
from twin.report.study import write_study
from twin.study import sweep as module
from twin.study.feasibility import beyond_tolerances
from twin.study.measuring import NOMINAL_CONDITIONS, CaseResult
from twin.study.optimise import _search_values
from twin.study.record import StudyRecord
from twin.study.remarks import remarks_of
from twin.study.store import Store
from twin.study.sweep import sweep
from twin.study.table import best_rows, read_table
from twin.study.workers import local_workers

ALBEDO = {"path": "coating.base_albedo", "name": "albedo", "values": [0.1, 0.3, 0.5, 0.7]}
ERROR = Objective(metric="z_rmse_um")
TOLERANCE = {"name": "ball", "quantity": "radius", "plus_minus_um": 5.0}


class Judged(Fake):
    """The error is the albedo; its radius is within 5 um where that is 0.5 or more.

    At 0.5 noise of a seed may take it out: only seed 8 does. Shinier coats are warned of.
    """

    def __call__(self, experiment, conditions=NOMINAL_CONDITIONS):
        albedo = experiment.coating.base_albedo
        margin = 100.0 * (albedo - 0.45) - (10.0 if experiment.seed == 8 else 0.0)
        verdict = "within tolerance" if margin >= 0 else "cannot tell"
        figures = {
            "z_rmse_um": albedo,
            "object_ball_margin_um": margin,
            "object_ball_verdict": verdict if margin > -20 else "not within tolerance",
            "object_points": 0 if albedo == 0.1 else 50,
            "mechanics_model": "sheet",
            "warnings": [f"the contact is {1 + 10 * albedo:.0f} cells wide"]
            if albedo > 0.2
            else [],
        }
        return CaseResult(figures)


@pytest.fixture
def judged(base):
    return vary(base, {"measurand": [TOLERANCE], "seed": 7})


@pytest.fixture
def swept(study_of, judged, tmp_path):
    def make(**keys):
        study = study_of(ALBEDO, objectives=(ERROR,), **keys)
        record = StudyRecord(study, judged)
        return sweep(record, tmp_path / "out", local_workers(1), make_measurer=Judged)

    return make


def test_a_design_beyond_its_tolerance_is_not_the_best(swept, tmp_path, capsys):
    """Setup: the smallest errors are beyond tolerance. Expected: the best is the best within."""
    swept()
    rows = read_table(tmp_path / "out").rows
    assert [row["feasible"] for row in rows] == [False, False, True, True]
    assert [row["albedo"] for row in best_rows(rows, [ERROR])] == [0.5]
    assert rows[1]["reason"] == (
        "not feasible: object_ball within tolerance: cannot tell, 15 um short, with U"
    )
    assert run(["sweep", "best", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert "2 of 4 finished cases feasible (2 miss: object_ball within tolerance)" in said.err
    assert "│ 0.5 " in said.out
    assert "│ 0.1 " not in said.out
    page = write_study(tmp_path / "out").read_text(encoding="utf-8")
    assert "Feasible: all tolerances of [[measurand]] are met, with U." in page


def test_where_no_design_is_feasible_the_nearest_are_shown_as_such(swept, tmp_path, capsys):
    swept(constraint=(Constraint(value="z_rmse_um", at_most=0.2),))
    assert run(["sweep", "best", str(tmp_path / "out")]) == 1
    said = capsys.readouterr()
    assert "no case is feasible; the nearest to the limits first" in said.err
    assert "3 miss: z_rmse_um <= 0.2; 2 miss: object_ball within tolerance" in said.err
    assert "not feasible:" in " ".join(said.out.split())
    page = write_study(tmp_path / "out").read_text(encoding="utf-8")
    assert "No case is feasible: 0 of 4 finished cases feasible" in page
    assert "best first" not in page


def test_a_lucky_repeat_is_no_feasible_design(swept, tmp_path):
    """Albedo 0.5 is within with seed 7 and not with seed 8: the design is not, and 0.7 is best."""
    swept(repeats=2)
    rows = read_table(tmp_path / "out").rows
    assert {row["feasible"] for row in rows if row["albedo"] == 0.5} == {False}
    assert best_rows(rows, [ERROR])[0]["albedo"] == 0.7
    assert any("every repeat of the design" in row["reason"] for row in rows)


def test_a_search_receives_the_excess_over_tolerances(swept, study_of, judged, tmp_path):
    swept()
    table = read_table(tmp_path / "out")
    plan = type("Plan", (), {"objectives": (ERROR,)})
    excess = [
        _search_values(table.record.study, plan, [case], Store(tmp_path / "out"))[1]
        for case in table.cases
    ]
    assert excess == [[pytest.approx(item)] for item in (35.0, 15.0, 0.0, 0.0)]
    assert beyond_tolerances({"object_x_verdict": "cannot tell"}) == float("inf")
    assert beyond_tolerances({"object_x_verdict": "within tolerance", "object_x_margin_um": 1}) == 0


def test_a_value_at_the_bound_is_within_though_it_is_rounded():
    """0.1 + 2 x 0.1 is 0.30000000000000004; one part in a million is beyond."""
    bound = Constraint(value="x", at_most=0.3)
    assert bound.holds_for(0.1 + 2 * 0.1)
    assert not bound.holds_for(0.3 * (1 + 1e-6))
    assert Constraint(value="x", at_least=0.0).excess(-1e-12) > 0


def test_warnings_of_cases_reach_terminal_and_page(swept, tmp_path, capsys, monkeypatch, study_of):
    """Each kind once, with how many cases have it, an example and a remedy."""
    outcome = swept()
    texts = [item.in_words(outcome.finished) for item in outcome.remarks]
    assert texts == [
        "3 of 4 cases: the contact is 4 cells wide (numbers of the first of them)",
        "1 of 4 cases: no point of the object (no contact in view of the camera): "
        "raise press.back_pressure_kpa, or the travel, press.depth_mm",
    ]
    page = write_study(tmp_path / "out").read_text(encoding="utf-8")
    assert "Warnings of the cases" in page
    assert all(f"<li>{text}</li>" in page for text in texts)
    file = tmp_path / "study.toml"
    file.write_text(
        'name = "s"\nbase = "examples/slab_balls"\nset.camera.binning = 4\n'
        '[[axis]]\npath = "coating.base_albedo"\nvalues = [0.1, 0.3]\n'
    )
    monkeypatch.setattr(module, "sweep", partial(module.sweep, make_measurer=Judged))
    assert run(["sweep", str(file), "-o", str(tmp_path / "cli"), "-j", "1"]) == 0
    said = capsys.readouterr().err
    assert "twin: 1 of 2 cases: the contact is 4 cells wide (case " in said
    assert "twin: 1 of 2 cases: no point of the object" in said


def test_remarks_of_results_without_any_point():
    unlit = {
        "points": 0,
        "lit_pixels": 9,
        "object_points": 0,
        "object_a_why": "nothing",
        "warnings": [],
    }
    unseen = {"points": 0, "lit_pixels": 0, "warnings": []}
    fit = {"points": 9, "lit_pixels": 9, "rod_width_why": "no crest", "true_rig_rod_width_why": "x"}
    texts = [item.text for item in remarks_of({"a": unlit, "b": unseen, "c": fit})]
    assert texts[0].startswith("no valid point: ")
    assert texts[1].startswith("no pixel that ought to give a point: move specimen or camera")
    assert texts[2:] == ["rod_width has no value: no crest"]
