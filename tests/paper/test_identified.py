"""The identified values are equal in scenes, trials and tables."""

from dataclasses import replace

import numpy as np
import pytest

from twin.config import load_experiment
from twin.config.problem import load_problem
from twin.config.quantities import value_at
from twin.output import RESULT_FILE, write_json
from twin.paper import identified as identified_module
from twin.paper.claims import claims_of
from twin.paper.identified import (
    PROBLEMS,
    bounds_table,
    choices_table,
    decisions_table,
    draw_ridges,
    fields_table,
    identified_rows_table,
    pending,
    pictures_table,
    problem,
    worth_table,
)
from twin.paper.plan import BALLS, FIT, RODS, identified
from twin.paper.trials import REFUSED, Trial, inputs
from twin.study.trials import draw


@pytest.mark.parametrize("name", [BALLS, *RODS, "nut", "gelsight_two_balls"])
def test_every_scene_has_the_identified_values(name):
    experiment, fields = load_experiment(f"paper/{name}"), identified()["fields"]
    of_sheet = name != "gelsight_two_balls"
    for field in fields.values():
        shared = of_sheet or field["path"] in ("press.depth_mm", "score.roi_radius_mm")
        if shared and (name in RODS or not field["path"].startswith("specimen.")):
            assert value_at(experiment, field["path"]) == pytest.approx(field["value"])
    if of_sheet:
        origin = experiment.provenance["elastomer.thickness_mm"]
        assert origin.source == fields["thickness_mm"]["source"]
        assert list(origin.range) == pytest.approx(fields["thickness_mm"]["range"])


def test_trials_draw_joint_samples_and_placement():
    experiment, given = load_experiment(f"paper/{BALLS}"), inputs()
    draws = identified()["draws"]
    samples = list(zip(draws["thickness_mm"], draws["back_pressure_kpa"], strict=True))
    drawn = [draw(experiment, given.inputs, given.seed, trial) for trial in range(1, 12)]
    for trial_experiment in drawn:
        pair = trial_experiment.elastomer.thickness_mm, trial_experiment.press.back_pressure_kpa
        assert any(np.allclose(pair, sample) for sample in samples)
    assert len({trial_experiment.specimen.x_mm for trial_experiment in drawn}) == 11


def test_rows_have_the_mean_and_sd_of_their_trials():
    """Balls of 3.8 and 4.0 mm in two trials: mean 3.9, SD 0.1414 pooled over the balls."""
    figures = [{f"sphere_{ball}_{FIT}radius_mm": value for ball in (1, 2)} for value in (3.8, 4.0)]
    trials = [Trial(0, {}), *(Trial(k, measured) for k, measured in enumerate(figures, 1))]
    table = identified_rows_table({"balls": [*trials, Trial(3, {REFUSED: "too thin"})]})
    row = table.row(row="radius_1")
    assert row["use"] == "fitted"
    assert row["trials_mean"] == pytest.approx(3.9)
    assert row["trials_sd"] == pytest.approx(np.sqrt(0.02))
    assert row["refused"] == 1
    assert table.row(row="mae_1")["use"] == "predicted"
    within = {"1 SD": 1.0, "2 SD": 2.0, "unexplained": np.inf}
    for row in table.rows:
        assert abs(row["judged"]) <= within[row["within"]]
    assert table.row(row="rod_b")["use"] == "steered"
    assert [note.partition(":")[0] for note in table.notes if " was added after " in note] == [
        "rod_b",
        ", ".join(f"gelsight_{f}_{b}_footprint" for b in (1, 2) for f in ("rmse", "mae", "p95")),
    ]


def test_a_fitted_row_is_not_judged_by_its_own_value():
    """Given itself radius 1 is 0.07 SD from the paper; with any coat, 0.67 SD of the difference.

    RMSE 1 was held out in turn: its difference is the one from the prediction by the other rows.
    """
    table, known = identified_rows_table({}), identified()["rows"]
    radius, rmse = known["radius_1"], known["rmse_1"]
    expected = (3.835 - radius["any_coat"]) / np.hypot(radius["any_coat_sd"], 0.023)
    assert table.row(row="radius_1")["judged"] == pytest.approx(expected)
    assert abs(expected) > 5 * abs(radius["steps"])
    assert table.row(row="rmse_1")["judged"] == rmse["deviation_when_held_out"]
    mae = known["mae_2"]
    steps = (0.0075 - mae["twin"]) / problem().rows["mae_2"].sd
    assert table.row(row="mae_2")["judged"] == pytest.approx(steps)


