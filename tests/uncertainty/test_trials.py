"""Trials as cases of a study: known results, same bytes with any workers, no repeated cases."""

import json

import numpy as np
import pytest
import xarray

import twin
from reconstruction.errors import InputError
from tests.uncertainty.conftest import X, Y
from tests.uncertainty.models import NOISE, RIG, Linear, Refusing
from twin.config import ConfigError, load_experiment
from twin.config.study import load_study
from twin.propagation.results import read_uncertainty
from twin.propagation.trials import record_of, write_uncertainty
from twin.study.record import StudyRecord
from twin.study.table import read_table, write_csv
from twin.study.trials import NOISE_REPEATS


def known_parts():
    return {
        "x": 2 * 0.1,
        "y": 3 * 0.1 / np.sqrt(3.0),
        "noise and decoding": NOISE,
        "calibration": RIG,
    }


def test_a_linear_model_adds_variances(run_trials):
    """y = 4 + 2 x - 3 y: u^2 = sum of squares of the parts, by budget and by 200 trials.

    Without x or y, u is smaller by 24 % or more; four standard errors of 200 trials are 20 %.
    """
    measurand = run_trials(200).measurands["value_mm"]
    parts = known_parts()
    expected = np.sqrt(sum(u**2 for u in parts.values()))
    assert measurand.distribution.mean == pytest.approx(4.0, abs=4 * expected / 200**0.5)
    assert measurand.distribution.standard_uncertainty == pytest.approx(expected, rel=4 / 400**0.5)
    assert measurand.from_budget == pytest.approx(expected, rel=0.02)
    for part in measurand.parts:
        exact = part.name in "xy"
        tolerance = 1e-9 if exact else 4 / np.sqrt(2 * NOISE_REPEATS)
        assert part.u == pytest.approx(parts[part.name], rel=tolerance)
    assert [part.name for part in measurand.parts[:2]] == ["x", "y"]
    assert measurand.correlations[0].name == "x"
    assert measurand.correlations[0].linear == pytest.approx(parts["x"] / expected, abs=0.15)


def test_trial_zero_is_nominal_and_in_no_spread(run_trials):
    result = run_trials(5)
    measurand = result.measurands["value_mm"]
    assert measurand.distribution.values.size == 5
    noise = np.random.default_rng([7, 0]).normal()
    assert measurand.nominal == pytest.approx(4.0 + NOISE * noise)


def test_the_true_rig_has_no_part(run_trials):
    measurand = run_trials(5, calibration="true").measurands["value_mm"]
    assert "calibration" not in {part.name for part in measurand.parts}


def test_without_a_budget(run_trials):
    result = run_trials(5, budget=False)
    assert result.measurands["value_mm"].parts == ()
    assert len(result.table.rows) == 6


def test_further_trials_are_added_to_the_stored_ones(run_trials, tmp_path):
    few = run_trials(4).measurands["value_mm"].distribution.values
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out/cases").iterdir()}
    more = run_trials(9).measurands["value_mm"].distribution.values
    np.testing.assert_array_equal(more[:4], few)
    after = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out/cases").iterdir()}
    assert {name: after[name] for name in before} == before
    assert len(after) == len(before) + 10  # five trials and five repeats of the noise


def test_same_bytes_with_one_worker_two_and_after_a_stop(run_trials, tmp_path, balls):
    """One process, two, and a run resumed after two trials: the same table and files."""
    texts = []
    for name, workers in (("one", 1), ("two", 2)):
        result = run_trials(4, name=name, workers=workers)
        write_uncertainty(tmp_path / name, result)
    run_trials(2, name="stopped")
    write_uncertainty(tmp_path / "stopped", run_trials(4, name="stopped"))
    for name in ("one", "two", "stopped"):
        write_csv(read_table(tmp_path / name), tmp_path / f"{name}.csv")
        files = [tmp_path / f"{name}.csv", tmp_path / name / "result.json"]
        texts.append([file.read_bytes() for file in files])
    assert texts[0] == texts[1] == texts[2]


