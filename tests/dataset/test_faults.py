"""Mistakes in recipes, and damaged or full folders: each is one clear line, or it works."""

import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from reconstruction.errors import InputError
from reconstruction.evaluate.samples import read_samples
from tests.dataset.conftest import COUNT, RECIPE, MadeSet
from twin.cli import run
from twin.dataset.make import pack
from twin.dataset.stored import stored_files
from twin.dataset.taking import SAMPLE_FOLDER
from twin.study.store import Store

SEED, DIAMETER = "seed = 10", "values = [6.0, 1e6]"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (SEED, "sead = 10", "unknown key 'sead' at the top level; did you mean 'seed'?"),
        (SEED, "seed = -1", "seed: found -1, should be greater than or equal to 0"),
        (SEED, 'seed = 1\nformat = "zarr"', "format: found 'zarr', should be 'webdataset', 'hdf5'"),
        (SEED, 'seed = 1\nbaseline = "net"', "baseline: found 'net', should be"),
        (SEED, 'seed = 1\nbaseline = "fourier"\nsample.hold = ["lit"]\n', None),
        (DIAMETER, "low = 9.0\nhigh = 8.0", "low: found 9, allowed below high, 8"),
        (DIAMETER, 'low = 0.0\nhigh = 8.0\nscale = "log"', "found 0, allowed above 0"),
        (
            DIAMETER,
            "low = 4.2\nhigh = 4.8\ninteger = true",
            "found no whole number from 4.2 to 4.8",
        ),
        (DIAMETER, "low = nan\nhigh = 8.0", "low: found nan, should be a finite number"),
        (DIAMETER, "values = []", "values: found []"),
        (DIAMETER, 'files = "./none/*.stl"', "files = './none/*.stl': found no such file in "),
        ("weight = 2.0", "weight = 0", "scene.0.weight: found 0, should be greater than 0"),
        ('"examples/gauges"', '"examples/gaugs"', "not found, neither as a file nor in scenes"),
        (
            '"frames", "radiance",',
            '"frame", "radiance",',
            "sample.hold: found 'frame', allowed: fr",
        ),
        ('name = "small"', 'name = "größe"', "name: found 'größe', string should match"),
        ('distribution = "normal"', 'distribution = "gauss"', "found 'gauss', should be 'normal'"),
        ("[sample]", "[sample", "not valid TOML"),
        ("[sample]", '[sample]\nmethods = ["contact_fpp", "stereo"]', "found 'stereo', should be"),
        ("train = 0.0", "train = 1.5", "split.train: found 1.5, should be less than or equal"),
    ],
)
def test_a_mistake_in_a_recipe_is_one_line(tmp_path, capsys, old, new, message) -> None:
    assert old in RECIPE
    text = RECIPE.replace(old, new, 1)
    if message is None:  # the baseline has no input
        message = "baseline: 'fourier' needs phase_column_rad with frames"
        text = text.replace('sample.hold = ["lit"]\n', "")
        text = text[: text.index("hold = [")] + 'hold = ["lit"]\n' + text[text.index("[split]") :]
    file = tmp_path / "recipe.toml"
    file.write_text(text, encoding="utf-8")
    assert run(["dataset", str(file), "-n", "2", "-o", str(tmp_path / "out"), "--dry-run"]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert len(printed.splitlines()) == 1, printed


def test_no_scene_and_no_quantity_are_named(tmp_path, capsys) -> None:
    file = tmp_path / "recipe.toml"
    for text, message in (
        ('name = "a"\nscene = []\n[sample]\nhold = ["lit"]\n', "scene: found none, allowed one or"),
        (
            RECIPE[: RECIPE.index("hold = [")] + "hold = []\n",
            "sample.hold: found none, allowed one",
        ),
    ):
        file.write_text(text, encoding="utf-8")
        assert run(["dataset", str(file), "-n", "1", "-o", str(tmp_path / "out"), "--dry-run"]) == 2
        assert message in capsys.readouterr().err


def test_a_folder_that_cannot_be_the_output_is_rejected_before_computing(made, tmp_path, capsys):
    """Expected: no store of samples next to it."""
    (tmp_path / "file").write_text("text", encoding="utf-8")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("text", encoding="utf-8")
    for name, message in (("file", "is a file"), ("mine", "is no earlier result")):
        assert run(["dataset", str(made.file), "-n", "1", "-o", str(tmp_path / name)]) == 2
        assert message in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "mine"]


