"""A data set on the disk: content, formats, bytes, failures, splits and card."""

import io
import json
import tarfile
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pyarrow.parquet
import pytest

from reconstruction.errors import InputError
from reconstruction.evaluate.baselines import score_baseline
from reconstruction.evaluate.samples import read_samples
from tests.dataset.conftest import COUNT, MadeSet
from twin.cli import run
from twin.config.dataset import SampleContent
from twin.dataset.make import draw_all, pack, take_samples
from twin.dataset.shards import PackedSample, write_shards
from twin.dataset.taking import SAMPLE_FOLDER, SampleMeasurer
from twin.study.store import Store
from twin.study.worker import forget_stages
from twin.study.workers import local_workers

FAILED = 1


def case_folder(made: MadeSet, number: int):
    return Store(made.work).path_of(made.draws[number].case.digest)


def members(folder) -> dict[str, bytes]:
    """Return all members of the tar shards of a folder."""
    content = {}
    for shard in sorted(folder.glob("*.tar")):
        with tarfile.open(shard, "r:") as tar:
            content |= {member.name: tar.extractfile(member).read() for member in tar}
    return content


def test_a_failed_draw_is_counted_and_not_drawn_again(made: MadeSet) -> None:
    index = pyarrow.parquet.read_table(made.folder / "index.parquet").to_pylist()
    assert made.code == 1
    assert "1 sample failed: ball: specimen.diameter_mm" in made.printed
    assert [row["number"] for row in index] == list(range(COUNT))
    (failed,) = (row for row in index if row["state"] == "failed")
    assert "allowed >= 0.0001" in failed["reason"]
    assert failed["shard"] is None
    card = (made.folder / "README.md").read_text(encoding="utf-8")
    assert f"{COUNT - FAILED} simulated samples of {COUNT} drawn" in card
    assert failed["reason"] in card
    figures = json.loads((made.folder / "result.json").read_text(encoding="utf-8"))["metrics"]
    assert figures["samples_failed"] == FAILED
    assert figures["samples_test"] == COUNT - FAILED


def test_members_are_named_by_key_and_quantity(made: MadeSet) -> None:
    stored = members(made.folder)
    schema = json.loads((made.folder / "schema.json").read_text(encoding="utf-8"))["files"]
    keys = {name.partition(".")[0] for name in stored}
    assert len(keys) == COUNT - FAILED
    assert {name.partition(".")[2] for name in stored} == set(schema)
    shards = sorted(path.name for path in made.folder.glob("*.tar"))
    assert shards == [f"test-{number:06d}.tar" for number in range(len(shards))]
    assert len(shards) > 1
    for shard in shards:  # the members of one sample are in sequence: loaders need it
        with tarfile.open(made.folder / shard) as tar:
            order = [name.partition(".")[0] for name in tar.getnames()]
        assert order == sorted(order)


def test_types_and_axes_are_those_of_the_schema(made: MadeSet) -> None:
    stored = members(made.folder)
    schema = json.loads((made.folder / "schema.json").read_text(encoding="utf-8"))["files"]
    sizes = {"row": 60, "col": 80, "xyz": 3}
    for name, content in stored.items():
        entry = schema[name.partition(".")[2]]
        if "axes" not in entry:
            continue
        values = np.load(io.BytesIO(content))
        assert str(values.dtype) == entry["dtype"]
        expected = [sizes.get(axis, values.shape[0]) for axis in entry["axes"]]
        assert list(values.shape) == expected
        assert np.isfinite(values).all()


def test_each_format_has_the_same_arrays(made: MadeSet, tmp_path) -> None:
    """Expected: the arrays of the tar files, by the reader of the project."""
    names = ("frames", "depth_mm", "normal_world", "order_column")
    expected = list(read_samples(made.folder, "test", names))
    for kind in ("hdf5", "parquet"):
        recipe = made.recipe.model_copy(update={"format": kind})
        pack(recipe, made.bases, made.draws, made.work, tmp_path / kind)
        result = list(read_samples(tmp_path / kind, "test", names))
        assert [sample.key for sample in result] == [sample.key for sample in expected]
        for sample, known in zip(result, expected, strict=True):
            assert sample.described == known.described
            for name in names:
                assert sample.arrays[name].dtype == known.arrays[name].dtype
                assert np.array_equal(sample.arrays[name], known.arrays[name])
    with h5py.File(next((tmp_path / "hdf5").glob("*.h5"))) as file:
        group = next(iter(file.values()))
        assert group["depth_mm"].attrs["units"] == "mm"
        assert group.attrs["experiment.toml"].startswith("schema_version")
    row = pyarrow.parquet.read_table(next((tmp_path / "parquet").glob("test-*.parquet"))).slice(
        0, 1
    )
    assert np.array(row["depth_mm"][0].as_py()).shape == (60, 80)
    score = score_baseline("decoded", tmp_path / "parquet").figures()
    assert score == score_baseline("decoded", made.folder).figures()


def test_a_tar_shard_is_that_of_tarfile(made: MadeSet) -> None:
    """Expected: the bytes that Python's own writer gives for the members; arrays as by NumPy."""
    for shard in sorted(made.folder.glob("*.tar")):
        expected = io.BytesIO()
        with (
            tarfile.open(shard) as tar,
            tarfile.open(fileobj=expected, mode="w", format=tarfile.USTAR_FORMAT) as copied,
        ):
            for member in tar:
                content = tar.extractfile(member).read()
                plain = tarfile.TarInfo(member.name)
                plain.size, plain.mode = len(content), 0o644
                copied.addfile(plain, io.BytesIO(content))
                if member.name.endswith(".npy"):
                    saved = io.BytesIO()
                    np.save(saved, np.load(io.BytesIO(content)))
                    assert saved.getvalue() == content
        assert shard.read_bytes() == expected.getvalue()


