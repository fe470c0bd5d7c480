"""Scores by method, by split and with a baseline, on data sets that are written by hand."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.evaluate.methods import score_dataset
from reconstruction.evaluate.predictions import score_predictions
from tests.reconstruction.test_baselines import with_decoded
from tests.reconstruction.test_predictions import COLS, predict, truth, write_dataset

METHODS = ("contact_fpp", "direct_fpp")


def named(method: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {f"{method}_{name}": values for name, values in arrays.items()}


def farther(step_mm: float) -> dict[str, np.ndarray]:
    """The plane at another distance, so that a truth of the wrong method gives its offset."""
    return truth() | {"depth_mm": truth()["depth_mm"] + np.float32(step_mm)}


@pytest.fixture
def dataset(tmp_path) -> Path:
    """Return a set of two methods: the plane of the second one is 1 mm farther."""
    contact = named("contact_fpp", with_decoded(masked=COLS >= 13))
    both = contact | named("direct_fpp", farther(1.0))
    folder = write_dataset(tmp_path / "set", {"00": ("a", both), "01": ("b", both)})
    state(folder, methods=METHODS)
    return folder


def state(folder: Path, **entries: object) -> None:
    """Add entries to the schema of a data set."""
    file = folder / "schema.json"
    schema = json.loads(file.read_text(encoding="utf-8"))
    file.write_text(json.dumps(schema | entries), encoding="utf-8")


def depths(folder: Path, offset_mm: float, base_mm: float = 0.0) -> Path:
    values = farther(base_mm)["depth_mm"] + offset_mm
    return predict(folder, k00=values, k01=values)


def test_each_method_is_compared_with_its_own_truth(dataset, tmp_path) -> None:
    """Expected: the offset of each method is its bias, by method and by object."""
    (tmp_path / "p").mkdir()
    depths(tmp_path / "p" / "contact_fpp", 0.003)
    depths(tmp_path / "p" / "direct_fpp", -0.005, base_mm=1.0)
    result = score_dataset(dataset, tmp_path / "p")
    figures = result.figures()
    assert figures["contact_fpp_depth_bias_um"] == pytest.approx(3.0, abs=0.02)
    assert figures["direct_fpp_depth_bias_um"] == pytest.approx(-5.0, abs=0.02)
    rows = {(row["method"], row["object"]): row for row in result.by_object()}
    assert set(rows) == {(method, name) for method in METHODS for name in "ab"}
    assert rows["direct_fpp", "b"]["depth_rms_um"] == pytest.approx(5.0, abs=0.02)
    assert result.by_split() == []
    assert result.baseline == ""


def test_the_files_of_one_method_may_be_in_the_folder_itself(dataset, tmp_path) -> None:
    folder = depths(tmp_path / "p", 0.004, base_mm=1.0)
    only = score_dataset(dataset, folder, method="direct_fpp").figures()
    assert only["direct_fpp_depth_bias_um"] == pytest.approx(4.0, abs=0.02)
    assert not any("contact" in name for name in only)
    (tmp_path / "q").mkdir()
    shutil.copytree(folder, tmp_path / "q" / "direct_fpp")
    for method in ("direct_fpp", ""):  # a method without a folder has no score
        assert score_dataset(dataset, tmp_path / "q", method=method).figures() == only


def test_a_set_of_one_method_has_the_figures_of_its_predictions(tmp_path) -> None:
    """Expected: names and values as without methods, in one split and in all."""
    folder = write_dataset(tmp_path / "set", {"00": ("a", truth()), "01": ("b", truth())})
    given = depths(tmp_path / "p", 0.002)
    score = score_predictions(given, folder)
    result = score_dataset(folder, given)
    assert result.figures() == score.figures()
    assert result.by_object() == score.by_object()
    with pytest.raises(InputError, match="--method: found 'direct_fpp', allowed: none"):
        score_dataset(folder, given, method="direct_fpp")


def test_all_splits_have_a_row_each_and_the_split_of_each_object(tmp_path) -> None:
    """Expected: sums over all samples together, not the mean of the splits."""
    folder = write_dataset(tmp_path / "set", {"00": ("a", truth()), "01": ("a", truth())})
    other = write_dataset(tmp_path / "other", {"02": ("b", truth())})
    (other / "test-000000.tar").rename(folder / "train-000000.tar")
    depth = truth()["depth_mm"]
    given = predict(tmp_path / "p", k00=depth + 0.002, k01=depth + 0.002, k02=depth + 0.005)
    result = score_dataset(folder, given, split="all")
    rows = {row["split"]: row for row in result.by_split()}
    assert set(rows) == {"train", "test"}
    assert rows["test"]["samples"] == 2
    assert rows["test"]["depth_bias_um"] == pytest.approx(2.0, abs=0.02)
    assert rows["train"]["depth_bias_um"] == pytest.approx(5.0, abs=0.02)
    assert {row["object"]: row["split"] for row in result.by_object()} == {
        "a": "test",
        "b": "train",
    }
    assert result.figures()["depth_bias_um"] == pytest.approx(3.0, abs=0.02)
    assert result.figures()["samples"] == 3


def test_the_baseline_of_the_recipe_is_scored_with_the_predictions(dataset, tmp_path) -> None:
    """Expected: the phase of the decoder is 0.01 rad too large, on 9 of 12 columns.

    The other method has no decoded arrays: the reason is stated, its predictions are scored.
    """
    state(dataset, methods=METHODS, baseline="decoded")
    (tmp_path / "p").mkdir()
    for method in METHODS:
        phase = truth()["phase_column_rad"] + 0.1
        predict(tmp_path / "p" / method, k00__phase_column_rad=phase)
    result = score_dataset(dataset, tmp_path / "p")
    figures = result.figures()
    assert result.baseline == "decoded"
    assert figures["contact_fpp_phase_column_bias_rad"] == pytest.approx(0.1, rel=1e-3)
    assert figures["contact_fpp_baseline_phase_column_bias_rad"] == pytest.approx(0.01, rel=1e-3)
    assert figures["contact_fpp_baseline_phase_column_completeness"] == pytest.approx(0.75)
    assert figures["direct_fpp_phase_column_bias_rad"] == pytest.approx(0.1, rel=1e-3)
    assert "direct_fpp_baseline_phase_column_bias_rad" not in figures
    assert list(result.unable) == ["direct_fpp"]
    (row, *_) = result.by_object()
    assert row["baseline_phase_column_bias_rad"] == pytest.approx(0.01, rel=1e-3)
    only = score_dataset(dataset)
    assert only.figures()["contact_fpp_phase_column_bias_rad"] == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize(
    ("files", "options", "message"),
    [
        (["00.npy"], {}, r"00\.npy: belongs to no method; give files METHOD/KEY.QUANTITY.npy"),
        (["other/00.npy"], {}, "found the folder 'other', allowed: contact_fpp, direct_fpp"),
        ([], {}, "p: found no folder; give files METHOD/KEY.QUANTITY.npy"),
        (["00.npy"], {"method": "stereo"}, "--method: found 'stereo', allowed: contact_fpp, dir"),
        (["direct_fpp/00.npy"], {"baseline": "decoded"}, "needs depth_mm with decoded_depth_mm"),
        (["direct_fpp/00.npy"], {"baseline": "neural"}, "--baseline: found 'neural', allowed"),
        (None, {}, "found neither PREDICTIONS nor a baseline"),
        (["contact_fpp/00.phase_row_rad.npy"], {}, "does not contain the truth"),
    ],
)
def test_faults_of_methods(dataset, tmp_path, files, options: dict, message: str) -> None:
    for file in files or []:
        path = tmp_path / "p" / file
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, farther(1.0)["depth_mm"])
    (tmp_path / "p").mkdir(exist_ok=True)
    with pytest.raises(InputError, match=message):
        score_dataset(dataset, None if files is None else tmp_path / "p", **options)


@pytest.mark.parametrize(
    ("quantity", "scale", "message"),
    [
        (
            "depth_mm",
            1e-3,
            "found values 1e.03 times smaller than the truth, as in metres; give mil",
        ),
        ("depth_mm", 0.1, "10 times smaller than the truth, as in centimetres"),
        ("depth_mm", 1e3, "1e.03 times larger than the truth, as in micrometres"),
        ("depth_mm", 1 / 600, "600 times smaller than the truth; give millimetres, and NaN"),
        ("depth_mm", 0.0, "found values of 0, smaller than the truth; give millimetres"),
        ("phase_column_rad", 1 / (2 * np.pi), "as in turns; give radians"),
        ("phase_column_rad", 180 / np.pi, "as in degrees; give radians"),
    ],
)
def test_predictions_in_another_unit(tmp_path, quantity: str, scale: float, message: str) -> None:
    folder = write_dataset(tmp_path / "set", {"00": ("a", truth())})
    given = predict(tmp_path / "p", **{f"k00__{quantity}": truth()[quantity] * scale})
    with pytest.raises(InputError, match=message):
        score_predictions(given, folder)


@pytest.mark.parametrize("scale", [0.2, 1.5, 5.0, -1.0])
def test_bad_predictions_in_the_right_unit_are_scored(tmp_path, scale: float) -> None:
    folder = write_dataset(tmp_path / "set", {"00": ("a", truth())})
    given = predict(tmp_path / "p", k00=truth()["depth_mm"] * scale)
    rms = score_predictions(given, folder).figures()["depth_rms_um"]
    assert rms == pytest.approx(abs(1 - scale) * 200.1e3, rel=1e-3)


def test_one_sample_in_another_unit_does_not_stop_the_score(tmp_path) -> None:
    """A network may fail on a sample; a wrong unit is in all of them."""
    folder = write_dataset(tmp_path / "set", {f"0{n}": ("a", truth()) for n in range(3)})
    depth = truth()["depth_mm"]
    given = predict(tmp_path / "p", k00=depth, k01=depth, k02=0 * depth)
    assert score_predictions(given, folder).figures()["depth_rms_um"] > 1e5


def test_a_quantity_that_one_sample_lacks_has_no_target_there(tmp_path) -> None:
    """With several methods a scene may lack a quantity that another scene has."""
    whole, without = truth(), truth()
    del without["phase_column_rad"]
    folder = write_dataset(tmp_path / "set", {"00": ("a", whole), "01": ("b", without)})
    given = predict(tmp_path / "p", k00__phase_column_rad=whole["phase_column_rad"])
    score = score_predictions(given, folder)
    assert score.figures()["phase_column_completeness"] == 1.0
    assert score.without_prediction == []
