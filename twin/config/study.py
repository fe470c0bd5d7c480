"""Study as data: a base experiment, the axes over which it is varied, and figures of merit.

Shipped studies are in `scenes/studies`; `docs/sweeps.md` explains every key.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from reconstruction.reading import is_regular
from twin.assets import scene_file
from twin.config.axis import Axis, with_files
from twin.config.base import Model
from twin.config.bounds import Figure
from twin.config.inputs import Input, load_inputs, require_distinct_keys, with_sources
from twin.config.loading import ABSENT, load_experiment, read_toml, resolve_uses, vary
from twin.config.methods import Method
from twin.config.models import Experiment
from twin.config.schema import validated

MOST_CASES = 100_000
"""Most cases of a study, including repeats and methods: making them takes about 1 min and 2 GB."""
_ROUNDING = 1e-9  # relative rounding error of a constrained number


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
    limit_axis: str | None = Field(
        default=None,
        exclude_if=lambda axis: axis is None,
        description="heading of an axis with numbers; the page states its largest value at which "
        "all conditions are met, for each setting of the other axes",
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
        self._check_limit_axis()
        if self.sampling.method == "grid":
            open_axes = [axis.title for axis in self.axis if axis.is_continuous]
            if open_axes:
                raise ValueError(f"axis {', '.join(open_axes)}: a grid needs count or values")
        return self

    def _check_limit_axis(self) -> None:
        if self.limit_axis is None:
            return
        if self.sampling.method != "grid":
            raise ValueError("limit_axis: needs sampling.method = 'grid'; remove one of both")
        ordered = [axis.title for axis in self.axis if axis.is_numeric]
        if self.limit_axis not in ordered:
            raise ValueError(
                f"limit_axis: found {self.limit_axis!r}, allowed the heading of an axis with two or"
                f" more numbers: {', '.join(ordered) or 'there is none'}"
            )

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
            "limit_axis": self.limit_axis is not None,
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
        """Objectives of the search, or of the study if it has no search.

        A study with `limit_axis` and without objectives has the largest value of this axis.
        """
        if self.gradient:
            return (self.gradient.objective,)
        if self.limit_axis is not None and not self.objectives:
            return (Objective(metric=self.limit_axis, goal="maximise"),)
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


def without_absent(node: Any) -> Any:
    """Return nested tables with every value "absent" replaced by None."""
    if isinstance(node, dict):
        return {key: without_absent(value) for key, value in node.items()}
    return None if node == ABSENT else node
