"""Checks of a study before its first case runs: the figures that the study names must exist."""

import difflib
from collections.abc import Iterable, Sequence

from reconstruction.errors import InputError
from twin.config import Experiment
from twin.results.bound import is_bound_name
from twin.results.names import figure_names
from twin.study.cases import Case
from twin.study.derived import DERIVED
from twin.study.feasibility import has_tolerances
from twin.study.measuring import TRUE_RIG
from twin.study.record import StudyRecord


def check_figures(record: StudyRecord, cases: Sequence[Case]) -> None:
    """Check that the metrics, objectives and constraints of a study name figures of its cases.

    Raises
    ------
    InputError : no case can have a named figure, with the most similar names; or `limit_axis` has
        no condition
    """
    study = record.study
    _check_conditions(record, cases)
    requested = [("metrics", name) for name in study.metrics]
    goals = [entry.metric for entry in study.goals if entry.metric != study.limit_axis]
    requested += [("objectives", name) for name in goals]
    bounds = [name for entry in study.constraint for name in (entry.value, entry.per) if name]
    requested += [("constraint", name) for name in bounds if "." not in name]
    if not requested:
        return
    known = _known(record.base, cases)
    if study.sampling.method == "trials":  # bounds are not computed for trials
        known = {name for name in known if not is_bound_name(name)}
    for where, name in requested:
        if name.removeprefix(TRUE_RIG) not in known:
            close = difflib.get_close_matches(name, known, n=2, cutoff=0.5)
            hint = f"; did you mean {' or '.join(close)}?" if close else ""
            raise InputError(
                f"{where}: no case of this study has a figure '{name}'{hint}; docs/evaluation.md "
                "and docs/sweeps.md list all figures"
            )


def _check_conditions(record: StudyRecord, cases: Iterable[Case]) -> None:
    """Raise InputError for a `limit_axis` without a condition that could limit its value."""
    study = record.study
    if study.limit_axis is None or study.constraint:
        return
    if not any(has_tolerances(case.experiment) for case in cases):
        raise InputError(
            f"limit_axis: found {study.limit_axis!r} in a study without a condition, allowed with "
            "one; add [[constraint]], or a tolerance of a [[measurand]]"
        )


def _known(base: Experiment, cases: Iterable[Case]) -> set[str]:
    """Return the names of the figures of all cases, and of derived figures.

    Of the cases with equal method, specimen, motion, measurands and score only one is evaluated.
    """
    names, kinds = set(DERIVED), set[str]()
    for experiment in (base, *(case.experiment for case in cases)):
        kind = _kind_of(experiment)
        if kind not in kinds:
            kinds.add(kind)
            names |= figure_names(experiment)
    return names


def _kind_of(experiment: Experiment) -> str:
    of_object = {"modality", "specimen", "measurand", "score"}
    moves = " moves" if experiment.motion.moves else ""
    return experiment.model_dump_json(include=of_object) + moves
