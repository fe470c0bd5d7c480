"""From a problem file to intervals, with a sensor of formulas."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.identification.sensors import NOISE_MM, Formula
from twin.config import ConfigError
from twin.config.problem import load_problem
from twin.identification import run
from twin.identification.known import NEGLIGIBLE
from twin.identification.record import experiments_at_best, figures_of
from twin.identification.run import _refined_places, identify, infer
from twin.identification.simulations import record_of, simulate, variants_of
from twin.study.table import read_table
from twin.study.workers import lasting, local_workers

PROBLEM = """
name = "sensor"
[experiments.ball]
base = "examples/slab_balls"
[free.thickness]
path = "elastomer.thickness_mm"
low = 0.1
high = 0.8
source = "assumed: a thin sheet"
[free.depth]
path = "press.depth_mm"
low = 0.2
high = 0.7
[design]
count = 64
[rows.radius]
experiment = "ball"
metric = "radius_mm"
value = 4.3
sd = 0.01
[rows.height]
experiment = "ball"
metric = "height_mm"
value = 0.4
sd = 0.01
"""


def _load(tmp_path: Path, text: str = PROBLEM):
    file = tmp_path / "problem.toml"
    file.write_text(text)
    return load_problem(file)


# Steps of 40 chains for tests of choices and signs: some 200 independent samples.
SHORT = 400


def _identify(tmp_path: Path, text: str = PROBLEM, workers: int = 1, longest: int | None = None):
    problem, experiments = _load(tmp_path, text)
    if longest:  # a file may not ask for so few
        design = problem.design.model_copy(update={"longest": longest})
        problem = problem.model_copy(update={"design": design})
    with lasting(local_workers(workers)) as pool:  # the processes are started once for all stages
        result = identify(problem, experiments, tmp_path / "out", pool, make_measurer=Formula)
    return result, experiments


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    return _identify(tmp_path_factory.mktemp("identified"))


def test_fields_have_the_rows_uncertainty(identified):
    fields = identified[0].intervals()
    assert fields["thickness"].mean == pytest.approx(0.3, abs=0.004)
    assert fields["thickness"].sd == pytest.approx(0.01, rel=0.15)
    exact = 0.4 * np.exp(0.3)
    assert fields["depth"].mean == pytest.approx(exact, abs=0.006)
    assert fields["depth"].sd == pytest.approx(np.hypot(0.01 * exact, 0.01 * np.exp(0.3)), rel=0.15)


def test_the_best_experiments_have_the_identified_values(identified):
    result, experiments = identified
    best = experiments_at_best(result, experiments)["ball"]
    assert best.elastomer.thickness_mm == pytest.approx(0.3, abs=0.01)
    assert best.press.depth_mm == pytest.approx(0.54, abs=0.02)
    origin = best.provenance["elastomer.thickness_mm"]
    assert origin.source.startswith("identified: sensor, from the rows radius, height")
    low, high = origin.range
    assert high - low == pytest.approx(4 * 0.01, rel=0.2)  # 95 % of a normal: 3.92 SD
    assert low <= best.elastomer.thickness_mm <= high


def test_intervals_cover_the_hidden_values_of_eight_sensors(tmp_path):
    problem, experiments = _load(tmp_path)
    simulated = simulate(
        problem, experiments, tmp_path / "out", local_workers(1), make_measurer=Formula
    )
    rng = np.random.default_rng(5)
    within_68, within_95 = [], []
    for _ in range(8):
        thickness, depth = rng.uniform(0.1, 0.8), rng.uniform(0.2, 0.7)
        true = {"radius": 4.0 + thickness, "height": depth * np.exp(-thickness)}
        read = {
            name: row.model_copy(update={"value": true[name] + row.sd * rng.normal()})
            for name, row in problem.rows.items()
        }
        intervals = infer(
            problem.model_copy(update={"rows": read}), simulated, longest=SHORT
        ).intervals()
        for name, value in (("thickness", thickness), ("depth", depth)):
            interval = intervals[name]
            within_68.append(interval.low_68 <= value <= interval.high_68)
            within_95.append(interval.low_95 <= value <= interval.high_95)
    # Binomial, 16 intervals, three standard deviations; forty sensors: `./run bench identify`.
    assert np.mean(within_68) > 0.33  # 16 intervals give no useful upper bound: see the benchmark
    assert np.mean(within_95) > 0.78


def test_a_measured_product_is_reported_as_a_ridge(tmp_path):
    text = (
        PROBLEM.split("[rows.radius]")[0]
        + """
