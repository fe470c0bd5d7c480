"""Commands for data sets: make labelled captures, and score predictions against them."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from reconstruction.errors import InputError, counted, few
from twin.cli.app import (
    BAD_INPUT,
    FAILURE,
    Cluster,
    DryRun,
    Out,
    Retry,
    WorkerCount,
    app,
    print_metrics,
    print_table,
    progress_bars,
    say,
    workers_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from reconstruction.evaluate.methods import DataSetScore
    from twin.config.dataset import SampleContent
    from twin.dataset.draws import SampleDraw

_MOST_REASONS, _MOST_OBJECTS = 10, 20


@app.command
def dataset(
    recipe: Path,
    /,
    *,
    out: Out,
    samples: Annotated[int, Parameter(name=["--samples", "-n"])],
    workers: WorkerCount = None,
    cluster: Cluster = None,
    dry_run: DryRun = False,
    retry: Retry = False,
) -> int:
    """Make a data set: labelled captures of experiments that are drawn from distributions.

    Computed samples are stored in OUT.work: run the command again to continue, or with a larger -n
    to add samples. Sample k has the same bytes for any -n and any number of workers. Exit code 1: a
    sample has no result; index.parquet has the reason.

    Parameters
    ----------
    recipe
        TOML file, or the name of a shipped recipe such as datasets/tactile.
    samples
        Number of samples that are drawn.
    """
    from twin.config.dataset import load_recipe
    from twin.dataset.make import draw_all, pack, take_samples, work_folder
    from twin.dataset.shards import arrow
    from twin.output import check_output
    from twin.report.dataset_card import write_card

    loaded, bases = load_recipe(recipe)
    arrow("twin dataset")
    draws = draw_all(loaded, bases, samples)
    if dry_run:
        return _print_plan(draws, loaded.sample)
    work = work_folder(out)
    check_output(out, [recipe])
    with progress_bars() as watch:
        outcome = take_samples(
            loaded,
            draws,
            work,
            workers_of(workers, cluster),
            retry=retry,
            watch=watch,
        )
        packed = pack(
            loaded, bases, draws, work, out, inputs=[recipe], watch=watch, present=write_card
        )
    _print_reasons(packed.failures)
    say(
        f"{counted(len(packed.samples), 'sample')} of {samples} in {outcome.seconds:.1f} s; "
        f"wrote {out}"
    )
    return FAILURE if packed.failures else 0


def _print_plan(draws: "Sequence[SampleDraw]", content: "SampleContent") -> int:
    """Print the samples by scene and split, and the reasons of invalid draws and experiments."""
    from twin.dataset.methods import cases_by_method
    from twin.study.measurable import unmeasurable

    cases = [draw.case for draw in draws if draw.case is not None]
    reasons = [draw.reason for draw in draws if draw.case is None]
    failed = {reason: reasons.count(reason) for reason in reasons}
    for some in cases_by_method(cases, content):
        failed |= {reason: len(unable) for reason, unable in unmeasurable(some).items()}
    rows = [(draw.scene, draw.split) for draw in draws if draw.case is not None]
    table = [(*row, str(rows.count(row))) for row in sorted(set(rows))]
    print_table(("scene", "split", "samples"), table)
    _print_reasons(failed)
    return BAD_INPUT if sum(failed.values()) >= len(draws) else 0


def _print_reasons(failures: dict[str, int]) -> None:
    for reason, count in list(failures.items())[:_MOST_REASONS]:
        sys.stderr.write(f"twin: {counted(count, 'sample')} failed: {reason}\n")
    if len(failures) > _MOST_REASONS:
        more = counted(len(failures) - _MOST_REASONS, "more reason")
        sys.stderr.write(f"twin: {more}: see index.parquet\n")


@app.command
def score(
    *folders: Path,
    out: Annotated[Path | None, Parameter(name=["--out", "-o"])] = None,
    baseline: str | None = None,
    split: str = "test",
    method: str | None = None,
) -> None:
    """Score predictions against a data set: twin score PREDICTIONS DATASET.

    PREDICTIONS is a folder with files KEY.QUANTITY.npy: depth_mm, normal_world, phase_column_rad or
    phase_row_rad, in the shape and unit of the truth; NaN: no prediction. For a data set of several
    methods it has one folder for each: METHOD/KEY.QUANTITY.npy. A classical method is scored
    in addition; twin score DATASET scores only this method.

    Parameters
    ----------
    folders
        PREDICTIONS and DATASET; or only DATASET.
    out
        Folder for result.json, objects.csv and report.html; default: none is written.
    baseline
        Classical method: decoded, spatial_unwrapping, fourier; default: that of the recipe.
    split
        Part of the data set: train, validation, test, or all.
    method
        Method of measurement, in a data set of several; its files may be in PREDICTIONS itself.
    """
    from reconstruction.evaluate.methods import score_dataset

    if len(folders) not in (1, 2):
        raise InputError(
            f"twin score: found {counted(len(folders), 'folder')}, allowed 2: PREDICTIONS DATASET; "
            "or 1: DATASET"
        )
    *predictions, dataset = folders
    result = score_dataset(
        dataset,
        predictions[0] if predictions else None,
        baseline=baseline or "",
        split=split,
        method=method or "",
    )
    if out is not None:
        _write_score(out, result, folders)
    if result.baseline:
        say(f"baseline: {result.baseline}")
    print_metrics(result.figures())
    _print_rows(result.by_split(), "split", "splits.csv")
    _print_rows(result.by_object(), "object", "objects.csv")
    _print_doubts(result)
    if out is not None:
        say(f"wrote {out}")


def _write_score(out: Path, result: "DataSetScore", folders: "Sequence[Path]") -> None:
    from twin.output import output_folder, write_outcome
    from twin.report.predictions import write_score_page
    from twin.results.parts import write_rows

    with output_folder(out, folders) as folder:
        write_rows(folder / "objects.csv", result.by_object(), 6)
        if splits := result.by_split():
            write_rows(folder / "splits.csv", splits, 6)
        write_score_page(folder, result, folders)
        named = {"baseline": result.baseline} if result.baseline else {}
        write_outcome(folder, "score", result.figures(), **named)


def _print_rows(rows: "Sequence[dict[str, Any]]", first: str, file: str) -> None:
    from twin.cli.app import cell

    if len(rows) < 2:
        return
    named = dict.fromkeys([first, "method", "split", "samples"])
    names = [name for name in named if name in rows[0]]
    names += [name for name in dict.fromkeys(n for row in rows for n in row) if "_rms_" in name]
    table = ([cell(row.get(name), 4) for name in names] for row in rows[:_MOST_OBJECTS])
    print_table(names, table, width=None if sys.stdout.isatty() else 120)
    if len(rows) > _MOST_OBJECTS:
        say(f"{len(rows) - _MOST_OBJECTS} more rows: {file} with -o DIR")


def _print_doubts(result: "DataSetScore") -> None:
    """Print which samples have no prediction, and which methods no baseline."""
    for part in result.parts:
        if keys := part.score.without_prediction:
            name = f"{part.method}: " if part.method else ""
            sys.stderr.write(
                f"twin: {name}{part.source}: no prediction for {counted(len(keys), 'sample')}, "
                f"which lowers completeness: {few(keys)}\n"
            )
    for method, reason in result.unable.items():
        sys.stderr.write(f"twin: {method or 'baseline'}: no score of a baseline: {reason}\n")
