"""Identification of a sensor: simulate, fit emulators, sample the posterior, refine near it."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.machine import one_blas_thread
from twin.config import Experiment
from twin.config.problem import SensorProblem
from twin.config.rows import LearnedAs, Limit, Metric, Row, Statistic
from twin.identification.emulator import Emulator
from twin.identification.findings import (
    BoundCompared,
    Prediction,
    bound_compared,
    predict_rows,
)
from twin.identification.known import NEGLIGIBLE, Identified, SensorModel
from twin.identification.posterior import (
    highest_probabilities,
    likelihood_of,
    probabilities,
    sample,
)
from twin.identification.simulations import (
    Simulated,
    SimulatedFigure,
    Variant,
    refine,
    simulate,
    variant_for,
)
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.study.measuring import CaseMeasurer
from twin.study.worker import Measurer
from twin.study.workers import Workers, lasting, local_workers

_Key = tuple[Variant, Metric, Statistic, LearnedAs]
# A combination of choices, and its emulators of figures and of scatters by name of the row.
_Task = tuple[Mapping[str, str], dict[str, Emulator], dict[str, Emulator]]
_FIRST_STEPS = 2000
# Steps of the chains from which the evidence of every combination of choices is computed first;
# combinations of a negligible probability keep these chains.
_SCREENING_STEPS = 500
_IMPROBABLE = 0.01


def identify(
    problem: SensorProblem,
    experiments: Mapping[str, Experiment],
    folder: Path,
    workers: Workers,
    *,
    watch: ProgressCallback = no_progress,
    make_measurer: Callable[[tuple[str, ...]], Measurer] = CaseMeasurer,
    inputs: Iterable[Path] = (),
) -> Identified:
    """Estimate the free fields of a problem from its measured rows.

    Parameters
    ----------
    problem, experiments
        Problem and experiments as `twin.config.problem.load_problem` returns them.
    folder : Path
        Output folder; the simulations are stored in its subfolder `studies`.
    workers : Workers
        Processes that simulate; the result does not depend on their number.
    watch : called with the stage and its finished fraction, 0 to 1
    make_measurer : function that returns the measurer of cases in each worker
    inputs : files that the problem reads; InputError if `folder` is one of them or contains one

    Raises
    ------
    ConfigError
        An experiment is invalid with one of the choices, or at an end of a field's range.
    InputError
        A store of simulations cannot be used, or too few simulations contain a row's figure.
    MissingBackend
        No usable Dr.Jit backend.
    """
    run = partial(simulate, watch=watch, make_measurer=make_measurer, inputs=inputs)
    again = partial(refine, watch=watch, make_measurer=make_measurer)
    simulated = run(problem, experiments, folder, workers)
    with lasting(workers) as pool:
        if any(problem.refined(name) for name in problem.experiments):
            steps = min(_FIRST_STEPS, problem.design.longest)
            first = infer(problem, simulated, watch, pool, longest=steps)
            further = again(problem, experiments, folder, pool, _refined_places(first))
            simulated |= {v: simulated[v].with_further(more) for v, more in further.items()}
        return infer(problem, simulated, watch, pool)


def _refined_places(first: Identified) -> dict[Variant, FloatArray]:
    """Draw places (point, free field) from a first posterior, for each variant to be refined.

    A variant is refined if a row or limit needs it. This applies to fitted and held-out rows, under
    every combination of choices with a probability of at least 1 %.
    """
    problem, rng = first.problem, np.random.default_rng(first.seed)
    drawn: dict[Variant, FloatArray] = {}
    known: list[Row | Limit] = [*problem.rows.values(), *problem.limits.values()]
    for model in first.models:
        if model.probability < _IMPROBABLE:
            continue
        for measured in known:
            name = problem.experiment_of(measured, model.combination)
            variant, count = variant_for(problem, name, model.combination), problem.refined(name)
            if count and variant not in drawn:
                places = model.posterior.places  # fewer than `count` if the chains are short
                drawn[variant] = rng.choice(places, min(count, len(places)), replace=False)
    return drawn


def infer(
    problem: SensorProblem,
    simulated: Mapping[Variant, Simulated],
    watch: ProgressCallback = no_progress,
    workers: Workers | None = None,
    *,
    longest: int | None = None,
) -> Identified:
    """Return the identification from the measured rows and from simulations that are already run.

    Parameters
    ----------
    workers : processes that fit emulators and sample in parallel; the result does not depend on
        their number. Default: only this process
    longest : largest number of steps of a chain; default: `longest` of the problem's design
    """
    tasks = workers or local_workers(1)
    executor, steps = tasks.open(), longest or problem.design.longest
    try:
        return _infer(problem, simulated, watch, partial(_in_parallel, executor), steps)
    finally:
        (tasks.release or tasks.close)(executor)


_Map = Callable[..., list[Any]]


def _in_parallel(executor: Executor, function: Callable[..., Any], *arguments: Any) -> list[Any]:
    """Return the results of a function for each set of arguments, computed in parallel."""
    return list(executor.map(partial(_on_one_thread, function), *arguments))


def _on_one_thread(function: Callable[..., Any], *arguments: Any) -> Any:
    # Small matrices are slower on several threads, and the last digits depend on the number of
    # threads.
    with one_blas_thread():
        return function(*arguments)


def _infer(
    problem: SensorProblem,
    simulated: Mapping[Variant, Simulated],
    watch: ProgressCallback,
    each: _Map,
    longest: int,
) -> Identified:
    combinations = list(problem.combinations())
    watch("learning", 0.0)
    keys = list(dict.fromkeys(k for c in combinations for k in _keys(problem, c).values()))
    samples = [simulated[k[0]].sample(*k[1:]) for k in keys]
    learned = dict(zip(keys, each(SimulatedFigure.learned, samples), strict=True))
    watch("learning", 1.0)
    watch("posterior", 0.0)
    given = [_emulators(problem, combination, learned) for combination in combinations]
    tasks = [(c, *emulators) for c, emulators in zip(combinations, given, strict=True)]
    models = _sampled(problem, tasks, each, longest)
    chances = probabilities([m.posterior for m in models], [m.prior for m in models])
    weighted = [replace(m, probability=float(p)) for m, p in zip(models, chances, strict=True)]
    best, *rest = sorted(weighted, key=lambda m: -m.probability)
    watch("posterior", len(models) / (len(models) + len(problem.rotate)))
    rotated = each(partial(_rotated, problem, best, longest), problem.rotate)
    compared = list(_bounds(problem))
    bounds = each(partial(_at_bound, problem, best, longest), compared)
    by_row = dict(zip(problem.rotate, rotated, strict=True))
    best = replace(best, rotated=by_row, bounds=tuple(bounds))
    watch("posterior", 1.0)
    return Identified(problem, (best, *rest), problem.design.seed)


def _sampled(
    problem: SensorProblem, tasks: Sequence[_Task], each: _Map, longest: int
) -> list[SensorModel]:
    """Sample every combination of choices; `probability` is still NaN.

    Chains are long only where the probability may be at least `NEGLIGIBLE`.
    """
    if len(tasks) == 1 or longest <= _SCREENING_STEPS:
        return each(partial(_model, longest, problem), *zip(*tasks, strict=True))
    models = each(partial(_model, _SCREENING_STEPS, problem), *zip(*tasks, strict=True))
    highest = highest_probabilities([m.posterior for m in models], [m.prior for m in models])
    probable = [number for number, share in enumerate(highest) if share >= NEGLIGIBLE]
    further = [tasks[number] for number in probable]
    longer = each(partial(_model, longest, problem), *zip(*further, strict=True))
    for number, model in zip(probable, longer, strict=True):
        models[number] = model
    return models


def _keys(problem: SensorProblem, combination: Mapping[str, str]) -> dict[tuple[str, bool], _Key]:
    """Return the figures to be emulated, by (name of row or limit, whether it is the scatter).

    The scatter of a figure is its standard deviation over the repeats; only rows with
    `realisations` need it.
    """
    keys: dict[tuple[str, bool], _Key] = {}
    for name, row in problem.figures.items():
        variant = variant_for(problem, problem.experiment_of(row, combination), combination)
        metric = problem.metric_of(name, row, combination)
        keys[name, False] = variant, metric, row.statistic, row.learned_as
        if isinstance(row, Row) and row.realisations is not None:
            keys[name, True] = variant, metric, "sd", "log"
    return keys


def _emulators(
    problem: SensorProblem, combination: Mapping[str, str], learned: Mapping[_Key, Emulator]
) -> tuple[dict[str, Emulator], dict[str, Emulator]]:
    """Return the emulators of figures and of scatters, each by name of row or limit."""
    keys = _keys(problem, combination)
    figures = {name: learned[key] for (name, of_scatter), key in keys.items() if not of_scatter}
    return figures, {name: learned[key] for (name, scatter), key in keys.items() if scatter}


def _model(
    longest: int,
    problem: SensorProblem,
    combination: Mapping[str, str],
    emulators: Mapping[str, Emulator],
    scatters: Mapping[str, Emulator],
) -> SensorModel:
    """Sample the posterior for one combination of choices; its `probability` is still NaN."""
    seed = problem.design.seed
    every = likelihood_of(problem, problem.rows, emulators, scatters)
    fitted = likelihood_of(problem, problem.fitted, emulators, scatters)
    posterior = sample(fitted, seed, longest)
    return SensorModel(
        combination=combination,
        prior=problem.weight(combination),
        probability=np.nan,
        emulators=emulators,
        scatters=scatters,
        posterior=posterior,
        predictions=tuple(predict_rows(posterior, every, seed)),
        rotated={},
    )


def _rotated(problem: SensorProblem, best: SensorModel, longest: int, held: str) -> Prediction:
    """Predict the row `held` from the other fitted rows, without its own measured value."""
    seed = problem.design.seed
    every = likelihood_of(problem, problem.rows, best.emulators, best.scatters)
    rows = {name: row for name, row in problem.fitted.items() if name != held}
    likelihood = likelihood_of(problem, rows, best.emulators, best.scatters)
    predictions = predict_rows(sample(likelihood, seed, longest), every, seed)
    return next(prediction for prediction in predictions if prediction.row == held)


def _bounds(problem: SensorProblem) -> Iterator[tuple[str, float | None]]:
    """Yield name and bound of each limit with `compare_at`: without it, then bounds in order."""
    for name, limit in problem.limits.items():
        if limit.compare_at:
            yield name, None
            for bound in sorted({limit.value, *limit.compare_at}):
                yield name, bound


def _at_bound(
    problem: SensorProblem, best: SensorModel, longest: int, compared: tuple[str, float | None]
) -> BoundCompared:
    """Sample the posterior of the most probable model with another bound of a limit, or without."""
    name, bound = compared
    stated = problem.limits[name]
    if bound == stated.value:
        return bound_compared(name, bound, best.posterior)
    others = {n: limit for n, limit in problem.limits.items() if n != name}
    limits = others if bound is None else others | {name: stated.at(bound)}
    likelihood = replace(best.posterior.likelihood, limits=limits)
    return bound_compared(name, bound, sample(likelihood, problem.design.seed, longest))
