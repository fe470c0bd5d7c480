"""Search of the design space with Optuna: propose a batch of points, measure it, return results.

The state of the search is not stored. Sampler and seed are fixed, and the sampler receives the
results in the order of its proposals. Therefore a study always has the same points, with any
number of workers. A second run reads the measured points from the store and continues.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.errors import InputError
from reconstruction.machine import warnings_ignored
from twin.config import ConfigError
from twin.config.axis import Axis
from twin.config.study import Constraint, Optimise, Study
from twin.extras import missing
from twin.results.rows import is_number
from twin.study.cases import Case, Cases, Point, cases_of, quantity
from twin.study.derived import DERIVED, with_derived
from twin.study.feasibility import beyond_tolerances, has_tolerances
from twin.study.outcome import SweepOutcome
from twin.study.record import StudyRecord
from twin.study.store import Store
from twin.study.table import cost_of

if TYPE_CHECKING:
    import optuna

_MOST_PROPOSALS = 200  # proposals until one point is valid

RunCases = Callable[[StudyRecord, Cases], SweepOutcome]
"""Function that writes the record into the store and computes the cases that the store lacks."""


def optimise(record: StudyRecord, folder: Path, run: RunCases) -> list[SweepOutcome]:
    """Search until the planned number of points is measured; return the outcome of each batch.

    Parameters
    ----------
    record : study with sampling.method = "optimise"
    folder : the store
    run : function that computes a batch of cases into the store

    Raises
    ------
    InputError : Optuna is not installed, an objective is not a figure of the cases, or no point is
        a valid experiment that satisfies the constraints
    """
    plan = record.study.optimise
    if plan is None:
        raise InputError(f"{record.study.name}: has no [optimise]; use twin sweep as it is")
    if len(record.study.modalities) > 1:
        raise InputError("modalities: an optimiser takes one; make them an axis of choices")
    search, points, outcomes = _search(record.study, plan), list[Point](), list[SweepOutcome]()
    while len(points) < plan.trials:
        count = min(plan.batch, plan.trials - len(points))
        proposals = [_propose(search, record) for _ in range(count)]
        points += [proposal.point for proposal in proposals]
        batch = Cases(tuple(case for proposal in proposals for case in proposal.cases), 0)
        outcomes.append(run(replace(record, points=tuple(points)), batch))
        _check_objectives(plan, proposals, Store(folder))
        for proposal in proposals:
            values = _search_values(record.study, plan, proposal.cases, Store(folder))
            _tell(search, proposal.trial, values)
    return outcomes


@dataclass(frozen=True)
class _Proposal:
    """A point that the sampler proposed, with its cases, one per repeat."""

    trial: "optuna.Trial"
    point: Point
    cases: tuple[Case, ...]


def _propose(search: "optuna.Study", record: StudyRecord) -> _Proposal:
    """Sample points until one is a valid experiment that satisfies constraints on fields."""
    distributions = {axis.title: _distribution(axis) for axis in record.study.axis}
    for _ in range(_MOST_PROPOSALS):
        trial = search.ask(fixed_distributions=distributions)
        point = point_of(record.study, trial.params)
        try:
            return _Proposal(trial, point, cases_of(record.study, record.base, [point]).run)
        except ConfigError as error:
            reason = str(error)
            _tell(search, trial, None)
    raise InputError(f"{reason}; found no valid point in {_MOST_PROPOSALS} proposals")


def point_of(study: Study, params: dict[str, Any]) -> Point:
    """Return the point of the design space for the parameters of an Optuna trial.

    `params` has a value for each title of an axis: a number, or the index of a level.
    """
    return tuple(
        axis.level_of(params[axis.title])
        if axis.is_continuous
        else axis.levels()[params[axis.title]]
        for axis in study.axis
    )


def _check_objectives(plan: Optimise, proposals: Sequence[_Proposal], store: Store) -> None:
    """Raise InputError if an objective is no figure of the measured cases of a batch."""
    measured = [_figures_of(case, store) for proposal in proposals for case in proposal.cases]
    known = {
        name: value
        for figures in measured
        if figures is not None
        for name, value in figures.items()
    }
    names = [objective.metric for objective in plan.objectives]
    unknown = [name for name in names if name not in {*known, *DERIVED}]
    if unknown and known:
        raise InputError(
            f"optimise.objectives: found {', '.join(unknown)}, allowed "
            + ", ".join(sorted(name for name, value in known.items() if is_number(value)))
        )


def _figures_of(case: Case, store: Store) -> dict[str, Any] | None:
    """Return the figures and derived figures of a case; None if the case failed."""
    figures = (store.read(case.digest) or {}).get("metrics")
    return None if figures is None else with_derived(case.experiment, figures)


def _search_values(
    study: Study, plan: Optimise, cases: Sequence[Case], store: Store
) -> tuple[list[float], list[float]] | None:
    """Return the objectives of a point, mean over repeats, and its excesses over limits.

    The limits are those of constraints and tolerances; each excess is the largest over the repeats.
    The sign of an objective to maximise is reversed. None if a case failed or lacks an objective.
    """
    values, excesses = [], []
    for case in cases:
        figures = _figures_of(case, store) or {}
        if not all(is_number(figures.get(objective.metric)) for objective in plan.objectives):
            return None
        values.append([cost_of(figures, objective) for objective in plan.objectives])
        excesses.append([_excess(case, figures, bound) for bound in study.constraint])
        if has_tolerances(case.experiment):
            excesses[-1].append(beyond_tolerances(figures))
    # A design is feasible if each of its repeats is feasible.
    return np.mean(values, axis=0).tolist(), np.max(excesses, axis=0).tolist()


def _excess(case: Case, figures: Mapping[str, Any], bound: Constraint) -> float:
    number = quantity(case.experiment, figures, bound)
    return np.inf if number is None else bound.excess(number)


def _tell(
    search: "optuna.Study",
    trial: "optuna.Trial",
    result: tuple[list[float], list[float]] | None,
) -> None:
    from optuna.trial import TrialState

    if result is None:
        search.tell(trial, state=TrialState.FAIL)
        return
    values, excesses = result
    for number, excess in enumerate(excesses):
        trial.set_constraint(f"constraint_{number}", excess)
    search.tell(trial, values)


def _search(study: Study, plan: Optimise) -> "optuna.Study":
    try:
        import optuna
    except ModuleNotFoundError:
        raise missing("sampling.method = 'optimise'", "Optuna", "sweep") from None
    seed = study.sampling.seed
    # constant_liar is marked experimental; without this option a batch has the same point many
    # times.
    with warnings_ignored(optuna.exceptions.ExperimentalWarning):
        samplers: dict[str, Callable[[], optuna.samplers.BaseSampler]] = {
            "tpe": lambda: optuna.samplers.TPESampler(
                seed=seed, constant_liar=True, n_startup_trials=plan.batch
            ),
            "nsga2": lambda: optuna.samplers.NSGAIISampler(
                seed=seed, population_size=max(plan.batch, 2)
            ),
            "random": lambda: optuna.samplers.RandomSampler(seed=seed),
        }
        directions, before = ["minimize"] * len(plan.objectives), optuna.logging.get_verbosity()
        optuna.logging.set_verbosity(optuna.logging.WARNING)  # it would report the new study
        try:
            return optuna.create_study(directions=directions, sampler=samplers[plan.sampler]())
        finally:
            optuna.logging.set_verbosity(before)


def _distribution(axis: Axis) -> "optuna.distributions.BaseDistribution":
    import optuna

    if not axis.is_continuous:
        return optuna.distributions.CategoricalDistribution(list(range(len(axis.levels()))))
    assert axis.low is not None  # the validator's
    assert axis.high is not None
    log = axis.scale == "log"
    if axis.integer:
        return optuna.distributions.IntDistribution(round(axis.low), round(axis.high), log=log)
    return optuna.distributions.FloatDistribution(axis.low, axis.high, log=log)
