"""What the twin finds over the space of free fields: studies of the experiments, kept in stores.

One study for every experiment and every choice that changes it; an interrupted run goes on from
them, and cases of the same content are shared within a study.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from twin.config import Experiment, vary
from twin.config.problem import LearnedAs, Metric, SensorProblem, Statistic
from twin.config.study import Sampling, Study, without_absent
from twin.identification.emulator import Emulator, fit_emulator
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.study.design import shares_of
from twin.study.measuring import CaseMeasurer
from twin.study.record import StudyRecord
from twin.study.sweep import sweep
from twin.study.table import StudyTable, read_table
from twin.study.worker import Measurer
from twin.study.workers import Workers

STUDIES_FOLDER = "studies"


@dataclass(frozen=True)
class Variant:
    """An experiment under the choices that change it."""

    experiment: str
    choices: tuple[tuple[str, str], ...] = ()

    @property
    def name(self) -> str:
        """Name of its study."""
        return "-".join((self.experiment, *(choice for _, choice in self.choices))).lower()


def variants_of(problem: SensorProblem) -> list[Variant]:
    """Return the variants that must be simulated."""
    found = []
    for experiment in _used(problem):
        changing = _changing(problem, experiment)
        labels = [problem.alternatives[name].choices for name in changing]
        for chosen in product(*labels):
            found.append(Variant(experiment, tuple(zip(changing, chosen, strict=True))))
    return found


def variant_for(problem: SensorProblem, experiment: str, combination: Mapping[str, str]) -> Variant:
    """Return the variant of an experiment in a combination of choices."""
    changing = _changing(problem, experiment)
    return Variant(experiment, tuple((name, combination[name]) for name in changing))


def _used(problem: SensorProblem) -> list[str]:
    rows = (*problem.rows.values(), *problem.worth.values())
    combinations = list(problem.combinations())
    return list(dict.fromkeys(problem.experiment_of(r, c) for r in rows for c in combinations))


def _changing(problem: SensorProblem, experiment: str) -> list[str]:
    return [
        name
        for name, one in problem.alternatives.items()
        if (not one.experiments or experiment in one.experiments)
        and any(choice.set for choice in one.choices.values())
    ]


def record_of(problem: SensorProblem, base: Experiment, variant: Variant) -> StudyRecord:
    """Return the study of a variant.

    Raises
    ------
    ConfigError
        A choice does not fit the experiment.
    """
    names, setup = problem.free_in(variant.experiment), problem.experiments[variant.experiment]
    study = Study(
        name=variant.name,
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
    """The simulations of one variant.

    Attributes
    ----------
    columns : which free fields were varied
    places : (point, free field) shares of the axes; fields that the experiment lacks are 0.5
    table : StudyTable
        One row per point and repeat, those of a point together.
    repeats : int
    """

    variant: Variant
    columns: tuple[int, ...]
    places: FloatArray
    table: StudyTable
    repeats: int = 1

    def emulator(
        self, metric: Metric, statistic: Statistic = "mean", learned_as: LearnedAs = "value"
    ) -> Emulator:
        """Learn a figure.

        Parameters
        ----------
        metric : str or tuple of str
            Name of the figure; of several their mean.
        statistic : "mean" or "sd"
            Over the repeats of a point. The deviation is pooled over several figures.
        learned_as : "value", "log" or "reciprocal"

        Raises
        ------
        InputError
            No simulation, or too few, gave this figure.
        """
        names = (metric,) if isinstance(metric, str) else metric
        where = f"{self.variant.experiment}: {', '.join(names)}"
        figures = np.array([[_number(row.get(n)) for n in names] for row in self.table.rows])
        if not np.isfinite(figures).all(axis=1).any():
            raise InputError(f"{where}: found in no simulation, allowed {self._known()}")
        found = summary(figures.reshape(-1, self.repeats, len(names)), statistic)
        try:
            return fit_emulator(self.places, found, self.columns, learned_as)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None

    def _known(self) -> str:
        numbers = [
            name
            for name in self.table.metrics
            if any(np.isfinite(_number(row.get(name))) for row in self.table.rows)
        ]
        return ", ".join(numbers) or f"none: {self._reasons()}"

    def _reasons(self) -> str:
        return "; ".join(dict.fromkeys(str(row["reason"]) for row in self.table.rows))


def summary(figures: FloatArray, statistic: Statistic) -> FloatArray:
    """Return mean or pooled standard deviation (point,) of figures (point, repeat, figure).

    NaN where a point has no figure, or for a deviation fewer than two repeats of one.
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
    """Run all simulations that the stores below `folder` lack.

    Raises
    ------
    ConfigError
        A choice or an end of an axis does not fit an experiment.
    InputError
        A store cannot be used.
    MissingBackend
        No usable Dr.Jit backend.
    """
    variants = variants_of(problem)
    records = {one: record_of(problem, experiments[one.experiment], one) for one in variants}
    found = {}
    for number, (variant, record) in enumerate(records.items()):
        store = folder / STUDIES_FOLDER / variant.name
        part = partial(_part, watch, number, len(records))
        sweep(record, store, workers, watch=part, make_measurer=make_measurer, inputs=tuple(inputs))
        found[variant] = _read(problem, variant, record, store)
    return found


def _part(watch: ProgressCallback, number: int, count: int, stage: str, fraction: float) -> None:
    watch("simulations", (number + fraction) / count)


def _read(problem: SensorProblem, variant: Variant, record: StudyRecord, store: Path) -> Simulated:
    table, shares = read_table(store), shares_of(record.study)
    names = list(problem.free)
    columns = tuple(names.index(name) for name in problem.free_in(variant.experiment))
    places = np.full((len(shares), len(names)), 0.5)
    places[:, columns] = shares
    return Simulated(variant, columns, places, table, record.study.repeats)
