"""Repeat a measurement with randomly drawn inputs: a study of the measurement's uncertainty.

| in the folder | content |
|---|---|
| result.json | mean, standard uncertainty, coverage intervals, budget of every measurand |
| experiment.toml | the nominal experiment |
| trials.nc | inputs and figures of every trial |
| study.json, cases/, index.sqlite, ... | the store of the study, see `twin.study.store` |
"""

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from reconstruction.netcdf import write_arrays
from twin.config import ConfigError, Experiment, load_experiment, require_experiment
from twin.config.inputs import DEFAULT_INPUTS, Input, Inputs, load_inputs, usual_inputs
from twin.config.schema import explain
from twin.config.study import Study
from twin.output import EXPERIMENT_FILE, RESULT_FILE, adding, write_json
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.propagation.distribution import COVERAGE
from twin.propagation.presentation import trial_arrays
from twin.propagation.results import SOBOL_FILE, Uncertainty, effects_as_json, read_uncertainty
from twin.propagation.sensitivity import presses_of_sobol
from twin.results.names import compensates_at_once
from twin.results.parts import write_result
from twin.study.estimate import duration, estimate, estimate_line, press_seconds
from twin.study.record import StudyRecord, write_record
from twin.study.sensitivity import Effect
from twin.study.store import Store
from twin.study.sweep import sweep
from twin.study.trials import (
    ALONE,
    CALIBRATION,
    NOISE,
    PART,
    TRIALS,
    counting_for,
    drawn_board,
    nominal,
    standard_uncertainty,
)
from twin.study.workers import Workers, local_workers

COMMAND, TRIALS_FILE = "uncertainty", "trials.nc"
MOST_TRIALS = 1_000_000
_PARTS = {
    TRIALS: "trials with the nominal one",
    ALONE: "with one input varied or none, without noise",
    NOISE: "repeats that differ only in noise",
    CALIBRATION: "with another calibration of the sensor",
}
_ABSENT = 9.969209968386869e36  # default fill value of netCDF for doubles


def uncertainty(
    experiment: Experiment | Path | str,
    inputs: Inputs | Mapping[str, Input | Mapping[str, Any]] | str = DEFAULT_INPUTS,
    n: int = 100,
    *,
    folder: Path | str | None = None,
    measurands: Sequence[str] = (),
    calibration: Literal["drawn", "true"] = "drawn",
    budget: bool = True,
    seed: int | None = None,
    workers: Workers | int = 1,
    coverage: float = COVERAGE,
    watch: ProgressCallback = no_progress,
) -> Uncertainty:
    """Repeat a measurement with randomly drawn inputs; return the uncertainty of its figures.

    Parameters
    ----------
    experiment : Experiment, Path or str
        The nominal measurement: an experiment, its file, or the name of a shipped experiment.
    inputs : Inputs, mapping or str
        The varied inputs: a file, the name of a shipped file, or tables by name.
    n : number of trials, at least 2, in addition to the nominal measurement
    folder : path, optional
        Store of the trials; cases that it already contains are not measured again. Default: a
        temporary folder.
    measurands : names of figures, such as "sphere_1_radius_mm"; default: the main figures
    calibration : {"drawn", "true"}
        "drawn": each trial is triangulated with a rig drawn from the covariance of a calibration;
        for photometric stereo the trials use five calibrations in turn. "true": the true rig.
    budget : True: also measure for the ranked budget: two measurements per input (for a choice, one
        per value), in which only this input is varied, and up to 20 with new noise only. For
        photometric stereo with drawn calibrations, five more measurements recalibrate the sensor
    seed : seed of all random draws; default: the seed in the file of inputs
    workers : Workers or int
        The workers, or a number of processes on this machine.
    coverage : coverage probability of the intervals, 0 to 1
    watch : is called with the stage and its completed fraction, 0 to 1

    Raises
    ------
    InputError
        The key of an input is not a number in the experiment, or a drawn value is not allowed. Or
        the nominal measurement fails or lacks a measurand, or the folder cannot be used.
    MissingBackend
        No usable Dr.Jit backend.
    """
    base = load_experiment(experiment) if isinstance(experiment, (str, Path)) else experiment
    require_experiment(base)
    options: dict[str, Any] = {"calibration": calibration, "budget": budget, "seed": seed}
    record = record_of(base, inputs, n, measurands=measurands, **options)
    who = local_workers(workers) if isinstance(workers, int) else workers
    if folder is not None:
        sweep(record, Path(folder), who, watch=watch)
        result = read_uncertainty(Path(folder), measurands, coverage)
        write_uncertainty(Path(folder), result)
        return result
    with tempfile.TemporaryDirectory() as scratch:
        sweep(record, Path(scratch), who, watch=watch)
        return read_uncertainty(Path(scratch), measurands, coverage)


