"""Commands for design-space sweeps: run a study, read its table."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from reconstruction.errors import InputError
from twin.cli.app import FAILURE, Out, app
from twin.cli.console import progress_bars, say

Objectives = Annotated[list[str] | None, Parameter(name=["--objective", "-b"])]

sweep_app = App(name="sweep", help="Measure a whole design space: twin sweep STUDY.toml -o DIR.")
app.command(sweep_app)


@sweep_app.default
def sweep(
    study: Path,
    /,
    *,
    out: Out,
    workers: Annotated[int | None, Parameter(name=["--workers", "-j"])] = None,
    cluster: str | None = None,
    dry_run: bool = False,
    retry: bool = False,
) -> int:
    """Compute every case of a study that OUT does not hold yet; run it again to go on.

    Parameters
    ----------
    study
        TOML file, or the name of a shipped study such as studies/albedo_flakes.
    workers
        Processes on this machine; absent: one per two cores, at least two of them.
    cluster
        Address of a Dask scheduler, tcp://HOST:PORT, instead of processes on this machine.
    dry_run
        Only validate the study, and say how many cases it has and what they take.
    retry
        Also try again what failed for a reason that lies in the experiment.
    """
    from twin.config.study import load_study
    from twin.study.record import StudyRecord
    from twin.study.store import Store
    from twin.study.sweep import estimate, told
    from twin.study.sweep import sweep as run
    from twin.study.workers import dask_workers, default_count, local_workers

    record = StudyRecord(*load_study(study))
    searches = record.study.sampling.method == "optimise"
    cases = None if searches else record.cases()
    who = dask_workers(cluster) if cluster else local_workers(workers or default_count())
    if cases is not None:
        sys.stderr.write(f"{told(estimate(record, cases, Store(out), who.count))}\n")
    if dry_run:
        return 0
    with progress_bars() as watch:
        outcome = run(record, out, who, cases=cases, retry=retry, watch=watch, inputs=[study])
    for digest, reason in outcome.unsaved.items():
        sys.stderr.write(f"twin: case {digest} could not be saved: {reason}\n")
    counts = ", ".join(f"{number} {state}" for state, number in sorted(outcome.states.items()))
    say(f"{counts or 'nothing to do'} in {outcome.seconds:.1f} s; wrote {out}")
    return FAILURE if outcome.unsaved else 0


@sweep_app.command
def best(
    folder: Path,
    /,
    *,
    objective: Objectives = None,
) -> None:
    """Print the best feasible designs of a study: those that no other beats in every objective.

    Parameters
    ----------
    folder
        The -o DIR of twin sweep.
    objective
        METRIC that is to be small, or +METRIC that is to be large; give several for a Pareto front.
        Absent: the objectives of the study.
    """
    from rich.console import Console
    from rich.table import Table

    from twin.study.best import best_rows, objective_of
    from twin.study.table import read_table

    found = read_table(folder)
    chosen = [objective_of(text) for text in objective or ()] or list(found.record.study.goals)
    if not chosen:
        raise InputError("--objective: found none; name a METRIC, for example -b z_rmse_um")
    names = dict.fromkeys([one.metric for one in chosen] + list(found.metrics))
    shown = Table(*found.axes, *names, "case")
    for row in best_rows(found.rows, chosen):
        cells = [row.get(name) for name in (*found.axes, *names, "case")]
        shown.add_row(*(f"{c:.5g}" if isinstance(c, float) else str(c) for c in cells))
    Console(width=None if sys.stdout.isatty() else 200).print(shown)


@sweep_app.command
def report(folder: Path, /, *, objective: Objectives = None) -> None:
    """Draw the HTML report of a study: best designs in pictures, effects, every case.

    Parameters
    ----------
    folder
        The -o DIR of twin sweep.
    objective
        What makes a design good, as for twin sweep best; absent: the study's objectives, or a small
        error.
    """
    from twin.output import adding
    from twin.report import REPORT_FILE, REPORT_NAMES
    from twin.report.study import write_study
    from twin.study.best import objective_of
    from twin.study.table import read_table

    chosen = [objective_of(text) for text in objective or ()]
    read_table(folder)  # it is a store, and can be read, before anything is made in it
    with adding(folder, *REPORT_NAMES) as drawn, progress_bars() as watch:
        write_study(folder, watch, chosen, drawn)
    say(f"wrote {folder / REPORT_FILE}")


@sweep_app.command
def table(folder: Path, /, *, csv: Path | None = None, parquet: Path | None = None) -> None:
    """Print the table of a study's cases, or write it as CSV or Parquet.

    Parameters
    ----------
    folder
        The -o DIR of twin sweep.
    csv
        New file, for example table.csv; without --csv and --parquet CSV goes to stdout.
    parquet
        New file; needs pyarrow.
    """
    from twin.study.table import csv_text, read_table, write_csv, write_parquet

    found = read_table(folder)
    if csv is None and parquet is None:
        sys.stdout.write(csv_text(found))
        return
    for path, write in ((csv, write_csv), (parquet, write_parquet)):
        if path is not None:
            write(found, path)
            say(f"wrote {path}, {len(found.rows)} cases")
