"""Identification problem as data: unknown fields of a sensor, and measured figures.

`twin identify` estimates the values of the free (unknown) fields from the measured rows. A row is
one measured figure. Shipped problems are in `scenes`; `docs/identify.md` explains every key.
"""

import itertools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import Field, model_validator
from scipy.special import ndtr, ndtri

from reconstruction.arrays import FloatArray
from reconstruction.reading import is_regular
from twin.assets import scene_file
from twin.config.axis import Axis
from twin.config.base import Model
from twin.config.bounds import Figure, FigureSigma
from twin.config.loading import ABSENT, load_experiment, read_toml, resolve_uses, vary
from twin.config.models import Experiment
from twin.config.rows import Limit, Metric, Name, Row
from twin.config.schema import validated
from twin.config.study import without_absent

LONGEST_CHAIN, _QUICK_STEPS = 8000, 2000
MOST_FREE, MOST_COMBINATIONS = 12, 64
DottedPath = Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]+(\.[A-Za-z0-9_\-]+)*$")]


class Free(Model):
    """Free field: a field of the experiments with an unknown value, and the prior of the value."""

    path: DottedPath = Field(description="dotted path of the field")
    low: Figure
    high: Figure
    scale: Literal["linear", "log"] = "linear"
    prior: Literal["uniform", "normal"] = Field(
        default="uniform", description="density over the scale, cut at low and high"
    )
    mean: Figure | None = Field(default=None, description="of a normal prior, in the field's unit")
    sd: FigureSigma | None = Field(
        default=None, description="of a normal prior: the field's unit, with scale = 'log' relative"
    )
    experiments: tuple[Name, ...] = Field(
        default=(), description="experiments with this field; absent: all"
    )
    among: Annotated[tuple[Figure, ...], Field(min_length=3, max_length=1000)] | None = Field(
        default=None,
        description="values for which every simulation computes its figures, in metrics named "
        "with {NAME} of this field; the field needs no additional simulations",
    )
    source: str | None = Field(default=None, description="origin of range and prior")

    @model_validator(mode="after")
    def _whole(self) -> "Free":
        if not self.low < self.high:
            raise ValueError(f"low: found {self.low:g}, allowed below high, {self.high:g}")
        if self.scale == "log" and self.low <= 0:
            raise ValueError(f"low: found {self.low:g}, allowed above 0 with scale = 'log'")
        outside = [value for value in self.among or () if not self.low <= value <= self.high]
        if outside:
            raise ValueError(f"among: found {outside[0]:g}, allowed {self.low:g} to {self.high:g}")
        stated = (self.mean is not None, self.sd is not None)
        if stated != ((self.prior == "normal"),) * 2:
            raise ValueError("mean and sd: needed with prior = 'normal', not allowed with uniform")
        if self.mean is not None and not self.low <= self.mean <= self.high:
            raise ValueError(f"mean: found {self.mean:g}, allowed {self.low:g} to {self.high:g}")
        return self

    def axis(self, name: str) -> Axis:
        """Return the field as an axis of a study, with the given name."""
        return Axis(
            path=self.path,
            name=name,
            low=self.low,
            high=self.high,
            scale=self.scale,
            source=self.source,
        )

    def place(self, probability: FloatArray) -> FloatArray:
        """Return the shares (0 to 1) of the axis at cumulative probabilities of the prior."""
        if self.mean is None or self.sd is None:
            return np.asarray(probability, dtype=np.float64)
        middle, width = self.share(self.mean), self._width(self.sd)
        below, within = ndtr(-middle / width), ndtr((1.0 - middle) / width)
        share = middle + width * ndtri(below + probability * (within - below))
        return np.asarray(np.clip(share, 0.0, 1.0))

    def value(self, share: FloatArray) -> FloatArray:
        """Return the values of the field, in its unit, at shares (0 to 1) of the axis."""
        if self.scale == "log":
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)

    def share(self, value: float) -> float:
        """Return the share (0 to 1) of the axis at a value of the field."""
        if self.scale == "log":
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)

    def _width(self, sd: float) -> float:
        if self.scale == "log":
            return sd / float(np.log(self.high / self.low))
        return sd / (self.high - self.low)