def record_of(
    experiment: Experiment,
    inputs: Inputs | Mapping[str, Input | Mapping[str, Any]] | str | Path,
    n: int,
    *,
    calibration: Literal["drawn", "true"] = "drawn",
    budget: bool = True,
    seed: int | None = None,
    compensated: bool | None = None,
    measurands: Sequence[str] = (),
) -> StudyRecord:
    """Return the study with the trials of an experiment as its cases.

    Parameters
    ----------
    n : number of trials, in addition to the nominal measurement
    measurands : names of figures that must have a value in the nominal measurement. If no name is
        given, the nominal measurement must have at least one point
    compensated : also estimate the surface of the object behind the coat in each trial. Default:
        True if the layer can be compensated, but False for a slab, where the fit takes some
        seconds

    Raises
    ------
    ConfigError
        The inputs are invalid (one line per problem), or the number of trials is not allowed.
    """
    if not 2 <= n <= MOST_TRIALS:
        raise ConfigError(f"trials: found {n}, allowed 2 to {MOST_TRIALS}")
    given = usual_inputs(experiment) if inputs == DEFAULT_INPUTS else _inputs(inputs)
    sampling = {
        "method": "trials",
        "count": n,
        "seed": given.seed if seed is None else seed,
        "calibration": calibration,
        "budget": budget,
        "compensated": compensates_at_once(experiment) if compensated is None else compensated,
    }
    study = {
        "name": "trials",
        "description": given.description,
        "base": experiment.name,
        "sampling": sampling,
        "inputs": given.inputs,
        "metrics": tuple(measurands),
    }
    return StudyRecord(_validated(Study, study), experiment)


def plan_in_words(
    record: StudyRecord, folder: Path, workers: int, sobol: int | None = None
) -> list[str]:
    """Return text lines on the planned trials: inputs, number of cases, and estimated run time.

    Parameters
    ----------
    folder : store of the trials; cases that it already contains are not measured again
    workers : number of processes
    sobol : number of base points of the Sobol' indices of the pressed face; None: no indices
    """
    experiment, cases = nominal(record.study, record.base), record.cases()
    varied = counting_for(experiment, record.study.inputs)
    lines = [f"{given.key}: {_in_words(given, experiment)}" for given in varied.values()]
    idle = [given.key for name, given in record.study.inputs.items() if name not in varied]
    if idle:
        lines.append(f"not in the experiment, ignored: {', '.join(idle)}")
    counts = Counter(case.settings[PART] for case in cases.run)
    lines.append(
        ", ".join(f"{counts[part]} {words}" for part, words in _PARTS.items() if counts[part])
    )
    board = drawn_board(record.study, record.base)
    if board:
        lines.append(f"before them a calibration of the rig on rendered poses of {board}")
    lines.append(estimate_line(estimate(record, cases, Store(folder), workers)))
    if sobol is not None:
        presses = presses_of_sobol(record.study.inputs, experiment, sobol)
        seconds = duration(presses * press_seconds(experiment))
        lines.append(f"Sobol' indices: {presses} further presses, about {seconds}")
    return lines


def _in_words(given: Input, experiment: Experiment) -> str:
    at = given.nominal_in(experiment)
    drawn = given.distribution.replace("_", " ")
    return f"{at:.5g}, standard uncertainty {standard_uncertainty(given, at):.3g} ({drawn})"


def _inputs(given: Inputs | Mapping[str, Input | Mapping[str, Any]] | str | Path) -> Inputs:
    if isinstance(given, Inputs):
        return given
    if isinstance(given, (str, Path)):
        return load_inputs(given)
    made: Inputs = _validated(Inputs, {"inputs": dict(given)})
    return made


def _validated(kind: Any, tree: Mapping[str, Any]) -> Any:
    from pydantic import ValidationError

    try:
        return kind.model_validate(tree)
    except ValidationError as error:
        raise ConfigError("\n".join(explain(error, kind))) from None


def write_uncertainty(
    folder: Path, result: Uncertainty, effects: Mapping[str, Sequence[Effect]] | None = None
) -> None:
    """Write `result.json`, `experiment.toml` and `trials.nc` into the store of the trials.

    If there are Sobol' indices, `sobol.json` is written, too. The measurands are stored in the
    study, so that a report that is drawn later shows the same measurands.

    Raises
    ------
    InputError
        The files cannot be written.
    """
    record = result.table.record
    metrics = {"metrics": tuple(result.measurands)}
    write_record(folder, replace(record, study=record.study.model_copy(update=metrics)))
    names = [RESULT_FILE, EXPERIMENT_FILE, TRIALS_FILE, *([SOBOL_FILE] if effects else [])]
    with adding(folder, *names) as made:
        write_trials(made / TRIALS_FILE, result)
        write_result(made, COMMAND, result.experiment, result.metrics())
        if effects:
            write_json(made / SOBOL_FILE, effects_as_json(result.table.record, effects))


def write_trials(path: Path, result: Uncertainty) -> None:
    """Write inputs and figures of every trial as netCDF-4, one variable (trial,) each.

    If a trial lacks a figure, the missing value of netCDF is stored.
    """
    write_arrays(path, trial_arrays(result, _ABSENT))
