"""Study as data: a base experiment, the axes over which it is varied, and figures of merit.

Shipped studies are in `scenes/studies`; `docs/sweeps.md` explains every key.

An axis varies one field, given by its dotted path, or several fields together between named
choices. The levels of an axis are a list of values, a range with a count, or the choices. Samplers
draw values from a range without a count, or select levels.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from reconstruction.reading import is_regular
from twin.assets import scene_file
from twin.config.base import ConfigError, Model
from twin.config.bounds import Figure
from twin.config.inputs import Input, load_inputs, require_distinct_keys, with_sources
from twin.config.loading import ABSENT, load_experiment, read_toml, resolve_uses, vary
from twin.config.methods import Method
from twin.config.models import Experiment
from twin.config.schema import validated

_ROUNDING = 1e-9  # relative rounding error of a constrained number


@dataclass(frozen=True)
class Level:
    """One level of an axis: its label in tables, and the values that it sets, by dotted path."""

    label: Any
    changes: Mapping[str, Any]


class Axis(Model):
    """One axis of a study: a field, or several fields together, and the levels or the range."""

    path: Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]+(\.[A-Za-z0-9_\-]+)*$")] | None = Field(
        default=None, description="dotted path of the field that is varied"
    )
    name: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        default=None, description="heading in tables and plots; absent: the path"
    )
    values: Annotated[tuple[Any, ...], Field(min_length=1)] | None = None
    low: Figure | None = None
    high: Figure | None = None
    count: Annotated[int, Field(ge=2, le=100_000)] | None = Field(
        default=None, description="levels between low and high, both included"
    )
    scale: Literal["linear", "log"] = "linear"
    integer: bool = Field(default=False, description="round to whole numbers")
    choices: dict[str, dict[str, Any]] | None = Field(
        default=None,
        description="named sets of tables that override those of the experiment; may `use` files",
    )
    files: str | None = Field(
        default=None,
        exclude_if=lambda pattern: pattern is None,
        description="files of a folder as values, in the order of their names: './parts/*.stl', "
        "relative to the file that states it",
    )
    source: str | None = Field(
        default=None,
        description="reason for values outside the range that a data file states",
    )

    @field_validator("values")
    @classmethod
    def _plain_values(cls, values: tuple[Any, ...] | None) -> tuple[Any, ...] | None:
        if any(isinstance(value, dict) for value in values or ()):
            raise ValueError("allowed numbers, texts and lists of numbers; use choices for tables")
        return values

    @model_validator(mode="after")
    def _one_kind_of_levels(self) -> "Axis":
        ranged = self.low is not None or self.high is not None or self.count is not None
        others = (self.values, self.choices, self.files)
        if ranged + sum(levels is not None for levels in others) != 1:
            raise ValueError("takes one of values, low and high, choices, or files")
        if self.choices is not None:
            return self._checked_choices()
        if self.path is None:
            raise ValueError("path: missing; name the field that is varied")
        if self.values is not None and len(set(map(repr, self.values))) < len(self.values):
            raise ValueError("values: found one of them twice; remove it")
        return self._checked_range() if ranged else self

    def _checked_choices(self) -> "Axis":
        if self.path is not None or not self.choices:
            raise ValueError("choices need at least one entry, and no path: each names its fields")
        if self.name is None:
            raise ValueError("name: missing; choices have no path to be used instead")
        return self

    def _checked_range(self) -> "Axis":
        if self.low is None or self.high is None:
            raise ValueError("a range needs low and high")
        if not self.low < self.high:
            raise ValueError(f"low: found {self.low:g}, allowed below high, {self.high:g}")
        if self.scale == "log" and self.low <= 0:
            raise ValueError(f"low: found {self.low:g}, allowed above 0 with scale = 'log'")
        return self

    @property
    def title(self) -> str:
        """Heading of the axis in tables and plots: the name, or else the path."""
        return self.name or str(self.path)

    @property
    def is_continuous(self) -> bool:
        """Whether the axis is a range without count, of which any value may be drawn."""
        return self.low is not None and self.count is None

    def levels(self) -> tuple[Level, ...]:
        """Return the levels of the axis; empty for a range without count."""
        if self.choices is not None:
            return tuple(Level(label, changes) for label, changes in self.choices.items())
        if self.values is not None:
            return tuple(self._level(value) for value in self.values)
        if self.count is None:
            return ()
        rounded = dict.fromkeys(self._at(u) for u in np.linspace(0.0, 1.0, self.count))
        return tuple(self._level(value) for value in rounded)

    def level_at(self, share: float) -> Level:
        """Return the level at a share (0 to 1) of the axis, which a sampler has drawn."""
        if self.is_continuous:
            return self._level(self._at(share))
        levels = self.levels()
        return levels[min(int(share * len(levels)), len(levels) - 1)]

    def level_of(self, value: float) -> Level:
        """Return the level with a given value, for an axis that is a range without count."""
        return self._level(round(value) if self.integer else value)

    def _at(self, share: float) -> float | int:
        assert self.low is not None  # the validator's
        assert self.high is not None
        if self.scale == "log":
            value = self.low * (self.high / self.low) ** float(share)
        else:
            value = self.low + (self.high - self.low) * float(share)
        # Rounded to ten digits, so that levels do not differ by rounding errors.
        return round(value) if self.integer else float(f"{value:.10g}")

    def _level(self, value: Any) -> Level:
        laid = value if self.source is None else {"value": value, "source": self.source}
        return Level(value, {str(self.path): laid})


MOST_CASES = 100_000
"""Most cases of a study, including repeats and methods: making them takes about 1 min and 2 GB."""


class Sampling(Model):
    """Method by which the points of the design space are selected."""

    method: Literal[
        "grid", "latin_hypercube", "sobol", "saltelli", "morris", "optimise", "gradient", "trials"
    ] = Field(
        default="grid",
        description="grid: every combination; latin_hypercube, sobol: `count` points that fill the "
        "space; saltelli: sobol pairs for sensitivity indices; morris: `count` elementary-effect "
        "walks; optimise: chosen from the results so far, see [optimise]; gradient: down the "
        "derivatives of a bound, see [gradient]; trials: `count` "
        "repetitions with independent draws of all [inputs], for an uncertainty",
    )
    count: Annotated[int, Field(ge=1, le=MOST_CASES)] | None = Field(
        default=None, description="points (latin_hypercube, sobol), base points, walks or trials"
    )
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    calibration: Literal["drawn", "true"] = Field(
        default="drawn", description="of trials: a simulated calibration per trial, or the true rig"
    )
    board: str = Field(
        default="boards/paper_dots", description="of trials: board of the simulated calibrations"
    )
    budget: bool = Field(
        default=True, description="of trials: also vary each input, and the noise, one at a time"
    )
    compensated: bool = Field(
        default=False,
        exclude_if=lambda compensated: not compensated,
        description="of trials: also reconstruct the object behind the coat",
    )

    @model_validator(mode="after")
    def _counted(self) -> "Sampling":
        counted = self.method not in ("grid", "optimise", "gradient")
        if counted and self.count is None:
            raise ValueError(f"count: missing; method = '{self.method}' needs it")
        if not counted and self.count is not None:
            raise ValueError(f"count: method = '{self.method}' does not take it; remove it")
        trials = self.method == "trials"
        if trials and self.count is not None and self.count < 2:
            raise ValueError(f"count: found {self.count}, allowed 2 or more trials")
        of_trials = ("calibration", "board", "budget", "compensated")
        set_here = [n for n in of_trials if getattr(self, n) != Sampling.model_fields[n].default]
        if set_here and not trials:
            raise ValueError(f"{set_here[0]}: method = '{self.method}' does not take it; remove it")
        return self


class Objective(Model):
    """Figure of the result to be minimised or maximised."""

    metric: str
    goal: Literal["minimise", "maximise"] = "minimise"


class Optimise(Model):
    """Settings of a search by Optuna, which needs the extra `sweep`."""

    objectives: Annotated[tuple[Objective, ...], Field(min_length=1)]
    trials: Annotated[int, Field(ge=1, le=100_000)]
    batch: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=8,
        description="points proposed together; results depend on it, not on the number of workers",
    )
    sampler: Literal["tpe", "nsga2", "random"] = "tpe"


class GradientSearch(Model):
    """Settings of a gradient search with the derivatives of a bound (SciPy's SLSQP)."""

    objective: Objective
    evaluations: Annotated[int, Field(ge=2, le=10_000)] = Field(
        default=40, description="largest number of cases, those of finite differences included"
    )
    starts: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1,
        description="number of starting points: the middle of the axes, then Sobol' points",
    )


