"""The blocks of docs/datasets.md, on the small data set."""

import importlib.util
import json
import subprocess
import sys

import numpy as np
import pyarrow.parquet
import pytest
import yaml

from tests.dataset.conftest import COUNT, MadeSet
from tests.docs.documents import DOCS, Block, blocks
from twin.config.dataset import Recipe, load_recipe
from twin.config.schema import list_keys
from twin.dataset.draws import draw_sample
from twin.dataset.make import pack
from twin.dataset.quantities import SAMPLE_QUANTITIES
from twin.dataset.taking import SAMPLE_FOLDER
from twin.study.store import Store

PAGE = DOCS / "datasets.md"


def block_of(start: str) -> Block:
    (block,) = (block for block in blocks(PAGE) if block.text.startswith(start))
    return block


def test_the_recipe_of_the_page(tmp_path) -> None:
    """Expected: valid, and the keys with a default have it or a stated other value."""
    file = tmp_path / "balls.toml"
    file.write_text(block_of("name =").text, encoding="utf-8")
    recipe, bases = load_recipe(file)
    assert recipe.format == Recipe.model_fields["format"].default
    assert recipe.shard_mb == Recipe.model_fields["shard_mb"].default
    draw = draw_sample(recipe, bases, 0)
    assert set(draw.settings) == {
        "specimen.diameter_mm",
        "coating.base_albedo",
        "elastomer.thickness_mm",
    }
    assert draw.case is not None


def test_the_page_names_all_quantities() -> None:
    text = PAGE.read_text(encoding="utf-8")
    named = [name for name in SAMPLE_QUANTITIES if "_row_" not in name and name != "order_row"]
    assert [name for name in named if f"`{name}`" not in text] == []


def test_every_key_of_a_recipe_has_a_meaning_or_is_on_the_page() -> None:
    text = PAGE.read_text(encoding="utf-8")
    of_studies = ("axis", "scene.axis", "inputs")
    plain = ("schema_version", "description")
    keys = [key for key in list_keys(Recipe) if not key.path.startswith((*of_studies, *plain))]
    assert len(keys) > 10
    named = [key for key in keys if key.meaning or key.path.split(".")[-1] in text]
    assert [key.path for key in keys if key not in named] == []


def test_the_loader_of_the_page(made: MadeSet) -> None:
    names: dict = {}
    exec(block_of("import io").text, names)
    read = {
        key: sample
        for shard in sorted(made.folder.glob("*.tar"))
        for key, sample in names["samples"](shard, {"depth_mm", "order_column"})
    }
    assert len(read) == COUNT - 1
    for sample in read.values():
        assert sample["depth_mm"].shape == (60, 80)
        assert sample["order_column"].dtype == np.int16


def test_loaders_of_other_packages(made: MadeSet, tmp_path, monkeypatch) -> None:
    """The blocks run where the packages are installed; else their names are checked."""
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out" / "phase"
    out.parent.mkdir()
    split = made.recipe.split.model_copy(update={"train": 1.0, "validation": 0.0, "test": 0.0})
    draws = tuple(_in_train(draw) for draw in made.draws)
    for kind, package in (("webdataset", "webdataset"), ("parquet", "datasets")):
        recipe = made.recipe.model_copy(update={"format": kind, "split": split})
        from twin.report.dataset_card import write_card

        pack(recipe, made.bases, draws, made.work, out, present=write_card)
        block = block_of(f"import {package}")
        if importlib.util.find_spec(package):
            exec(block.text, {})
        elif kind == "webdataset":
            assert (out / "train-000000.tar").is_file()
        else:
            header = (out / "README.md").read_text(encoding="utf-8").split("---")[1]
            (files,) = yaml.safe_load(header)["configs"][0]["data_files"]
            assert files["split"] == "train"
            (first, *_) = sorted(out.glob(files["path"]))
            columns = pyarrow.parquet.read_schema(first).names
            assert "phase_column_rad" in columns


def _in_train(draw):
    from dataclasses import replace

    return replace(draw, split="train" if draw.case else "")


@pytest.mark.parametrize(
    "name", ["single_shot_fpp", "tactile", "contact_denoising", "phase_unwrapping"]
)
def test_shipped_recipes_are_on_the_page_and_draw_valid_experiments(name: str) -> None:
    from twin.dataset.make import draw_all
    from twin.study.measurable import unmeasurable

    assert f"`datasets/{name}`" in PAGE.read_text(encoding="utf-8")
    draws = draw_all(*load_recipe(f"datasets/{name}"), 3)
    assert [draw.reason for draw in draws if draw.case is None] == []
    assert unmeasurable([draw.case for draw in draws]) == {}


_READERS = {
    "webdataset": """
exec(loader)
for shard in sorted(folder.glob("*.tar")):
    for key, sample in samples(shard, names):
        read[key] = sample
""",
    "hdf5": """
import h5py
for shard in sorted(folder.glob("test-*.h5")):
    with h5py.File(shard) as file:
        for key, group in file.items():
            read[key] = {name: group[name][()] for name in names}
            units |= {name: group[name].attrs["units"] for name in names}
""",
    "parquet": """
import numpy
from pyarrow import parquet
for shard in sorted(folder.glob("test-*.parquet")):
    for row in parquet.read_table(shard, columns=["key", *names]).to_pylist():
        read[row["key"]] = {name: numpy.array(row[name]) for name in names}
""",
}
_ALONE = """
import json, pathlib, sys
sys.modules["twin"] = sys.modules["reconstruction"] = None  # importing them is an error
folder, names = pathlib.Path(sys.argv[1]), set(json.loads(sys.argv[2]))
loader, read, units = sys.argv[3], {}, {}
READER
known = {k: {n: [list(v.shape), float(v.sum())] for n, v in s.items()} for k, s in read.items()}
print(json.dumps([known, units]))
"""


@pytest.mark.parametrize("kind", [*_READERS])
def test_a_process_without_the_twin_reads_each_format(made: MadeSet, tmp_path, kind: str) -> None:
    """Expected: shapes of schema.json and values of the store; in HDF5 the units of schema.json."""
    out = made.folder
    if kind != "webdataset":
        out = tmp_path / kind
        recipe = made.recipe.model_copy(update={"format": kind})
        pack(recipe, made.bases, made.draws, made.work, out)
    names = ["depth_mm", "normal_world", "order_column", "label"]
    script = _ALONE.replace("READER", _READERS[kind])
    words = [str(out), json.dumps(names), block_of("import io").text]
    printed = subprocess.run(
        [sys.executable, "-I", "-c", script, *words], check=True, capture_output=True, cwd=tmp_path
    ).stdout
    read, units = json.loads(printed)
    schema = json.loads((out / "schema.json").read_text(encoding="utf-8"))["files"]
    assert units == ({name: schema[f"{name}.npy"]["unit"] for name in names} if units else {})
    assert bool(units) == (kind == "hdf5")
    assert len(read) == COUNT - 1
    for draw in made.draws:
        if draw.case is None:
            continue
        for name in names:
            folder = Store(made.work).path_of(draw.case.digest) / SAMPLE_FOLDER
            stored = np.load(folder / f"{name}.npy")
            shape, total = read[draw.key][name]
            assert shape == list(stored.shape)
            assert total == pytest.approx(float(stored.sum()), rel=1e-5)
