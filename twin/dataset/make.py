"""Make a data set: draw its samples, compute those that the store lacks, and pack all of them.

The store of the samples is the folder DIR.work next to the data set DIR. It is the store of a
study: an interrupted run continues there, and several processes or hosts may share it. The data set
is written completely or not at all.
"""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from reconstruction.errors import InputError, counted
from reconstruction.evaluate.baselines import needs_of, predicted_by
from reconstruction.evaluate.samples import CALIBRATION_JSON, SPLITS, npy
from reconstruction.writing import write_bytes, write_text
from twin.config import Experiment
from twin.config.dataset import Recipe
from twin.config.methods import Method
from twin.dataset.draws import SampleDraw, draw_sample
from twin.dataset.methods import check_content
from twin.dataset.quantities import quantity_of
from twin.dataset.shards import (
    EXPERIMENT_TOML,
    SAMPLE_JSON,
    PackedSample,
    arrow,
    write_shards,
)
from twin.dataset.taking import SAMPLE_FOLDER, SampleMeasurer, SampleMeasuring
from twin.output import output_folder, write_json, write_outcome
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.figures import Metrics
from twin.study.cases import Cases
from twin.study.index import Index
from twin.study.outcome import SweepOutcome
from twin.study.store import Store
from twin.study.sweep import CaseGroup, run_groups
from twin.study.table import one_type
from twin.study.workers import Workers

INDEX_PARQUET, RECIPE_TOML, SCHEMA_JSON = "index.parquet", "recipe.toml", "schema.json"
MOST_SAMPLES = 100_000
DRAWN, FIGURE = "drawn.", "figure."
"""Prefixes of the columns of the index with drawn values and with figures of the measurement."""


@dataclass(frozen=True, eq=False)
class PackedDataSet:
    """A data set whose shards have been written.

    Attributes
    ----------
    recipe, bases : the recipe, and the base experiment of each scene
    draws : all drawn samples, failed ones included
    samples : samples that have a result, in the order of their numbers
    rows : one row per drawn sample, as in `index.parquet`
    schema : content of `schema.json`
    """

    recipe: Recipe
    bases: tuple[Experiment, ...]
    draws: tuple[SampleDraw, ...]
    samples: tuple[PackedSample, ...]
    rows: tuple[Mapping[str, Any], ...]
    schema: Mapping[str, Any]

    @property
    def failures(self) -> dict[str, int]:
        """Number of samples without a result by reason, the most frequent first."""
        reasons = [row["reason"] for row in self.rows if row["state"] == "failed"]
        counts = {reason: reasons.count(reason) for reason in dict.fromkeys(reasons)}
        return dict(sorted(counts.items(), key=lambda item: -item[1]))


Presenter = Callable[[Path, PackedDataSet], None]
"""Writes data card and pictures of a data set into its folder."""


def work_folder(out: Path) -> Path:
    """Return the folder of the store of the samples of a data set.

    Raises
    ------
    InputError : the data set's folder has no name
    """
    if out.name in ("", ".."):
        raise InputError(f"-o {out}: found no name of a folder; give one, for example -o out")
    return out.with_name(f"{out.name}.work")


def draw_all(recipe: Recipe, bases: Sequence[Experiment], count: int) -> tuple[SampleDraw, ...]:
    """Return the first samples of a recipe.

    Raises
    ------
    InputError : the number is not allowed, or a scene does not have a quantity that samples contain
    """
    if not 1 <= count <= MOST_SAMPLES:
        raise InputError(f"--samples: found {count}, allowed 1 to {MOST_SAMPLES}")
    for base in bases:
        check_content(recipe.sample, base)
    check_baseline(recipe)
    return tuple(draw_sample(recipe, bases, number) for number in range(count))


