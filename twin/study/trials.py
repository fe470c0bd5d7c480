"""Cases of a study that repeats a measurement: trials, and variations of single inputs.

Trial 0 is the nominal measurement. In every other trial all inputs are drawn (JCGM 101, 7.3), the
camera has a new noise, and the rig is drawn from the covariance of a calibration. For the budget
each input is set to one standard uncertainty below and above its nominal value, without noise. In
addition, the nominal measurement is repeated with new noise only.

A draw depends only on the root seed, the name of the input and the number of the trial. The order
of the inputs, other inputs and the instrument do not change the draw. Inputs with the same key
`together` use the same index into their lists of values, which gives a sample of a joint
distribution.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray
from twin.config import ConfigError, Experiment, vary
from twin.config.digest import keyed_sequence
from twin.config.inputs import Input
from twin.config.loading import as_built, by_method
from twin.config.sensor_layer import SensorLayer
from twin.config.study import Study
from twin.study.cases import Case, Cases, case_of
from twin.study.measuring import Conditions
from twin.study.needed import layer_for

PART, TRIAL, INPUT, STEP = "part", "trial", "input", "step"
TRIALS, NOISE, CALIBRATION, ALONE = "trial", "noise", "calibration", "alone"
"""Kinds of cases of a study of trials, as the setting `part` states them."""

NOISE_REPEATS = 20
"""Repeats with new noise only: their standard deviation has a standard uncertainty of 16 %."""
CALIBRATIONS = 5
"""Calibrations of a photometric sensor, each by about 50 presses; trial i uses number i mod 5."""
MIDDLE, LOW, HIGH = "nominal", "low", "high"


def trial_cases(study: Study, base: Experiment) -> Cases:
    """Return the trials of a study, and the cases of its budget.

    Raises
    ------
    ConfigError : no input applies to the experiment, the key of an input is not a number of the
        experiment, or a drawn value is not allowed; the first problem is reported
    """
    experiment = nominal(study, base)
    count = study.sampling.count or 0
    if not counting_for(experiment, study.inputs):
        raise ConfigError(f"{study.name}: inputs: none of them is in {experiment.name}; add one")
    # The user does not know the sheet of a trial: all trials assume the nominal sheet.
    layer = layer_for(experiment) if study.sampling.compensated else None
    cases = list(_trials(study, experiment, layer))
    if study.sampling.budget:
        cases += alone_cases(experiment, study.inputs, layer=layer)
        cases += _repeats(experiment, min(count, NOISE_REPEATS), layer)
        if study.sampling.calibration == "drawn" and not experiment.method.fringes:
            cases += _recalibrated(experiment)
    return Cases(tuple(cases), 0)


def nominal(study: Study, base: Experiment) -> Experiment:
    """Return the experiment that a study of trials repeats: the base with the study's method."""
    return vary(base, by_method(study.modalities[0])) if study.modalities else base


def _trials(study: Study, experiment: Experiment, layer: SensorLayer | None) -> Iterator[Case]:
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
        yield case_of(settings | values, *_measured(study, drawn, Conditions(number, layer=layer)))


def _measured(
    study: Study, drawn: Experiment, conditions: Conditions
) -> tuple[Experiment, Conditions]:
    """Return experiment and conditions of a trial, changed to the trial's own calibration."""
    plan, number = study.sampling, conditions.trial
    if plan.calibration == "true" or not number:
        return drawn, conditions
    if drawn.method.fringes:
        return drawn, replace(conditions, board=plan.board, seed=plan.seed)
    # The reference presses are drawn from the root seed of the experiment.
    return vary(drawn, {"seed": drawn.seed + number % CALIBRATIONS}), conditions


def alone_cases(
    experiment: Experiment,
    inputs: Mapping[str, Input],
    *,
    face_only: bool = False,
    layer: SensorLayer | None = None,
) -> list[Case]:
    """Return the cases of the budget: the nominal case, and cases with one varied input.

    Each input is set to one standard uncertainty below and above its nominal value. An input that
    is a choice is set to each of its values. The cases have no noise and the true rig. With
    `face_only` only the coated face is evaluated, which does not depend on the optics. With a
    `layer` also the object behind the coat is reconstructed.

    Raises
    ------
    ConfigError : the key of an input is not a number of the experiment, or a value is not allowed
    """
    silent = vary(as_built(experiment), {"camera.noise": False})
    conditions = Conditions(face_only=face_only, layer=layer)
    settings: dict[str, Any] = {PART: ALONE, INPUT: "", STEP: MIDDLE}
    cases = [case_of(settings, silent, conditions)]
    for name, variable in counting_for(experiment, inputs).items():
        if face_only and variable.group == "optics":
            continue
        for step, value in _steps(variable, variable.nominal_in(experiment)).items():
            varied = vary(silent, {variable.key: value})
            settings = {PART: ALONE, INPUT: name, STEP: step, variable.key: value}
            cases.append(case_of(settings, varied, conditions))
    return cases


def _steps(variable: Input, nominal: float) -> dict[str, float]:
    if variable.distribution == "choice":
        return {f"{value:g}": value for value in variable.values}
    u = standard_uncertainty(variable, nominal)
    return {LOW: nominal - u, HIGH: nominal + u} if u else {}


def _repeats(experiment: Experiment, count: int, layer: SensorLayer | None) -> Iterator[Case]:
    for number in range(1, count + 1):
        yield case_of({PART: NOISE, TRIAL: number}, experiment, Conditions(number, layer=layer))