class SensorChoice(Model):
    """One choice of an alternative: the fields that it sets, and metrics that it replaces."""

    set: dict[str, Any] = Field(
        default={}, description="tables that override those of the experiments"
    )
    metrics: dict[Name, Metric] = Field(
        default={}, description="metric by row, instead of the row's own"
    )
    parts: dict[Name, str] = Field(
        default={}, description="text that replaces {NAME} in the metrics of all rows, by NAME"
    )
    instead: dict[Name, Name] = Field(
        default={}, description="replaced experiment = replacement, for the rows measured in it"
    )
    weight: FigureSigma = Field(
        default=1.0, description="prior probability over the other choices'"
    )

    @property
    def instead_named(self) -> dict[str, tuple[str, ...]]:
        """All names of experiments in `instead`, under the key "instead"; empty without names."""
        return {"instead": (*self.instead, *self.instead.values())} if self.instead else {}


class Alternative(Model):
    """Discrete unknown: one of several choices is true, for the named experiments or for all."""

    choices: Annotated[dict[Name, SensorChoice], Field(min_length=2)]
    experiments: tuple[Name, ...] = Field(
        default=(), description="experiments to which `set` applies; absent: all"
    )
    source: str | None = None

    @model_validator(mode="after")
    def _each_choice_has_the_same_parts(self) -> "Alternative":
        first, *others = ((label, {*choice.parts}) for label, choice in self.choices.items())
        for label, parts in others:
            if parts != first[1]:
                raise ValueError(f"{label}.parts: the names must be those of {first[0]}.parts")
        return self


class Nuisance(Model):
    """Nuisance parameter: an error common to several rows, as that of a scale or an artefact."""

    sd: FigureSigma = Field(description="standard deviation; its mean is 0")
    source: str | None = None


class Setup(Model):
    """Experiment in which rows were measured, with the numbers of its simulations."""

    base: str = Field(description="experiment file next to the problem, or a shipped one")
    set: dict[str, Any] = Field(default={}, description="tables that override those of `base`")
    count: Annotated[int, Field(ge=8, le=100_000)] | None = Field(
        default=None, description="simulations; absent: design.count"
    )
    repeats: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1, description="measurements per simulation, each with a new draw of coat and noise"
    )
    refine: Annotated[int, Field(ge=0, le=100_000)] | None = Field(
        default=None,
        description="simulations at draws of a first posterior; absent: design.refine",
    )


class Design(Model):
    """Number of simulations to which emulators are fitted, and length of the Markov chains."""

    count: Annotated[int, Field(ge=8, le=100_000)] = Field(
        default=128, description="Sobol' points per experiment and choice"
    )
    refine: Annotated[int, Field(ge=0, le=100_000)] = Field(
        default=0,
        description="additional points per experiment and choice, drawn from the posterior of an "
        "emulator that is trained with the first points",
    )
    longest: Annotated[int, Field(ge=1000, le=1_000_000)] = Field(
        default=LONGEST_CHAIN,
        description="largest number of steps of the Markov chain that samples the posterior",
    )
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0