class Constraint(Model):
    """Limits of a number: a field of the experiment, a metric, or the ratio of two of them.

    At least one of the lower limit `at_least` and the upper limit `at_most` must be given.
    """

    value: str = Field(description="dotted path of a number in the experiment, or a metric")
    per: str | None = Field(default=None, description="divided by this path or metric")
    at_least: Figure | None = None
    at_most: Figure | None = None

    @model_validator(mode="after")
    def _bounded(self) -> "Constraint":
        if self.at_least is None and self.at_most is None:
            raise ValueError("needs at_least or at_most")
        return self

    def holds_for(self, number: float) -> bool:
        """Return True if a number is within the limits."""
        return self.excess(number) <= 0.0

    def excess(self, number: float) -> float:
        """Return the excess of a number over the limits; 0 or less if it is within the limits.

        A relative excess up to 1e-9 counts as 0, because levels and ratios have rounding errors
        (three steps of 0.1 give 0.30000000000000004).
        """
        over = [] if self.at_most is None else [number - self.at_most]
        under = [] if self.at_least is None else [self.at_least - number]
        excess = max(over + under)
        return 0.0 if 0.0 < excess <= _ROUNDING * abs(number) else excess

    @property
    def title(self) -> str:
        """The constraint as text for reports, for example "1 <= camera.binning <= 4"."""
        name = self.value if self.per is None else f"{self.value} / {self.per}"
        low = "" if self.at_least is None else f"{self.at_least:g} <= "
        high = "" if self.at_most is None else f" <= {self.at_most:g}"
        return f"{low}{name}{high}"


