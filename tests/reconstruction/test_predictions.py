"""Scores of predictions against closed forms, on data sets that are written by hand."""

import io
import json
import tarfile
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.evaluate.predictions import score_predictions
from reconstruction.evaluate.samples import npy as read_npy

SHAPE = (12, 16)
ROWS, COLS = np.indices(SHAPE)
TURN = 2 * np.pi


def truth() -> dict[str, np.ndarray]:
    """A plane with a tilted normal; the left quarter of the image shows no surface."""
    label = np.where(COLS < 4, 0, 2).astype(np.uint8)
    lit = np.where(ROWS == 0, 0, 1).astype(np.uint8)
    normal = np.zeros((*SHAPE, 3), np.float32)
    normal[...] = (np.sin(0.3), 0.0, np.cos(0.3))
    return {
        "depth_mm": (200.0 + 0.01 * COLS).astype(np.float32),
        "normal_world": normal,
        "phase_column_rad": (0.9 * COLS + 0.1 * ROWS).astype(np.float32),
        "label": label,
        "lit": lit,
    }


TARGETS = 12 * 11  # of each sample


def write_dataset(folder: Path, samples: dict[str, tuple[str, dict[str, np.ndarray]]]) -> Path:
    """Write the test split: object and arrays by key."""
    folder.mkdir()
    names = {f"{name}.npy": {} for _, arrays in samples.values() for name in arrays}
    (folder / "schema.json").write_text(json.dumps({"files": names}), encoding="utf-8")
    with tarfile.open(folder / "test-000000.tar", "w") as tar:
        for key, (name, arrays) in samples.items():
            contents = {f"{n}.npy": npy(a) for n, a in arrays.items()}
            contents["sample.json"] = json.dumps({"object": name}).encode()
            for ending, content in sorted(contents.items()):
                member = tarfile.TarInfo(f"{key}.{ending}")
                member.size = len(content)
                tar.addfile(member, io.BytesIO(content))
    return folder


def npy(values: np.ndarray) -> bytes:
    made = io.BytesIO()
    np.save(made, values)
    return made.getvalue()


@pytest.fixture
def dataset(tmp_path) -> Path:
    return write_dataset(
        tmp_path / "set", {"00": ("a", truth()), "01": ("a", truth()), "02": ("b", truth())}
    )


def predict(folder: Path, **named: np.ndarray) -> Path:
    """Write predictions: KEY__QUANTITY or KEY."""
    folder.mkdir(exist_ok=True)
    for name, values in named.items():
        key, _, quantity = name.removeprefix("k").partition("__")
        np.save(folder / ".".join(filter(None, (key, quantity, "npy"))), values)
    return folder


def test_an_offset_is_bias_and_rms(dataset, tmp_path) -> None:
    depth = truth()["depth_mm"]
    given = {"k00": depth + 0.002, "k01__depth_mm": depth - 0.004, "k02": depth.astype(np.float64)}
    score = score_predictions(predict(tmp_path / "p", **given), dataset)
    figures = score.figures()
    assert figures["samples"] == 3
    assert figures["objects"] == 2
    assert figures["samples_without_prediction"] == 0
    assert figures["depth_completeness"] == 1.0
    assert figures["depth_bias_um"] == pytest.approx(-2.0 / 3, abs=0.02)  # float32 at 200 mm
    assert figures["depth_rms_um"] == pytest.approx(np.sqrt((4 + 16) / 3), rel=1e-2)
    assert figures["depth_mean_absolute_um"] == pytest.approx(2.0, rel=1e-2)
    rows = {row["object"]: row for row in score.by_object()}
    assert rows["a"]["samples"] == 2
    assert rows["a"]["depth_bias_um"] == pytest.approx(-1.0, abs=0.02)
    assert rows["b"]["depth_rms_um"] == pytest.approx(0.0, abs=1e-9)


def test_pixels_without_prediction_lower_the_completeness_only(dataset, tmp_path) -> None:
    depth = truth()["depth_mm"] + np.float32(0.001)
    depth[:, 10:] = np.nan
    depth[:, :4] = 1e6  # not the measured surface
    depth[0] = -1e6  # not lit
    figures = score_predictions(predict(tmp_path / "p", k00=depth), dataset).figures()
    assert figures["samples_without_prediction"] == 2
    assert figures["depth_completeness"] == pytest.approx(6 * 11 / (3 * TARGETS))
    assert figures["depth_rms_um"] == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("angle_deg", [0.001, 3.0, 170.0])
