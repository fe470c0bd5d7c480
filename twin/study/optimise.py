"""Search the design space with Optuna: ask for a batch, measure it, tell the results, go on.

Nothing of the search itself is stored. Sampler and seed are fixed, and results are told in the
order in which they were asked for, so the same study asks for the same points: run again, it finds
what it has measured already in the store and goes on from there, on any number of workers.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.errors import InputError
from reconstruction.machine import warnings_ignored
from twin.config import ConfigError
from twin.config.study import Axis, Constraint, Optimise, Study
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

_MOST_ASKED = 200  # for one point

RunCases = Callable[[StudyRecord, Cases], SweepOutcome]
"""Computes the cases that the store lacks, and keeps the record."""


def optimise(record: StudyRecord, folder: Path, run: RunCases) -> list[SweepOutcome]:
    """Search until as many points as there are trials are measured.

    Parameters
    ----------
    record : with sampling.method = "optimise"
    folder : the store
    run : computes a batch

    Raises
    ------
    InputError : optuna is not installed, an objective is no figure of the cases, or no point is a
        valid experiment that the constraints admit
    """
    plan = record.study.optimise
    if plan is None:
        raise InputError(f"{record.study.name}: has no [optimise]; use twin sweep as it is")
    if len(record.study.modalities) > 1:
        raise InputError("modalities: an optimiser takes one; make them an axis of choices")
    search, points, outcomes = _search(record.study, plan), list[Point](), list[SweepOutcome]()
    while len(points) < plan.trials:
        count = min(plan.batch, plan.trials - len(points))
        asked = [_ask(search, record) for _ in range(count)]
        points += [one.point for one in asked]
        batch = Cases(tuple(case for one in asked for case in one.cases), 0)
        outcomes.append(run(replace(record, points=tuple(points)), batch))
        _refuse_unknown(plan, asked, Store(folder))
        for one in asked:
            _tell(search, one.trial, _figures(record.study, plan, one.cases, Store(folder)))
    return outcomes


@dataclass(frozen=True)
class _Asked:
    """What the search wants to know: the figures of these cases."""

    trial: "optuna.Trial"
    point: Point
    cases: tuple[Case, ...]


def _ask(search: "optuna.Study", record: StudyRecord) -> _Asked:
    """Ask until a point is a valid experiment that the constraints on its fields admit."""
    distributions = {axis.title: _distribution(axis) for axis in record.study.axis}
    for _ in range(_MOST_ASKED):
        trial = search.ask(fixed_distributions=distributions)
        point = point_of(record.study, trial.params)
        try:
            return _Asked(trial, point, cases_of(record.study, record.base, [point]).run)
        except ConfigError as error:
            told = str(error)
            _tell(search, trial, None)
    raise InputError(f"{told}; the search found no point that may be measured in {_MOST_ASKED}")


def point_of(study: Study, params: dict[str, Any]) -> Point:
    """Return the point that a trial's parameters stand for."""
    return tuple(
        axis.level_of(params[axis.title])
        if axis.is_continuous
        else axis.levels()[params[axis.title]]
        for axis in study.axis
    )


def _refuse_unknown(plan: Optimise, asked: Sequence[_Asked], store: Store) -> None:
    """Refuse an objective that no measured case of a batch has, not even as one that is absent."""
    found = [_found(case, store) for one in asked for case in one.cases]
    known = {
        name: value for figures in found if figures is not None for name, value in figures.items()
    }
    unknown = [one.metric for one in plan.objectives if one.metric not in {*known, *DERIVED}]
    if unknown and known:
        raise InputError(
            f"optimise.objectives: found {', '.join(unknown)}, allowed "
            + ", ".join(sorted(name for name, value in known.items() if is_number(value)))
        )


def _found(case: Case, store: Store) -> dict[str, Any] | None:
    """Figures of a case and what follows from them; None when it failed."""
    found = (store.read(case.digest) or {}).get("metrics")
    return None if found is None else with_derived(case.experiment, found)


def _figures(
    study: Study, plan: Optimise, cases: Sequence[Case], store: Store
) -> tuple[list[float], list[float]] | None:
    """Objectives, the mean over repeats; excesses over constraints and tolerances, the largest.

    None where a case failed, or lacks an objective (no point was measured): no number would be
    true. Objectives that are to grow are counted negative.
    """
    values, excesses = [], []
    for case in cases:
        figures = _found(case, store) or {}
        if not all(is_number(figures.get(one.metric)) for one in plan.objectives):
            return None
        values.append([cost_of(figures, one) for one in plan.objectives])
        excesses.append([_excess(case, figures, bound) for bound in study.constraint])
        if has_tolerances(case.experiment):
            excesses[-1].append(beyond_tolerances(figures))
    # A design is feasible when each of its repeats is.
    return np.mean(values, axis=0).tolist(), np.max(excesses, axis=0).tolist()


def _excess(case: Case, figures: Mapping[str, Any], bound: Constraint) -> float:
    number = quantity(case.experiment, figures, bound)
    return np.inf if number is None else bound.excess(number)


def _tell(
    search: "optuna.Study",
    trial: "optuna.Trial",
    found: tuple[list[float], list[float]] | None,
) -> None:
    from optuna.trial import TrialState

    if found is None:
        search.tell(trial, state=TrialState.FAIL)
        return
    values, excesses = found
    for number, excess in enumerate(excesses):
        trial.set_constraint(f"constraint_{number}", excess)
    search.tell(trial, values)


def _search(study: Study, plan: Optimise) -> "optuna.Study":
    try:
        import optuna
    except ModuleNotFoundError:
        raise missing("sampling.method = 'optimise'", "Optuna", "sweep") from None
    seed = study.sampling.seed
    # constant_liar is marked experimental; without it a batch asks for one place many times.
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
