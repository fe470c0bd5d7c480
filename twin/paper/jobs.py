"""Measure side by side: the pieces of a reproduction as jobs for several processes.

Every job leaves its results in the folder's small files. What is then asked of the reproduction in
this process it finds there: jobs change how long it takes, never what comes out.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from reconstruction.machine import threads
from twin.config.methods import TRAITS
from twin.paper.colours import CALIBRATIONS
from twin.paper.figures import FIGURES
from twin.paper.plan import BALLS, BUDGET_OF, CASES, RODS
from twin.paper.reproduction import Reproduction
from twin.study.workers import Workers

Outcome = TypeVar("Outcome")

_TRIALS_PER_JOB = 6
_WITH_CASES = "completeness"


@dataclass(frozen=True)
class Job:
    """One piece.

    Attributes
    ----------
    what : a key of the table of jobs below
    which : specimens, trials or calibration
    rests_on_rig : it needs the calibration of the rig
    """

    what: str
    which: tuple[Any, ...] = ()
    rests_on_rig: bool = False


def jobs_of(tables: Sequence[str], figures: Sequence[str], trials: int) -> list[Job]:
    """Return what the named groups of tables and figures need, the longest first."""
    jobs: list[Job] = []
    with_cases = _WITH_CASES in tables or any(FIGURES[name].cases for name in figures)
    specimens = [*([BALLS] if "spheres" in tables else []), *(RODS if "rods" in tables else [])]
    if "spheres" in tables:
        jobs += [Job("colours", (number,)) for number in reversed(range(1, CALIBRATIONS))]
    if "spheres" in tables or with_cases:
        jobs.append(Job("sensor", ("spheres" in tables, with_cases)))
    if with_cases:
        jobs += list(_case_jobs())
    if "differences" in tables:
        jobs.append(Job("bare_nut"))
    jobs += [Job("budget", (name,)) for name in specimens if name in BUDGET_OF]
    for name in specimens:
        numbers = range(trials + 1)
        parts = [numbers[k : k + _TRIALS_PER_JOB] for k in numbers[::_TRIALS_PER_JOB]]
        jobs += [Job("fringes", (name, tuple(part)), rests_on_rig=True) for part in parts]
    return jobs


def _case_jobs() -> Iterator[Job]:
    for names, methods in CASES:
        for method in methods:
            if TRAITS[method].fringes:
                yield from (Job("cases", ((name,), (method,))) for name in names)


def measure_ahead(
    run: Reproduction,
    jobs: Sequence[Job],
    workers: Workers,
    meanwhile: Callable[[], Outcome],
) -> Outcome:
    """Do the jobs; results lie in the folder of the reproduction.

    The rig is calibrated in this process: its last digits depend on how many threads the linear
    algebra has, and these must not depend on the workers.

    Parameters
    ----------
    meanwhile : done in this process while the workers measure

    Returns
    -------
    What `meanwhile` returned.

    Raises
    ------
    InputError, MissingBackend
        As the first job that fails.
    """
    if not jobs:
        return meanwhile()
    executor = workers.open()

    def begin(job: Job) -> "Future[None]":
        return executor.submit(do, run.work, run.trials, dict(run.settings), job)

    try:
        begun = [begin(job) for job in jobs if not job.rests_on_rig]
        if len(begun) < len(jobs):
            run.rigs()
        begun += [begin(job) for job in jobs if job.rests_on_rig]
        outcome = meanwhile()
        for done, future in enumerate(as_completed(begun)):
            run.watch("measurements", done / len(begun))
            future.result()
        run.watch("measurements", 1.0)
        return outcome
    finally:
        workers.close(executor)


def do(work: Path, trials: int, settings: Mapping[str, Any], job: Job) -> None:
    """Do one job in this process, with its share of the cores."""
    from twin.optics.backend import use_threads

    use_threads(threads())
    _JOBS[job.what](Reproduction(work, trials, settings), *job.which)


def _sensor(run: Reproduction, trials: bool, cases: bool) -> None:
    """Whatever uses the first calibration of the photometric sensor, which stays in memory."""
    if trials:
        run.colour_trials().of_calibration(0)
    if cases:
        for names, methods in CASES:
            run.cases(names, tuple(one for one in methods if not TRAITS[one].fringes))


_JOBS: Mapping[str, Callable[..., Any]] = {
    "fringes": Reproduction.fringe_trials,
    "colours": lambda run, number: run.colour_trials().of_calibration(number),
    "sensor": _sensor,
    "cases": Reproduction.cases,
    "budget": Reproduction.budget,
    "bare_nut": Reproduction.bare_nut,
}
