"""The blocks of docs/datasets.md, on the small data set."""

import importlib.util
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import h5py
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


_FORMATS = {
    "webdataset": ("import io", "test-*.tar", ("numpy",)),
    "hdf5": ("import h5py", "test-*.h5", ("numpy", "h5py")),
    "parquet": ("from pyarrow", "test-*.parquet", ("numpy", "pyarrow")),
}
"""Beginning of the block of the page, names of the shards, and packages, by format."""

_ALONE = """
import importlib.util, json, pathlib, sys
folder, pattern, names, block, packages = json.loads(sys.argv[1])
sys.path.append(packages)
assert not any(map(importlib.util.find_spec, ("twin", "reconstruction", "scipy", "mitsuba")))
exec(block)
read = {}
for shard in sorted(pathlib.Path(folder).glob(pattern)):
    for key, sample in samples(shard, names):
        read[key] = {n: [list(v.shape), str(v.dtype), float(v.sum())] for n, v in sample.items()}
print(json.dumps([read, sorted({name.partition(".")[0] for name in sys.modules})]))
"""


def only(folder: Path, packages: Sequence[str]) -> Path:
    """Return a folder that contains these installed packages and their libraries only."""
    folder.mkdir()
    for name in packages:
        (origin,) = importlib.util.find_spec(name).submodule_search_locations
        for place in (Path(origin), Path(f"{origin}.libs")):
            if place.exists():
                (folder / place.name).symlink_to(place)
    return folder


def packed_as(made: MadeSet, folder: Path, kind: str) -> Path:
    recipe = made.recipe.model_copy(update={"format": kind})
    pack(recipe, made.bases, made.draws, made.work, folder)
    return folder


@pytest.mark.parametrize("kind", [*_FORMATS])
def test_a_bare_process_reads_each_format(made: MadeSet, tmp_path, kind: str) -> None:
    """The block of the page in a new interpreter that has NumPy and the package of the format only.

    Expected: shapes and types of schema.json, and the values of the store.
    """
    start, pattern, packages = _FORMATS[kind]
    out = packed_as(made, tmp_path / "set", kind)
    names = ["depth_mm", "frames", "normal_world", "order_column", "label"]
    given = [str(out), pattern, names, block_of(start).text, str(only(tmp_path / "only", packages))]
    # -I: no user's folders; -S: not the packages of this environment.
    words = [sys.executable, "-I", "-S", "-c", _ALONE, json.dumps(given)]
    printed = subprocess.run(words, check=True, capture_output=True, cwd=tmp_path).stdout
    read, imported = json.loads(printed)
    assert {"numpy", *packages} <= {*imported}
    assert len(read) == COUNT - 1
    schema = json.loads((out / "schema.json").read_text(encoding="utf-8"))["files"]
    for draw in made.draws:
        if draw.case is None:
            continue
        for name in names:
            folder = Store(made.work).path_of(draw.case.digest) / SAMPLE_FOLDER
            stored = np.load(folder / f"{name}.npy")
            shape, dtype, total = read[draw.key][name]
            assert shape == list(stored.shape)
            assert len(shape) == len(schema[f"{name}.npy"]["axes"])
            assert dtype == schema[f"{name}.npy"]["dtype"] == str(stored.dtype)
            assert total == float(stored.sum())


def test_units_are_in_hdf5(made: MadeSet, tmp_path) -> None:
    out = packed_as(made, tmp_path / "set", "hdf5")
    schema = json.loads((out / "schema.json").read_text(encoding="utf-8"))["files"]
    with h5py.File(out / "test-000000.h5") as file:
        (group, *_) = file.values()
        assert {name: array.attrs["units"] for name, array in group.items()} == {
            name.removesuffix(".npy"): entry["unit"]
            for name, entry in schema.items()
            if name.endswith(".npy")
        }
