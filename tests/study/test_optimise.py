"""Search by Optuna: finds the minimum, respects constraints, continues from the store."""

import numpy as np
import pytest

from reconstruction.errors import InputError
from tests.study.synthetic import Bowl
from twin.config.study import Objective
from twin.study.record import StudyRecord, read_record
from twin.study.store import Store
from twin.study.sweep import sweep
from twin.study.table import best_rows, csv_text, on_front, read_table
from twin.study.workers import local_workers

ALBEDO = {"path": "coating.base_albedo", "name": "albedo", "low": 0.1, "high": 0.9}
ROUGH = {"path": "coating.flake_roughness", "name": "rough", "low": 0.1, "high": 0.9}


def search(study_of, base, folder, trials, workers=1, **keys):
    study = study_of(
        ALBEDO,
        ROUGH,
        sampling={"method": "optimise", "seed": 5},
        optimise={"trials": trials, "batch": 6} | keys.pop("optimise"),
        **keys,
    )
    record = StudyRecord(study, base)
    return sweep(record, folder, local_workers(workers), make_measurer=Bowl)


def test_front_has_the_undominated_rows():
    costs = np.array([[1.0, 3.0], [2.0, 2.0], [3.0, 1.0], [3.0, 3.0], [2.0, 2.0], [2.5, 2.0]])
    assert on_front(costs).tolist() == [True, True, True, False, True, False]


def test_best_rows_are_feasible_and_sorted():
    rows = [
        {"feasible": True, "error": 3.0, "force": 1.0},
        {"feasible": True, "error": 1.0, "force": 3.0},
        {"feasible": False, "error": 0.5, "force": 0.5},
        {"feasible": True, "error": 4.0, "force": 4.0},
    ]
    objectives = [Objective(metric="error"), Objective(metric="force")]
    assert [row["error"] for row in best_rows(rows, objectives)] == [1.0, 3.0]
    largest = best_rows(rows, [Objective(metric="error", goal="maximise")])
    assert largest[0]["error"] == 4.0


def test_search_finds_a_known_minimum(study_of, base, tmp_path):
    """A bowl with its minimum at albedo 0.4, roughness 0.6; with a bound that cuts it off.

    Expected: within 0.1 of the constrained minimum (albedo 0.5, roughness 0.6), and better than
    as many random points by far; every best design feasible.
    """
    pytest.importorskip("optuna")
    bound = {"value": "coating.base_albedo", "at_least": 0.2}
    on_result = {"value": "bowl_albedo", "at_least": 0.5}
    goals = {"objectives": [{"metric": "bowl"}]}
    search(study_of, base, tmp_path, 60, optimise=goals, constraint=(bound, on_result))
    table = read_table(tmp_path)
    best = best_rows(table.rows, [Objective(metric="bowl")])[0]
    assert best["albedo"] == pytest.approx(0.5, abs=0.1)
    assert best["rough"] == pytest.approx(0.6, abs=0.15)
    assert best["albedo"] >= 0.5


def test_search_continues_with_other_workers(study_of, base, tmp_path):
    """12 trials, then 24 of the same study: the same as 24 at once, on other workers too."""
    pytest.importorskip("optuna")
    goals = {"objectives": [{"metric": "bowl"}, {"metric": "slope", "goal": "maximise"}]}
    search(study_of, base, tmp_path / "two", 12, optimise=goals)
    again = search(study_of, base, tmp_path / "two", 24, optimise=goals)
    assert again.states["done"] <= 12
    search(study_of, base, tmp_path / "one", 24, workers=2, optimise=goals)
    assert csv_text(read_table(tmp_path / "two")) == csv_text(read_table(tmp_path / "one"))
    assert len(read_record(tmp_path / "two").points) == 24
    assert len(Store(tmp_path / "two").finished()) == len(Store(tmp_path / "one").finished())


def test_excluded_points_are_no_trials(study_of, base, tmp_path):
    """A bound on a field admits 12.5 % of the space: the requested number of cases is measured."""
    pytest.importorskip("optuna")
    bound = {"value": "coating.base_albedo", "at_most": 0.2}
    goals = {"objectives": [{"metric": "bowl"}], "sampler": "random"}
    search(study_of, base, tmp_path, 10, optimise=goals, constraint=(bound,))
    rows = read_table(tmp_path).rows
    assert [row["state"] for row in rows] == ["done"] * 10
    assert all(row["albedo"] <= 0.2 for row in rows)


@pytest.mark.parametrize(
    ("path", "message"),
    [("coating.base_albdo", "did you mean"), ("coating.base_albedo", "constraints exclude all")],
)
def test_search_without_a_valid_point(study_of, base, tmp_path, path, message):
    """A misspelt field, or a bound that excludes all points, gives an error, no endless search."""
    pytest.importorskip("optuna")
    study = study_of(
        ALBEDO | {"path": path},
        sampling={"method": "optimise"},
        optimise={"trials": 4, "objectives": [{"metric": "bowl"}]},
        constraint=({"value": "coating.base_albedo", "at_least": 0.95},),
    )
    with pytest.raises(InputError, match=message):
        sweep(StudyRecord(study, base), tmp_path, local_workers(1), make_measurer=Bowl)
    assert not any((tmp_path / "cases").iterdir())
