"""An identification problem as data: what is not known of a sensor, and what was measured with it.

`twin identify` finds which values of the free fields agree with the measured rows. Shipped ones lie
in `scenes`; `docs/identify.md` explains every key.
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
from twin.config.base import Model
from twin.config.bounds import Figure, FigureSigma
from twin.config.loading import load_experiment, read_toml, resolve_uses, vary
from twin.config.models import Experiment
from twin.config.rows import Limit, Metric, Name, Row
from twin.config.schema import validated
from twin.config.study import Axis, without_absent

LONGEST_CHAIN, _QUICK_STEPS = 8000, 2000
MOST_FREE, MOST_COMBINATIONS = 12, 64
DottedPath = Annotated[str, Field(pattern=r"^[A-Za-z0-9_\-]+(\.[A-Za-z0-9_\-]+)*$")]


class Free(Model):
    """A field of the experiments whose value is not known, and what is believed of it."""

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
    experiments: tuple[Name, ...] = Field(default=(), description="where it applies; absent: all")
    among: Annotated[tuple[Figure, ...], Field(min_length=3, max_length=1000)] | None = Field(
        default=None,
        description="values at which every simulation gives its figures, in metrics named with "
        "{NAME} of this field: it costs no simulation",
    )
    source: str | None = Field(default=None, description="where range and prior come from")

    @model_validator(mode="after")
    def _whole(self) -> "Free":
        if not self.low < self.high:
            raise ValueError(f"low: found {self.low:g}, allowed below high, {self.high:g}")
        if self.scale == "log" and self.low <= 0:
            raise ValueError(f"low: found {self.low:g}, allowed above 0 with scale = 'log'")
        outside = [one for one in self.among or () if not self.low <= one <= self.high]
        if outside:
            raise ValueError(f"among: found {outside[0]:g}, allowed {self.low:g} to {self.high:g}")
        stated = (self.mean is not None, self.sd is not None)
        if stated != ((self.prior == "normal"),) * 2:
            raise ValueError("mean and sd: needed with prior = 'normal', not allowed with uniform")
        if self.mean is not None and not self.low <= self.mean <= self.high:
            raise ValueError(f"mean: found {self.mean:g}, allowed {self.low:g} to {self.high:g}")
        return self

    def axis(self, name: str) -> Axis:
        """Return the field as an axis of a study."""
        return Axis(
            path=self.path,
            name=name,
            low=self.low,
            high=self.high,
            scale=self.scale,
            source=self.source,
        )

    def place(self, probability: FloatArray) -> FloatArray:
        """Return shares (0 to 1) of the axis at cumulative prior probabilities."""
        if self.mean is None or self.sd is None:
            return np.asarray(probability, dtype=np.float64)
        middle, width = self.share(self.mean), self._width(self.sd)
        below, within = ndtr(-middle / width), ndtr((1.0 - middle) / width)
        share = middle + width * ndtri(below + probability * (within - below))
        return np.asarray(np.clip(share, 0.0, 1.0))

    def value(self, share: FloatArray) -> FloatArray:
        """Return the field's values at shares (0 to 1) of the axis."""
        if self.scale == "log":
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)

    def share(self, value: float) -> float:
        """Return the share (0 to 1) of the axis at which a value lies."""
        if self.scale == "log":
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)

    def _width(self, sd: float) -> float:
        if self.scale == "log":
            return sd / float(np.log(self.high / self.low))
        return sd / (self.high - self.low)


class SensorChoice(Model):
    """One way in which something can have been: other fields, or other figures for the rows."""

    set: dict[str, Any] = Field(default={}, description="tables laid over the experiments")
    metrics: dict[Name, Metric] = Field(
        default={}, description="metric by row, in place of its own"
    )
    instead: dict[Name, Name] = Field(
        default={}, description="experiment in place of another, for the rows measured in that"
    )
    weight: FigureSigma = Field(
        default=1.0, description="prior probability over the other choices'"
    )

    @property
    def instead_named(self) -> dict[str, tuple[str, ...]]:
        """Names of experiments, by where they stand."""
        return {"instead": (*self.instead, *self.instead.values())} if self.instead else {}


