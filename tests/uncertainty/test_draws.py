"""Draws of repeated trials: stated distributions, which depend only on input, seed and trial."""

import numpy as np
import pytest
from scipy import stats

from twin.config import ConfigError, load_experiment
from twin.config.inputs import DEFAULT_INPUTS, Input, Inputs, load_inputs, usual_inputs
from twin.config.sensor_layer import sensor_layer_of
from twin.pipeline.comparison import PhotometricPlan, case_for
from twin.propagation.trials import record_of
from twin.study.trials import deviation_of, draw, drawn_values, standard_uncertainty

SEED = 5


def inputs_of(**inputs):
    return {name: Input(**({"group": "placement"} | given)) for name, given in inputs.items()}


def values_of(experiment, inputs, trial):
    return drawn_values(experiment, inputs, SEED, trial)


def paper():
    return load_inputs("paper/trials")


def balls():
    return load_experiment("examples/slab_balls")


X = {"key": "specimen.x_mm", "distribution": "normal", "spread": 0.2}
SIZE = {"key": "specimen.diameter_mm", "distribution": "uniform", "spread": 0.01}
DRAPE = {
    "key": "press.back_pressure_kpa",
    "distribution": "normal",
    "spread": 0.05,
    "relative": True,
}


def test_draws_have_the_stated_mean_and_spread():
    """1000 draws: means within 4 standard errors, standard deviations within 4 of theirs."""
    all_three, experiment, n = inputs_of(x=X, size=SIZE, drape=DRAPE), balls(), 1000
    values = [values_of(experiment, all_three, trial) for trial in range(1, n + 1)]
    for name, given in all_three.items():
        nominal = {"x": 0.0, "size": 8.0, "drape": experiment.press.back_pressure_kpa}[name]
        samples = np.array([drawn[given.key] for drawn in values])
        u = standard_uncertainty(given, nominal)
        assert abs(samples.mean() - nominal) < 4 * u / np.sqrt(n)
        assert abs(samples.std(ddof=1) / u - 1) < 4 / np.sqrt(2 * n)
    sizes = [drawn["specimen.diameter_mm"] for drawn in values]
    assert 7.99 <= min(sizes) < 7.9905
    assert 8.0095 < max(sizes) <= 8.01


def test_a_draw_does_not_depend_on_the_other_inputs():
    alone = values_of(balls(), inputs_of(x=X), 3)
    together = values_of(balls(), inputs_of(drape=DRAPE, size=SIZE, x=X), 3)
    assert alone["specimen.x_mm"] == together["specimen.x_mm"]
    assert alone != values_of(balls(), inputs_of(x=X), 4)


def test_trial_zero_is_the_nominal_one():
    assert draw(balls(), paper().inputs, SEED, 0) == balls()
    assert values_of(balls(), inputs_of(x=X), 0) == {"specimen.x_mm": 0.0}


def test_every_instrument_has_the_specimen_in_the_same_place():
    drawn = draw(balls(), paper().inputs, SEED, 7)
    gelsight = case_for(drawn, "photometric_stereo", PhotometricPlan(match="depth"))
    assert gelsight.specimen == drawn.specimen
    assert drawn.specimen.x_mm != 0.0


def test_shipped_inputs_reach_numbers_of_every_repeated_experiment():
    """Otherwise a renamed field would be detected only after an hour of trials."""
    for name in ("two_balls", "rods_a", "rods_b", "rods_c"):
        experiment = load_experiment(f"paper/{name}")
        assert len(values_of(experiment, paper().inputs, 1)) >= 8 - (name != "two_balls")


@pytest.mark.parametrize(
    "name", ["examples/slab_balls", "examples/wrapped_nut", "examples/starter"]
)
def test_default_inputs_fit_any_experiment(name):
    """Each of placement, press, elastomer and optics has inputs; absent keys are ignored."""
    experiment, shipped = load_experiment(name), load_inputs(DEFAULT_INPUTS).inputs
    keys = values_of(experiment, shipped, 1)
    groups = {given.group for given in shipped.values() if given.key in keys}
    assert groups == {"placement", "press", "elastomer", "optics"}
    for trial in range(1, 20):
        draw(experiment, shipped, SEED, trial)


def test_spreads_carry_their_source():
    assert all(given.source for given in paper().inputs.values())
    assert all(given.source for given in load_inputs(DEFAULT_INPUTS).inputs.values())


def test_an_unknown_key_is_an_error_of_one_line():
    with pytest.raises(ConfigError, match=r"specimen\.weight_g: found no number"):
        draw(balls(), inputs_of(w={**X, "key": "specimen.weight_g"}), SEED, 1)


def test_a_bad_file_is_one_line(tmp_path):
    file = tmp_path / "spread.toml"
    text = 'seed = 1\n[inputs.x]\ngroup = "press"\nkey = "specimen.x_mm"\ndistribution = "cauchy"\n'
    file.write_text(text)
    with pytest.raises(ConfigError, match="distribution"):
        load_inputs(str(file))
    file.write_text(text.replace("cauchy", "normal") + "spread = { value = 0.1 }\n")
    with pytest.raises(ConfigError, match=r"inputs\.x\.spread: a quantity needs a source"):
        load_inputs(file.with_name("spread.toml").resolve())


