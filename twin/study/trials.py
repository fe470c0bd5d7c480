"""Cases of a study that repeats a measurement: trials, and what each input does alone.

Trial 0 is the nominal measurement. In every other trial all inputs are drawn anew (JCGM 101, 7.3),
the camera's noise is new, and the rig is as one calibration found it. For the budget each input is
set to one standard uncertainty below and above its nominal value, without noise, and the nominal
measurement is repeated with new noise alone.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from twin.config import ConfigError, Experiment, vary
from twin.config.inputs import Input
from twin.config.study import Study
from twin.study.cases import Case, Cases, case_of
from twin.study.draws import counting_for, draw, drawn_values, standard_uncertainty
from twin.study.measuring import Conditions

PART, TRIAL, INPUT, STEP = "part", "trial", "input", "step"
TRIALS, NOISE, CALIBRATION, ALONE = "trial", "noise", "calibration", "alone"
"""Parts of a study of trials."""

NOISE_REPEATS = 20
"""Their standard deviation is then known to 16 % (one standard uncertainty)."""
CALIBRATIONS = 5
"""Of a photometric sensor: each takes some fifty reference presses, and trials take turns."""
MIDDLE, LOW, HIGH = "nominal", "low", "high"


def trial_cases(study: Study, base: Experiment) -> Cases:
    """Return the trials of a study, and the cases of its budget.

    Raises
    ------
    ConfigError
        A key leads to no number, or a drawn value is not allowed: the first of each.
    """
    experiment = nominal(study, base)
    count = study.sampling.count or 0
    if not counting_for(experiment, study.inputs):
        raise ConfigError(f"{study.name}: inputs: none of them is in {experiment.name}; add one")
    found = list(_trials(study, experiment))
    if study.sampling.budget:
        found += alone_cases(experiment, study.inputs)
        found += _repeats(experiment, min(count, NOISE_REPEATS))
        if study.sampling.calibration == "drawn" and not experiment.method.fringes:
            found += _recalibrated(experiment)
    return Cases(tuple(found), 0)


def nominal(study: Study, base: Experiment) -> Experiment:
    """Return what a study of trials repeats: its base, by the method that it names."""
    return vary(base, {"modality": study.modalities[0]}) if study.modalities else base


def _trials(study: Study, experiment: Experiment) -> Iterator[Case]:
    plan, inputs = study.sampling, study.inputs
    for number in range((plan.count or 0) + 1):
        try:
            drawn = draw(experiment, inputs, plan.seed, number)
        except ConfigError as error:
            raise ConfigError(
                f"{error} (drawn in trial {number}; use a smaller spread, or cut the distribution "
                "off with at_least or at_most)"
            ) from None
        settings = {PART: TRIALS, TRIAL: number}
        values = drawn_values(experiment, inputs, plan.seed, number)
        yield case_of(settings | values, *_measured(study, drawn, number))


def _measured(study: Study, drawn: Experiment, number: int) -> tuple[Experiment, Conditions]:
    """Return experiment and conditions of a trial, with its calibration."""
    plan = study.sampling
    if plan.calibration == "true" or not number:
        return drawn, Conditions(number)
    if drawn.method.fringes:
        return drawn, Conditions(number, plan.board, plan.seed)
    # The reference presses are drawn from the root seed of the experiment.
    return vary(drawn, {"seed": drawn.seed + number % CALIBRATIONS}), Conditions(number)


def alone_cases(
    experiment: Experiment, inputs: Mapping[str, Input], *, face_only: bool = False
) -> list[Case]:
    """Return each input's cases below and above its nominal value, and the nominal one.

    A choice among values is set to each of them. No noise, true rig; with `face_only` the face
    alone, which the optics leave alone.

    Raises
    ------
    ConfigError
        A key leads to no number, or such a value is not allowed.
    """
    silent = vary(experiment, {"camera.noise": False})
    conditions = Conditions(face_only=face_only)
    settings: dict[str, Any] = {PART: ALONE, INPUT: "", STEP: MIDDLE}
    found = [case_of(settings, silent, conditions)]
    for name, one in counting_for(experiment, inputs).items():
        if face_only and one.group == "optics":
            continue
        for step, value in _steps(one, one.nominal_in(experiment)).items():
            varied = vary(silent, {one.key: value})
            settings = {PART: ALONE, INPUT: name, STEP: step, one.key: value}
            found.append(case_of(settings, varied, conditions))
    return found


def _steps(one: Input, nominal: float) -> dict[str, float]:
    if one.distribution == "choice":
        return {f"{value:g}": value for value in one.values}
    u = standard_uncertainty(one, nominal)
    return {LOW: nominal - u, HIGH: nominal + u} if u else {}


def _repeats(experiment: Experiment, count: int) -> Iterator[Case]:
    for number in range(1, count + 1):
        yield case_of({PART: NOISE, TRIAL: number}, experiment, Conditions(number))


def _recalibrated(experiment: Experiment) -> Iterator[Case]:
    for number in range(CALIBRATIONS):
        redone = vary(experiment, {"seed": experiment.seed + number})
        yield case_of({PART: CALIBRATION, TRIAL: number}, redone)