class Alternative(Model):
    """A discrete unknown: one of several choices holds, for all experiments that it names."""

    choices: Annotated[dict[Name, SensorChoice], Field(min_length=2)]
    experiments: tuple[Name, ...] = Field(
        default=(), description="where `set` applies; absent: all"
    )
    source: str | None = None


class Nuisance(Model):
    """An error common to several rows that is not asked for: a scale, the size of an artefact."""

    sd: FigureSigma = Field(description="standard deviation; its mean is 0")
    source: str | None = None


class Setup(Model):
    """An experiment in which rows were measured."""

    base: str = Field(description="experiment file beside the problem, or a shipped experiment")
    set: dict[str, Any] = Field(default={}, description="tables laid over it")
    count: Annotated[int, Field(ge=8, le=100_000)] | None = Field(
        default=None, description="simulations; absent: design.count"
    )
    repeats: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1, description="measurements per simulation, each of another coat and noise"
    )
    refine: Annotated[int, Field(ge=0, le=100_000)] | None = Field(
        default=None,
        description="simulations at draws of a first posterior; absent: design.refine",
    )


class Design(Model):
    """How many simulations the emulator learns from."""

    count: Annotated[int, Field(ge=8, le=100_000)] = Field(
        default=128, description="Sobol' points per experiment and choice"
    )
    refine: Annotated[int, Field(ge=0, le=100_000)] = Field(
        default=0,
        description="further points per experiment and choice, drawn from what the rows leave when "
        "the figures are learned from the first ones",
    )
    longest: Annotated[int, Field(ge=1000, le=1_000_000)] = Field(
        default=LONGEST_CHAIN, description="most steps of a Markov chain that samples the posterior"
    )
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0


