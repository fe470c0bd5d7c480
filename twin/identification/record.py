"""What an identification leaves in its folder.

| in the folder | content |
|---|---|
| result.json | intervals of the fields, rows measured and predicted, limits, ridges, models |
| posterior.nc | samples of the fields by model |
| identified.toml | the same and joint draws of the fields, see `summary` |
| experiment.toml, experiments/NAME.toml | the experiments at the most probable values |
| studies/ | the simulations; an interrupted run goes on from here |
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
    source = f"identified: {problem.name}, from the rows {_rests_on(problem)}; 95 % interval"
    values = {}
    for (name, free), share, samples in zip(problem.free.items(), at, best.values.T, strict=True):
        value, wide = _digits(float(free.value(share))), interval_of(samples)
        ends = [min(_digits(wide.low_95), value), max(_digits(wide.high_95), value)]
        values[name] = {"value": value, "range": ends, "source": source}
    return values


def _rests_on(problem: SensorProblem) -> str:
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


def figures_of(found: Identified) -> dict[str, Any]:
    """Return everything that was found, as for result.json; fields and rows by their names."""
    return {
        "fields": {
            name: {"path": found.problem.free[name].path} | asdict(one)
            for name, one in found.intervals().items()
        },
        "rows": {one.row: asdict(one) for one in found.best.predictions},
        "limits": {one.limit: asdict(one) for one in found.limits()},
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
        write_text(path, to_toml(one))
    write_arrays(folder / POSTERIOR_FILE, samples_of(found))
    write_result(folder, COMMAND, next(iter(best.values())), figures_of(found))
