"""Sensitivity of a measurand to each input: correlations over the trials, and Sobol' indices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.config import ConfigError, Experiment, vary
from twin.config.inputs import Input
from twin.config.loading import as_built
from twin.pipeline.memory import Memory
from twin.pipeline.press import press
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.results.parts import face_figures
from twin.results.rows import is_number
from twin.study.cases import saltelli_shares
from twin.study.sensitivity import Effect, saltelli_effects
from twin.study.trials import InputDistribution, counting_for, deviation_of, standard_uncertainty


@dataclass(frozen=True)
class Correlation:
    """Correlation of an input with a measurand over the trials.

    Attributes
    ----------
    name : name of the input
    linear, rank : correlation coefficients of Pearson and of Spearman, -1 to 1
    """

    name: str
    linear: float
    rank: float


def correlation_of(name: str, inputs: ArrayLike, values: ArrayLike) -> Correlation | None:
    """Return the correlation of an input (n,) with a measurand (n,) over n trials.

    None if there are fewer than three trials, or if input or measurand is constant.
    """
    from scipy import stats  # takes 0.5 s to import, and a report without trials needs none

    x, y = np.asarray(inputs, np.float64), np.asarray(values, np.float64)
    if x.size < 3 or not np.ptp(x) or not np.ptp(y):
        return None
    linear = float(np.corrcoef(x, y)[0, 1])
    return Correlation(name, linear, float(stats.spearmanr(x, y).statistic))


def presses_of_sobol(inputs: Mapping[str, Input], experiment: Experiment, base_points: int) -> int:
    """Return the number of presses of `sobol_of_face`: base points x (inputs + 2)."""
    return base_points * (len(_of_face(inputs, experiment)) + 2)


def sobol_of_face(
    experiment: Experiment,
    inputs: Mapping[str, Input],
    measurands: Sequence[str],
    base_points: int,
    *,
    seed: int = 0,
    watch: ProgressCallback = no_progress,
) -> dict[str, list[Effect]]:
    """Return Sobol' indices of figures of the pressed face, without rendering.

    First-order and total indices are computed by `scipy.stats.sobol_indices` over the
    distributions of the inputs, with 95 % bootstrap intervals. The number of presses is base
    points x (inputs + 2) for all figures together.

    Parameters
    ----------
    inputs : varied inputs by name; inputs of the optics do not change the face and have no index
    measurands : names of figures, such as sphere_1_radius_mm, rod_width_mm, force_n,
        relief_peak_mm; figures that the face does not have are omitted
    base_points : number of base points, a power of 2, at least 2
    seed : seed of the points

    Raises
    ------
    InputError
        `base_points` is 1 or not a power of 2, or the modality has no press. Or a press fails, no
        input changes the face, or the face has none of the figures.
    """
    if base_points < 2 or base_points & (base_points - 1):
        raise InputError(f"--sobol {base_points}: allowed a power of 2, for example 64")
    if not experiment.method.presses:
        raise InputError(f"--sobol: modality = '{experiment.modality}' has no press; omit --sobol")
    counting, memory = _of_face(inputs, experiment), Memory()
    if not counting:
        raise InputError("--sobol: found no input that changes the pressed face; omit --sobol")
    nominal = [given.nominal_in(experiment) for given in counting.values()]
    dists = [deviation_of(o, at) for o, at in zip(counting.values(), nominal, strict=True)]
    columns = sobol_points(dists, base_points, seed).T
    rows: list[dict[str, Any]] = []
    for done, column in enumerate(columns):
        watch("presses", done / len(columns))
        values = (float(at + step) for at, step in zip(nominal, column, strict=True))
        keys = (given.key for given in counting.values())
        rows.append(_face(experiment, dict(zip(keys, values, strict=True)), memory))
        _require_known(measurands, rows[0])
    watch("presses", 1.0)
    return {
        name: sobol_effects([row[name] for row in rows], list(counting))
        for name in measurands
        if all(is_number(row.get(name)) for row in rows)
    }


def _face(experiment: Experiment, drawn: Mapping[str, float], memory: Memory) -> dict[str, Any]:
    try:
        case = vary(as_built(experiment), drawn)
        return face_figures(case, press(case, memory).pressed)
    except ConfigError as error:
        raise InputError(f"--sobol: {error}") from None


def _require_known(measurands: Sequence[str], figures: Mapping[str, Any]) -> None:
    numbers = sorted(name for name, value in figures.items() if is_number(value))
    if not set(numbers) & set(measurands):
        raise InputError(
            f"--sobol: {', '.join(measurands)}: no figure of the pressed face, allowed "
            f"{', '.join(numbers)}"
        )


def _of_face(inputs: Mapping[str, Input], experiment: Experiment) -> dict[str, Input]:
    """Return the inputs, by name, that change the pressed face: not those of the optics."""
    return {
        name: given
        for name, given in counting_for(experiment, inputs).items()
        if given.group != "optics" and standard_uncertainty(given, given.nominal_in(experiment)) > 0
    }


def sobol_points(
    distributions: Sequence[InputDistribution], base_points: int, seed: int
) -> FloatArray:
    """Return the points at which a model is evaluated for Sobol' indices.

    Returns
    -------
    (input, n) float, values of each input
    """
    rng = np.random.default_rng(seed)
    shares = saltelli_shares(len(distributions), base_points, rng)
    return np.array([d.ppf(column) for d, column in zip(distributions, shares.T, strict=True)])


def sobol_effects(values: ArrayLike, names: Sequence[str]) -> list[Effect]:
    """Return the Sobol' indices of each input from a figure's values (n,) at `sobol_points`."""
    return saltelli_effects(np.asarray(values, np.float64).reshape(len(names) + 2, -1), names)