[rows.product]
experiment = "ball"
metric = "product_mm2"
value = 0.12
sd = 0.001
"""
    )
    result, _ = _identify(tmp_path, text, longest=SHORT)
    assert [set(ridge.share) for ridge in result.ridges()] == [{"thickness", "depth"}]
    shares = list(result.ridges()[0].share.values())
    assert shares[0] * shares[1] > 0  # across the ridge of a product both fields increase


CHOICES = (
    PROBLEM.replace("count = 64", "count = 32")  # the two layouts are simulated
    + """
[alternatives.fit.choices.near]
[alternatives.fit.choices.far]
metrics = { radius = "radius_far_mm" }
[alternatives.layout.choices.free]
[alternatives.layout.choices.window]
set = { elastomer = { layout = "contact_face" } }
[rows.product]
experiment = "ball"
metric = "product_mm2"
value = 0.32
sd = 0.005
"""
)


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """The problem with two alternatives, its simulations, and the result."""
    folder = tmp_path_factory.mktemp("judged")
    problem, experiments = _load(folder, CHOICES)
    out = folder / "out"
    simulated = simulate(problem, experiments, out, local_workers(1), make_measurer=Formula)
    return problem, simulated, infer(problem, simulated, longest=SHORT)


def test_choices_are_judged_and_only_those_that_change_it_are_simulated(judged):
    problem, _, result = judged
    assert [model.name for model in variants_of(problem)] == ["ball-free", "ball-window"]
    # Thickness 0.3 and depth 0.54 give 0.162; the window doubles the product.
    assert result.best.combination == {"fit": "near", "layout": "window"}
    assert result.best.probability > 0.95
    assert sum(model.probability for model in result.models) == pytest.approx(1.0)


def test_improbable_choices_have_short_chains_and_change_no_result(judged, monkeypatch):
    """Setup: chains of 400 steps, with screening by 200 steps and without.

    Expected: the same fields and probabilities; improbable choices keep their 200 steps.
    """
    problem, simulated, whole = judged
    monkeypatch.setattr(run, "_SCREENING_STEPS", SHORT // 2)
    screened = infer(problem, simulated, longest=SHORT)
    assert [m.posterior.steps == SHORT for m in screened.models] == [
        m.probability >= NEGLIGIBLE for m in screened.models
    ]
    assert 1 <= len(screened.probable) < len(screened.models)
    np.testing.assert_array_equal(screened.best.posterior.z, whole.best.posterior.z)
    for one, other in zip(screened.models, whole.models, strict=True):
        assert one.probability == pytest.approx(other.probability, rel=0.2, abs=1e-6)
    samples = screened.to_xarray()
    assert np.isfinite(samples["thickness"].values[0]).all()


def test_a_row_held_out_is_not_fitted_and_rotated_ones_are_predicted(tmp_path):
    text = PROBLEM.replace("value = 0.4\n", "value = 0.9\nheld_out = true\n")
    result, _ = _identify(tmp_path, text)
    row = {prediction.row: prediction for prediction in result.best.predictions}["height"]
    assert not row.fitted
    assert row.deviation > 2.0
    assert "depth" in result.undetermined()


def test_a_field_among_the_figures_needs_no_further_simulation(tmp_path):
    """Reach = thickness x region: thickness 0.3 mm and reach 0.6 give a region of 2 mm."""
    region = """