class _Growing(type(Path())):
    """A file that is larger when its size is read than when its content is."""

    def stat(self, **options: object) -> SimpleNamespace:
        return SimpleNamespace(st_size=super().stat(**options).st_size + 1)


def test_a_file_that_changes_while_it_is_packed_is_an_error(tmp_path) -> None:
    """Else the tar file would be damaged from this member on."""
    (tmp_path / "depth_mm.npy").write_bytes(bytes(100))
    files = {"depth_mm.npy": _Growing(tmp_path / "depth_mm.npy")}
    sample = PackedSample("0", "test", files, {"object": "ball"})
    with pytest.raises(InputError, match=r"depth_mm\.npy: changed while the data set was written"):
        write_shards(tmp_path, [sample], "webdataset", 1.0)
    assert [path.name for path in tmp_path.iterdir()] == ["depth_mm.npy"]


def test_packing_again_gives_the_same_bytes_and_removes_shards(made: MadeSet, tmp_path) -> None:
    again = tmp_path / "again"
    few = made.recipe.model_copy(update={"shard_mb": 100.0})
    pack(made.recipe, made.bases, made.draws, made.work, again)
    for name in ("index.parquet", "schema.json", "result.json", "recipe.toml", "test-000000.tar"):
        assert (again / name).read_bytes() == (made.folder / name).read_bytes()
    pack(few, made.bases, made.draws, made.work, again)
    assert [path.name for path in again.glob("*.tar")] == ["test-000000.tar"]
    assert members(again) == members(made.folder)


def test_a_sample_has_the_same_bytes_alone_and_elsewhere(made: MadeSet, tmp_path) -> None:
    """The last sample, computed alone in another store, of a recipe read for more samples."""
    draws = draw_all(made.recipe, made.bases, COUNT + 2)
    alone = draws[COUNT - 1]
    forget_stages()
    take_samples(made.recipe, [alone], tmp_path / "work", local_workers(1))
    first = case_folder(made, COUNT - 1)
    second = Store(tmp_path / "work").path_of(alone.case.digest)
    files = sorted(path.name for path in (first / SAMPLE_FOLDER).iterdir())
    assert sorted(path.name for path in (second / SAMPLE_FOLDER).iterdir()) == files
    for name in files:
        ours, others = first / SAMPLE_FOLDER / name, second / SAMPLE_FOLDER / name
        assert ours.read_bytes() == others.read_bytes(), name


def test_frames_as_png_are_the_frames(made: MadeSet, tmp_path) -> None:
    import imageio.v3 as imageio

    draw = made.draws[COUNT - 1]
    content = SampleContent(hold=("frames",), frames="png")
    result = SampleMeasurer(content=content)(draw.case.experiment, draw.case.conditions)
    result.write(tmp_path)
    frames = np.load(case_folder(made, COUNT - 1) / SAMPLE_FOLDER / "frames.npy")
    files = sorted((tmp_path / SAMPLE_FOLDER).glob("frames.*.png"))
    assert np.array_equal(np.stack([imageio.imread(file) for file in files]), frames)


def test_pictures_of_the_card_are_drawn(made: MadeSet) -> None:
    import imageio.v3 as imageio

    for name in ("samples.png", "distributions.png"):
        assert np.ptp(imageio.imread(made.folder / name)) > 100


def test_a_quantity_that_a_scene_has_not_is_refused(made: MadeSet) -> None:
    for name, message in (
        ("contact", "needs a method with a press; gauges has none"),
        ("image", "needs modality = 'photometric_stereo'"),
        ("phase_row_rad", ""),
        ("dept_mm", "found 'dept_mm', allowed: frames"),
    ):
        content = made.recipe.sample.model_copy(update={"hold": (name,)})
        recipe = made.recipe.model_copy(update={"sample": content})
        if not message:
            assert draw_all(recipe, made.bases, 1)
            continue
        with pytest.raises(InputError, match=message):
            draw_all(recipe, made.bases, 1)
    with pytest.raises(InputError, match="found 0, allowed 1"):
        draw_all(made.recipe, made.bases, 0)


def test_a_dry_run_and_scores_are_printed(made: MadeSet, tmp_path, capsys) -> None:
    words = ["dataset", str(made.file), "-n", str(COUNT), "-o", str(tmp_path / "none")]
    assert run([*words, "--dry-run"]) == 0
    printed = capsys.readouterr()
    assert "relief" in printed.out
    assert "1 sample failed" in printed.err
    assert not (tmp_path / "none").exists()
    out = tmp_path / "score"
    assert run(["score", "--baseline", "decoded", str(made.folder), "-o", str(out)]) == 0
    assert "depth_rms_um" in capsys.readouterr().out
    figures = json.loads((out / "result.json").read_text(encoding="utf-8"))["metrics"]
    assert figures["samples"] == COUNT - FAILED
    assert len((out / "objects.csv").read_text(encoding="utf-8").splitlines()) == 1 + COUNT - FAILED
    assert run(["score", str(made.folder)]) == 2
    assert "found neither PREDICTIONS nor a baseline" in capsys.readouterr().err
    assert run(["score"]) == 2
    assert "found 0 folders, allowed 2: PREDICTIONS DATASET" in capsys.readouterr().err
