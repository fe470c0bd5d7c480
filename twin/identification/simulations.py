"""Simulations over the space of the free fields: studies of the experiments, saved in stores.

There is one study for every experiment and every choice that changes this experiment. An
interrupted run is resumed from the stores. Within a study, identical cases are simulated once.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import InputError
from twin.config import Experiment, vary
from twin.config.problem import SensorProblem
from twin.config.rows import LearnedAs, Metric, Statistic
from twin.config.study import Sampling, Study, without_absent
from twin.identification.emulator import Emulator, fit_emulator
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.study.cases import point_at, shares_of
from twin.study.derived import DERIVED
from twin.study.measuring import CaseMeasurer
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.table import read_table
from twin.study.worker import Measurer
from twin.study.workers import Workers

STUDIES_FOLDER = "studies"


@dataclass(frozen=True)
class Variant:
    """An experiment with the choices that change it; every variant has its own study."""

    experiment: str
    choices: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """Name of the variant's study: the experiment and the choices, in lower case."""
        return "-".join((self.experiment, *(choice for _, choice in self.choices))).lower()


def variants_of(problem: SensorProblem) -> list[Variant]:
    """Return the variants that must be simulated for the rows and limits of a problem."""
    variants = []
    for experiment in _used(problem):
        changing = _changing(problem, experiment)
        labels = [problem.alternatives[name].choices for name in changing]
        for chosen in product(*labels):
            variants.append(Variant(experiment, tuple(zip(changing, chosen, strict=True))))
    return variants


def variant_for(problem: SensorProblem, experiment: str, combination: Mapping[str, str]) -> Variant:
    """Return the variant of an experiment for one combination of choices."""
    changing = _changing(problem, experiment)
    return Variant(experiment, tuple((name, combination[name]) for name in changing))


def _used(problem: SensorProblem) -> list[str]:
    figures, combinations = problem.figures.values(), list(problem.combinations())
    return list(dict.fromkeys(problem.experiment_of(f, c) for f in figures for c in combinations))


def _changing(problem: SensorProblem, experiment: str) -> list[str]:
    return [
        name
        for name, alternative in problem.alternatives.items()
        if (not alternative.experiments or experiment in alternative.experiments)
        and any(choice.set for choice in alternative.choices.values())
    ]


