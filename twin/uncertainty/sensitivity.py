"""Which input moves a measurand: correlations over the trials, and Sobol' indices."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.config import ConfigError, Experiment, vary
from twin.config.inputs import Input
from twin.pipeline.memory import Memory
from twin.pipeline.press import press
from twin.pipeline.progress import Watcher, nobody
from twin.results.face import face_figures
from twin.study.design import saltelli_shares
from twin.study.draws import Distribution, counting_for, deviation_of, standard_uncertainty
from twin.study.sensitivity import Effect, saltelli_effects


@dataclass(frozen=True)
class Correlation:
    """How an input and a measurand go together over the trials.

    Attributes
    ----------
    name : of the input
    linear, rank : coefficients of Pearson and Spearman, -1 to 1
    """

    name: str
    linear: float
    rank: float


def correlation_of(name: str, inputs: ArrayLike, values: ArrayLike) -> Correlation | None:
    """Return the correlation of an input (n,) with a measurand (n,).

    None with fewer than three trials, or where one of both does not differ.
    """
    x, y = np.asarray(inputs, np.float64), np.asarray(values, np.float64)
    if x.size < 3 or not np.ptp(x) or not np.ptp(y):
        return None
    linear = float(np.corrcoef(x, y)[0, 1])
    return Correlation(name, linear, float(stats.spearmanr(x, y).statistic))


def presses_of_sobol(inputs: Mapping[str, Input], experiment: Experiment, base_points: int) -> int:
    """Return how many presses `sobol_of_face` costs: base points x (inputs + 2)."""
    return base_points * (len(_of_face(inputs, experiment)) + 2)


def sobol_of_face(
    experiment: Experiment,
    inputs: Mapping[str, Input],
    measurand: str,
    base_points: int,
    *,
    seed: int = 0,
    watch: Watcher = nobody,
) -> list[Effect]:
    """Return Sobol' indices of a figure of the pressed face: the cheap stage, without light.

    First order and total, by `scipy.stats.sobol_indices` over the inputs' own distributions, with
    95 % bootstrap intervals. Costs base points x (inputs + 2) presses.

    Parameters
    ----------
    experiment : Experiment
    inputs : those of the optics leave the face alone and have no index
    measurand : such as sphere_1_radius_mm, rod_width_mm, force_n, relief_peak_mm
    base_points : a power of 2

    Raises
    ------
    InputError
        `base_points` is no power of 2; a press fails or has no such figure; nothing is pressed.
    """
    if base_points < 2 or base_points & (base_points - 1):
        raise InputError(f"--sobol {base_points}: allowed a power of 2, for example 64")
    if not experiment.method.presses:
        raise InputError(f"--sobol: modality = '{experiment.modality}' presses nothing; leave it")
    counting, memory, done = _of_face(inputs, experiment), Memory(), 0
    if not counting:
        raise InputError("--sobol: found no input that moves the pressed face; leave it")
    total = base_points * (len(counting) + 2)

    def figure(deviations: FloatArray) -> float:
        nonlocal done
        steps = zip(counting.values(), deviations, strict=True)
        drawn = {one.key: one.nominal_in(experiment) + float(step) for one, step in steps}
        found = _face_figure(experiment, drawn, measurand, memory)
        done += 1
        watch("presses", done / total)
        return found

    def figures(columns: FloatArray) -> FloatArray:
        return np.array([figure(column) for column in columns.T])

    dists = [deviation_of(one, one.nominal_in(experiment)) for one in counting.values()]
    return sobol_indices(figures, dists, list(counting), base_points, seed)


def _face_figure(
    experiment: Experiment, drawn: Mapping[str, float], measurand: str, memory: Memory
) -> float:
    try:
        case = vary(experiment, drawn)
        figures = face_figures(case, press(case, memory).pressed)
    except ConfigError as error:
        raise InputError(f"--sobol: {error}") from None
    value = figures.get(measurand)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        numbers = sorted(n for n, v in figures.items() if isinstance(v, (int, float)))
        raise InputError(
            f"--sobol: {measurand}: no figure of the pressed face, allowed {', '.join(numbers)}"
        )
    return float(value)


def _of_face(inputs: Mapping[str, Input], experiment: Experiment) -> dict[str, Input]:
    """Return the inputs that move the face."""
    return {
        name: one
        for name, one in counting_for(experiment, inputs).items()
        if one.group != "optics" and standard_uncertainty(one, one.nominal_in(experiment)) > 0
    }


def sobol_indices(
    model: Callable[[FloatArray], FloatArray],
    distributions: Sequence[Distribution],
    names: Sequence[str],
    base_points: int,
    seed: int = 0,
) -> list[Effect]:
    """Return Sobol' indices of a model over independent inputs.

    Parameters
    ----------
    model : takes inputs (input, n) and returns values (n,)
    distributions : with `ppf`, as frozen ones of `scipy.stats`
    base_points : a power of 2; the model is asked for base points x (inputs + 2) values
    """
    rng = np.random.default_rng(seed)
    shares = saltelli_shares(len(distributions), base_points, rng)
    drawn = np.array([one.ppf(column) for one, column in zip(distributions, shares.T, strict=True)])
    return saltelli_effects(model(drawn).reshape(len(distributions) + 2, base_points), names)
