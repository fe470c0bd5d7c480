"""Further measurements that decide between the choices of an alternative.

A measurement decides if its expected value differs between the choices by more than its standard
deviation and the remaining uncertainty of the fields. The measure is the expected posterior
probability of the choice that is the most probable one after the measurement: the probability that
this choice is the true one (Bayes decision; DeGroot, Optimal Statistical Decisions, 1970).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from reconstruction.arrays import FloatArray

_VALUES, _SAMPLES = 4000, 500
_IMPROBABLE = 0.001
# Silverman's bandwidth of a normal distribution, relative to its SD, times n^(1/5).
_BANDWIDTH = 1.06


@dataclass(frozen=True)
class Decision:
    """Expected result of one more measurement for one alternative.

    Attributes
    ----------
    row : name of the candidate row of `worth`
    alternative : name of the alternative
    before : probability of the most probable choice, given the fitted rows
    after : expected probability, after the measurement, of the choice that is then the most
        probable one
    """

    row: str
    alternative: str
    before: float
    after: float


def _model_probabilities(
    figures: Sequence[FloatArray], weights: Sequence[float], sd: float, seed: int
) -> FloatArray:
    """Return the probability (model, value) of every model at values that may be measured.

    The values are drawn from the models in shares of their weights. Half of the samples of a model
    give its values, the other half its density: the mean of normal densities with `sd`, widened by
    Silverman's bandwidth of the samples.

    Parameters
    ----------
    figures : samples (n,) of the measured figure under each model, in one unit
    weights : probability of each model before the measurement, above 0; their sum is 1
    sd : standard deviation of the measurement
    seed : seed of the random draws
    """
    rng = np.random.default_rng(seed)
    halves = [np.array_split(rng.permutation(samples), 2) for samples in figures]
    counts = rng.multinomial(_VALUES, weights)
    drawn = [rng.choice(half, n) for (half, _), n in zip(halves, counts, strict=True)]
    values = np.concatenate(drawn)
    values += sd * rng.standard_normal(values.size)
    logs = np.log(weights)[:, None] + [_log_density(half, sd, values) for _, half in halves]
    return np.asarray(np.exp(logs - logsumexp(logs, axis=0)))


def _log_density(known: FloatArray, sd: float, values: FloatArray) -> FloatArray:
    """Return the logarithm of the density of measured values (n,), without a common constant."""
    known = known[:_SAMPLES]
    width = float(np.hypot(sd, _BANDWIDTH * known.std() * known.size**-0.2))
    steps = (values[:, None] - known) / width
    return np.asarray(logsumexp(-0.5 * steps**2, axis=1) - np.log(width * known.size))


@dataclass(frozen=True, eq=False)
class ExpectedFigure:
    """Figure of a candidate measurement under one model.

    Attributes
    ----------
    combination : by name of the alternative, the model's choice
    probability : probability of the model, given the fitted rows
    samples : (n,) samples of the figure
    """

    combination: Mapping[str, str]
    probability: float
    samples: FloatArray


def decisions_of(
    row: str, models: Sequence[ExpectedFigure], sd: float, seed: int
) -> list[Decision]:
    """Return the expected result of one more measurement for every alternative.

    Parameters
    ----------
    row : name of the candidate row
    models : its figure under every model; models with a probability below 0.001 are left out
    sd : standard deviation of the measurement
    seed : seed of the random draws
    """
    kept = [model for model in models if model.probability >= _IMPROBABLE]
    weights = np.array([model.probability for model in kept])
    weights /= weights.sum()
    chances = _model_probabilities([m.samples for m in kept], weights.tolist(), sd, seed)
    decisions = []
    for alternative in models[0].combination:
        chosen = np.array([model.combination[alternative] for model in kept])
        of_choice = [chosen == choice for choice in np.unique(chosen)]
        before = max(float(weights[own].sum()) for own in of_choice)
        after = np.max([chances[own].sum(axis=0) for own in of_choice], axis=0)
        decisions.append(Decision(row, alternative, before, float(after.mean())))
    return decisions
