"""Commands for data sets: make labelled captures, and score predictions against them."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from reconstruction.errors import InputError, counted
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

    from reconstruction.evaluate.predictions import PredictionScore
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
    from twin.report.dataset_card import write_card

    loaded, bases = load_recipe(recipe)
    arrow("twin dataset")
    draws = draw_all(loaded, bases, samples)
    if dry_run:
        return _print_plan(draws)
    work = work_folder(out)
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


def _print_plan(draws: "Sequence[SampleDraw]") -> int:
    """Print the samples by scene and split, and the reasons of invalid draws and experiments."""
    from twin.study.measurable import unmeasurable

    cases = [draw.case for draw in draws if draw.case is not None]
    reasons = [draw.reason for draw in draws if draw.case is None]
    failed = {reason: reasons.count(reason) for reason in reasons}
    failed |= {reason: len(some) for reason, some in unmeasurable(cases).items()}
    rows = [(draw.scene, draw.split) for draw in draws if draw.case is not None]
    table = [(*row, str(rows.count(row))) for row in sorted(set(rows))]
    print_table(("scene", "split", "samples"), table)
    _print_reasons(failed)
    return BAD_INPUT if sum(failed.values()) == len(draws) else 0


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
) -> None:
    """Score predictions against a data set: twin score PREDICTIONS DATASET.

    PREDICTIONS is a folder with files KEY.QUANTITY.npy: depth_mm, normal_world, phase_column_rad or
    phase_row_rad, in the shape and unit of the truth; NaN: no prediction.

    Parameters
    ----------
    folders
        PREDICTIONS and DATASET; with --baseline only DATASET.
    out
        Folder for result.json and objects.csv; default: none is written.
    baseline
        Classical method that is scored in place of predictions: decoded, spatial_unwrapping,
        fourier.
    split
        Part of the data set: train, validation or test.
    """
    from reconstruction.evaluate.baselines import score_baseline
    from reconstruction.evaluate.predictions import score_predictions

    expected = 1 if baseline else 2
    if len(folders) != expected:
        raise InputError(
            f"twin score: found {counted(len(folders), 'folder')}, allowed {expected}: "
            + ("DATASET" if baseline else "PREDICTIONS DATASET")
        )
    if baseline:
        result = score_baseline(baseline, folders[0], split)
    else:
        result = score_predictions(folders[0], folders[1], split)
    figures = result.figures()
    if out is not None:
        _write_score(out, result, figures, folders)
    print_metrics(figures)
    _print_objects(result)
    if out is not None:
        say(f"wrote {out}")


def _write_score(
    out: Path, result: "PredictionScore", figures: dict[str, Any], folders: "Sequence[Path]"
) -> None:
    from twin.output import output_folder, write_outcome
    from twin.results.parts import write_rows

    with output_folder(out, folders) as folder:
        write_rows(folder / "objects.csv", result.by_object(), 6)
        write_outcome(folder, "score", figures)


def _print_objects(result: "PredictionScore") -> None:
    from twin.cli.app import cell

    rows = result.by_object()
    if len(rows) < 2:
        return
    names = ["object", "samples", *(name for name in rows[0] if "_rms_" in name)]
    table = ([cell(row[name], 4) for name in names] for row in rows[:_MOST_OBJECTS])
    print_table(names, table, width=None if sys.stdout.isatty() else 120)
    if len(rows) > _MOST_OBJECTS:
        say(f"{len(rows) - _MOST_OBJECTS} more objects: objects.csv with -o DIR")