class Study(Model):
    """Complete description of a study; `base` names the experiment that is varied."""

    schema_version: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_\-]*$", max_length=64)]
    description: str = ""
    base: str = Field(description="experiment file next to the study, or a shipped one")
    set: dict[str, Any] = Field(default={}, description="tables that override those of `base`")
    axis: tuple[Axis, ...] = Field(
        default=(), description="[[axis]]: 1 to 16 varied quantities; none with trials"
    )
    inputs_file: str = Field(
        default="", description="of trials: file of inputs, or a shipped one; [inputs] override it"
    )
    inputs: dict[str, Input] = Field(
        default={}, description="[inputs.NAME]: quantities that trials draw"
    )
    sampling: Sampling = Sampling()
    modalities: tuple[Method, ...] = Field(
        default=(), description="methods to compare; absent: the base's own"
    )
    repeats: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=1, description="measurements per point, with seed, seed + 1, ..."
    )
    metrics: tuple[str, ...] = Field(default=(), description="columns of the table; absent: all")
    keep: tuple[Literal["press", "capture", "points"], ...] = Field(
        default=(), description="arrays to keep per case; capture has two bytes per frame and pixel"
    )
    constraint: tuple[Constraint, ...] = ()
    objectives: tuple[Objective, ...] = Field(
        default=(), description="figures of merit of a study without a search"
    )
    optimise: Optimise | None = None
    # Excluded if None, so that digests of older records do not change.
    gradient: GradientSearch | None = Field(default=None, exclude_if=lambda plan: plan is None)

    @model_validator(mode="after")
    def _whole(self) -> "Study":
        if self.sampling.method == "trials":
            return self._checked_trials()
        if self.inputs or self.inputs_file:
            raise ValueError("inputs: only sampling.method = 'trials' draws them")
        if not 1 <= len(self.axis) <= 16:
            raise ValueError(f"axis: found {len(self.axis)}, allowed 1 to 16")
        titles = [axis.title for axis in self.axis]
        twice = sorted({title for title in titles if titles.count(title) > 1})
        if twice:
            raise ValueError(f"axis: found {', '.join(twice)} twice; give each a name of its own")
        if (self.optimise is not None) != (self.sampling.method == "optimise"):
            raise ValueError("[optimise] and sampling.method = 'optimise' need each other")
        if (self.gradient is not None) != (self.sampling.method == "gradient"):
            raise ValueError("[gradient] and sampling.method = 'gradient' need each other")
        if self.gradient is not None:
            self._check_gradient()
        if (self.optimise or self.gradient) is not None and self.objectives:
            raise ValueError(
                "objectives: not allowed with a search; set them in [optimise] or [gradient]"
            )
        if self.sampling.method == "grid":
            open_axes = [axis.title for axis in self.axis if axis.is_continuous]
            if open_axes:
                raise ValueError(f"axis {', '.join(open_axes)}: a grid needs count or values")
        return self

    def _check_gradient(self) -> None:
        if self.repeats > 1 or len(self.modalities) > 1:
            raise ValueError("a gradient search takes one method and no repeats")
        for axis in self.axis:
            if not axis.is_continuous or axis.integer:
                raise ValueError(
                    f"axis {axis.title}: a gradient search needs low and high without count, and"
                    " no whole numbers"
                )

    def _checked_trials(self) -> "Study":
        conflicts = {
            "axis": len(self.axis) > 0,
            "modalities": len(self.modalities) > 1,
            "repeats": self.repeats > 1,
            "optimise": self.optimise is not None,
            "gradient": self.gradient is not None,
        }
        for name, is_set in conflicts.items():
            if is_set:
                raise ValueError(f"{name}: sampling.method = 'trials' does not take it; remove it")
        if not self.inputs:
            raise ValueError("inputs: found none; trials need [inputs.NAME] or inputs_file")
        require_distinct_keys(self.inputs)
        return self

    @property
    def goals(self) -> tuple[Objective, ...]:
        """Objectives of the search, or of the study if it has no search."""
        if self.gradient:
            return (self.gradient.objective,)
        return self.optimise.objectives if self.optimise else self.objectives