def _recalibrated(experiment: Experiment) -> Iterator[Case]:
    for number in range(CALIBRATIONS):
        redone = vary(experiment, {"seed": experiment.seed + number})
        yield case_of({PART: CALIBRATION, TRIAL: number}, redone)


class InputDistribution(Protocol):
    """Interface of a probability distribution; frozen distributions of `scipy.stats` have it."""

    def rvs(self, *, random_state: np.random.Generator) -> Any:
        """Return one random value."""

    def ppf(self, q: ArrayLike, /) -> Any:
        """Return the quantiles at the probabilities `q`, in the shape of `q`."""

    def std(self) -> Any:
        """Return the standard deviation."""


@dataclass(frozen=True)
class Choice:
    """Discrete distribution: `values` with the probabilities `shares`, which have the sum 1."""

    values: tuple[float, ...]
    shares: tuple[float, ...]

    def rvs(self, *, random_state: np.random.Generator) -> float:
        """Return one random value."""
        return float(random_state.choice(self.values, p=self.shares))

    def ppf(self, q: ArrayLike, /) -> FloatArray:
        """Return the quantiles (...) float at the probabilities `q` (...)."""
        ends = np.cumsum(self.shares)
        at = np.searchsorted(ends, np.asarray(q), side="left")
        return np.asarray(self.values, np.float64)[np.minimum(at, len(self.values) - 1)]

    def std(self) -> float:
        """Return the standard deviation."""
        values, shares = np.array(self.values), np.array(self.shares)
        return float(np.sqrt(shares @ (values - shares @ values) ** 2))


def deviation_of(variable: Input, nominal: float) -> InputDistribution:
    """Return the distribution of the deviation of an input from its nominal value, in its unit.

    Uniform, triangular and arcsine distributions are symmetric with the half width `spread` (JCGM
    101, 6.4.2, 6.4.5, 6.4.6). A normal distribution has the standard deviation `spread` and may be
    cut off. A student_t distribution has the scale `spread` (6.4.9). A choice has the differences
    of its values from the nominal value.
    """
    from scipy import stats  # takes 0.5 s to import, and only trials need it

    if variable.distribution == "choice":
        weights = np.array(variable.weights or [1.0] * len(variable.values))
        values = tuple(value - nominal for value in variable.values)
        return Choice(values, tuple((weights / weights.sum()).tolist()))
    spread = variable.spread_at(nominal)
    if not spread:
        return Choice((0.0,), (1.0,))
    wide: dict[str, Any] = {"loc": -spread, "scale": 2.0 * spread}
    deviation: InputDistribution
    match variable.distribution:
        case "uniform":
            deviation = stats.uniform(**wide)
        case "triangular":
            deviation = stats.triang(0.5, **wide)
        case "arcsine":
            deviation = stats.arcsine(**wide)
        case "student_t":
            deviation = stats.t(variable.degrees_of_freedom, scale=spread)
        case _:
            deviation = _normal(variable, nominal, spread)
    return deviation


def _normal(variable: Input, nominal: float, sigma: float) -> InputDistribution:
    from scipy import stats

    if variable.at_least is variable.at_most is None:
        return stats.norm(scale=sigma)  # type: ignore[no-any-return]
    low = -np.inf if variable.at_least is None else (variable.at_least - nominal) / sigma
    high = np.inf if variable.at_most is None else (variable.at_most - nominal) / sigma
    if not low < high:
        raise ConfigError(f"inputs: {variable.key}: at_least is not below at_most; exchange them")
    return stats.truncnorm(low, high, scale=sigma)  # type: ignore[no-any-return]


def standard_uncertainty(variable: Input, nominal: float) -> float:
    """Return the standard uncertainty of an input in its unit (JCGM 100, 4.3.7)."""
    return float(deviation_of(variable, nominal).std())


def counting_for(experiment: Experiment, inputs: Mapping[str, Input]) -> dict[str, Input]:
    """Return the inputs, by name, that can change the result of an experiment."""
    return {name: variable for name, variable in inputs.items() if variable.counts_for(experiment)}


def draw(experiment: Experiment, inputs: Mapping[str, Input], seed: int, trial: int) -> Experiment:
    """Return the experiment of a trial, with drawn inputs; trial 0 is the nominal experiment.

    Raises
    ------
    ConfigError : the key of an input is not in the experiment, or a drawn value is not allowed
    """
    if not trial:
        return experiment
    return vary(as_built(experiment), drawn_values(experiment, inputs, seed, trial))


def drawn_values(
    experiment: Experiment, inputs: Mapping[str, Input], seed: int, trial: int
) -> dict[str, float]:
    """Return the values of the inputs in a trial by dotted path; in trial 0 the nominal ones."""
    values = {}
    for name, variable in counting_for(experiment, inputs).items():
        values[variable.key] = nominal = variable.nominal_in(experiment)
        if trial:
            key = keyed_sequence(seed, f"trial {variable.together or name}", trial)
            rng = np.random.default_rng(key)
            deviation = deviation_of(variable, nominal).rvs(random_state=rng)
            values[variable.key] = nominal + float(deviation)
    return values


def drawn_board(study: Study, base: Experiment) -> str:
    """Return the name of the board on which the rig is calibrated, for trials that draw rigs.

    The name is empty if all trials use the true rig.
    """
    plan = study.sampling
    if plan.method != "trials" or plan.calibration == "true":
        return ""
    return plan.board if nominal(study, base).method.fringes else ""