def test_the_table_as_netcdf(run_trials, tmp_path):
    result = run_trials(6)
    write_uncertainty(tmp_path / "out", result)
    with xarray.open_dataset(tmp_path / "out/trials.nc") as table:
        assert table.sizes == {"trial": 7}
        np.testing.assert_array_equal(
            table["value_mm"][1:], result.measurands["value_mm"].distribution.values
        )
        assert float(table["specimen.x_mm"][0]) == 0.0
        assert np.isnan(table["true_rig_value_mm"][0])


def test_result_has_units_at_the_ends_of_its_names(run_trials, tmp_path):
    write_uncertainty(tmp_path / "out", run_trials(50))
    result = json.loads((tmp_path / "out/result.json").read_text())
    assert result["command"] == "uncertainty"
    metrics = result["metrics"]
    assert metrics["trials"] == 50
    assert metrics["interval_low_value_mm"] < metrics["mean_value_mm"]
    assert metrics["uncertainty_by_x_value_mm"] == pytest.approx(0.2)
    assert load_experiment(tmp_path / "out/experiment.toml").specimen.x_mm == 0.0


def test_trials_that_fail_are_counted_and_left_out(run_trials):
    result = run_trials(30, model=Refusing)
    measurand = result.measurands["value_mm"]
    assert result.failures == {"specimen: beyond the elastomer": measurand.missing}
    assert 0 < measurand.missing < 15
    assert measurand.distribution.values.size == 30 - measurand.missing
    assert result.metrics()["failed_trials"] == measurand.missing


def test_a_measurand_in_no_trial_is_an_error(run_trials, tmp_path):
    run_trials(3)
    with pytest.raises(InputError, match=r"value_um: found in no trial, allowed .*value_mm"):
        read_uncertainty(tmp_path / "out", ["value_um"])


def test_a_study_file_of_trials(tmp_path, balls):
    """The study's inputs override those of a named file key by key; spreads state their source."""
    file = tmp_path / "study.toml"
    file.write_text(
        'name = "t"\nbase = "examples/slab_balls"\ninputs_file = "paper/trials"\n'
        '[sampling]\nmethod = "trials"\ncount = 4\nseed = 3\ncalibration = "true"\n'
        "[inputs.place_x]\nspread = 0.5\n"
    )
    study, base = load_study(file)
    assert study.inputs["place_x"].spread == 0.5
    assert study.inputs["place_y"].spread == 0.2
    assert "assumed" in study.inputs["place_y"].source
    cases = StudyRecord(study, base).cases().run
    assert sum(case.settings["part"] == "trial" for case in cases) == 5
    again = type(study).model_validate(study.model_dump(mode="json"))
    assert again == study


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            {"axis": [{"path": "press.depth_mm", "values": [1.0]}]},
            "axis: sampling.method = 'trials'",
        ),
        ({"inputs": {}}, "inputs: found none"),
        ({"repeats": 3}, "repeats: sampling.method"),
        ({"sampling": {"method": "grid"}}, "only sampling.method = 'trials' draws them"),
        ({"sampling": {"method": "trials"}}, "count: missing"),
        ({"inputs": {"x": X, "again": X}}, "again and x both draw specimen.x_mm"),
    ],
)
def test_bad_studies(change, line):
    from pydantic import ValidationError

    from twin.config.study import Study

    tree = {
        "name": "t",
        "base": "examples/slab_balls",
        "sampling": {"method": "trials", "count": 4},
        "inputs": {"x": X},
    }
    with pytest.raises(ValidationError, match=line):
        Study.model_validate(tree | change)


def test_bad_inputs_are_one_line(balls):
    with pytest.raises(ConfigError, match=r"press.weight_g: found no number there in two_balls"):
        record_of(balls, {"w": {**X, "key": "press.weight_g"}}, 3).cases()
    wide = {**X, "key": "elastomer.thickness_mm", "spread": 50.0}
    with pytest.raises(ConfigError, match=r"thickness_mm: .*drawn in trial \d+; use a smaller"):
        record_of(balls, {"t": wide}, 3).cases()
    with pytest.raises(ConfigError, match="trials: found 1, allowed 2"):
        record_of(balls, {"x": X}, 1)
    with pytest.raises(ConfigError, match="degrees_of_freedom: required by student_t"):
        record_of(balls, {"x": {**X, "distribution": "student_t"}}, 3)


