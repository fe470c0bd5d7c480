"""Commands that repeat measurements: for a design space, an uncertainty, or the paper's tables."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter

from reconstruction.errors import InputError, counted
from twin.cli.app import (
    BAD_INPUT,
    FAILURE,
    Cluster,
    DryRun,
    ExperimentFile,
    Out,
    Retry,
    Settings,
    WorkerCount,
    app,
    cell,
    load,
    print_table,
    progress_bars,
    say,
    workers_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from twin.propagation.results import Uncertainty
    from twin.study.cases import Case
    from twin.study.outcome import SweepOutcome
    from twin.study.record import StudyRecord
    from twin.study.remarks import Remark
    from twin.study.table import StudyTable
    from twin.study.workers import Workers

_MOST_REASONS, _MOST_NEAREST = 10, 6
QUICK_TRIALS, FULL_TRIALS = 5, 100

Objectives = Annotated[list[str] | None, Parameter(name=["--objective", "-b"])]

sweep_app = App(name="sweep", help="Measure a whole design space: twin sweep STUDY.toml -o DIR.")
app.command(sweep_app)


@sweep_app.default
def sweep(
    study: Path,
    /,
    *,
    out: Out,
    workers: WorkerCount = None,
    cluster: Cluster = None,
    dry_run: DryRun = False,
    retry: Retry = False,
) -> int:
    """Compute every case of a study that is not in OUT yet; run it again to continue.

    The reasons of failed cases are printed. Exit code 1: no case has a result, or some cases could
    not be saved.

    Parameters
    ----------
    study
        TOML file, or the name of a shipped study such as studies/albedo_flakes.
    """
    from twin.config.study import load_study
    from twin.study.estimate import estimate, estimate_line
    from twin.study.record import StudyRecord
    from twin.study.store import Store
    from twin.study.sweep import sweep as run

    record = StudyRecord(*load_study(study))
    searches = record.study.sampling.method in ("optimise", "gradient")
    cases = None if searches else record.first_look() if dry_run else record.cases()
    who = workers_of(workers, cluster)
    if cases is not None:
        sys.stderr.write(f"{estimate_line(estimate(record, cases, Store(out), who.count))}\n")
    code = _check(record, () if cases is None else cases.run)
    if dry_run or code:
        return code
    with progress_bars() as watch:
        outcome = run(
            record,
            out,
            who,
            cases=cases,
            retry=retry,
            watch=watch,
            inputs=[study],
            tell=_on_message,
        )
    _print_outcome(outcome, out)
    return FAILURE if outcome.unsaved or not outcome.finished else 0


def _on_message(sentence: str) -> None:
    sys.stderr.write(f"twin: {sentence}\n")


def _check(record: "StudyRecord", cases: "Sequence[Case]") -> int:
    """Print the cases that cannot be measured; return exit code 2 if none can be, else 0.

    Values outside the ranges of their sources are printed as warnings. A search has no list of
    cases; points along its axes are checked instead.

    Raises
    ------
    InputError : a figure that the study names is in no case
    """
    from twin.study.checks import check_figures
    from twin.study.measurable import probes_of, unmeasurable
    from twin.study.remarks import remarks_of

    searches = record.study.sampling.method in ("optimise", "gradient")
    cases = probes_of(record) if searches else cases
    check_figures(record, cases)
    for remark in remarks_of({case.digest: {} for case in cases}, cases):
        sys.stderr.write(f"twin: warning: {remark.in_words(len(cases))}\n")
    unmeasurable_cases = unmeasurable(cases)
    for reason, some in unmeasurable_cases.items():
        at = ", ".join(f"{name} = {value}" for name, value in some[0].settings.items())
        probes = " tried along the axes" if searches else ""
        share = f"{len(some)} of {counted(len(cases), 'case')}{probes}"
        sys.stderr.write(f"twin: {share} cannot be measured: {reason} (at {at})\n")
    return BAD_INPUT if sum(map(len, unmeasurable_cases.values())) == len(cases) else 0


def _print_outcome(outcome: "SweepOutcome", out: Path) -> None:
    """Print unsaved and damaged cases, failures, warnings, and the number of cases by state."""
    for digest, reason in outcome.unsaved.items():
        sys.stderr.write(f"twin: case {digest} could not be saved: {reason}\n")
    for digest, reason in outcome.damaged.items():
        sys.stderr.write(f"twin: case {digest} was damaged and ran again: {reason}\n")
    _print_failures(outcome, out)
    _print_remarks(outcome.remarks, outcome.finished, out)
    counts = ", ".join(f"{number} {state}" for state, number in sorted(outcome.states.items()))
    say(f"{counts or 'nothing to do'} in {outcome.seconds:.1f} s; wrote {out}")


def _print_failures(outcome: "SweepOutcome", out: Path) -> None:
    """Print the reasons of failures, the most frequent first, each with an example file."""
    ranked = sorted(outcome.failures.items(), key=lambda item: -len(item[1]))
    for reason, digests in ranked[:_MOST_REASONS]:
        file = out / "cases" / digests[0] / "failure.json"
        sys.stderr.write(f"twin: {len(digests)} failed: {reason} (see {file})\n")
    if len(ranked) > _MOST_REASONS:
        more = len(ranked) - _MOST_REASONS
        sys.stderr.write(f"twin: {counted(more, 'more reason')}: twin sweep table {out}\n")


def _print_remarks(remarks: "Sequence[Remark]", of: int, out: Path) -> None:
    """Print each kind of warning once, with the number of cases that have it and an example."""
    for remark in remarks[:_MOST_REASONS]:
        sys.stderr.write(f"twin: {remark.in_words(of)} (case {remark.digests[0]})\n")
    if len(remarks) > _MOST_REASONS:
        more = counted(
            len(remarks) - _MOST_REASONS, "more kind of warning", "more kinds of warnings"
        )
        sys.stderr.write(f"twin: {more}: twin sweep report {out}\n")


@sweep_app.command
def best(
    folder: Path,
    /,
    *,
    objective: Objectives = None,
) -> int:
    """Print the best feasible designs of a study, its Pareto front, and the design to build.

    A case is feasible if it satisfies all constraints and all tolerances. A measurand satisfies its
    tolerance if its value plus or minus its expanded uncertainty is within the limits. Exit code 1:
    no case is feasible; the cases nearest to the limits are printed, and the axis that would help.

    Parameters
    ----------
    folder
        The -o DIR of twin sweep.
    objective
        METRIC to minimise, or +METRIC to maximise; repeat the option for a Pareto front. Default:
        the objectives of the study.
    """
    from twin.report.study_limits import limit_sentences
    from twin.report.study_words import verdict_sentence
    from twin.report.words import in_ascii
    from twin.study.feasibility import feasibility_in_words
    from twin.study.table import best_rows, nearest_rows, objective_of, read_table, usable_rows
    from twin.study.verdict import verdict_of

    table = read_table(folder)
    chosen = [objective_of(text) for text in objective or ()] or list(table.record.study.goals)
    if not chosen:
        raise InputError("--objective: found none; name a METRIC, for example -b z_rmse_um")
    some, nearest = usable_rows(table.rows, chosen), nearest_rows(table.rows, chosen)
    feasible = some or not nearest  # an empty table is an error
    rows = best_rows(table.rows, chosen) if feasible else nearest[:_MOST_NEAREST]
    if table.conditions:
        sys.stderr.write(f"twin: {feasibility_in_words(table.rows)}\n")
    if not some:
        sys.stderr.write("twin: no case is feasible; the nearest to the limits first:\n")
    goals = [goal.metric for goal in chosen if goal.metric not in table.axes]
    names = dict.fromkeys(goals + list(table.metrics))
    more = ("case",) if some else ("case", "reason")
    columns = (*table.axes, *names, *more)
    cells = ([cell(row.get(n), 5) for n in columns] for row in rows)
    headings = [_heading(table, name) for name in columns]
    print_table(headings, cells, width=None if sys.stdout.isatty() else 200)
    for sentence in limit_sentences(table):
        say(in_ascii(sentence))
    say(in_ascii(verdict_sentence(table, verdict_of(table, chosen))))
    return 0 if some else FAILURE


def _heading(table: "StudyTable", name: str) -> str:
    """Return the name of a column; the unit is appended unless it is part of the name."""
    from twin.report.study_words import axis_headings
    from twin.report.words import in_ascii, split_unit

    unit = axis_headings(table).get(name, ("", ""))[1]
    return f"{name} ({in_ascii(unit)})" if unit and not split_unit(name)[1] else name


@sweep_app.command
def report(folder: Path, /, *, objective: Objectives = None) -> None:
    """Draw the HTML report of a study: best designs in pictures, effects, every case.

    The report of a study of trials shows distributions, intervals and ranked budgets.

    Parameters
    ----------
    folder
        The -o DIR of twin sweep.
    objective
        METRIC or +METRIC, as for twin sweep best; default: the study's objectives, or the first
        error figure.
    """
    from twin.output import adding
    from twin.report import REPORT_FILE, REPORT_NAMES
    from twin.report.study import write_study
    from twin.report.study_words import verdict_sentence
    from twin.report.uncertainty import write_uncertainty_page
    from twin.report.words import in_ascii
    from twin.study.pictures import picture_best
    from twin.study.table import objective_of, read_table
    from twin.study.verdict import verdict_of

    chosen = [objective_of(text) for text in objective or ()]
    table = read_table(folder)  # raises before any file is written if the folder is no store
    verdict = ""
    with adding(folder, *REPORT_NAMES) as drawn, progress_bars() as watch:
        if table.record.study.sampling.method == "trials":
            write_uncertainty_page(folder, watch, drawn, [goal.metric for goal in chosen])
        else:
            failed = picture_best(folder, chosen, watch)
            write_study(folder, watch, chosen, drawn, failed)
            verdict = verdict_sentence(table, verdict_of(table, chosen))
    if verdict:
        say(in_ascii(verdict))
    say(f"wrote {folder / REPORT_FILE}")


@sweep_app.command
def table(folder: Path, /, *, csv: Path | None = None, parquet: Path | None = None) -> None:
    """Print the table of a study's cases, or write it as CSV or Parquet.

    Parameters
    ----------
    folder
        The -o DIR of twin sweep.
    csv
        New file, for example table.csv; without --csv and --parquet, CSV is printed to stdout.
    parquet
        New file; needs pyarrow.
    """
    from twin.study.table import csv_text, read_table, write_csv, write_parquet

    table = read_table(folder)
    if csv is None and parquet is None:
        sys.stdout.write(csv_text(table))
        return
    for path, write in ((csv, write_csv), (parquet, write_parquet)):
        if path is not None:
            write(table, path)
            say(f"wrote {path}, {counted(len(table.rows), 'case')}")


@app.command
def uncertainty(
    experiment: ExperimentFile,
    /,
    *,
    out: Out,
    trials: Annotated[int, Parameter(name=["--trials", "-n"])] = 100,
    inputs: str = "inputs/handling",
    settings: Settings = None,
    measurand: Annotated[list[str] | None, Parameter(name=["--measurand", "-m"])] = None,
    calibration: Literal["drawn", "true"] = "drawn",
    budget: bool = True,
    sobol: int | None = None,
    seed: int | None = None,
    workers: WorkerCount = None,
    cluster: Cluster = None,
    dry_run: DryRun = False,
    retry: Retry = False,
) -> int:
    """Repeat a measurement with randomly drawn inputs: interval and ranked budget of any figure.

    For example: twin uncertainty examples/slab_balls -n 100 -m sphere_1_radius_mm
    -s camera.binning=4 -o out/u. Run it again to continue, or with a larger -n to add trials. The
    nominal measurement is first; if it fails or lacks a measurand, no trial runs (exit code 2).
    Exit code 1: too few trials have a result, or some could not be saved.

    Parameters
    ----------
    trials
        Repetitions with all inputs drawn, in addition to the nominal measurement.
    inputs
        TOML file of [inputs.NAME] tables, or the name of a shipped file.
    measurand
        Figure such as z_rmse_um; repeat the option for several. Default: the main figures.
    calibration
        drawn: a new calibration of the rig in each trial; true: always the true rig.
    budget
        Also vary each input separately (two measurements each) and only the noise (up to 20).
    sobol
        Base points N, a power of 2, of Sobol' indices of the face: N x (inputs + 2) presses.
    seed
        Seed of all random draws; default: the seed in the file of inputs.
    """
    from twin.propagation.trials import plan_in_words, record_of
    from twin.results.names import of_the_object

    measurement, named = (load(experiment, settings), inputs, trials), measurand or ()
    options: dict[str, Any] = {"calibration": calibration, "budget": budget, "seed": seed}
    compensated = of_the_object(named) or None
    record = record_of(*measurement, compensated=compensated, measurands=named, **options)
    who = workers_of(workers, cluster)
    if dry_run:
        for line in plan_in_words(record, out, who.count, sobol):
            sys.stderr.write(f"{line}\n")
        return _check(record, record.cases().run)
    outcome = _swept(record, out, who, [experiment, Path(inputs)], retry)
    if outcome.finished < 3:  # the nominal one and two trials
        return FAILURE
    _print_results(_evaluated(record, out, measurand or [], sobol))
    say(f"wrote {out / 'report.html'}")
    return FAILURE if outcome.unsaved else 0


def _swept(
    record: "StudyRecord", out: Path, who: "Workers", read: list[Path], retry: bool
) -> "SweepOutcome":
    """Print the estimated run time, measure the trials that are not in OUT, print the outcome."""
    from twin.study.estimate import estimate, estimate_line
    from twin.study.store import Store
    from twin.study.sweep import sweep

    cases = record.cases()
    sys.stderr.write(f"{estimate_line(estimate(record, cases, Store(out), who.count))}\n")
    with progress_bars() as watch:
        outcome = sweep(
            record,
            out,
            who,
            cases=cases,
            retry=retry,
            watch=watch,
            inputs=read,
            tell=_on_message,
        )
    _print_outcome(outcome, out)
    return outcome


def _evaluated(
    record: "StudyRecord", out: Path, measurands: list[str], sobol: int | None
) -> "Uncertainty":
    """Evaluate the trials, write results and report into OUT, and return the result."""
    from twin.output import adding
    from twin.propagation.results import read_uncertainty
    from twin.propagation.sensitivity import sobol_of_face
    from twin.propagation.trials import write_uncertainty
    from twin.report import REPORT_NAMES
    from twin.report.uncertainty import write_uncertainty_page

    result = read_uncertainty(out, measurands)
    with progress_bars() as watch:
        effects = {}
        if sobol is not None:
            inputs, seed = record.study.inputs, record.study.sampling.seed
            names = list(result.measurands)
            effects = sobol_of_face(result.experiment, inputs, names, sobol, seed=seed, watch=watch)
        write_uncertainty(out, result, effects)
        with adding(out, *REPORT_NAMES) as drawn:
            write_uncertainty_page(out, watch, drawn, measurands)
    return result


def _print_results(result: "Uncertainty") -> None:
    from twin.report.uncertainty import result_lines

    headings = ("figure", "trials", "mean", "u", "95 % interval", "digits", "largest part")
    keys = ("name", "n", "mean", "u", "symmetric", "digits", "first")
    rows = ([line[key] for key in keys] for line in result_lines(result))
    print_table(headings, rows, width=None if sys.stdout.isatty() else 120)


@app.command
def paper(
    *,
    out: Out,
    only: list[str] | None = None,
    trials: int | None = None,
    quick: bool = False,
    full: bool = False,
    workers: WorkerCount = None,
) -> None:
    """Reproduce the tables and figures of the paper, with the paper's numbers next to the twin's.

    Measurements that are in OUT/work already are not repeated: an interrupted run continues.

    Parameters
    ----------
    only
        Group of tables (identified, hardness, rods, spheres, completeness, differences) or figure
        (concept, ridges, hardness, setup, direct_and_contact, missing, rods, grid, sphere_fit); one
        table or figure: tables/NAME, figures/NAME. Only their measurements run. Repeat the option
        for several.
    trials
        Number of repetitions of every repeated measurement; default: 100, or with --quick the
        paper's 5.
    quick
        Use five trials as in the paper, with the same parameters as without --quick.
    full
        Use all 1936 x 1464 camera pixels instead of 2 x 2 binning.
    """
    from twin.paper.run import Request, reproduce
    from twin.study.workers import default_count

    if trials is not None and not 2 <= trials <= 10000:
        raise InputError(f"--trials {trials}: allowed 2 to 10000")
    if workers is not None and workers < 1:
        raise InputError(f"--workers {workers}: allowed 1 or more")
    count = trials or (QUICK_TRIALS if quick else FULL_TRIALS)
    with progress_bars() as watch:
        request = Request(count, tuple(only or ()), full)
        done = reproduce(out, request, watch, default_count() if workers is None else workers)
    for line in done.lines:
        say(line)
    say(f"wrote {done.page}")