def check_baseline(recipe: Recipe) -> None:
    """Check that samples contain the input of the recipe's baseline, and a truth to score it.

    Raises
    ------
    InputError : they do not
    """
    if recipe.baseline and not predicted_by(recipe.baseline, recipe.sample.hold):
        raise InputError(
            f"baseline: '{recipe.baseline}' needs {needs_of(recipe.baseline)} in sample.hold; add "
            "them, or remove baseline"
        )


def take_samples(
    recipe: Recipe,
    draws: Sequence[SampleDraw],
    work: Path,
    workers: Workers,
    *,
    retry: bool = False,
    watch: ProgressCallback = no_progress,
    measurer: type[SampleMeasurer] = SampleMeasurer,
) -> SweepOutcome:
    """Compute the samples that the store `work` lacks.

    Parameters
    ----------
    retry : also compute samples again that failed because of their experiment
    measurer : importable class of the measurer of each worker

    Raises
    ------
    InputError : the folder cannot be used
    MissingBackend : there is no usable Dr.Jit backend
    """
    cases = Cases(tuple(draw.case for draw in draws if draw.case is not None), 0)
    make = SampleMeasuring(recipe.sample, work.absolute() / "calibrations", measurer)
    (outcome,) = run_groups([CaseGroup(work, cases, make)], workers, watch, retry=retry)
    if outcome.unsaved:
        reason = next(iter(outcome.unsaved.values()))
        raise InputError(
            f"{work}: {counted(len(outcome.unsaved), 'sample')} could not be saved: {reason}"
        )
    return outcome


def pack(
    recipe: Recipe,
    bases: tuple[Experiment, ...],
    draws: tuple[SampleDraw, ...],
    work: Path,
    out: Path,
    *,
    inputs: Sequence[Path] = (),
    watch: ProgressCallback = no_progress,
    present: Presenter = lambda *_: None,
) -> PackedDataSet:
    """Write the data set of computed samples into the folder `out`.

    Parameters
    ----------
    work : store of the samples
    inputs : files that the command reads
    present : writes data card and pictures

    Raises
    ------
    InputError : `out` cannot be written, no sample has a result, or pyarrow is not installed
    """
    arrow(INDEX_PARQUET)
    samples, rows = _packed(draws, Store(work), recipe.sample.methods)
    if not samples:
        reasons = "; ".join(dict.fromkeys(str(row["reason"]) for row in rows))
        raise InputError(f"{out}: no sample has a result: {reasons}")
    done = 0

    def progress(count: int) -> None:
        nonlocal done
        done += count
        watch("pack", done / len(samples))

    with output_folder(out, inputs) as folder:
        shard_of = write_shards(folder, samples, recipe.format, recipe.shard_mb, progress)
        indexed = tuple({**row, "shard": shard_of.get(str(row["key"]))} for row in rows)
        schema = dataset_schema(recipe, samples)
        packed = PackedDataSet(recipe, bases, draws, tuple(samples), indexed, schema)
        _write_index(folder / INDEX_PARQUET, indexed)
        content = recipe.model_dump(mode="json", exclude_none=True)
        write_text(folder / RECIPE_TOML, tomli_w.dumps(content))
        write_json(folder / SCHEMA_JSON, schema)
        present(folder, packed)
        write_outcome(folder, "dataset", _figures(packed))
    return packed


def _packed(
    draws: Sequence[SampleDraw], store: Store, methods: tuple[Method, ...]
) -> tuple[list[PackedSample], list[dict[str, Any]]]:
    """Return the samples that have a result, and a row for each drawn sample."""
    entries = Index(store).entries()
    samples, rows = [], []
    for draw in draws:
        row: dict[str, Any] = {
            "key": draw.key,
            "number": draw.number,
            "scene": draw.scene,
            "split": draw.split or None,
            "object": draw.object_digest or None,
            "state": "failed",
            "reason": draw.reason,
            "digest": None if draw.case is None else draw.case.digest,
        }
        row |= {"methods": ", ".join(methods)} if methods else {}
        row |= {f"{DRAWN}{name}": value for name, value in draw.settings.items()}
        entry = None if draw.case is None else entries.get(draw.case.digest)
        if entry is not None and entry.state == "done":
            folder = store.path_of(entry.digest)
            described = _described(draw, entry.figures)
            described |= {"methods": list(methods)} if methods else {}
            samples.append(PackedSample(draw.key, draw.split, _files(folder), described))
            row |= {"state": "done"}
            row |= {f"{FIGURE}{name}": value for name, value in _plain(entry.figures).items()}
        elif draw.case is not None:
            row["reason"] = "was not computed" if entry is None else entry.reason
        rows.append(row)
    return samples, rows


