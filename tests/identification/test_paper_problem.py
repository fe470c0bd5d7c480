"""The paper as a problem: fitted and held-out rows, and the pressure scale of its press."""

import numpy as np
import pytest
from scipy.stats import t

from reconstruction.integration_schemes import schemes_in_order
from twin.config import vary
from twin.config.problem import Alternative, load_problem
from twin.config.rows import Row
from twin.identification.simulations import record_of, summary, variants_of
from twin.paper.plan import COARSE, rows_of
from twin.pipeline.press import press_smooth

HELD_OUT = ("rod_b", "single", "mae", "p95", "gelsight")


@pytest.fixture(scope="module")
def loaded():
    return load_problem("paper/identify")


def test_every_design_point_is_a_valid_experiment(loaded):
    problem, experiments = loaded
    for variant in variants_of(problem):
        cases = record_of(problem, experiments[variant.experiment], variant).cases().run
        setup = problem.experiments[variant.experiment]
        assert len(cases) == (setup.count or problem.design.count) * setup.repeats


def test_the_listed_rows_are_held_out(loaded):
    problem, _ = loaded
    assert set(problem.fitted) == {"rod_a", "rod_c", "radius_1", "radius_2", "rmse_1", "rmse_2"}
    held = [name for name, row in problem.rows.items() if row.held_out]
    assert all(name.startswith(HELD_OUT) or "_sd" in name for name in held)
    assert sum(name.startswith("gelsight") for name in held) == 16


def test_values_are_those_of_the_papers_tables(loaded):
    rows = loaded[0].rows
    for row in rows_of("rods"):
        ours = rows[f"rod_{row['name'].lower()}"]
        assert ours.value == row["mean"]
        assert ours.sd == pytest.approx(row["sd"] / np.sqrt(5), abs=5e-4)
        assert rows[f"rod_{row['name'].lower()}_sd"].value == row["sd"]
    for row in rows_of("repeated_fit"):
        kind = {"GelSight": "gelsight_", "contact-FPP": ""}[row["method"]]
        tail = "_footprint" if kind else ""
        assert rows[f"{kind}radius_{row['sphere']}{tail}"].value == row["mean_radius"]
        assert rows[f"{kind}radius_{row['sphere']}_sd{tail}"].value == row["sd"]
    for row in rows_of("sphere_fit"):
        kind = {"GelSight": "gelsight_", "contact-FPP": ""}[row["method"]]
        tail = "_footprint" if kind else ""
        for ours, theirs in (("single", "radius"), ("mae", "mae"), ("p95", "p95")):
            assert rows[f"{kind}{ours}_{row['sphere']}{tail}"].value == row[theirs]
        assert rows[f"{kind}rmse_{row['sphere']}{tail}"].value == row["rmse"]


def _two_balls_sd(figure, method):
    """68 % half width of Student's t with one degree of freedom, times the SD of two values."""
    first, second = (row[figure] for row in rows_of("sphere_fit") if row["method"] == method)
    return t.ppf(0.5 + 0.6827 / 2, 1) * abs(first - second) / np.sqrt(2)


@pytest.mark.parametrize("name", ["identify", "identify_next"])
def test_residual_rows_have_the_sd_of_the_papers_two_balls(name):
    rows = load_problem(f"paper/{name}")[0].rows
    judged = {n: row for n, row in rows.items() if {"rmse", "mae", "p95"} & set(n.split("_"))}
    assert len(judged) in (12, 14)
    for row_name, row in judged.items():
        figure = next(f for f in ("rmse", "mae", "p95") if f in row_name)
        method = "GelSight" if row_name.startswith("gelsight") else "contact-FPP"
        if name == "identify" and row.use == "fitted":  # as when the stored solution was computed
            assert figure == "rmse"
            continue
        assert row.sd == pytest.approx(_two_balls_sd(figure, method), rel=0.03)


def test_rows_that_steered_a_choice_are_no_predictions(loaded):
    rows = loaded[0].rows
    steered = {name for name, row in rows.items() if row.use == "steered"}
    footprint = {f"gelsight_{f}_{b}_footprint" for f in ("rmse", "mae", "p95") for b in (1, 2)}
    assert steered == {"rod_b"} | footprint
    with pytest.raises(ValueError, match="steered: needs held_out = true"):
        Row.model_validate(rows["rod_b"].model_dump() | {"held_out": False})