class SensorProblem(Model):
    """Complete description of an identification problem."""

    schema_version: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_\-]*$", max_length=64)]
    description: str = ""
    experiments: Annotated[dict[Name, Setup], Field(min_length=1)]
    free: Annotated[dict[Name, Free], Field(min_length=1, max_length=MOST_FREE)]
    alternatives: dict[Name, Alternative] = Field(default={})
    nuisance: dict[Name, Nuisance] = Field(default={})
    rows: Annotated[dict[Name, Row], Field(min_length=1)]
    limits: dict[Name, Limit] = Field(
        default={}, description="one-sided bounds on figures; always fitted"
    )
    design: Design = Design()
    rotate: tuple[Name, ...] = Field(
        default=(), description="fitted rows that are held out in turn, one at a time"
    )
    worth: dict[Name, Row] = Field(
        default={},
        description="possible measurements, to be ranked by information; `value` is not used",
    )

    @model_validator(mode="after")
    def _scatter_needs_repeats(self) -> "SensorProblem":
        for name, row in {**self.rows, **self.worth}.items():
            setup = self.experiments.get(row.experiment)
            needs = row.needs_repeats
            if needs and setup is not None and setup.repeats < 2:
                raise ValueError(
                    f"rows.{name}: {needs} needs experiments.{row.experiment}.repeats of 2 or more"
                )
        return self

    @model_validator(mode="after")
    def _references_exist(self) -> "SensorProblem":
        _named("free", {n: f.experiments for n, f in self.free.items()}, self.experiments)
        _named(
            "alternatives",
            {n: a.experiments for n, a in self.alternatives.items()},
            self.experiments,
        )
        for rows, where in ((self.rows, "rows"), (self.worth, "worth")):
            _named(where, {n: (row.experiment,) for n, row in rows.items()}, self.experiments)
            _named(where, {n: tuple(row.nuisance) for n, row in rows.items()}, self.nuisance)
        _named("rotate", {"": self.rotate}, self.fitted)
        _named(
            "limits", {n: (limit.experiment,) for n, limit in self.limits.items()}, self.experiments
        )
        _each_name_once({"rows": self.rows, "worth": self.worth, "limits": self.limits})
        for name, alternative in self.alternatives.items():
            known = set(self.figures)
            for label, choice in alternative.choices.items():
                where = f"alternatives.{name}.{label}"
                _named(where, choice.instead_named, self.experiments)
            metrics = {n: tuple(c.metrics) for n, c in alternative.choices.items()}
            _named(f"alternatives.{name}", metrics, known)
        if not self.fitted:
            raise ValueError("rows: found all of them held_out; at least one must be fitted")
        if len(list(self.combinations())) > MOST_COMBINATIONS:
            raise ValueError(f"alternatives: allowed up to {MOST_COMBINATIONS} combinations")
        return self

    @property
    def fitted(self) -> dict[str, Row]:
        """Rows, by name, from which the free fields are estimated."""
        return {name: row for name, row in self.rows.items() if not row.held_out}

    @property
    def figures(self) -> dict[str, Row | Limit]:
        """Figures, by name, to be emulated: rows, limits and possible measurements."""
        return {**self.rows, **self.worth, **self.limits}

    def quick(self) -> "SensorProblem":
        """Return the problem with 25 % of the simulations and 50 % of the repeats.

        At least 12 simulations and 2 repeats remain if there are as many. Simulations are not
        refined, and chains are shorter.
        """
        setups = {name: _quicker(setup) for name, setup in self.experiments.items()}
        design = _quicker(self.design).model_copy(update={"longest": _QUICK_STEPS})
        return self.model_copy(update={"design": design, "experiments": setups})

    def refined(self, experiment: str) -> int:
        """Return the number of simulations of an experiment at points from a first posterior."""
        own = self.experiments[experiment].refine
        return self.design.refine if own is None else own

    def combinations(self) -> Iterator[dict[str, str]]:
        """Yield every combination: one choice for each alternative, by the alternative's name."""
        names = list(self.alternatives)
        for chosen in itertools.product(*(self.alternatives[name].choices for name in names)):
            yield dict(zip(names, chosen, strict=True))

    def weight(self, combination: Mapping[str, str]) -> float:
        """Return the prior probability of a combination of choices."""
        shares = [
            unknown.choices[combination[name]].weight
            / sum(choice.weight for choice in unknown.choices.values())
            for name, unknown in self.alternatives.items()
        ]
        return float(np.prod(shares))

    def experiment_of(self, row: Row | Limit, combination: Mapping[str, str]) -> str:
        """Return the name of the experiment in which a row was measured, under given choices."""
        replaced = [self.alternatives[n].choices[c].instead for n, c in combination.items()]
        return next(
            (names[row.experiment] for names in replaced if row.experiment in names),
            row.experiment,
        )

    def metric_of(self, name: str, row: Row | Limit, combination: Mapping[str, str]) -> Metric:
        """Return the name or names of a row's figure, under given choices."""
        chosen = [self.alternatives[a].choices[c] for a, c in combination.items()]
        metric = next((c.metrics[name] for c in chosen if name in c.metrics), row.metric)
        parts = {key: text for choice in chosen for key, text in choice.parts.items()}
        if isinstance(metric, str):
            return _with_parts(metric, parts)
        return tuple(_with_parts(part, parts) for part in metric)

    def free_in(self, experiment: str) -> list[str]:
        """Return the names of the free fields that an experiment has."""
        return [n for n, f in self.free.items() if not f.experiments or experiment in f.experiments]

    def simulated_in(self, experiment: str) -> list[str]:
        """Return the names of the free fields that the simulations of an experiment vary."""
        return [name for name in self.free_in(experiment) if self.free[name].among is None]