def _files(folder: Path) -> dict[str, Path]:
    files = {path.name: path for path in sorted((folder / SAMPLE_FOLDER).iterdir())}
    return files | {EXPERIMENT_TOML: folder / EXPERIMENT_TOML}


def _described(draw: SampleDraw, figures: Metrics) -> dict[str, Any]:
    """Return the content of `sample.json`."""
    return {
        "key": draw.key,
        "scene": draw.scene,
        "split": draw.split,
        "object": draw.object_digest,
        "trial": draw.number + 1,
        "drawn": dict(draw.settings),
        "figures": dict(figures),
    }


def _plain(figures: Metrics) -> dict[str, Any]:
    """Return figures for a table; a list, such as that of warnings, becomes one text."""
    return {
        name: "; ".join(map(str, value)) if isinstance(value, list) else value
        for name, value in figures.items()
    }


def dataset_schema(recipe: Recipe, samples: Sequence[PackedSample]) -> dict[str, Any]:
    """Return the content of `schema.json`: files of a sample; methods and baseline, if any."""
    schema = sample_schema(samples)
    if recipe.sample.methods:
        schema["methods"] = list(recipe.sample.methods)
    if recipe.baseline:
        schema["baseline"] = recipe.baseline
    return schema


def sample_schema(samples: Sequence[PackedSample]) -> dict[str, Any]:
    """Return the description of the files of a sample: type, axes, unit, meaning."""
    described: dict[str, Any] = {}
    files = {name: path for sample in reversed(samples) for name, path in sample.files.items()}
    for name, path in files.items():
        stem = name.partition(".")[0]
        quantity = quantity_of(stem)
        if quantity is None:
            described[name] = {"type": "text", "meaning": _meaning_of_text(name)}
            continue
        described[name] = {
            "axes": list(quantity.axes),
            "unit": quantity.unit,
            "meaning": quantity.meaning,
        }
        if name.endswith(".npy"):
            described[name]["dtype"] = str(npy(path.read_bytes()).dtype)
    described[SAMPLE_JSON] = {"type": "text", "meaning": _TEXTS[SAMPLE_JSON]}
    return {"schema_version": 1, "files": described}


_TEXTS = {
    EXPERIMENT_TOML: "the resolved experiment",
    SAMPLE_JSON: "scene, split, object, drawn values, figures, and the trial (seed of the noise)",
}
_CALIBRATION_MEANING = "pinholes, poses and layers of camera and projector, mm"


def _meaning_of_text(name: str) -> str:
    return _CALIBRATION_MEANING if name.endswith(CALIBRATION_JSON) else _TEXTS[name]


def _write_index(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    pyarrow, parquet = arrow(INDEX_PARQUET)
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: one_type([row.get(name) for row in rows]) for name in names}
    made = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), made)
    write_bytes(path, made.getbuffer())


def _figures(packed: PackedDataSet) -> Metrics:
    splits = [sample.split for sample in packed.samples]
    objects = {sample.described["object"] for sample in packed.samples}
    return {
        "samples": len(packed.draws),
        "samples_done": len(packed.samples),
        "samples_failed": len(packed.draws) - len(packed.samples),
        "objects": len(objects),
        **{f"samples_{split}": splits.count(split) for split in SPLITS},
    }
