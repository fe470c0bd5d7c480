"""Output folder of an identification: its files and the functions that write them.

| in the folder | content |
|---|---|
| result.json | intervals of the fields, rows measured and predicted, limits, ridges, models |
| posterior.nc | samples of the fields by model |
| identified.toml | the same and joint draws of the fields, see `summary` |
| experiment.toml, experiments/NAME.toml | the experiments at the most probable values |
| studies/ | the simulations; an interrupted run is resumed from these |
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from reconstruction.netcdf import write_arrays
from reconstruction.writing import write_text
from twin.config import Experiment, to_toml, vary
from twin.config.problem import SensorProblem
from twin.config.study import without_absent
from twin.identification.findings import interval_of
from twin.identification.known import Identified
from twin.identification.presentation import samples_of
from twin.identification.simulations import variant_for
from twin.output import EXPERIMENT_FILE, RESULT_FILE
from twin.results.parts import write_result

COMMAND = "identify"
POSTERIOR_FILE, EXPERIMENTS_FOLDER = "posterior.nc", "experiments"
WRITTEN = (POSTERIOR_FILE, EXPERIMENTS_FOLDER, RESULT_FILE, EXPERIMENT_FILE)


def experiments_at_best(
    identified: Identified, experiments: Mapping[str, Experiment]
) -> dict[str, Experiment]:
    """Return the experiments, by name, with the most probable choices and field values.

    Every identified value is stored with its 95 % interval and with a source that names the fitted
    rows.

    Raises
    ------
    ConfigError
        An experiment is invalid with these choices or values.
    """
    values = identified_values(identified)
    return {
        name: _at(identified.problem, name, experiment, identified.best.combination, values)
        for name, experiment in experiments.items()
    }


def identified_values(identified: Identified) -> dict[str, dict[str, Any]]:
    """Return the most probable value of each field by name, with range and source.

    The format is that of a value in a data file: `range` is the 95 % interval, extended to contain
    the value; `source` names the fitted rows.
    """
    problem, best = identified.problem, identified.best.posterior
    at = best.likelihood.places(best.best_z[None])[0]
    source = f"identified: {problem.name}, from the rows {_fitted_names(problem)}; 95 % interval"
    values = {}
    for (name, free), share, samples in zip(problem.free.items(), at, best.values.T, strict=True):
        value, interval = _digits(float(free.value(share))), interval_of(samples)
        ends = [min(_digits(interval.low_95), value), max(_digits(interval.high_95), value)]
        values[name] = {"value": value, "range": ends, "source": source}
    return values


def _fitted_names(problem: SensorProblem) -> str:
    rows = ", ".join(problem.fitted)
    if not problem.limits:
        return rows
    return f"{rows} and the limit{'s' * (len(problem.limits) > 1)} {', '.join(problem.limits)}"


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


def figures_of(identified: Identified) -> dict[str, Any]:
    """Return all results of the identification as nested tables for `result.json`."""
    return {
        "fields": {
            name: {"path": identified.problem.free[name].path} | asdict(interval)
            for name, interval in identified.intervals().items()
        },
        "rows": {row.row: asdict(row) for row in identified.best.predictions},
        "limits": {limit.limit: asdict(limit) for limit in identified.limits()},
        "bounds": [asdict(compared) for compared in identified.best.bounds],
        "rotated": {name: asdict(row) for name, row in identified.best.rotated.items()},
        "models": [
            {
                "choices": dict(model.combination),
                "prior": model.prior,
                "probability": model.probability,
                "log_evidence": model.posterior.log_evidence,
                "log_evidence_sd": model.posterior.log_evidence_sd,
                "independent_samples": model.posterior.independent,
                "converged": model.posterior.is_converged,
            }
            for model in identified.models
        ],
        "ridges": [asdict(ridge) for ridge in identified.ridges()],
        "undetermined": identified.undetermined(),
        "priors": [asdict(shift) for shift in identified.prior_shifts()],
        "worth": [asdict(worth) for worth in identified.worth()],
        "decisions": [asdict(decision) for decision in identified.decisions],
        "emulators": {
            name: {
                "cross_validated_rmse": emulator.cross_validated_rmse,
                "missing_share": emulator.missing,
            }
            for name, emulator in identified.best.emulators.items()
        },
    }


def write_identified(
    folder: Path, identified: Identified, experiments: Mapping[str, Experiment]
) -> None:
    """Write `result.json`, `posterior.nc`, and the experiments at the most probable values."""
    best = experiments_at_best(identified, experiments)
    (folder / EXPERIMENTS_FOLDER).mkdir()
    for name, experiment in best.items():
        path = folder / EXPERIMENTS_FOLDER / f"{name}.toml"
        write_text(path, to_toml(experiment))
    write_arrays(folder / POSTERIOR_FILE, samples_of(identified))
    write_result(folder, COMMAND, next(iter(best.values())), figures_of(identified))