def test_names_that_are_no_ascii_are_written_and_read(tmp_path) -> None:
    """Folders, files and titles of axes; a vertical bar would end a cell of the card's table."""
    folder = tmp_path / "Prüfkörper ö"
    folder.mkdir()
    np.save(
        folder / "höhe.npy", np.fromfunction(lambda y, x: 0.1 * np.hypot(x - 8, y - 8), (16, 16))
    )
    text = """
name = "maps"
[[scene]]
name = "map"
base = "examples/slab_ball"
[scene.set]
camera = { binning = 4, width_px = 160, height_px = 120 }
patterns = { steps = 3, code = "gray" }
specimen = { kind = "height_map", file = "./Prüfkörper ö/höhe.npy", pixel_mm = 0.5 }
[[scene.axis]]
name = "Maß | ø"
path = "specimen.x_mm"
values = [0.0]
[[scene.axis]]
path = "specimen.file"
files = "./Prüfkörper ö/*.npy"
[sample]
hold = ["depth_mm"]
"""
    (tmp_path / "rezept.toml").write_text(text, encoding="utf-8")
    out = tmp_path / "Ausgabe ü"
    assert (
        run(["dataset", str(tmp_path / "rezept.toml"), "-n", "1", "-o", str(out), "-j", "1"]) == 0
    )
    assert "| map | Maß / ø | 0.0, equally probable |" in (out / "README.md").read_text("utf-8")
    (row,) = pyarrow.parquet.read_table(out / "index.parquet").to_pylist()
    assert row["drawn.Maß | ø"] == 0.0
    assert row["drawn.specimen.file"].endswith("höhe.npy")


def last(made: MadeSet) -> tuple[Path, object]:
    case = made.draws[COUNT - 1].case
    assert case is not None
    return Store(made.work).path_of(case.digest), case.experiment


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            lambda f: (f / SAMPLE_FOLDER / "depth_mm.npy").unlink(),
            "depth_mm is missing; delete this",
        ),
        (lambda f: shutil.rmtree(f / SAMPLE_FOLDER), "frames is missing"),
        (lambda f: (f / "experiment.toml").unlink(), "experiment is missing"),
        (lambda f: (f / SAMPLE_FOLDER / "calibration.json").unlink(), "calibration is missing"),
        (
            lambda f: cut(f / SAMPLE_FOLDER / "label.npy", 40),
            "label.npy: EOF: reading array header",
        ),
        (
            lambda f: cut(f / SAMPLE_FOLDER / "label.npy", 4000),
            "label.npy: found 4000 bytes, allowed",
        ),
        (lambda f: cut(f / SAMPLE_FOLDER / "label.npy", 0), "label.npy: EOF"),
    ],
)
def test_a_damaged_sample_of_the_store_is_not_packed(made, tmp_path, damage, message) -> None:
    """Expected: intact samples have all files of their data set; a damaged one is named."""
    folder, experiment = last(made)
    copy = tmp_path / "sample"
    shutil.copytree(folder, copy)
    content = made.recipe.sample
    assert {f"{name}.npy" for name in content.hold} < {*stored_files(copy, content, experiment)}
    damage(copy)
    with pytest.raises(InputError, match=message):
        stored_files(copy, content, experiment)


def cut(path: Path, size: int) -> None:
    path.write_bytes(path.read_bytes()[:size])


@pytest.mark.parametrize(("kind", "ending"), [("hdf5", "h5"), ("parquet", "parquet")])
def test_shards_that_are_cut_empty_or_a_folder_are_named(made, tmp_path, kind, ending) -> None:
    recipe = made.recipe.model_copy(update={"format": kind})
    pack(recipe, made.bases, made.draws, made.work, tmp_path / "set")
    (shard, *_) = sorted((tmp_path / "set").glob(f"test-*.{ending}"))
    whole = shard.read_bytes()
    for content in (whole[:-100], whole[: len(whole) // 2], b"", None):
        shard.unlink()
        shard.mkdir() if content is None else shard.write_bytes(content)
        with pytest.raises(InputError, match=f"{shard.name}: damaged") as raised:
            list(read_samples(tmp_path / "set", "test", ("depth_mm",)))
        assert "\n" not in str(raised.value)