def _with_parts(metric: str, parts: Mapping[str, str]) -> str:
    """Return a metric's name with every {NAME} of `parts` replaced by its text."""
    for name, text in parts.items():
        metric = metric.replace(f"{{{name}}}", text)
    return metric


_Counted = TypeVar("_Counted", Setup, Design)


def _quicker(counted: _Counted) -> _Counted:
    """Return an experiment or a design with the smaller counts of a quick run."""
    fewer: dict[str, int | None] = {"refine": 0, "count": _fewer(counted.count, 12, 4)}
    if isinstance(counted, Setup):
        fewer["repeats"] = _fewer(counted.repeats, 2, 2)
    return counted.model_copy(update=fewer)


def _fewer(count: int | None, least: int, share: int) -> int | None:
    """Return count / share, rounded down, but at least the smaller of `least` and `count`.

    None if `count` is None.
    """
    return None if count is None else max(min(count, least), count // share)


def _named(where: str, used: Mapping[str, tuple[str, ...]], known: Any) -> None:
    for name, words in used.items():
        for word in words:
            if word not in known:
                at = f"{where}.{name}" if name else where
                raise ValueError(f"{at}: found {word!r}, allowed {', '.join(known) or 'none'}")


def _each_name_once(tables: Mapping[str, Mapping[str, Any]]) -> None:
    table_of: dict[str, str] = {}
    for where, names in tables.items():
        for name in names:
            if name in table_of:
                raise ValueError(
                    f"{where}.{name}: {table_of[name]} has this name, too; use another"
                )
            table_of[name] = where


def load_problem(path: str | Path) -> tuple[SensorProblem, dict[str, Experiment]]:
    """Load a problem, and its experiments by their names in the problem.

    A problem may `use` another one: its keys override those of the used problem, and the value
    "absent" removes a row, a choice or another entry.

    Parameters
    ----------
    path : a TOML file, or the name of a shipped problem

    Raises
    ------
    ConfigError : with one line per problem: key, found, allowed, remedy
    """
    file = scene_file(path)
    problem = validated(SensorProblem, _with_used_problem(read_toml(file), file), f"{path}: ")
    experiments = {name: _experiment(setup, file) for name, setup in problem.experiments.items()}
    return _with_files(problem, file), experiments


def _with_used_problem(tree: dict[str, Any], file: Path) -> dict[str, Any]:
    return _without_removed(resolve_uses(tree, (file,))) if "use" in tree else tree


def _without_removed(tree: dict[str, Any]) -> dict[str, Any]:
    """Return tables without the keys set to "absent"; not in `set`, where it is a value."""
    return {
        key: _without_removed(node) if isinstance(node, dict) and key != "set" else node
        for key, node in tree.items()
        if node != ABSENT
    }


def _experiment(setup: Setup, file: Path) -> Experiment:
    local = file.parent / setup.base
    base = load_experiment(local if is_regular(local) else setup.base)
    return vary(base, without_absent(resolve_uses(setup.set, (file,))))


def _with_files(problem: SensorProblem, file: Path) -> SensorProblem:
    """Return the problem with the files that choices `use` replaced by the values in the files."""
    alternatives = {}
    for name, alternative in problem.alternatives.items():
        choices = {
            label: choice.model_copy(update={"set": resolve_uses(choice.set, (file,))})
            for label, choice in alternative.choices.items()
        }
        alternatives[name] = alternative.model_copy(update={"choices": choices})
    return problem.model_copy(update={"alternatives": alternatives})
