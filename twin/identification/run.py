"""Identify: simulate, learn, sample, and say what is known, what is not, and what would decide it.

| in the folder | content |
|---|---|
| result.json | intervals of the fields, rows measured and predicted, ridges, models |
| posterior.nc | samples of the fields by model |
| identified.toml | the same and joint draws of the fields, see `summary` |
| experiment.toml, experiments/NAME.toml | the experiments at the most probable values |
| studies/ | the simulations; an interrupted run goes on from here |
"""

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from reconstruction.arrays import FloatArray
from reconstruction.machine import write_dataset
from twin.config import Experiment, to_toml, vary
from twin.config.problem import LearnedAs, Metric, SensorProblem, Statistic
from twin.config.study import without_absent
from twin.identification.emulator import Emulator
from twin.identification.findings import (
    Marginal,
    Prediction,
    PriorShift,
    Ridge,
    Worth,
    interval_of,
    predict_rows,
    prior_shifts,
    ridges,
    undetermined,
    worth_of,
)
from twin.identification.posterior import (
    LONGEST,
    Posterior,
    likelihood_of,
    probabilities,
    profile,
    sample,
)
from twin.identification.simulations import (
    Sample,
    Simulated,
    Variant,
    refine,
    simulate,
    variant_for,
)
from twin.output import EXPERIMENT_FILE, RESULT_FILE
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.parts import write_result
from twin.study.measuring import CaseMeasurer
from twin.study.worker import Measurer
from twin.study.workers import Workers, lasting, local_workers

if TYPE_CHECKING:
    import xarray

_Key = tuple[Variant, Metric, Statistic, LearnedAs]
COMMAND = "identify"
_FIRST_STEPS = 2000
_IMPROBABLE = 0.01
POSTERIOR_FILE, EXPERIMENTS_FOLDER = "posterior.nc", "experiments"
WRITTEN = (POSTERIOR_FILE, EXPERIMENTS_FOLDER, RESULT_FILE, EXPERIMENT_FILE)


@dataclass(frozen=True, eq=False)
class SensorModel:
    """The sensor under one combination of choices.

    Attributes
    ----------
    combination : choice by alternative
    prior, probability : of the combination, before and after the fitted rows
    emulators : by row, of `rows` and `worth`
    scatters : of the figures over the repeats, by the rows with `realisations`
    rotated : by held-out row, its prediction when the other rows are fitted; of the most probable
        model alone
    """

    combination: Mapping[str, str]
    prior: float
    probability: float
    emulators: Mapping[str, Emulator]
    scatters: Mapping[str, Emulator]
    posterior: Posterior
    predictions: tuple[Prediction, ...]
    rotated: Mapping[str, Prediction]


