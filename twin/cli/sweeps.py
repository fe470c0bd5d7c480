"""Commands for design-space sweeps: run a study, read its table."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from reconstruction.errors import InputError
from twin.cli.app import BAD_INPUT, FAILURE, Out, app
from twin.cli.console import cell, print_table, progress_bars, say

if TYPE_CHECKING:
    from twin.study.engine import SweepOutcome
    from twin.study.record import StudyRecord

_MOST_REASONS = 10

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

    Why cases failed is told. Exit code 1: none has a result, or some could not be saved.

    Parameters
    ----------
    study
        TOML file, or the name of a shipped study such as studies/albedo_flakes.
    workers
        Processes on this machine; default: one per two cores, at least two of them.
    cluster
        Address of a Dask scheduler, tcp://HOST:PORT, instead of processes on this machine.
    dry_run
        Only validate the study, say how many cases it has and what they take, and which of them
        cannot be measured, and why; exit code 2 when none can.
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
        return _check(record)
    with progress_bars() as watch:
        outcome = run(record, out, who, cases=cases, retry=retry, watch=watch, inputs=[study])
    tell_outcome(outcome, out)
    return FAILURE if outcome.unsaved or not outcome.finished else 0


def _check(record: "StudyRecord") -> int:
    """Say which cases cannot be measured; of a search, which along its axes."""
    from twin.study.dry_run import probes_of, unmeasurable

    searches = record.study.sampling.method == "optimise"
    cases = probes_of(record) if searches else list(record.cases().run)
    found = unmeasurable(cases)
    for reason, some in found.items():
        at = ", ".join(f"{name} = {value}" for name, value in some[0].settings.items())
        probes = " tried along the axes" if searches else ""
        sys.stderr.write(
            f"twin: {len(some)} of {len(cases)} cases{probes} cannot be measured: {reason} "
            f"(at {at})\n"
        )
    return BAD_INPUT if sum(map(len, found.values())) == len(cases) else 0


def tell_outcome(outcome: "SweepOutcome", out: Path) -> None:
    """Say what a run did: what could not be saved, what failed and why, how much is done."""
    for digest, reason in outcome.unsaved.items():
        sys.stderr.write(f"twin: case {digest} could not be saved: {reason}\n")
    for digest, reason in outcome.damaged.items():
        sys.stderr.write(f"twin: case {digest} was damaged and ran again: {reason}\n")
    _tell_failures(outcome, out)
    counts = ", ".join(f"{number} {state}" for state, number in sorted(outcome.states.items()))
    say(f"{counts or 'nothing to do'} in {outcome.seconds:.1f} s; wrote {out}")


def _tell_failures(outcome: "SweepOutcome", out: Path) -> None:
    """Say why cases failed, commonest reason first, each with a file that tells more."""
    ranked = sorted(outcome.failures.items(), key=lambda item: -len(item[1]))
    for reason, digests in ranked[:_MOST_REASONS]:
        file = out / "cases" / digests[0] / "failure.json"
        sys.stderr.write(f"twin: {len(digests)} failed: {reason} (see {file})\n")
    if len(ranked) > _MOST_REASONS:
        more = len(ranked) - _MOST_REASONS
        sys.stderr.write(f"twin: {more} more reasons: twin sweep table {out}\n")


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
        Default: the objectives of the study.
    """
    from twin.study.best import best_rows, objective_of
    from twin.study.table import read_table

    found = read_table(folder)
    chosen = [objective_of(text) for text in objective or ()] or list(found.record.study.goals)
    if not chosen:
        raise InputError("--objective: found none; name a METRIC, for example -b z_rmse_um")
    names = dict.fromkeys([one.metric for one in chosen] + list(found.metrics))
    headings = (*found.axes, *names, "case")
    rows = ([cell(row.get(n), 5) for n in headings] for row in best_rows(found.rows, chosen))
    print_table(headings, rows, width=None if sys.stdout.isatty() else 200)


@sweep_app.command
def report(folder: Path, /, *, objective: Objectives = None) -> None:
    """Draw the HTML report of a study: best designs in pictures, effects, every case.

    Of a study of trials: distributions, intervals and ranked budgets.

    Parameters
    ----------
    folder
        The -o DIR of twin sweep.
    objective
        What makes a design good, as for twin sweep best; default: the study's objectives, or a
        small error.
    """
    from twin.output import adding
    from twin.report import REPORT_FILE, REPORT_NAMES
    from twin.report.study import write_study
    from twin.report.uncertainty import write_uncertainty_page
    from twin.study.best import objective_of
    from twin.study.pictures import picture_best
    from twin.study.table import read_table

    chosen = [objective_of(text) for text in objective or ()]
    found = read_table(folder)  # it is a store, and can be read, before anything is made in it
    with adding(folder, *REPORT_NAMES) as drawn, progress_bars() as watch:
        if found.record.study.sampling.method == "trials":
            write_uncertainty_page(folder, watch, drawn, [one.metric for one in chosen])
        else:
            failed = picture_best(folder, chosen, watch)
            write_study(folder, watch, chosen, drawn, failed)
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
