"""Uncertainty of measurands from the trials of a study, read from the study's store."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import InputError
from reconstruction.reading import is_regular, read_json
from twin.config import Experiment, digest
from twin.config.inputs import Input
from twin.propagation.budget import Part, calibration_part, noise_part, part_of, ranked, together
from twin.propagation.distribution import COVERAGE, Distribution, distribution_of
from twin.propagation.presentation import measurand_in_short, trial_arrays, trial_drawing
from twin.propagation.sensitivity import Correlation, correlation_of
from twin.results.rows import is_number
from twin.study.measuring import TRUE_RIG
from twin.study.record import STUDY_FILE, StudyRecord, read_record
from twin.study.sensitivity import Effect
from twin.study.table import StudyTable, read_table
from twin.study.trials import (
    ALONE,
    CALIBRATION,
    INPUT,
    NOISE,
    PART,
    STEP,
    TRIAL,
    TRIALS,
    counting_for,
    nominal,
)

if TYPE_CHECKING:
    import xarray

    from reconstruction.drawing import Drawing

SOBOL_FILE = "sobol.json"
MAIN = (
    "sphere_1_radius_mm",
    "rod_width_mm",
    "z_rmse_um",
    "z_bias_um",
    "completeness",
    "force_n",
)
"""Default measurands; those that a measurement lacks are left out."""
_MOST_OTHERS = 4

Row = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Measurand:
    """One figure of the measurement and its uncertainty over the trials.

    Attributes
    ----------
    name : name of the figure, which ends with the unit
    nominal : value in trial 0, the nominal measurement; None if it has no value
    distribution : distribution over the trials that have a value
    missing : number of trials without a value, because the measurement or the fit failed
    parts : contributions of the budget, the largest first; empty if no budget was requested
    undetermined : names of inputs without a contribution, because a step has no value
    correlations : correlations with the inputs, the strongest first
    effects : Sobol' indices; empty if they were not requested
    """

    name: str
    nominal: float | None
    distribution: Distribution
    missing: int
    parts: tuple[Part, ...] = ()
    undetermined: tuple[str, ...] = ()
    correlations: tuple[Correlation, ...] = ()
    effects: tuple[Effect, ...] = ()

    @property
    def from_budget(self) -> float | None:
        """Combined standard uncertainty of the budget in the figure's unit; None if no budget."""
        return together(self.parts) if self.parts else None


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Uncertainties of the measurands, evaluated from the trials of a study.

    Attributes
    ----------
    table : table of all cases of the study
    measurands : the measurands by name
    failures : number of failed trials by reason
    """

    table: StudyTable
    measurands: Mapping[str, Measurand]
    failures: Mapping[str, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        shown = "; ".join(f"{name} {value}" for name, value in self._in_short().items())
        return f"<Uncertainty: {self.experiment.name}, {shown}>"

    def _repr_html_(self) -> str:
        from reconstruction.drawing import as_html

        return as_html(f"uncertainty of {self.experiment.name}", self._in_short(), self.plot())

    def _in_short(self) -> dict[str, str]:
        """Return texts by name: number of trials, mean and standard uncertainty u of measurands."""
        failed = sum(self.failures.values())
        trials = f"{self.trials}, {failed} failed" if failed else f"{self.trials}"
        measurands = {name: measurand_in_short(m) for name, m in self.measurands.items()}
        return {"trials": trials} | measurands

    def plot(self) -> "Drawing":
        """Draw the values of each measurand with its coverage interval into a Matplotlib figure."""
        return trial_drawing(self)

    def to_xarray(self) -> "xarray.Dataset":
        """Return inputs and figures of the trials as (trial,) variables; NaN if one is missing."""
        return trial_arrays(self).to_xarray()

    @property
    def trials(self) -> int:
        """Number of requested trials; the nominal measurement is not counted."""
        return self.table.record.study.sampling.count or 0

    @property
    def experiment(self) -> Experiment:
        """The nominal experiment, which was measured repeatedly with varied inputs."""
        record = self.table.record
        return nominal(record.study, record.base)

    def inputs(self) -> dict[str, Input]:
        """Return the varied inputs, by name, that apply to the experiment."""
        return counting_for(self.experiment, self.table.record.study.inputs)

    def metrics(self) -> dict[str, Any]:
        """Return the results of all measurands by name, as in `result.json`.

        Each name ends with the unit.
        """
        figures: dict[str, Any] = {
            "trials": self.trials,
            "failed_trials": sum(self.failures.values()),
        }
        for measurand in self.measurands.values():
            figures |= _metrics_of(measurand)
        return figures


def is_uncertainty(folder: Path) -> bool:
    """Return True if a folder is the store of a study of trials."""
    if not is_regular(folder / STUDY_FILE):
        return False
    return read_record(folder).study.sampling.method == "trials"


def read_uncertainty(
    folder: Path, measurands: Sequence[str] = (), coverage: float = COVERAGE
) -> Uncertainty:
    """Evaluate the trials in the store of a study.

    Parameters
    ----------
    folder : the store
    measurands : names of figures; default: the metrics of the study, or `MAIN` if it has none
    coverage : coverage probability of the intervals, 0 to 1

    Raises
    ------
    InputError
        The folder is no study of trials, fewer than two trials have a value, or no trial has a
        figure of that name.
    """
    if not is_uncertainty(folder):
        raise InputError(f"{folder}: found no trials; give the -o DIR of twin uncertainty")
    table = read_table(folder)
    trials = _part(table.rows, TRIALS)
    failures = Counter(row["reason"] for row in trials if row["state"] == "failed" and row[TRIAL])
    names = list(measurands or table.record.study.metrics) or _main(trials)
    known = {name for row in trials for name, value in row.items() if is_number(value)}
    known -= {TRIAL, *(given.key for given in table.record.study.inputs.values())}
    unknown = [name for name in names if name not in known]
    if unknown:
        allowed = ", ".join(sorted(n for n in known if not n.startswith(TRUE_RIG)))
        why = "; ".join(failures) if failures else "no trial is finished; run it again"
        raise InputError(f"measurand {unknown[0]}: found in no trial, allowed {allowed or why}")
    effects = _read_effects(folder, table.record)
    by_name = {name: _measurand(table, name, coverage, effects.get(name, ())) for name in names}
    return Uncertainty(table, by_name, failures)


def _main(trials: Sequence[Row]) -> list[str]:
    """Return those of `MAIN` that vary over the trials; if none does, up to four other figures."""
    some = [row for row in trials if row["state"] == "done"]
    if not some:
        return list(MAIN[:1])
    of_inputs = {TRIAL, *(name for name in some[0] if "." in name)}
    differ = [
        name
        for name, value in some[0].items()
        if is_number(value)
        and name not in of_inputs
        and not name.startswith(TRUE_RIG)
        and len({row.get(name) for row in some}) > 1
    ]
    return [name for name in MAIN if name in differ] or differ[:_MOST_OTHERS] or list(MAIN[:1])


def _measurand(
    table: StudyTable, name: str, coverage: float, effects: Iterable[Effect]
) -> Measurand:
    rows = _part(table.rows, TRIALS)
    drawn = [row for row in rows if row[TRIAL]]
    with_value = [row for row in drawn if is_number(row.get(name))]
    values = _values(with_value, name)
    if values.size < 2:
        raise InputError(f"measurand {name}: found in {values.size} trials, needed 2; add trials")
    middle = next((row.get(name) for row in rows if not row[TRIAL]), None)
    study = table.record.study
    inputs = counting_for(nominal(study, table.record.base), study.inputs)
    parts, undetermined = _budget(table, name, inputs, with_value)
    pairs = [
        correlation_of(title, [row[given.key] for row in with_value], values)
        for title, given in inputs.items()
    ]
    return Measurand(
        name,
        middle if is_number(middle) else None,
        distribution_of(values, coverage),
        len(drawn) - len(with_value),
        tuple(ranked(parts)),
        tuple(undetermined),
        tuple(sorted(filter(None, pairs), key=lambda pair: -abs(pair.rank))),
        tuple(effects),
    )


def _budget(
    table: StudyTable, name: str, inputs: Mapping[str, Input], trials: Sequence[Row]
) -> tuple[list[Part], list[str]]:
    """Return contributions of inputs, noise and calibration; and inputs without contribution."""
    if not table.record.study.sampling.budget:
        return [], []
    alone = [row for row in _part(table.rows, ALONE) if is_number(row.get(name))]
    middle = {row[STEP]: row[name] for row in alone if not row[INPUT]}
    parts, undetermined = [], []
    for title, given in inputs.items():
        steps = middle | {row[STEP]: row[name] for row in alone if row[INPUT] == title}
        part = part_of(title, given, steps)
        if part is None:
            undetermined.append(title)
        else:
            parts.append(part)
    rest = (
        noise_part(_values(_part(table.rows, NOISE), name)),
        calibration_part(_calibration_changes(table, name, trials)),
    )
    return parts + [part for part in rest if part is not None], undetermined


def _calibration_changes(table: StudyTable, name: str, trials: Sequence[Row]) -> FloatArray:
    """Return the change (n,) of a measurand by another calibration, one value per trial.

    With fringes, the same images are evaluated with the drawn calibration and with the true rig.
    """
    both = [row for row in trials if is_number(row.get(f"{TRUE_RIG}{name}"))]
    if both:
        return _values(both, name) - _values(both, f"{TRUE_RIG}{name}")
    return _values(_part(table.rows, CALIBRATION), name)


def _part(rows: Iterable[Row], part: str) -> list[Row]:
    return [row for row in rows if row.get(PART) == part]


def _values(rows: Iterable[Row], name: str) -> FloatArray:
    return np.array([row[name] for row in rows if is_number(row.get(name))], np.float64)


def _metrics_of(measurand: Measurand) -> dict[str, Any]:
    result, name = measurand.distribution, measurand.name
    stability = result.stability
    figures: dict[str, Any] = {
        f"trials_of_{name}": int(result.values.size),
        f"nominal_{name}": measurand.nominal,
        f"mean_{name}": result.mean,
        f"standard_uncertainty_{name}": result.standard_uncertainty,
        f"budget_standard_uncertainty_{name}": measurand.from_budget,
        f"supported_digits_of_{name}": None if stability is None else stability.digits,
    }
    for title, interval in (
        ("interval", result.symmetric),
        ("shortest_interval", result.shortest),
    ):
        figures[f"{title}_low_{name}"] = None if interval is None else interval.low
        figures[f"{title}_high_{name}"] = None if interval is None else interval.high
    return figures | {
        f"uncertainty_by_{part.name}_{name}".replace(" ", "_"): part.u for part in measurand.parts
    }


def effects_as_json(record: StudyRecord, effects: Mapping[str, Sequence[Effect]]) -> dict[str, Any]:
    """Return Sobol' indices as the content of `SOBOL_FILE`, with a digest of the inputs."""
    by_name = {name: [asdict(effect) for effect in some] for name, some in effects.items()}
    return {"schema_version": 1, "of": _mark(record), "effects": by_name}


def _mark(record: StudyRecord) -> str:
    inputs = {name: given.model_dump(mode="json") for name, given in record.study.inputs.items()}
    return f"{digest(record.base)} {json.dumps(inputs, sort_keys=True)}"


def _read_effects(folder: Path, record: StudyRecord) -> dict[str, list[Effect]]:
    """Read Sobol' indices by measurand; empty if they are of another experiment or other inputs."""
    path = folder / SOBOL_FILE
    if not is_regular(path):
        return {}
    content = read_json(path)
    if content.get("of") != _mark(record):
        return {}
    try:
        return {name: [Effect(**row) for row in some] for name, some in content["effects"].items()}
    except (KeyError, TypeError, AttributeError):
        raise InputError(f"{path}: damaged; delete it, or run with --sobol again") from None