@dataclass(frozen=True, eq=False)
class Identified:
    """What is known of a sensor; models with the most probable first."""

    problem: SensorProblem
    models: tuple[SensorModel, ...]
    seed: int

    @property
    def best(self) -> SensorModel:
        """The most probable model."""
        return self.models[0]

    @cached_property
    def values(self) -> FloatArray:
        """(sample, free field) over all models, each with its share of the samples."""
        return mixed([one.posterior.values for one in self.models], self._weights, self.seed)

    @property
    def _weights(self) -> list[float]:
        return [one.probability for one in self.models]

    def intervals(self) -> dict[str, Marginal]:
        """Return the intervals of the free fields, in their own units, by name."""
        return {n: interval_of(v) for n, v in zip(self.problem.free, self.values.T, strict=True)}

    def ridges(self) -> list[Ridge]:
        """Return what the most probable model's rows cannot take apart."""
        return ridges(self.best.posterior)

    def undetermined(self) -> list[str]:
        """Return the fields of which the rows say little."""
        return undetermined(self.best.posterior)

    def worth(self) -> list[Worth]:
        """Return what each measurement of `worth` would decide."""
        candidates = likelihood_of(
            self.problem, self.problem.worth, self.best.emulators, self.best.scatters
        )
        return worth_of(self.best.posterior, candidates, self.seed)

    def prior_shifts(self) -> list[PriorShift]:
        """Return what each field's prior does to the conclusions."""
        best = self.best
        rows = likelihood_of(self.problem, self.problem.rows, best.emulators, best.scatters)
        posteriors = [one.posterior for one in self.models]
        return prior_shifts(posteriors, self._weights, rows, self.seed)

    def profiles(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return the profile of the likelihood by field: its values and log likelihood."""
        found = {}
        for number, (name, free) in enumerate(self.problem.free.items()):
            shares, heights = profile(self.best.posterior, number)
            found[name] = free.value(shares), heights
        return found


def mixed(samples: list[FloatArray], weights: list[float], seed: int) -> FloatArray:
    """Draw from the models' samples, each with its weight."""
    rng = np.random.default_rng(seed)
    count = min(len(one) for one in samples)
    shares = rng.multinomial(count, np.array(weights) / sum(weights))
    drawn = [one[rng.choice(len(one), n)] for one, n in zip(samples, shares, strict=True)]
    return np.concatenate(drawn)


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
    """Find what the rows say of the free fields.

    Parameters
    ----------
    problem, experiments
        As from `twin.config.problem.load_problem`.
    folder : Path
        Where the simulations are kept, below `studies`.
    workers : Workers
        Processes that simulate; the result is the same with any number.

    Raises
    ------
    ConfigError
        A choice, or an end of a field's range, does not fit an experiment.
    InputError
        A store cannot be used, or too few simulations gave a row's figure.
    MissingBackend
        No usable Dr.Jit backend.
    """
    run = partial(simulate, watch=watch, make_measurer=make_measurer, inputs=inputs)
    again = partial(refine, watch=watch, make_measurer=make_measurer)
    found = run(problem, experiments, folder, workers)
    with lasting(workers) as kept:
        if any(problem.refined(name) for name in problem.experiments):
            first = infer(problem, found, watch, kept, longest=_FIRST_STEPS)
            further = again(problem, experiments, folder, kept, _places_again(first))
            found |= {one: found[one].with_further(more) for one, more in further.items()}
        return infer(problem, found, watch, kept)


def _places_again(first: Identified) -> dict[Variant, FloatArray]:
    """Draw places (point, free field) from what the rows leave, by the variants that matter.

    Those have rows, fitted or not, under the choices of which none is less probable than 1 %.
    """
    problem, rng = first.problem, np.random.default_rng(first.seed)
    drawn: dict[Variant, FloatArray] = {}
    for model in first.models:
        if model.probability < _IMPROBABLE:
            continue
        for row in problem.rows.values():
            name = problem.experiment_of(row, model.combination)
            variant, count = variant_for(problem, name, model.combination), problem.refined(name)
            if count and variant not in drawn:
                drawn[variant] = rng.choice(model.posterior.places, count, replace=False)
    return drawn


def infer(
    problem: SensorProblem,
    simulated: Mapping[Variant, Simulated],
    watch: ProgressCallback = no_progress,
    workers: Workers | None = None,
    *,
    longest: int = LONGEST,
) -> Identified:
    """Return what the rows say, given the simulations.

    Parameters
    ----------
    workers : learn and sample side by side; the result is the same with any. Default: this process
    longest : most steps of a chain
    """
    tasks = workers or local_workers(1)
    executor = tasks.open()
    try:
        return _infer(problem, simulated, watch, partial(_side_by_side, executor), longest)
    finally:
        (tasks.release or tasks.close)(executor)


_Map = Callable[..., list[Any]]


def _side_by_side(executor: Executor, function: Callable[..., Any], *arguments: Any) -> list[Any]:
    """Return a function of each of some arguments."""
    return list(executor.map(partial(_on_one_thread, function), *arguments))


def _on_one_thread(function: Callable[..., Any], *arguments: Any) -> Any:
    # Matrices this small are slower on several threads, whose number would show in last digits.
    with threadpool_limits(1):
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
    learned = dict(zip(keys, each(Sample.learned, samples), strict=True))
    watch("learning", 1.0)
    watch("posterior", 0.0)
    given = [_emulators(problem, combination, learned) for combination in combinations]
    model = partial(_model, longest, problem)
    models = each(model, combinations, *zip(*given, strict=True))
    found = probabilities([one.posterior for one in models], [one.prior for one in models])
    judged = [replace(m, probability=float(p)) for m, p in zip(models, found, strict=True)]
    best, *others = sorted(judged, key=lambda one: -one.probability)
    watch("posterior", len(models) / (len(models) + len(problem.rotate)))
    rotated = each(partial(_rotated, problem, best, longest), problem.rotate)
    best = replace(best, rotated=dict(zip(problem.rotate, rotated, strict=True)))
    watch("posterior", 1.0)
    return Identified(problem, (best, *others), problem.design.seed)


def _keys(problem: SensorProblem, combination: Mapping[str, str]) -> dict[tuple[str, bool], _Key]:
    """Return what must be learned: each row's figure, and the scatter of those that have one."""
    keys: dict[tuple[str, bool], _Key] = {}
    for name, row in {**problem.rows, **problem.worth}.items():
        variant = variant_for(problem, problem.experiment_of(row, combination), combination)
        metric = problem.metric_of(name, row, combination)
        keys[name, False] = variant, metric, row.statistic, row.learned_as
        if row.realisations is not None:
            keys[name, True] = variant, metric, "sd", "log"
    return keys


def _emulators(
    problem: SensorProblem, combination: Mapping[str, str], learned: Mapping[_Key, Emulator]
) -> tuple[dict[str, Emulator], dict[str, Emulator]]:
    """Return the emulators of all rows' figures, and of the scatter where a row has one."""
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
    """Return a model whose probability among the others is still to be judged."""
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
    """Predict a row of `rotate` from the other fitted rows."""
    seed = problem.design.seed
    every = likelihood_of(problem, problem.rows, best.emulators, best.scatters)
    rows = {name: row for name, row in problem.fitted.items() if name != held}
    likelihood = likelihood_of(problem, rows, best.emulators, best.scatters)
    found = predict_rows(sample(likelihood, seed, longest), every, seed)
    return next(one for one in found if one.row == held)


def experiments_at_best(
    found: Identified, experiments: Mapping[str, Experiment]
) -> dict[str, Experiment]:
    """Return the experiments with the most probable choices and values.

    Every value states that it is identified, its 95 % interval, and the rows that it rests on.

    Raises
    ------
    ConfigError
        The values do not fit an experiment.
    """
    values = identified_values(found)
    return {
        name: _at(found.problem, name, one, found.best.combination, values)
        for name, one in experiments.items()
    }


def identified_values(found: Identified) -> dict[str, dict[str, Any]]:
    """Return the most probable values of the fields by name, as data files state them."""
    problem, best = found.problem, found.best.posterior
    at = best.likelihood.places(best.best_z[None])[0]
    source = f"identified: {problem.name}, from the rows {', '.join(problem.fitted)}; 95 % interval"
    values = {}
    for (name, free), share, samples in zip(problem.free.items(), at, best.values.T, strict=True):
        value, wide = _digits(float(free.value(share))), interval_of(samples)
        ends = [min(_digits(wide.low_95), value), max(_digits(wide.high_95), value)]
        values[name] = {"value": value, "range": ends, "source": source}
    return values


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


def _at(
    problem: SensorProblem,
    name: str,
    base: Experiment,
    combination: Mapping[str, str],
    values: Mapping[str, Mapping[str, Any]],
) -> Experiment:
    for alternative, choice in variant_for(problem, name, combination).choices:
        base = vary(base, without_absent(problem.alternatives[alternative].choices[choice].set))
    return vary(base, {problem.free[n].path: dict(values[n]) for n in problem.free_in(name)})


def figures_of(found: Identified) -> dict[str, Any]:
    """Return everything that was found, as for result.json; fields and rows by their names."""
    return {
        "fields": {
            name: {"path": found.problem.free[name].path} | asdict(one)
            for name, one in found.intervals().items()
        },
        "rows": {one.row: asdict(one) for one in found.best.predictions},
        "rotated": {name: asdict(one) for name, one in found.best.rotated.items()},
        "models": [
            {
                "choices": dict(one.combination),
                "prior": one.prior,
                "probability": one.probability,
                "log_evidence": one.posterior.log_evidence,
                "log_evidence_sd": one.posterior.log_evidence_sd,
                "independent_samples": one.posterior.independent,
                "converged": one.posterior.is_converged,
            }
            for one in found.models
        ],
        "ridges": [asdict(one) for one in found.ridges()],
        "undetermined": found.undetermined(),
        "priors": [asdict(one) for one in found.prior_shifts()],
        "worth": [asdict(one) for one in found.worth()],
        "emulators": {
            name: {"cross_validated_rmse": one.cross_validated_rmse, "missing_share": one.missing}
            for name, one in found.best.emulators.items()
        },
    }


def write_identified(
    folder: Path, found: Identified, experiments: Mapping[str, Experiment]
) -> None:
    """Write what was found, the samples, and the experiments at the most probable values."""
    best = experiments_at_best(found, experiments)
    (folder / EXPERIMENTS_FOLDER).mkdir()
    for name, one in best.items():
        path = folder / EXPERIMENTS_FOLDER / f"{name}.toml"
        path.write_text(to_toml(one), encoding="utf-8")
    write_dataset(folder / POSTERIOR_FILE, samples_of(found))
    write_result(folder, COMMAND, next(iter(best.values())), figures_of(found))


def samples_of(found: Identified) -> "xarray.Dataset":
    """Return the samples of the free fields by model, in the fields' own units."""
    import xarray

    count = min(len(one.posterior.z) for one in found.models)
    dims = ("model", "sample")
    by_model = np.stack([one.posterior.values[-count:] for one in found.models])
    variables = {
        name: (dims, by_model[:, :, i], {"long_name": free.path})
        for i, (name, free) in enumerate(found.problem.free.items())
    }
    names = [", ".join(one.combination.values()) or "only" for one in found.models]
    weights = [one.probability for one in found.models]
    probability = ("model", weights, {"units": "1", "long_name": "probability given the rows"})
    return xarray.Dataset(variables | {"probability": probability}, coords={"model": names})