[free.region]
path = "score.roi_radius_mm"
low = 1.0
high = 4.0
scale = "log"
among = [1.0, 1.5, 2.5, 4.0]
[rows.reach]
experiment = "ball"
metric = "reach_{region}_mm"
learned_as = "log"
value = 0.6
sd = 0.003
[worth.region]
experiment = "ball"
metric = "{region}"
value = 0.0
sd = 0.1
"""
    result, _ = _identify(tmp_path, PROBLEM + region)
    studies = list((tmp_path / "out" / "studies").iterdir())
    assert [len(list((study / "cases").iterdir())) for study in studies] == [64]
    known = result.intervals()["region"]
    assert known.mean == pytest.approx(2.0, abs=0.02)
    assert known.sd == pytest.approx(2.0 * np.hypot(0.01 / 0.3, 0.003 / 0.6), rel=0.15)
    (worth,) = result.worth()
    left = 1 / (1 + (known.sd / 0.1) ** 2)
    assert worth.shrink["region"] == pytest.approx(left, rel=0.15)


CURVED = PROBLEM.replace('"height_mm"', '"wave_mm"').replace("count = 64", "count = 20")


def test_further_simulations_are_near_the_posterior_and_improve_the_emulator(tmp_path):
    """The wave has a period of 0.25 mm in depth: 20 points over 0.5 mm do not resolve it."""
    (tmp_path / "coarse").mkdir()
    (tmp_path / "refined").mkdir()
    coarse, _ = _identify(tmp_path / "coarse", CURVED, longest=SHORT)
    further = CURVED.replace("= 20", "= 20\nrefine = 16")
    refined, _ = _identify(tmp_path / "refined", further, longest=SHORT)
    table = read_table(tmp_path / "refined" / "out" / "studies" / "ball_refined")
    assert len(table.rows) == 16
    thickness = np.array([row["thickness"] for row in table.rows])
    assert abs(thickness.mean() - 0.3) < 0.02
    assert thickness.std() < 0.03  # of 0.7 mm
    for row in table.rows:
        assert row["depth"] == pytest.approx(0.45, abs=0.26)
    at = refined.best.posterior.places
    errors = [result.best.emulators["height"].predict(at)[1].mean() for result in (coarse, refined)]
    assert errors[1] < 0.7 * errors[0]
    assert refined.best.emulators["radius"].known.shape[0] == 36


def test_no_more_places_are_drawn_than_there_are_samples(identified):
    result = identified[0]
    setup = result.problem.experiments["ball"].model_copy(update={"refine": 100_000})
    problem = result.problem.model_copy(update={"experiments": {"ball": setup}})
    (drawn,) = _refined_places(replace(result, problem=problem)).values()
    assert drawn.shape == result.best.posterior.places.shape


def test_same_results_after_a_resume_and_with_two_workers(tmp_path):
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    text = CURVED.replace("= 20", "= 12\nrefine = 4")
    first, _ = _identify(tmp_path / "one", text, longest=SHORT // 4)
    again, _ = _identify(tmp_path / "one", text, longest=SHORT // 4)
    parallel, _ = _identify(tmp_path / "two", text, workers=2, longest=SHORT // 4)
    assert figures_of(first) == figures_of(again) == figures_of(parallel)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('experiment = "ball"', 'experiment = "bal"', "rows.radius: found 'bal', allowed ball"),
        ("sd = 0.01", "sd = 0", "sd"),
        ("low = 0.1", "low = 1.0", "low: found 1, allowed below high, 0.8"),
        ("[design]", 'rotate = ["wide"]\n[design]', "rotate"),
        ('name = "sensor"', 'name = "sensor"\nrotate = ["wide"]', "found 'wide', allowed"),
        ("count = 64", "count = 4", "count"),
    ],
)
def test_a_faulty_problem_is_an_error_of_one_line(tmp_path, old, new, message):
    with pytest.raises(ConfigError, match=message) as error:
        _load(tmp_path, PROBLEM.replace(old, new, 1))
    assert "\n" not in str(error.value)


def test_an_unknown_figure_is_an_error_with_the_simulated_names(tmp_path):
    with pytest.raises(Exception, match="radius_m: found in no simulation, allowed height_mm"):
        _identify(tmp_path, PROBLEM.replace('"radius_mm"', '"radius_m"'))


def test_the_emulators_error_is_the_simulations_noise(identified):
    error = identified[0].best.emulators["radius"].cross_validated_rmse
    assert 0.7 * NOISE_MM < error < 1.4 * NOISE_MM


def test_shipped_problems_are_valid():
    files = sorted((Path(__file__).parents[2] / "scenes" / "problems").glob("*.toml"))
    assert files
    for file in files:
        problem, experiments = load_problem(f"problems/{file.stem}")
        for variant in variants_of(problem):
            record_of(problem, experiments[variant.experiment], variant).cases()


def test_an_identification_in_one_line_in_pictures_and_as_labelled_arrays(identified):
    result = identified[0]
    text = repr(result)
    assert text.startswith(f"<Identified: {result.problem.name}, {len(result.models)} model")
    for name, field in result.intervals().items():
        assert f"{name} {field.mean:.4g} ({field.low_95:.4g} to {field.high_95:.4g})" in text
    data = result.to_xarray()
    assert data["thickness"].dims == ("model", "sample")
    assert data["thickness"].attrs["long_name"] == result.problem.free["thickness"].path
    drawing = result.plot()
    shown = [axes.get_xlabel() for axes in drawing.axes if axes.axison]
    assert shown == [free.path for free in result.problem.free.values()]
    assert "data:image/png;base64," in result._repr_html_()