@pytest.fixture(scope="module")
def following():
    return load_problem("paper/identify_next")


def test_the_next_problem_frees_the_friction_of_every_sheet(loaded, following):
    friction = following[0].free["friction_coefficient"]
    assert "friction_coefficient" not in loaded[0].free
    assert set(friction.experiments) == set(following[0].free["thickness_mm"].experiments)
    assert (friction.low, friction.high) == (0.0, 2.0)


def test_flakes_of_the_next_problem_differ_from_its_balls_only_in_coat_and_filter(following):
    """The domain of the filter matters with flakes only; all else is as for the balls."""
    problem, experiments = following
    assert problem.alternatives["coat"].choices["flakes"].instead == {"balls": "balls_flakes"}
    plain, flaked = experiments["balls"], experiments["balls_flakes"]
    assert (plain.decode.weights, flaked.decode.weights) == ("equal", "modulation")
    assert flaked.coating.glints is not None
    alike = {"coating.glints": None, "decode.weights": "equal"}
    same = vary(flaked, alike).model_dump(exclude={"provenance"})
    assert same == plain.model_dump(exclude={"provenance"})
    plain_fields = set(problem.free_in("balls"))
    assert set(problem.free_in("balls_flakes")) == plain_fields | {"flake_um"}


def test_the_next_problem_holds_out_the_row_of_the_stated_rule(loaded, following):
    """Of the fitted rows that were not held out in turn: the smallest relative SD."""
    problem = loaded[0]
    candidates = {n: r.sd / r.value for n, r in problem.fitted.items() if n not in problem.rotate}
    assert set(candidates) == {"radius_1", "radius_2", "rmse_2"}
    held_out = min(candidates, key=candidates.__getitem__)
    rows = following[0].rows
    assert rows[held_out].use == "predicted"
    assert rows["rod_b"].use == "fitted"
    gelsight = {f"gelsight_rmse_{ball}" for ball in (1, 2)}
    assert set(following[0].fitted) == {*problem.fitted, "rod_b", *gelsight} - {held_out}


def test_gelsight_may_be_evaluated_as_contact_fpp(following):
    problem, kinds = following[0], {"fit": set(), "as_gelsight": set()}
    for choices in problem.combinations():
        ours, theirs = (
            problem.metric_of(n, problem.rows[n], choices) for n in ("rmse_1", "gelsight_rmse_1")
        )
        assert (ours == theirs) == (choices["gelsight_region"] == "same")
        kinds["fit"].add(ours)
        kinds["as_gelsight"].add(theirs)
    assert len(kinds["fit"]) == 2
    assert len(kinds["as_gelsight"]) == 4
    same = {c["gelsight_region"]: problem.weight(c) for c in problem.combinations()}
    assert same["same"] == pytest.approx(3 * same["footprint"])


def test_the_next_problem_simulates_every_scheme_of_gelsight(following):
    problem, experiments = following
    of = [v for v in variants_of(problem) if v.experiment == "gelsight"]
    schemes = set()
    for variant in of:
        case = record_of(problem, experiments["gelsight"], variant).cases().run[0]
        assert case.experiment.photometric.colour_map == "table"
        schemes.add(case.experiment.photometric.integration)
    assert schemes == {scheme.name for scheme in schemes_in_order()}


def test_choices_of_an_alternative_have_the_same_parts(following):
    alternative = following[0].alternatives["gelsight_region"].model_dump()
    del alternative["choices"]["same"]["parts"]["gelsight_region"]
    with pytest.raises(ValueError, match=r"footprint\.parts: the names must be those of same"):
        Alternative.model_validate(alternative)