SHAPES = {
    "normal": ({}, 1.0),
    "uniform": ({}, 1 / np.sqrt(3.0)),
    "triangular": ({}, 1 / np.sqrt(6.0)),
    "arcsine": ({}, 1 / np.sqrt(2.0)),
    "student_t": ({"degrees_of_freedom": 5.0}, np.sqrt(5.0 / 3.0)),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_standard_uncertainties_of_the_guide(kind):
    """JCGM 101, 6.4: s, a / sqrt 3, a / sqrt 6, a / sqrt 2, s sqrt(nu / (nu - 2)); and of draws."""
    more, factor = SHAPES[kind]
    given = Input(group="press", key="k", distribution=kind, spread=0.2, **more)
    assert standard_uncertainty(given, 7.0) == pytest.approx(0.2 * factor)
    dist, rng = deviation_of(given, 7.0), np.random.default_rng(1)
    values = [float(dist.rvs(random_state=rng)) for _ in range(3000)]
    assert stats.kstest(np.array(values), dist.cdf).pvalue > 1e-3
    assert np.mean(values) == pytest.approx(0.0, abs=4 * 0.2 * factor / 3000**0.5)


def test_a_normal_that_is_cut_off():
    """Half normal: standard deviation s sqrt(1 - 2 / pi), and no draw below the cut."""
    given = Input(group="press", key="k", distribution="normal", spread=0.5, at_least=3.0)
    assert standard_uncertainty(given, 3.0) == pytest.approx(0.5 * np.sqrt(1 - 2 / np.pi))
    rng, dist = np.random.default_rng(1), deviation_of(given, 3.0)
    assert min(float(dist.rvs(random_state=rng)) for _ in range(500)) >= 0.0


def test_a_choice_among_values():
    """Values 4 and 8 with weights 3 and 1: mean 5, standard deviation sqrt 3; only these drawn."""
    given = Input(group="optics", key="k", distribution="choice", values=(4, 8), weights=(3, 1))
    dist, rng = deviation_of(given, 4.0), np.random.default_rng(1)
    assert dist.std() == pytest.approx(np.sqrt(3.0))
    drawn = np.array([dist.rvs(random_state=rng) for _ in range(1000)])
    assert set(drawn) == {0.0, 4.0}
    assert (drawn == 4.0).mean() == pytest.approx(0.25, abs=4 * np.sqrt(0.1875 / 1000))
    np.testing.assert_array_equal(dist.ppf([0.1, 0.74, 0.76, 1.0]), [0.0, 0.0, 4.0, 4.0])


def test_draws_equal_those_of_the_earlier_reproduction():
    """The draws equal those of the reproduction of 2026-11: its tables depend on them."""
    drawn = drawn_values(balls(), paper().inputs, 20261121, 1)
    assert drawn["specimen.x_mm"] == 0.045347888207099785
    assert drawn["specimen.diameter_mm"] == 8.007813392360598


def test_values_drawn_together_are_listed_pairs():
    """Travel and pressure from one list of pairs: 200 trials have only these pairs."""
    pairs = [(0.5, 1.0), (0.6, 4.0), (0.7, 9.0)]
    travel, pressure = (list(values) for values in zip(*pairs, strict=True))
    listed = {"distribution": "choice", "together": "posterior"}
    given = inputs_of(
        travel=listed | {"key": "press.depth_mm", "values": travel},
        pressure=listed | {"key": "press.back_pressure_kpa", "values": pressure},
    )
    drawn = [values_of(balls(), given, trial) for trial in range(1, 201)]
    counted = [sum(np.allclose(list(values.values()), pair) for values in drawn) for pair in pairs]
    assert sum(counted) == 200
    assert min(counted) > 40  # of 67 expected, SD 6.7


def test_lists_drawn_together_have_equal_lengths():
    listed = {"group": "press", "distribution": "choice", "together": "posterior"}
    two = {
        "travel": listed | {"key": "press.depth_mm", "values": [0.5, 0.6]},
        "pressure": listed | {"key": "press.back_pressure_kpa", "values": [1.0, 2.0, 3.0]},
    }
    with pytest.raises(ValueError, match="unequal numbers of values"):
        Inputs.model_validate({"inputs": two})


def test_the_sigma_of_an_experiment_is_that_of_its_trials_and_of_its_layer():
    """One statement of a tolerance: for the object's U, and for drawn sheets."""
    case = load_experiment("examples/wrapped_balls", {"sigma.thickness_mm": 1e-3})
    drawn, usual = usual_inputs(case).inputs, load_inputs().inputs
    assert standard_uncertainty(drawn["thickness"], 0.2) == pytest.approx(1e-3)
    assert drawn["back_pressure"] == usual["back_pressure"]
    sigma = sensor_layer_of(case).sigma
    assert sigma.thickness_mm == 1e-3
    assert sigma.back_pressure_kpa == pytest.approx(0.05 * case.press.back_pressure_kpa)
    record = record_of(case, DEFAULT_INPUTS, 2)
    assert record.study.inputs["thickness"] == drawn["thickness"]
    assert sensor_layer_of(load_experiment("examples/slab_balls")).sigma.thickness_mm == 0.0