def test_photometric_trials_use_the_calibrations_in_turn(balls):
    """Seeds of the sensor: one of five by trial, and each of the five on the nominal press."""
    sensor = load_experiment("paper/gelsight_two_balls")
    cases = record_of(sensor, {"x": X}, 7).cases().run
    seeds = [case.experiment.seed for case in cases if case.settings["part"] == "trial"]
    assert [seed - sensor.seed for seed in seeds] == [0, 1, 2, 3, 4, 0, 1, 2]
    redone = [case.experiment.seed for case in cases if case.settings["part"] == "calibration"]
    assert [seed - sensor.seed for seed in redone] == [0, 1, 2, 3, 4]


def test_the_public_function(balls, monkeypatch, tmp_path):
    """`twin.uncertainty` is the function even if its modules were imported first."""
    import twin.propagation.results
    from twin.propagation import trials
    from twin.study import measuring

    assert callable(twin.uncertainty)
    run = trials.sweep
    monkeypatch.setattr(
        trials, "sweep", lambda *given, **named: run(*given, **named, make_measurer=Linear)
    )
    result = twin.uncertainty(
        balls, {"x": X, "y": Y}, n=3, calibration="true", measurands=["value_mm"]
    )
    assert result.trials == 3
    assert measuring.NOMINAL_CONDITIONS.trial == 0
    assert list(result.measurands) == ["value_mm"]


def test_a_real_trial(mi, tmp_path):
    """Two trials of the whole chain: the drawn input changes the radius, and the noise differs."""
    small = {
        "camera.binning": 4,
        "camera.width_px": 640,
        "camera.height_px": 480,
        "press.solver_pitch_mm": 0.4,
        "patterns.steps": 3,
        "render.samples": 1,
    }
    experiment = load_experiment("examples/slab_balls", small)
    thick = {**X, "group": "elastomer", "key": "elastomer.thickness_mm", "spread": 0.1}
    result = twin.uncertainty(
        experiment,
        {"thickness": thick},
        n=2,
        calibration="true",
        folder=tmp_path / "out",
        measurands=["sphere_1_radius_mm", "z_bias_um"],
    )
    radius, bias = result.measurands.values()
    slope = radius.parts[0].u / 0.1
    drawn = [row["elastomer.thickness_mm"] for row in result.table.rows[1:3]]
    moved = radius.distribution.values - radius.nominal
    # The camera's noise changes the difference of two radii by 0.01 mm (SD of 150 trials); the
    # tolerance is three of these.
    np.testing.assert_allclose(
        np.abs(moved), slope * np.abs(np.array(drawn) - 3.0), rtol=0.35, atol=0.03
    )
    assert len({*bias.distribution.values, bias.nominal}) == 3


def test_trials_in_one_line_in_pictures_and_as_labelled_arrays(run_trials):
    result = run_trials(40)
    values = result.measurands["value_mm"].distribution
    text = repr(result)
    assert text.startswith(f"<Uncertainty: {result.experiment.name}, trials 40; value_mm ")
    assert f"{values.mean:.6g}, u {values.standard_uncertainty:.2g}, 95 % " in text
    data = result.to_xarray()
    assert data["value_mm"].dims == ("trial",)
    np.testing.assert_allclose(data["value_mm"][data["trial"] > 0], values.values)
    assert data["specimen.x_mm"].attrs["long_name"] == "input"
    drawing = result.plot()
    assert drawing.axes[0].get_xlabel() == "value_mm"
    assert sum(bar.get_height() for bar in drawing.axes[0].containers[0]) == 40
    assert "data:image/png;base64," in result._repr_html_()
