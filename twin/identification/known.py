"""The result of an identification: every combination of choices, its posterior and conclusions."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import counted
from twin.config.problem import SensorProblem
from twin.identification.emulator import Emulator
from twin.identification.findings import (
    LimitMet,
    Marginal,
    Prediction,
    PriorShift,
    Ridge,
    Worth,
    interval_of,
    limits_met,
    prior_shifts,
    ridges,
    undetermined,
    worth_of,
)
from twin.identification.posterior import Posterior, likelihood_of, profile
from twin.identification.presentation import fields_in_short, posterior_drawing, samples_of

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing


@dataclass(frozen=True, eq=False)
class SensorModel:
    """The sensor under one combination of choices.

    Attributes
    ----------
    combination : choice by alternative
    prior, probability : of the combination, before and after the fitted rows
    emulators : by row, of `rows` and `worth`
    scatters : of the figures over the repeats, by the rows with `realisations`
    rotated : by held-out row, its prediction when the other rows are fitted; empty except in the
        most probable model
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
    """Identified fields of a sensor, with the most probable model first."""

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
        """Draw the samples of each field with its 95 % interval: a Matplotlib figure."""
        return posterior_drawing(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return the samples (model, sample) of the free fields, as in posterior.nc."""
        return samples_of(self).to_xarray()

    @property
    def best(self) -> SensorModel:
        """The most probable model."""
        return self.models[0]

    @cached_property
    def values(self) -> FloatArray:
        """(sample, free field) over all models, in numbers proportional to their probability."""
        return mixed([model.posterior.values for model in self.models], self._weights, self.seed)

    @property
    def _weights(self) -> list[float]:
        return [model.probability for model in self.models]

    def intervals(self) -> dict[str, Marginal]:
        """Return mean, SD and 68.3 and 95 % intervals of each fitted field by name, in its unit."""
        return {n: interval_of(v) for n, v in zip(self.problem.free, self.values.T, strict=True)}

    def ridges(self) -> list[Ridge]:
        """Return the combinations of fields that the rows cannot separate, in the best model."""
        return ridges(self.best.posterior)

    def undetermined(self) -> list[str]:
        """Return the fields that the rows hardly narrow."""
        return undetermined(self.best.posterior)

    def limits(self) -> list[LimitMet]:
        """Return the probability of each limit in the most probable model."""
        return limits_met(self.best.posterior, self.seed)

    def worth(self) -> list[Worth]:
        """Return by how much each measurement of `worth` would narrow the fields."""
        candidates = likelihood_of(
            self.problem, self.problem.worth, self.best.emulators, self.best.scatters
        )
        return worth_of(self.best.posterior, candidates, self.seed)

    def prior_shifts(self) -> list[PriorShift]:
        """Return the effect of each field's prior on the conclusions."""
        best = self.best
        rows = likelihood_of(self.problem, self.problem.rows, best.emulators, best.scatters)
        posteriors = [model.posterior for model in self.models]
        return prior_shifts(posteriors, self._weights, rows, self.seed)

    def profiles(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return the profile of the likelihood by field: its values and log likelihood."""
        profiles = {}
        for number, (name, free) in enumerate(self.problem.free.items()):
            shares, heights = profile(self.best.posterior, number)
            profiles[name] = free.value(shares), heights
        return profiles


def mixed(samples: list[FloatArray], weights: list[float], seed: int) -> FloatArray:
    """Draw from the models' samples, each with its weight."""
    rng = np.random.default_rng(seed)
    count = min(len(values) for values in samples)
    shares = rng.multinomial(count, np.array(weights) / sum(weights))
    drawn = [values[rng.choice(len(values), n)] for values, n in zip(samples, shares, strict=True)]
    return np.concatenate(drawn)
