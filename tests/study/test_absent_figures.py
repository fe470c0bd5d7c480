"""A case without measured points is never the best: its figures are None in table and search."""

import csv
import io

import pytest

from reconstruction.errors import InputError
from tests.study.synthetic import Blind
from twin.config import vary
from twin.config.study import Constraint, Objective, Study
from twin.report.study import write_study
from twin.study import optimise, pictures
from twin.study.cases import cases_of, quantity
from twin.study.derived import with_derived
from twin.study.measuring import CaseResult
from twin.study.record import StudyRecord, read_record
from twin.study.sensitivity import effects_of, without
from twin.study.sweep import sweep
from twin.study.table import best_rows, csv_text, ranked_rows, read_table, write_parquet
from twin.study.workers import local_workers

ALBEDO = {"path": "coating.base_albedo", "name": "albedo", "values": [0.1, 0.2, 0.3, 0.5, 0.7]}
PERIOD = {"path": "patterns.period_px", "name": "period", "values": [12, 18]}
ERROR = Objective(metric="z_rmse_um")
QUICK = Objective(metric="exposure_ms")


@pytest.fixture
def table(base, tmp_path):
    study = Study(name="test", base="x", axis=(ALBEDO, PERIOD), objectives=(ERROR, QUICK))
    sweep(StudyRecord(study, base), tmp_path, local_workers(1), make_measurer=Blind)
    return read_table(tmp_path)


def test_the_blind_are_on_no_front(table):
    assert [row["albedo"] for row in best_rows(table.rows, [ERROR])] == [0.1, 0.1]
    assert {row["albedo"] for row in best_rows(table.rows, [ERROR, QUICK])} == {0.1, 0.2, 0.3}
    assert max(row["albedo"] for row in ranked_rows(table.rows, [ERROR])) == 0.3


def test_table_has_empty_cells_and_reasons(table, tmp_path):
    rows = list(csv.DictReader(io.StringIO(csv_text(table))))
    blind = [row for row in rows if float(row["albedo"]) >= 0.5]
    assert len(blind) == 4
    for row in blind:
        assert (row["z_rmse_um"], row["completeness"]) == ("", "0.0")
        assert (row["state"], row["reason"]) == ("done", "no valid point")
    assert {row["reason"] for row in rows if row not in blind} == {""}
    parquet = pytest.importorskip("pyarrow.parquet")
    write_parquet(table, tmp_path / "t.parquet")
    assert parquet.read_table(tmp_path / "t.parquet")["z_rmse_um"].null_count == 4


def test_effects_leave_out_and_count_cases_without_points(table, tmp_path, monkeypatch):
    effects = {item.axis: item.value for item in effects_of(table, "z_rmse_um")}
    assert effects == {"albedo": pytest.approx(1.0), "period": pytest.approx(0.0)}
    assert without(table, "z_rmse_um") == 4

    def refuse(*_):
        raise InputError("no renderer in this test")

    monkeypatch.setattr(pictures, "take_picture", refuse)
    page = write_study(tmp_path, failed=pictures.picture_best(tmp_path)).read_text()
    assert "Cases left out: 4 without z_rmse_um." in page
    assert page.count('class="reason">no valid point') == 4
    assert "4 of 10 cases: no valid point" in page
    assert (tmp_path / "figures" / "front.png").is_file()


def test_report_of_a_study_without_points(base, tmp_path):
    study = Study(
        name="test", base="x", axis=(ALBEDO | {"values": [0.6, 0.8]},), objectives=(ERROR,)
    )
    sweep(StudyRecord(study, base), tmp_path, local_workers(1), make_measurer=Blind)
    assert write_study(tmp_path).read_text().count('class="reason">no valid point') == 2
    with pytest.raises(InputError, match="no feasible case has z_rmse_um"):
        best_rows(read_table(tmp_path).rows, [ERROR])


def test_search_receives_a_failure_instead_of_zero(base, tmp_path, monkeypatch):
    pytest.importorskip("optuna")
    search_values = []
    tell = optimise._tell
    monkeypatch.setattr(
        optimise, "_tell", lambda *args: (search_values.append(args[2]), tell(*args))
    )
    study = Study(
        name="test",
        base="x",
        axis=({"path": "coating.base_albedo", "name": "albedo", "low": 0.1, "high": 0.9},),
        sampling={"method": "optimise", "seed": 2},
        optimise={"trials": 24, "batch": 8, "objectives": [ERROR]},
    )
    sweep(StudyRecord(study, base), tmp_path, local_workers(1), make_measurer=Blind)
    rows = read_table(tmp_path).rows
    blind = [row["albedo"] >= 0.5 for row in rows]
    assert 0 < sum(blind) < len(rows)
    assert [result is None for result in search_values] == blind
    assert best_rows(rows, [ERROR])[0]["albedo"] < 0.2


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_a_bound_on_an_absent_figure_is_not_met(base, tmp_path, sampler):
    """The fastest designs have no measured point: the search counts them as infeasible."""
    pytest.importorskip("optuna")
    study = Study(
        name="test",
        base="x",
        axis=({"path": "coating.base_albedo", "name": "albedo", "low": 0.1, "high": 0.9},),
        sampling={"method": "optimise", "seed": 2},
        optimise={"trials": 24, "batch": 8, "objectives": [QUICK], "sampler": sampler},
        constraint=({"value": "z_rmse_um", "at_most": 1.0},),
    )
    sweep(StudyRecord(study, base), tmp_path, local_workers(1), make_measurer=Blind)
    rows = read_table(tmp_path).rows
    assert {row["feasible"] for row in rows} == {True, False}
    assert 0.35 < best_rows(rows, [QUICK])[0]["albedo"] < 0.5


def test_figures_that_are_no_numbers_cost_their_case(base, study_of, stored):
    class Broken(Blind):
        def __call__(self, experiment, conditions=None):
            result = super().__call__(experiment)
            nan = float("nan") if experiment.coating.base_albedo == 0.2 else 1.0
            return CaseResult(result.figures | {"spread": nan})

    store, _ = stored(study_of(ALBEDO))
    outcome = sweep(read_record(store.folder), store.folder, local_workers(1), make_measurer=Broken)
    assert outcome.states == {"done": 4, "failed": 1}
    assert list(outcome.failures) == ["spread: not finite"]


def test_no_figure_is_derived_from_an_absent_figure(base):
    grating = {"specimen": {"kind": "grating", "pitch_mm": 7.19, "groove_mm": 0.2}}
    figures = {"z_rmse_um": None, "depth_mm": None, "force_n": 0.1}
    result = with_derived(vary(base, grating), figures)
    assert {"groove_over_error", "depth_over_thickness", "force_per_depth_n_per_mm"}.isdisjoint(
        result
    )
    assert result["groove_contrast_kept"] > 0


def test_a_ratio_over_zero_meets_no_bound(base, study_of):
    """press.back_pressure_kpa is 0 in one of two cases: that one is excluded, not a crash."""
    bound = {"value": "press.depth_mm", "per": "press.back_pressure_kpa", "at_least": 0.0}
    pressure = {"path": "press.back_pressure_kpa", "values": [0.0, 1.0]}
    cases = cases_of(study_of(pressure, constraint=(bound,)), base)
    assert [case.settings["press.back_pressure_kpa"] for case in cases.run] == [1.0]
    assert cases.excluded == 1
    by_result = Constraint(value="force_n", per="relief_peak_mm", at_most=1.0)
    assert quantity(base, {"force_n": 1.0, "relief_peak_mm": 0.0}, by_result) is None
