"""Result of an identification: the posterior of the fields for every combination of choices."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import counted
from twin.config.problem import SensorProblem
from twin.identification.decisions import Decision, ExpectedFigure, decisions_of
from twin.identification.emulator import Emulator
from twin.identification.findings import (
    BoundCompared,
    LimitMet,
    Marginal,
    Prediction,
    PriorShift,
    Ridge,
    Worth,
    draw_rows,
    interval_of,
    limits_met,
    prior_shifts,
    ridges,
    undetermined,
    worth_of,
)
from twin.identification.posterior import Likelihood, Posterior, likelihood_of, profile
from twin.identification.presentation import fields_in_short, posterior_drawing, samples_of

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing


NEGLIGIBLE = 1e-4
"""Probability of a combination of choices below which its chains are short."""


@dataclass(frozen=True, eq=False)
class SensorModel:
    """Model of the sensor for one combination of choices, with the posterior of its free fields.

    Attributes
    ----------
    combination : by name of the alternative, the name of the choice
    prior, probability : probability of the combination before and after the rows are fitted
    emulators : by name of the row or limit, the emulator of its figure; also for the rows of
        `worth`
    scatters : by name of each row with `realisations`, the emulator of the figure's standard
        deviation over the repeats
    posterior : samples of the free fields given the fitted rows and limits
    predictions : prediction of every row, fitted or held out
    rotated : by name of the row, its prediction when this row is held out and the other rows are
        fitted; empty except in the most probable model
    bounds : the fields with other bounds of the limits (`compare_at`), without each limit, and
        as stated; empty except in the most probable model
    """

    combination: Mapping[str, str]
    prior: float
    probability: float
    emulators: Mapping[str, Emulator]
    scatters: Mapping[str, Emulator]
    posterior: Posterior
    predictions: tuple[Prediction, ...]
    rotated: Mapping[str, Prediction]
    bounds: tuple[BoundCompared, ...] = ()


@dataclass(frozen=True, eq=False)
class Identified:
    """Identified fields of a sensor: one model per combination of choices, the most probable first.

    Attributes
    ----------
    problem : the unknown fields, rows, limits and choices
    models : posterior and predictions for each combination of choices
    seed : seed of all random draws
    """

    problem: SensorProblem
    models: tuple[SensorModel, ...]
    seed: int

    def __repr__(self) -> str:
        count = counted(len(self.models), "model")
        fields = ", ".join(f"{n} {value}" for n, value in fields_in_short(self).items())
        rows = counted(len(self.problem.fitted), "row")
        return f"<Identified: {self.problem.name}, {count}, {rows} fitted, {fields}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        probability = f"{100 * self.best.probability:.3g} %"
        choices = ", ".join(self.best.combination.values())
        best = {f"most probable model {choices}".rstrip(): probability}
        return as_html(self.problem.name, fields_in_short(self) | best, self.plot())

    def plot(self) -> "Drawing":
        """Draw the samples of each field with its 95 % interval into a Matplotlib figure."""
        return posterior_drawing(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return the samples (model, sample) of each free field, as in `posterior.nc`."""
        return samples_of(self).to_xarray()

    @property
    def probable(self) -> tuple[SensorModel, ...]:
        """Models of a probability of at least `NEGLIGIBLE`, the most probable first."""
        return tuple(model for model in self.models if model.probability >= NEGLIGIBLE)

    @property
    def best(self) -> SensorModel:
        """Model of the most probable combination of choices."""
        return self.models[0]

    @cached_property
    def values(self) -> FloatArray:
        """Samples (sample, free field) of all models, with shares equal to their probability."""
        return mixed([model.posterior.values for model in self.models], self._weights, self.seed)

    @property
    def _weights(self) -> list[float]:
        return [model.probability for model in self.models]

    def intervals(self) -> dict[str, Marginal]:
        """Return mean, SD, 68.3 % and 95 % interval of each free field by name, in its unit."""
        return {n: interval_of(v) for n, v in zip(self.problem.free, self.values.T, strict=True)}

    def ridges(self) -> list[Ridge]:
        """Return the combinations of fields that the rows cannot separate, in the best model."""
        return ridges(self.best.posterior)

    def undetermined(self) -> list[str]:
        """Return the names of fields with a posterior variance over 50 % of the prior's.

        The most probable model is used.
        """
        return undetermined(self.best.posterior)

    def limits(self) -> list[LimitMet]:
        """Return the probability that each limit is met, in the most probable model."""
        return limits_met(self.best.posterior, self.seed)

    def worth(self) -> list[Worth]:
        """Return the expected reduction of the fields' variances by each row of `worth`."""
        return worth_of(self.best.posterior, _candidates(self.problem, self.best), self.seed)

    @cached_property
    def decisions(self) -> tuple[Decision, ...]:
        """How well each row of `worth` decides each alternative, the best first."""
        if not self.problem.worth:
            return ()
        models = self.models
        drawn = [draw_rows(m.posterior, _candidates(self.problem, m), self.seed) for m in models]
        decisions: list[Decision] = []
        for number, (name, row) in enumerate(self.problem.worth.items()):
            figures = [
                ExpectedFigure(model.combination, model.probability, samples[:, number])
                for model, samples in zip(models, drawn, strict=True)
            ]
            decisions += decisions_of(name, figures, row.sd, self.seed + 1)
        return tuple(sorted(decisions, key=lambda decision: decision.before - decision.after))

    def prior_shifts(self) -> list[PriorShift]:
        """Return the change of the conclusions when the prior of each field is tilted."""
        best = self.best
        rows = likelihood_of(self.problem, self.problem.rows, best.emulators, best.scatters)
        posteriors = [model.posterior for model in self.models]
        return prior_shifts(posteriors, self._weights, rows, self.seed)

    def profiles(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return the profile likelihood of each field: values in the field's unit, log likelihood.

        The log likelihood is relative to its maximum; the most probable model is used.
        """
        profiles = {}
        for number, (name, free) in enumerate(self.problem.free.items()):
            shares, heights = profile(self.best.posterior, number)
            profiles[name] = free.value(shares), heights
        return profiles


def _candidates(problem: SensorProblem, model: SensorModel) -> Likelihood:
    """Return the likelihood of the rows of `worth` under one combination of choices."""
    return likelihood_of(problem, problem.worth, model.emulators, model.scatters)


def mixed(samples: list[FloatArray], weights: list[float], seed: int) -> FloatArray:
    """Draw samples (sample, free field) from several models, in shares given by their weights.

    There are as many as the model with the largest weight has.
    """
    rng = np.random.default_rng(seed)
    count = len(samples[int(np.argmax(weights))])
    shares = rng.multinomial(count, np.array(weights) / sum(weights))
    drawn = [values[rng.choice(len(values), n)] for values, n in zip(samples, shares, strict=True)]
    return np.concatenate(drawn)
