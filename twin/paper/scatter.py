"""What differs when a measurement is repeated: distributions as data, draws by trial.

A draw depends on the root seed, the input's name and the trial alone: the order of inputs, other
inputs and the instrument do not change it.
"""

from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from twin.assets import scene_file
from twin.config import ConfigError, Experiment, vary
from twin.config.base import Model, NonNegative
from twin.config.digest import keyed_sequence
from twin.config.loading import read_toml
from twin.config.messages import explain
from twin.config.models import Provenance
from twin.config.quantities import check_ranges, split_quantities

Group = Literal["placement", "press", "elastomer", "optics"]


class Input(Model):
    """One quantity that differs from trial to trial."""

    group: Group = Field(description="what it belongs to; optics leave the pressed face alone")

    key: str = Field(description="dotted path in the experiment")
    distribution: Literal["normal", "uniform"]
    spread: NonNegative = Field(description="standard deviation, or half width when uniform")
    relative: bool = Field(default=False, description="spread is a share of the nominal value")
    methods: tuple[str, ...] = Field(default=(), description="modalities; empty: all")
    specimens: tuple[str, ...] = Field(default=(), description="specimen kinds; empty: all")

    def counts_for(self, experiment: Experiment) -> bool:
        """Tell whether the input can change this experiment's result."""
        return (not self.methods or experiment.modality in self.methods) and (
            not self.specimens or experiment.specimen.kind in self.specimens
        )

    def standard_uncertainty(self, nominal: float) -> float:
        """Return the standard deviation of the input around its nominal value (JCGM 100, 4.3.7)."""
        spread = self.spread * abs(nominal) if self.relative else self.spread
        return spread / np.sqrt(3.0) if self.distribution == "uniform" else spread


class Scatter(Model):
    """All inputs that a repeated measurement varies."""

    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    inputs: dict[str, Input]
    provenance: dict[str, Provenance] = Field(default_factory=dict)

    def counting_for(self, experiment: Experiment, *, optics: bool) -> dict[str, Input]:
        """Return the inputs that can change an experiment: those of its optics, or all others."""
        return {
            name: one
            for name, one in self.inputs.items()
            if one.counts_for(experiment) and (one.group == "optics") == optics
        }


@lru_cache
def load_scatter(name: str = "paper/trials") -> Scatter:
    """Load a file of spreads, or a shipped one by name.

    Raises
    ------
    ConfigError
        One line per problem.
    """
    file = scene_file(name)
    values, origins = split_quantities(read_toml(file))
    try:
        loaded = Scatter.model_validate(values | {"provenance": {}})
    except ValidationError as error:
        lines = explain(error, Scatter)
        raise ConfigError("\n".join(f"{file}: {line}" for line in lines)) from None
    check_ranges(values, origins, str(file))
    return loaded.model_copy(update={"provenance": origins})


def draw(experiment: Experiment, scatter: Scatter, trial: int) -> Experiment:
    """Return the experiment as it is in one trial; trial 0 is the nominal one.

    Raises
    ------
    ConfigError
        An input's key is not in the experiment, or a drawn value is not allowed.
    """
    return vary(experiment, drawn_values(experiment, scatter, trial)) if trial else experiment


def drawn_values(experiment: Experiment, scatter: Scatter, trial: int) -> dict[str, float]:
    """Return the drawn values by dotted path."""
    return {
        one.key: nominal_of(experiment, one.key) + _deviation(experiment, scatter, name, trial)
        for name, one in scatter.inputs.items()
        if one.counts_for(experiment)
    }


def _deviation(experiment: Experiment, scatter: Scatter, name: str, trial: int) -> float:
    one = scatter.inputs[name]
    sigma = one.standard_uncertainty(nominal_of(experiment, one.key))
    rng = np.random.default_rng(keyed_sequence(scatter.seed, f"trial {name}", trial))
    if one.distribution == "normal":
        return float(sigma * rng.standard_normal())
    return float(sigma * np.sqrt(3.0) * rng.uniform(-1.0, 1.0))


def nominal_of(experiment: Experiment, key: str) -> float:
    """Return a number of the experiment by its dotted path.

    Raises
    ------
    ConfigError
        The path does not lead to a number.
    """
    node: Any = experiment
    for part in key.split("."):
        node = getattr(node, part, None)
    if isinstance(node, bool) or not isinstance(node, (int, float)):
        raise ConfigError(
            f"inputs: {key}: found no number there in {experiment.name}; allowed a path"
        )
    return float(node)