def test_a_turned_normal_has_its_angle(dataset, tmp_path, angle_deg: float) -> None:
    angle = 0.3 + np.deg2rad(angle_deg)
    normal = 5.0 * np.broadcast_to([np.sin(angle), 0.0, np.cos(angle)], (*SHAPE, 3))
    folder = predict(tmp_path / "p", k00__normal_world=normal)
    figures = score_predictions(folder, dataset).figures()
    # The true normals are float32: 2e-6 deg.
    assert figures["normal_rms_deg"] == pytest.approx(angle_deg, rel=1e-3, abs=1e-5)
    assert figures["normal_completeness"] == pytest.approx(1 / 3)


def test_wrong_orders_are_counted(dataset, tmp_path) -> None:
    phase = truth()["phase_column_rad"] + np.where(COLS >= 13, TURN, 0.0)
    figures = score_predictions(predict(tmp_path / "p", k02__phase_column_rad=phase), dataset)
    figures = figures.figures()
    assert figures["phase_column_wrong_order_share"] == pytest.approx(0.25)
    assert figures["phase_column_rms_rad"] == pytest.approx(TURN / 2, rel=1e-6)


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({}, "found no predictions"),
        ({"k00": np.zeros((3, 3))}, r"found the shape \(3, 3\), allowed \(12, 16\)"),
        ({"k99": np.zeros(SHAPE)}, "no file belongs to a sample"),
        ({"k00__height": np.zeros(SHAPE)}, "found 'height', allowed depth_mm"),
        ({"k00": np.zeros(SHAPE), "k00__depth_mm": np.zeros(SHAPE)}, "given twice"),
        ({"k00__phase_row_rad": np.zeros(SHAPE)}, "does not contain the truth"),
    ],
)
def test_faults_of_predictions(dataset, tmp_path, named: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        score_predictions(predict(tmp_path / "p", **named), dataset)


def test_files_of_another_split_are_reported(dataset, tmp_path) -> None:
    folder = predict(tmp_path / "p", k00=truth()["depth_mm"], k99=np.zeros(SHAPE))
    assert score_predictions(folder, dataset).figures()["unused_predictions"] == 1
    with pytest.raises(InputError, match="the split 'train' has no sample"):
        score_predictions(folder, dataset, "train")
    with pytest.raises(InputError, match="is no data set"):
        score_predictions(folder, tmp_path)


def test_a_prediction_that_is_no_array(dataset, tmp_path) -> None:
    (tmp_path / "p").mkdir()
    (tmp_path / "p" / "00.npy").write_bytes(b"text")
    with pytest.raises(InputError, match=r"00\.npy: is no \.npy file"):
        score_predictions(tmp_path / "p", dataset)
    (tmp_path / "p" / "00.npy").write_bytes(npy(np.array(["text"])))
    with pytest.raises(InputError, match=r"is no \.npy file of numbers"):
        score_predictions(tmp_path / "p", dataset)


def test_a_damaged_shard_is_named(dataset, tmp_path) -> None:
    shard = dataset / "test-000000.tar"
    shard.write_bytes(shard.read_bytes()[:3000])
    with pytest.raises(InputError, match=r"test-000000\.tar: damaged"):
        score_predictions(predict(tmp_path / "p", k00=truth()["depth_mm"]), dataset)


@pytest.mark.parametrize("split", ["", "/test", "**", "*"])
def test_an_unknown_split_is_one_line(dataset, tmp_path, split: str) -> None:
    folder = predict(tmp_path / "p", k00=truth()["depth_mm"])
    with pytest.raises(
        InputError, match=r"--split: found .* allowed: train, validation, test, all"
    ):
        score_predictions(folder, dataset, split)


def test_damaged_bytes_of_an_array_are_a_value_error() -> None:
    """Archives, cut and changed headers: NumPy raises errors of several kinds."""
    intact, rng = npy(np.zeros((4, 5), np.float32)), np.random.default_rng(0)
    np.testing.assert_array_equal(read_npy(intact), np.zeros((4, 5)))
    damaged = [b"", b"PK" + intact, intact[:40], intact[:-8]]
    for _ in range(300):
        changed = bytearray(intact)
        changed[int(rng.integers(128))] ^= 1 << int(rng.integers(8))
        damaged.append(bytes(changed))
    for content in damaged:
        with suppress(ValueError):
            read_npy(content)