def record_of(
    problem: SensorProblem, base: Experiment, variant: Variant, suffix: str = ""
) -> StudyRecord:
    """Return the study of a variant, with `suffix` at the end of its name.

    Raises
    ------
    ConfigError
        The experiment is invalid with one of the choices.
    """
    setup = problem.experiments[variant.experiment]
    names = problem.simulated_in(variant.experiment)
    study = Study(
        name=f"{variant.name}{suffix}",
        description=f"simulations for {problem.name}",
        base=base.name,
        axis=tuple(problem.free[name].axis(name) for name in names),
        sampling=Sampling(
            method="sobol", count=setup.count or problem.design.count, seed=problem.design.seed
        ),
        repeats=setup.repeats,
    )
    changed = base
    for alternative, choice in variant.choices:
        laid = problem.alternatives[alternative].choices[choice].set
        changed = vary(changed, without_absent(laid))
    return StudyRecord(study, changed)


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulations of one variant at the points of its study.

    Attributes
    ----------
    variant : the simulated variant
    columns : indices of the free fields that were varied
    places : (point, free field) shares of the axes; 0.5 for fields that were not varied
    rows
        Figures and settings by name, one row per point and repeat; repeats of a point are
        consecutive.
    repeats : int
    among : by name of each field with a fixed list of values: the index of the field's column, and
        (value, share of the axis) by the form of the value in names of figures
    varied : names of the fields that were varied
    """

    variant: Variant
    columns: tuple[int, ...]
    places: FloatArray
    rows: tuple[Mapping[str, Any], ...]
    repeats: int = 1
    among: Mapping[str, tuple[int, Mapping[str, tuple[float, float]]]] = field(default_factory=dict)
    varied: tuple[str, ...] = ()

    def sample(
        self, metric: Metric, statistic: Statistic = "mean", learned_as: LearnedAs = "value"
    ) -> "SimulatedFigure":
        """Return the simulated values of a figure, from which its emulator is fitted.

        Parameters
        ----------
        metric : str or tuple of str
            Name of the figure. If several names are given, their mean is taken.
        statistic : "mean" or "sd"
            Mean or standard deviation over the repeats of a point. The standard deviation is
            pooled over several figures.
        learned_as : "value", "log" or "reciprocal"

        Raises
        ------
        InputError
            No simulation gave the figure.
        """
        names = (metric,) if isinstance(metric, str) else metric
        where = f"{self.variant.experiment}: {', '.join(names)}"
        parts = [
            (places, columns, self._figures(full_names, statistic))
            for places, columns, full_names in self._named(names)
        ]
        places = np.concatenate([part[0] for part in parts])
        figures = np.concatenate([part[2] for part in parts])
        simulation = np.tile(np.arange(len(self.places)), len(parts))
        if not np.isfinite(figures).any():
            raise InputError(f"{where}: found in no simulation, allowed {self._known()}")
        return SimulatedFigure(where, places, figures, parts[0][1], learned_as, simulation)

    def with_further(self, further: "Simulated") -> "Simulated":
        """Return these simulations together with further simulations of the same variant."""
        places = np.concatenate((self.places, further.places))
        return replace(self, places=places, rows=self.rows + further.rows)

    def _named(
        self, names: tuple[str, ...]
    ) -> Iterator[tuple[FloatArray, tuple[int, ...], tuple[str, ...]]]:
        """Yield places, columns and full names of the figures, once per value of a field in braces.

        If the names contain `{FIELD}` of a field in `among`, the braces are replaced by each value
        of the field. Otherwise the names are yielded unchanged.
        """
        marked = (n for n in self.among if any(f"{{{n}}}" in name for name in names))
        field_name = next(marked, None)
        if field_name is None:
            yield self.places, self.columns, names
            return
        column, given = self.among[field_name]
        for part, (_, share) in given.items():
            places = self.places.copy()
            places[:, column] = share
            full = tuple(name.replace(f"{{{field_name}}}", part) for name in names)
            yield places, tuple(sorted((*self.columns, column))), full

    def _figures(self, names: tuple[str, ...], statistic: Statistic) -> FloatArray:
        """Return mean or standard deviation (point,) over the repeats, for the named figures."""
        values = {part: v for _, given in self.among.values() for part, (v, _) in given.items()}
        if names[0] in values:  # the field itself
            return np.full(len(self.places), values[names[0]])
        figures = np.array([[_number(row.get(n)) for n in names] for row in self.rows])
        return summary(figures.reshape(-1, self.repeats, len(names)), statistic)

    def _known(self) -> str:
        varied = {"seed", *self.varied}
        names = dict.fromkeys(name for row in self.rows for name in row if name not in varied)
        numbers = [
            name for name in names if any(np.isfinite(_number(row.get(name))) for row in self.rows)
        ]
        return ", ".join(numbers) or f"none: {self._reasons()}"

    def _reasons(self) -> str:
        return "; ".join(dict.fromkeys(str(row["reason"]) for row in self.rows))


@dataclass(frozen=True, eq=False)
class SimulatedFigure:
    """Values of one result ("figure") in all simulations of a variant: input of `fit_emulator`.

    `where` is the text that names experiment and figure in error messages. The other fields are the
    arguments of `fit_emulator`.
    """

    where: str
    places: FloatArray
    figures: FloatArray
    columns: tuple[int, ...]
    learned_as: LearnedAs
    simulation: IntArray

    def learned(self) -> Emulator:
        """Return the emulator that is fitted to the figure.

        Raises
        ------
        InputError
            Too few simulations gave the figure.
        """
        try:
            return fit_emulator(
                self.places, self.figures, self.columns, self.learned_as, self.simulation
            )
        except InputError as error:
            raise InputError(f"{self.where}: {error}") from None


def summary(figures: FloatArray, statistic: Statistic) -> FloatArray:
    """Return mean or pooled standard deviation (point,) of figures (point, repeat, figure).

    The mean is NaN at a point where one of the figures has no value. The standard deviation is NaN
    at a point where one of the figures has fewer than two repeats.
    """
    there = np.isfinite(figures)
    count, filled = there.sum(axis=1), np.where(there, figures, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = filled.sum(axis=1) / count
        if statistic == "mean":
            return np.asarray(mean.mean(axis=1))
        squares = np.where(there, (figures - mean[:, None]) ** 2, 0.0).sum(axis=1)
        return np.asarray(np.sqrt((squares / (count - 1)).mean(axis=1)))


def _number(value: Any) -> float:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number else float("nan")


def simulate(
    problem: SensorProblem,
    experiments: Mapping[str, Experiment],
    folder: Path,
    workers: Workers,
    *,
    watch: ProgressCallback = no_progress,
    make_measurer: Callable[[tuple[str, ...]], Measurer] = CaseMeasurer,
    inputs: Iterable[Path] = (),
) -> dict[Variant, Simulated]:
    """Run all simulations that are not yet in the stores below `folder`; return them by variant.

    Raises
    ------
    ConfigError
        An experiment is invalid with one of the choices, or at an end of an axis.
    InputError
        A store cannot be used.
    MissingBackend
        No usable Dr.Jit backend.
    """
    variants = variants_of(problem)
    records = {v: record_of(problem, experiments[v.experiment], v) for v in variants}
    simulated = {}
    for number, (variant, record) in enumerate(records.items()):
        store = folder / STUDIES_FOLDER / variant.name
        part = partial(_part, watch, number, len(records))
        sweep(record, store, workers, watch=part, make_measurer=make_measurer, inputs=tuple(inputs))
        simulated[variant] = _read(problem, variant, store, shares_of(record.study))
    return simulated


def refine(
    problem: SensorProblem,
    experiments: Mapping[str, Experiment],
    folder: Path,
    workers: Workers,
    places: Mapping[Variant, FloatArray],
    *,
    watch: ProgressCallback = no_progress,
    make_measurer: Callable[[tuple[str, ...]], Measurer] = CaseMeasurer,
) -> dict[Variant, Simulated]:
    """Run further simulations at given places, in additional stores; return them by variant.

    Parameters
    ----------
    places : by variant, (point, free field) shares of the axes

    Raises
    ------
    ConfigError, InputError, MissingBackend
        For the reasons of `simulate`.
    """
    simulated = {}
    for number, (variant, at) in enumerate(places.items()):
        record = record_of(problem, experiments[variant.experiment], variant, "_refined")
        columns = [list(problem.free).index(n) for n in problem.simulated_in(variant.experiment)]
        points = tuple(point_at(record.study.axis, row) for row in at[:, columns])
        store = folder / STUDIES_FOLDER / record.study.name
        part = partial(_part, watch, number, len(places))
        there = replace(record, points=points)
        sweep(there, store, workers, watch=part, make_measurer=make_measurer)
        simulated[variant] = _read(problem, variant, store, at[:, columns])
    return simulated


def _part(watch: ProgressCallback, number: int, count: int, stage: str, fraction: float) -> None:
    watch("simulations", (number + fraction) / count)


def _read(problem: SensorProblem, variant: Variant, store: Path, shares: FloatArray) -> Simulated:
    """Read the simulations of a variant from its store; `shares` (point, axis) are of the axes."""
    names = list(problem.free)
    varied = problem.simulated_in(variant.experiment)
    columns = tuple(names.index(name) for name in varied)
    places = np.full((len(shares), len(names)), 0.5)
    places[:, columns] = shares
    among = {
        name: (names.index(name), {figure_part(v): (v, free.share(v)) for v in free.among})
        for name, free in problem.free.items()
        if free.among is not None and name in problem.free_in(variant.experiment)
    }
    repeats = problem.experiments[variant.experiment].repeats
    rows = read_table(store, _derived(problem)).rows
    return Simulated(variant, columns, places, rows, repeats, among, tuple(varied))


def _derived(problem: SensorProblem) -> list[str]:
    """Return the names of the derived figures that rows, limits or choices name."""
    figures, combinations = problem.figures, list(problem.combinations())
    metrics = {problem.metric_of(n, f, c) for n, f in figures.items() for c in combinations}
    names = {name for m in metrics for name in ((m,) if isinstance(m, str) else m)}
    return [name for name in DERIVED if name in names]


def figure_part(value: float) -> str:
    """Return a value in the form that names of figures contain, for example 1p2 for 1.2."""
    return f"{value:g}".replace(".", "p")
