"""Inputs: quantities that differ when a measurement is repeated, with distributions, as data.

Shipped files are in `scenes/inputs`; `docs/uncertainty.md` explains every key.
"""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from twin.assets import scene_file
from twin.config.base import ConfigError, Model
from twin.config.bounds import Figure, Spread
from twin.config.loading import read_toml
from twin.config.models import Experiment
from twin.config.quantities import check_ranges, split_quantities, value_at
from twin.config.schema import validated

DEFAULT_INPUTS = "inputs/handling"

Group = Literal["placement", "press", "elastomer", "optics"]


class Input(Model):
    """One quantity that differs from trial to trial, with its distribution.

    The distribution "choice" draws from given values. All other distributions are centred on the
    nominal value, that of the experiment.
    """

    group: Group = Field(
        description="group of the uncertainty budget; optics do not change the pressed face"
    )
    key: str = Field(description="dotted path of a number in the experiment")
    distribution: Literal["normal", "uniform", "triangular", "arcsine", "student_t", "choice"]
    spread: Spread | None = Field(
        default=None,
        description="standard deviation of normal; scale of student_t; half width of the others",
    )
    relative: bool = Field(default=False, description="spread is a share of the nominal value")
    at_least: Figure | None = Field(default=None, description="normal is cut off below this value")
    at_most: Figure | None = Field(default=None, description="normal is cut off above this value")
    degrees_of_freedom: Annotated[float, Field(gt=2, le=1e6)] | None = Field(
        default=None, description="of student_t"
    )
    values: tuple[Figure, ...] = Field(default=(), description="values that choice draws from")
    weights: tuple[Spread, ...] = Field(default=(), description="default: all alike")
    together: str = Field(
        default="",
        description="of choice: inputs with the same name draw the same index of `values`",
    )
    methods: tuple[str, ...] = Field(default=(), description="modalities; empty: all")
    specimens: tuple[str, ...] = Field(default=(), description="specimen kinds; empty: all")
    optional: bool = Field(
        default=False, description="omit the input if the experiment has no such number"
    )
    source: str = Field(default="", description="origin of the spread")

    @model_validator(mode="after")
    def _whole(self) -> "Input":
        kind = self.distribution
        if (self.spread is None) != (kind == "choice"):
            raise ValueError("spread: required by every distribution except choice")
        if (self.degrees_of_freedom is None) == (kind == "student_t"):
            raise ValueError("degrees_of_freedom: required by student_t, not allowed otherwise")
        if kind != "normal" and not self.at_least is self.at_most is None:
            raise ValueError("at_least, at_most: only normal is cut off")
        if kind != "choice" and (self.values or self.weights or self.together):
            raise ValueError("values, weights, together: only choice has them")
        if kind == "choice" and len(set(self.values)) < 2:
            raise ValueError("values: a choice needs at least two different ones")
        if self.weights and (len(self.weights) != len(self.values) or not sum(self.weights)):
            raise ValueError("weights: give one per value, not all 0")
        return self

    def counts_for(self, experiment: Experiment) -> bool:
        """Return True if the input can change the result of an experiment."""
        return (
            (not self.methods or experiment.modality in self.methods)
            and (not self.specimens or experiment.specimen.kind in self.specimens)
            and not (self.optional and number_at(experiment, self.key) is None)
        )

    def spread_at(self, nominal: float) -> float:
        """Return the spread in the unit of the key, for a nominal value; 0 for a choice."""
        return (self.spread or 0.0) * (abs(nominal) if self.relative else 1.0)

    def nominal_in(self, experiment: Experiment) -> float:
        """Return the nominal value of the input in an experiment, in the unit of its key.

        Raises
        ------
        ConfigError : there is no number at the key in the experiment
        """
        number = number_at(experiment, self.key)
        if number is None:
            raise ConfigError(
                f"inputs: {self.key}: found no number there in {experiment.name}; give the dotted "
                "path of one (twin keys lists them), or set optional = true"
            )
        return number


class Inputs(Model):
    """All inputs that differ when a measurement is repeated."""

    description: str = ""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    inputs: dict[str, Input]

    @model_validator(mode="after")
    def _keys_differ(self) -> "Inputs":
        require_distinct_keys(self.inputs)
        return self


def require_distinct_keys(inputs: Mapping[str, Input]) -> None:
    """Raise ValueError if two inputs have the same key, or joint inputs have unequal lists.

    Joint inputs have the same `together`; their lists of values must have equal lengths.
    """
    lists = {(drawn.together, len(drawn.values)) for drawn in inputs.values() if drawn.together}
    if len(lists) > len({name for name, _ in lists}):
        raise ValueError("inputs: found unequal numbers of values drawn together; add the missing")
    name_of: dict[tuple[Any, ...], str] = {}
    for name, drawn in inputs.items():
        mark = (drawn.key, drawn.methods, drawn.specimens)
        if mark in name_of:
            raise ValueError(
                f"inputs: {name} and {name_of[mark]} both draw {drawn.key}; remove one"
            )
        name_of[mark] = name


@lru_cache
def load_inputs(name: str | Path = DEFAULT_INPUTS) -> Inputs:
    """Load inputs from a file, or shipped inputs by their name.

    Raises
    ------
    ConfigError : one line per problem
    """
    file = scene_file(name)
    tree = with_sources(read_toml(file), str(file))
    return validated(Inputs, tree, f"{file}: ")


def usual_inputs(experiment: Experiment) -> Inputs:
    """Return `inputs/handling`, with the standard uncertainties that [sigma] of an experiment has.

    An input with the key `elastomer.NAME` or `press.NAME` has that of `sigma.NAME`, if it is given.
    """
    usual, stated = load_inputs(), experiment.sigma.model_dump(exclude_none=True)
    own = {f"{table}.{name}": u for table in ("elastomer", "press") for name, u in stated.items()}
    changes = {
        name: given.model_copy(
            update={"spread": own[given.key], "relative": False, "source": "[sigma]"}
        )
        for name, given in usual.inputs.items()
        if given.key in own
    }
    return usual.model_copy(update={"inputs": usual.inputs | changes}) if changes else usual


def with_sources(tree: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the tables of a file of inputs, with each quantity in [inputs.NAME] as a plain number.

    A quantity is a table with value, range and source, such as `spread`. Its source is stored in
    the key `source` of the input, unless the input has that key.

    Parameters
    ----------
    tree : tables as read from TOML
    where : name of the file, for messages

    Raises
    ------
    ConfigError : a quantity has no source, or its value is outside its stated range
    """
    inputs = tree.get("inputs")
    if not isinstance(inputs, dict):
        return tree
    values, origins = split_quantities({"inputs": inputs})
    check_ranges(values, origins, where)
    for path, origin in origins.items():
        _, name, *_ = path.split(".")
        values["inputs"][name].setdefault("source", origin.source)
    return tree | values


def number_at(experiment: Experiment, key: str) -> float | None:
    """Return the number at a dotted path of an experiment; None if there is no number."""
    node = value_at(experiment, key)
    if isinstance(node, bool) or not isinstance(node, (int, float)):
        return None
    return float(node)