class SensorProblem(Model):
    """An identification problem, whole."""

    schema_version: Literal[1] = 1
    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_\-]*$", max_length=64)]
    description: str = ""
    experiments: Annotated[dict[Name, Setup], Field(min_length=1)]
    free: Annotated[dict[Name, Free], Field(min_length=1, max_length=MOST_FREE)]
    alternatives: dict[Name, Alternative] = Field(default={})
    nuisance: dict[Name, Nuisance] = Field(default={})
    rows: Annotated[dict[Name, Row], Field(min_length=1)]
    limits: dict[Name, Limit] = Field(
        default={}, description="what is known of a figure from one side alone; always fitted"
    )
    design: Design = Design()
    rotate: tuple[Name, ...] = Field(
        default=(), description="fitted rows that are held out in turn, one at a time"
    )
    worth: dict[Name, Row] = Field(
        default={},
        description="measurements that could be made: what would each decide? `value` is not used",
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
    def _refers_to_what_is_there(self) -> "SensorProblem":
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
        _named("limits", {n: (one.experiment,) for n, one in self.limits.items()}, self.experiments)
        _each_name_once({"rows": self.rows, "worth": self.worth, "limits": self.limits})
        for name, one in self.alternatives.items():
            known = set(self.figures)
            for label, choice in one.choices.items():
                where = f"alternatives.{name}.{label}"
                _named(where, choice.instead_named, self.experiments)
            _named(
                f"alternatives.{name}", {n: tuple(c.metrics) for n, c in one.choices.items()}, known
            )
        if not self.fitted:
            raise ValueError("rows: found all of them held_out; at least one must be fitted")
        if len(list(self.combinations())) > MOST_COMBINATIONS:
            raise ValueError(f"alternatives: allowed up to {MOST_COMBINATIONS} combinations")
        return self

    @property
    def fitted(self) -> dict[str, Row]:
        """Rows that are fitted."""
        return {name: row for name, row in self.rows.items() if not row.held_out}

    @property
    def figures(self) -> dict[str, Row | Limit]:
        """Everything that is learned: rows, limits, and what could be measured."""
        return {**self.rows, **self.worth, **self.limits}

    def quick(self) -> "SensorProblem":
        """Return the problem with a quarter of the simulations and half of the repeats.

        Where there are so many, 12 simulations and 2 repeats stay; none is refined.
        """
        setups = {name: _quicker(one) for name, one in self.experiments.items()}
        design = _quicker(self.design).model_copy(update={"longest": _QUICK_STEPS})
        return self.model_copy(update={"design": design, "experiments": setups})

    def refined(self, experiment: str) -> int:
        """Return how many simulations of an experiment are drawn from a first posterior."""
        own = self.experiments[experiment].refine
        return self.design.refine if own is None else own

    def combinations(self) -> Iterator[dict[str, str]]:
        """Yield one choice per alternative, in all ways."""
        names = list(self.alternatives)
        for chosen in itertools.product(*(self.alternatives[name].choices for name in names)):
            yield dict(zip(names, chosen, strict=True))

    def weight(self, combination: Mapping[str, str]) -> float:
        """Return the prior probability of a combination."""
        shares = [
            one.choices[combination[name]].weight / sum(c.weight for c in one.choices.values())
            for name, one in self.alternatives.items()
        ]
        return float(np.prod(shares))

    def experiment_of(self, row: Row | Limit, combination: Mapping[str, str]) -> str:
        """Return the experiment in which a row was measured if a combination of choices holds."""
        chosen = [self.alternatives[name].choices[one].instead for name, one in combination.items()]
        return next(
            (one[row.experiment] for one in chosen if row.experiment in one), row.experiment
        )

    def metric_of(self, name: str, row: Row | Limit, combination: Mapping[str, str]) -> Metric:
        """Return the figure behind a row if a combination of choices holds."""
        for alternative, choice in combination.items():
            other = self.alternatives[alternative].choices[choice].metrics.get(name)
            if other is not None:
                return other
        return row.metric

    def free_in(self, experiment: str) -> list[str]:
        """Return the names of the free fields that an experiment has."""
        return [n for n, f in self.free.items() if not f.experiments or experiment in f.experiments]

    def simulated_in(self, experiment: str) -> list[str]:
        """Return the names of those that its simulations vary."""
        return [name for name in self.free_in(experiment) if self.free[name].among is None]


_Counted = TypeVar("_Counted", Setup, Design)


def _quicker(one: _Counted) -> _Counted:
    """Return the counts of an experiment or a design for a quick look."""
    fewer: dict[str, int | None] = {"refine": 0, "count": _fewer(one.count, 12, 4)}
    if isinstance(one, Setup):
        fewer["repeats"] = _fewer(one.repeats, 2, 2)
    return one.model_copy(update=fewer)


def _fewer(count: int | None, least: int, share: int) -> int | None:
    """Return a share of a count, but no fewer than `least` of it."""
    return None if count is None else max(min(count, least), count // share)


def _named(where: str, used: Mapping[str, tuple[str, ...]], known: Any) -> None:
    for name, words in used.items():
        for word in words:
            if word not in known:
                at = f"{where}.{name}" if name else where
                raise ValueError(f"{at}: found {word!r}, allowed {', '.join(known) or 'none'}")


def _each_name_once(tables: Mapping[str, Mapping[str, Any]]) -> None:
    seen: dict[str, str] = {}
    for where, names in tables.items():
        for name in names:
            if name in seen:
                raise ValueError(f"{where}.{name}: {seen[name]} has this name, too; use another")
            seen[name] = where


def load_problem(path: str | Path) -> tuple[SensorProblem, dict[str, Experiment]]:
    """Read a problem and its experiments, by their names in it.

    Parameters
    ----------
    path : a TOML file, or the name of a shipped one

    Raises
    ------
    ConfigError : with one line per fault: what, where, found, allowed
    """
    file = scene_file(path)
    problem = validated(SensorProblem, read_toml(file), f"{path}: ")
    found = {name: _experiment(setup, file) for name, setup in problem.experiments.items()}
    return _with_files(problem, file), found


def _experiment(setup: Setup, file: Path) -> Experiment:
    beside = file.parent / setup.base
    base = load_experiment(beside if is_regular(beside) else setup.base)
    return vary(base, without_absent(resolve_uses(setup.set, (file,))))


def _with_files(problem: SensorProblem, file: Path) -> SensorProblem:
    """Replace what choices `use` by the values of the data files."""
    alternatives = {}
    for name, one in problem.alternatives.items():
        choices = {
            label: choice.model_copy(update={"set": resolve_uses(choice.set, (file,))})
            for label, choice in one.choices.items()
        }
        alternatives[name] = one.model_copy(update={"choices": choices})
    return problem.model_copy(update={"alternatives": alternatives})
