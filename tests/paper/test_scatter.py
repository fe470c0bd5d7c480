"""Draws of repeated trials: distributions as stated, keyed by input and trial alone."""

import numpy as np
import pytest

from twin.config import ConfigError, load_experiment
from twin.paper.scatter import Input, Scatter, draw, drawn_values, load_scatter
from twin.pipeline.instruments import PhotometricPlan, case_for

SEED = 5


def scatter(**inputs):
    made = {name: Input(**({"group": "placement"} | one)) for name, one in inputs.items()}
    return Scatter(seed=SEED, inputs=made)


def balls():
    return load_experiment("paper/two_balls")


X = {"key": "specimen.x_mm", "distribution": "normal", "spread": 0.2}
SIZE = {"key": "specimen.diameter_mm", "distribution": "uniform", "spread": 0.01}
DRAPE = {
    "key": "press.back_pressure_kpa",
    "distribution": "normal",
    "spread": 0.05,
    "relative": True,
}


def test_draws_have_the_stated_mean_and_spread():
    """4000 draws: means within 4 standard errors, standard deviations within 4 of theirs."""
    all_three, experiment, n = scatter(x=X, size=SIZE, drape=DRAPE), balls(), 4000
    values = [drawn_values(experiment, all_three, trial) for trial in range(1, n + 1)]
    for name, one in all_three.inputs.items():
        nominal = {"x": 0.0, "size": 8.0, "drape": experiment.press.back_pressure_kpa}[name]
        found = np.array([drawn[one.key] for drawn in values])
        u = one.standard_uncertainty(nominal)
        assert abs(found.mean() - nominal) < 4 * u / np.sqrt(n)
        assert abs(found.std(ddof=1) / u - 1) < 4 / np.sqrt(2 * n)
    sizes = [drawn["specimen.diameter_mm"] for drawn in values]
    assert 7.99 <= min(sizes) < 7.9905
    assert 8.0095 < max(sizes) <= 8.01


def test_a_draw_does_not_depend_on_the_other_inputs():
    alone = drawn_values(balls(), scatter(x=X), 3)
    together = drawn_values(balls(), scatter(drape=DRAPE, size=SIZE, x=X), 3)
    assert alone["specimen.x_mm"] == together["specimen.x_mm"]
    assert alone != drawn_values(balls(), scatter(x=X), 4)


def test_trial_zero_is_the_nominal_one():
    assert draw(balls(), load_scatter(), 0) == balls()


def test_every_instrument_meets_the_specimen_in_the_same_place():
    drawn = draw(balls(), load_scatter(), 7)
    gelsight = case_for(drawn, "photometric_stereo", PhotometricPlan(match="depth"))
    assert gelsight.specimen == drawn.specimen
    assert drawn.specimen.x_mm != 0.0


def test_shipped_inputs_reach_numbers_of_every_repeated_experiment():
    """A renamed field would otherwise be noticed after an hour."""
    for name in ("two_balls", "rods_a", "rods_b", "rods_c"):
        experiment = load_experiment(f"paper/{name}")
        assert len(drawn_values(experiment, load_scatter(), 1)) >= 8 - (name != "two_balls")


def test_spreads_carry_their_source():
    shipped = load_scatter()
    assert {f"inputs.{name}.spread" for name in shipped.inputs} <= shipped.provenance.keys()


def test_a_key_that_leads_nowhere_is_one_line():
    with pytest.raises(ConfigError, match=r"specimen\.weight_g: found no number"):
        draw(balls(), scatter(w={**X, "key": "specimen.weight_g"}), 1)


def test_a_bad_file_is_one_line(tmp_path):
    file = tmp_path / "spread.toml"
    text = 'seed = 1\n[inputs.x]\ngroup = "press"\nkey = "specimen.x_mm"\ndistribution = "cauchy"\n'
    file.write_text(text)
    with pytest.raises(ConfigError, match="distribution"):
        load_scatter(str(file))
