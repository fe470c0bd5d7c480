"""`twin uncertainty`: repeat a measurement with its inputs drawn anew."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from twin.cli.app import FAILURE, Out, Settings, app
from twin.cli.console import load, print_table, progress_bars, say
from twin.cli.sweeps import tell_outcome

if TYPE_CHECKING:
    from twin.study.engine import SweepOutcome
    from twin.study.record import StudyRecord
    from twin.study.workers import Workers
    from twin.uncertainty.results import Uncertainty

WorkerCount = Annotated[
    int | None,
    Parameter(
        name=["--workers", "-j"],
        help="processes on this machine; default: one per two cores, at least two of them",
    ),
]
Cluster = Annotated[
    str | None,
    Parameter(help="Dask scheduler, tcp://HOST:PORT, instead of processes on this machine"),
]
Retry = Annotated[
    bool, Parameter(help="also try again what failed for a reason that lies in the experiment")
]


@app.command
def uncertainty(
    experiment: Path,
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
    retry: Retry = False,
) -> int:
    """Repeat a measurement with its inputs drawn anew: interval and ranked budget of any figure.

    For example: twin uncertainty paper/two_balls -n 100 -m sphere_1_radius_mm -s camera.binning=4
    -o out/u. Run it again to go on, or with a larger -n to add trials. Exit code 1: too few trials
    have a result, or some could not be saved.

    Parameters
    ----------
    experiment
        TOML file, or the name of a shipped experiment such as paper/two_balls.
    trials
        Repetitions with all inputs drawn; the nominal measurement comes on top.
    inputs
        TOML file of [inputs.NAME] tables, or the name of a shipped one.
    measurand
        Figure of the measurement such as z_rmse_um; give several. Default: the main ones.
    calibration
        drawn: a new calibration of the rig in each trial; true: always the true rig.
    budget
        Also vary each input alone (two measurements each) and the noise alone (up to 20).
    sobol
        Base points of Sobol' indices of the pressed face, a power of 2; costs as many presses
        times the number of inputs and two.
    seed
        Of all draws; default: that of the inputs.
    """
    from twin.study.workers import dask_workers, default_count, local_workers
    from twin.uncertainty.trials import record_of

    record = record_of(
        load(experiment, settings),
        inputs,
        trials,
        calibration=calibration,
        budget=budget,
        seed=seed,
    )
    who = dask_workers(cluster) if cluster else local_workers(workers or default_count())
    outcome = _swept(record, out, who, [experiment, Path(inputs)], retry)
    if outcome.finished < 3:  # the nominal one and two trials
        return FAILURE
    _tell(_evaluated(record, out, measurand or [], sobol))
    say(f"wrote {out / 'report.html'}")
    return FAILURE if outcome.unsaved else 0


def _swept(
    record: "StudyRecord", out: Path, who: "Workers", read: list[Path], retry: bool
) -> "SweepOutcome":
    """Say what the trials will take, measure those that OUT lacks, and say what became of them."""
    from twin.study.store import Store
    from twin.study.sweep import estimate, sweep, told

    cases = record.cases()
    sys.stderr.write(f"{told(estimate(record, cases, Store(out), who.count))}\n")
    with progress_bars() as watch:
        outcome = sweep(record, out, who, cases=cases, retry=retry, watch=watch, inputs=read)
    tell_outcome(outcome, out)
    return outcome


def _evaluated(
    record: "StudyRecord", out: Path, measurands: list[str], sobol: int | None
) -> "Uncertainty":
    """Evaluate the trials, write the results and draw the report."""
    from twin.output import adding
    from twin.report import REPORT_NAMES
    from twin.report.uncertainty import write_uncertainty_page
    from twin.uncertainty.results import read_uncertainty
    from twin.uncertainty.sensitivity import sobol_of_face
    from twin.uncertainty.trials import write_uncertainty

    found = read_uncertainty(out, measurands)
    with progress_bars() as watch:
        effects = {}
        if sobol is not None:
            inputs, seed = record.study.inputs, record.study.sampling.seed
            names = list(found.measurands)
            effects = sobol_of_face(found.experiment, inputs, names, sobol, seed=seed, watch=watch)
        write_uncertainty(out, found, effects)
        with adding(out, *REPORT_NAMES) as drawn:
            write_uncertainty_page(out, watch, drawn, measurands)
    return found


def _tell(found: "Uncertainty") -> None:
    from twin.report.uncertainty import result_lines

    headings = ("figure", "trials", "mean", "u", "95 % interval", "digits", "largest part")
    keys = ("name", "n", "mean", "u", "symmetric", "digits", "first")
    rows = ([line[key] for key in keys] for line in result_lines(found))
    print_table(headings, rows, width=None if sys.stdout.isatty() else 120)