def test_the_stored_solution_belongs_to_the_problem_that_is_compared():
    """Fitted rows, fields, choices and limits: a change of one of them needs a new solution."""
    summary, current = identified(), problem()
    assert set(summary["fields"]) == set(current.free)
    for name, row in current.rows.items():
        stored = summary["rows"][name]
        assert stored["fitted"] == (row.use == "fitted"), name
        if row.use == "fitted":
            assert (stored["measured"], stored["sd"]) == (row.value, row.sd), name
    combinations = [model["choices"] for model in summary["models"]]
    assert all(choices in combinations for choices in current.combinations())
    assert len(combinations) == len(list(current.combinations()))
    for name, limit in current.limits.items():
        assert summary["limits"][name]["at_least"] == limit.at_least
        assert summary["limits"][name]["sd"] == limit.sd


def test_a_newer_problem_is_named_with_its_command(monkeypatch):
    assert "`twin identify paper/identify_next -o DIR`" in pending()
    for name, file in PROBLEMS.items():
        assert load_problem(file)[0].name == name
    newest = dict(identified()) | {"name": "paper_next"}
    monkeypatch.setattr(identified_module, "identified", lambda: newest)
    assert pending() == ""


def test_bounds_without_a_stored_posterior_are_empty(monkeypatch):
    table = bounds_table()
    assert [row["bound"] for row in table.rows] == [
        "without",
        "at least 0.3",
        "at least 0.5",
        "at least 0.7",
    ]
    assert [("thickness_mm" in row) for row in table.rows] == [False, False, True, False]
    assert "`twin identify paper/identify -o DIR`" in table.notes[0]
    fields = identified()["fields"]
    stored = [{"limit": "nut_hexagon", "fields": fields}]
    stored += [{"limit": "nut_hexagon", "bound": b, "fields": fields} for b in (0.3, 0.7)]
    monkeypatch.setattr(identified_module, "identified", lambda: identified() | {"bounds": stored})
    table = bounds_table()
    assert all(row["thickness_mm"] == "0.0517 to 0.2" for row in table.rows)
    assert table.notes == ()


def test_tables_have_every_field_choice_and_measurement():
    *fields, pose = fields_table().rows
    assert len(fields) == len(problem().free)
    assert pose["value"] == 12.5
    assert pose["known"].startswith("assumed: ")
    assert {"caliper"} <= set(identified()["worth"])
    assert len(worth_table().rows) == len(identified()["worth"])
    by_alternative = {}
    for row in choices_table().rows:
        name = str(row["choice"]).partition(":")[0]
        by_alternative[name] = by_alternative.get(name, 0.0) + row["probability"]
    assert all(total == pytest.approx(1.0, abs=1e-3) for total in by_alternative.values())


def test_decisions_name_the_measurement_and_the_alternative(monkeypatch):
    assert decisions_table().rows == ()
    decision = {"row": "caliper", "alternative": "sphere_fit", "before": 0.6, "after": 0.8}
    solved = dict(identified()) | {"decisions": [decision]}
    monkeypatch.setattr(identified_module, "identified", lambda: solved)
    (row,) = decisions_table().rows
    assert row["measurement"] == problem().worth["caliper"].source
    assert (row["alternative"], row["before"], row["after"]) == ("sphere fit", 0.6, 0.8)


def test_ridges_are_drawn(tmp_path):
    draw_ridges(tmp_path, tmp_path / "ridges")
    assert (tmp_path / "ridges.png").stat().st_size > 0
    assert (tmp_path / "ridges.pdf").stat().st_size > 0


@pytest.mark.parametrize(("share", "met"), [(0.9, True), (0.1, False), (None, False)])
def test_a_limit_from_a_picture_is_compared_with_its_case(tmp_path, share, met):
    folder = tmp_path / "nut" / "contact_fpp"
    folder.mkdir(parents=True)
    figures = {} if share is None else {"nut_hexagon_share": share}
    write_json(folder / RESULT_FILE, {"metrics": figures})
    table = pictures_table(tmp_path)
    row, limit = table.rows[0], problem().limits["nut_hexagon"]
    assert row["known"] == f"at least {limit.at_least:g}"
    assert row["measured"] == share
    assert row["before"] < row["probability"]
    (claim,) = claims_of({"pictures": table})
    assert (claim.met, claim.value) == (met, share)
    assert bool(claim.why) != met


def test_mean_radii_are_judged_with_any_coat():
    """Setup: deviations of 0.05 and 0.15 mm from the paper. Expected: only the first is met.

    The prediction given the radii themselves, as stored, is not judged.
    """
    table = identified_rows_table({})
    radii = ("radius_1", "radius_2")
    moved = dict(zip(radii, (0.05, -0.15), strict=True))
    rows = [
        dict(r) | {"any_coat": r["paper"] + moved[r["row"]]}
        for r in table.rows
        if r["row"] in moved
    ]
    near, far = claims_of({"identified": replace(table, rows=tuple(rows))})
    assert (near.met, far.met) == (True, False)
    assert "(SD 0.19 mm)" in far.why
    assert not near.why
    stored = claims_of({"identified": table})
    assert [claim.value for claim in stored] == [table.row(row=name)["any_coat"] for name in radii]
    assert [claim.met for claim in stored] == [False, False]