def test_a_problem_overrides_and_removes_entries_of_the_one_that_it_uses(tmp_path):
    """In `set`, "absent" is a value: it removes a key of the experiment."""
    first = 'name = "a"\n[experiments.balls]\nbase = "paper/two_balls"\n'
    for name, value in (("one", 1), ("two", 2)):
        first += f'[rows.{name}]\nexperiment = "balls"\nmetric = "m"\nvalue = {value}\nsd = 1\n'
    first += '[free.depth]\npath = "press.depth_mm"\nlow = 0.3\nhigh = 0.5\n'
    (tmp_path / "first.toml").write_text(first)
    (tmp_path / "second.toml").write_text(
        'use = "./first.toml"\nname = "b"\nrows.two = "absent"\n[rows.one]\nvalue = 3\nsd = 2\n'
        '[experiments.balls.set.coating]\ntexture = "absent"\n'
    )
    problem, experiments = load_problem(tmp_path / "second.toml")
    assert problem.name == "b"
    assert {name: row.value for name, row in problem.rows.items()} == {"one": 3.0}
    assert experiments["balls"].coating.texture is None


def test_the_balls_nuisance_is_the_papers_reference_uncertainty(following):
    (u_ref,) = {row["u_ref"] for row in rows_of("uncertainty")}
    problem = following[0]
    radii = {n: r.nuisance["ball"] for n, r in problem.rows.items() if "ball" in r.nuisance}
    assert set(radii.values()) == {1.0}
    assert len(radii) == 8
    assert problem.nuisance["ball"].sd == u_ref


def test_the_round_form_measures_the_rows_on_round_rods(loaded):
    problem, _ = loaded
    chosen = {"form": "round", "width": "slope_break", "sphere_fit": "geometric"}
    assert problem.experiment_of(problem.rows["rod_b"], chosen) == "round_b"
    assert problem.experiment_of(problem.rows["radius_1"], chosen) == "balls"
    assert problem.experiment_of(problem.rows["rod_b"], chosen | {"form": "bars"}) == "bar_b"


@pytest.mark.parametrize("thickness_mm", [0.3, 0.8])
def test_shape_depends_on_pressure_over_modulus(loaded, thickness_mm):
    """Doubled modulus and pressure at a set travel: the same face, and a doubled force.

    By dimensional analysis: without weight and tack only these two have a unit of force.
    """
    base = vary(
        loaded[1]["balls"],
        {
            "elastomer.thickness_mm": thickness_mm,
            "press.depth_mm": 0.5,
            "press.cell_mm": 0.5,
            "elastomer.length_x_mm": 18.0,
            "elastomer.length_y_mm": 15.0,
            "elastomer.young_modulus_kpa": 200.0,
            "press.back_pressure_kpa": 1.0,
        },
    )
    twice = vary(base, {"elastomer.young_modulus_kpa": 400.0, "press.back_pressure_kpa": 2.0})
    soft, hard = (press_smooth(experiment) for experiment in (base, twice))
    np.testing.assert_allclose(hard.face_z_mm, soft.face_z_mm, atol=2e-5)
    assert hard.force_n == pytest.approx(2 * soft.force_n, rel=1e-3)


def test_scatter_is_pooled_over_figures():
    """Two balls with SD 3 and 4 (n - 1) have the pooled SD of their mean variance."""
    figures = np.array([[[1.0, 10.0], [1.0 + 3.0 * np.sqrt(2), 10.0 + 4.0 * np.sqrt(2)]]])
    assert summary(figures, "sd") == pytest.approx([np.sqrt((9 + 16) / 2)])
    assert summary(figures, "mean") == pytest.approx([5.5 + 3.5 / np.sqrt(2)])
    figures[0, 1] = np.nan
    assert summary(figures, "mean") == pytest.approx([5.5])
    assert np.isnan(summary(figures, "sd")).all()


def test_the_paper_is_reproduced_on_the_cells_it_was_identified_on(loaded):
    cells = {e.name: e.press.cell_mm for e in loaded[1].values() if e.press.cell_mm}
    assert cells == {name: COARSE.cells_mm[name] for name in cells}
    assert {"two_balls", "nut", "bars_a", "rods_c"} <= set(cells)


def test_the_quick_problem_has_enough_simulations_for_its_emulators(loaded):
    problem = loaded[0].quick()
    for name, setup in problem.experiments.items():
        fields = len(problem.simulated_in(name))
        assert (setup.count or problem.design.count) >= max(8, 2 * (1 + fields)), name
        assert problem.refined(name) == 0
        assert setup.repeats >= min(loaded[0].experiments[name].repeats, 2)