def load_study(path: str | Path) -> tuple[Study, Experiment]:
    """Load a study and the experiment that it varies.

    Parameters
    ----------
    path : a TOML file, or the name of a shipped study ("studies/albedo_flakes")

    Raises
    ------
    ConfigError : with one line per problem: key, found, allowed, remedy
    """
    file = scene_file(path)
    tree = read_toml(file)
    study = _study_of(tree, str(path), file)
    local = file.parent / study.base
    base = load_experiment(local if is_regular(local) else study.base)
    return study, vary(base, study.set)


def _study_of(tree: dict[str, Any], where: str, file: Path) -> Study:
    study = validated(Study, with_inputs(tree, where, file), f"{where}: ")
    axes = tuple(with_files(axis, file) for axis in study.axis)
    laid = without_absent(resolve_uses(study.set, (file,)))
    return study.model_copy(update={"axis": axes, "set": laid})


def with_inputs(tree: dict[str, Any], where: str, file: Path) -> dict[str, Any]:
    """Return the tables of a study or recipe with the inputs of its `inputs_file`.

    Keys of its own inputs override those of the file.

    Parameters
    ----------
    tree : tables as read from TOML
    where : name of the study, for messages
    file : file of the study, to which names of files are relative

    Raises
    ------
    ConfigError : the inputs are invalid
    """
    own, named = with_sources(tree, where), tree.get("inputs_file")
    if not isinstance(named, str) or not named:
        return own
    local = file.parent / named
    loaded = load_inputs(local if is_regular(local) else named)
    base = {name: value.model_dump(exclude_unset=True) for name, value in loaded.inputs.items()}
    top = own.get("inputs", {})
    merged = {name: {**base.get(name, {}), **top.get(name, {})} for name in {**base, **top}}
    return own | {"inputs": merged}


def with_files(axis: Axis, file: Path) -> Axis:
    """Return the axis with the values of the files that its choices `use`, and the listed files.

    Parameters
    ----------
    file : file that states the axis, to which names of files are relative

    Raises
    ------
    ConfigError : no file has a name of the pattern `files`, or a used file is invalid
    """
    if axis.files is not None:
        return axis.model_copy(update={"values": _listed(axis.files, file), "files": None})
    if axis.choices is None:
        return axis
    read = {label: resolve_uses(tree, (file,)) for label, tree in axis.choices.items()}
    return axis.model_copy(update={"choices": read})


def _listed(pattern: str, file: Path) -> tuple[str, ...]:
    """Return the names of the files of a pattern such as "./parts/*.stl", sorted."""
    relative = PurePath(pattern)
    folder = file.parent / relative.parent
    names = sorted(str(path) for path in folder.glob(relative.name) if is_regular(path))
    if not names:
        raise ConfigError(
            f"{file}: files = '{pattern}': found no such file in {folder}; give a pattern such as "
            "'./parts/*.stl'"
        )
    return tuple(names)


def without_absent(node: Any) -> Any:
    """Return nested tables with every value "absent" replaced by None."""
    if isinstance(node, dict):
        return {key: without_absent(value) for key, value in node.items()}
    return None if node == ABSENT else node
