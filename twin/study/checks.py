"""What is plain of a study before its first case runs: figures that no case will have."""

import difflib
from collections.abc import Iterable

from reconstruction.errors import InputError
from twin.config import Experiment
from twin.results.bound import is_bound_name
from twin.results.names import figure_names
from twin.study.cases import Case
from twin.study.derived import DERIVED
from twin.study.measuring import TRUE_RIG
from twin.study.record import StudyRecord


def check_figures(record: StudyRecord, cases: Iterable[Case]) -> None:
    """Refuse metrics and objectives that no case can have, and constraints on nothing.

    Raises
    ------
    InputError : the figure, the nearest name, and where all names are told
    """
    study = record.study
    asked = [("metrics", name) for name in study.metrics]
    asked += [("objectives", one.metric) for one in study.goals]
    bounds = [name for one in study.constraint for name in (one.value, one.per) if name]
    asked += [("constraint", name) for name in bounds if "." not in name]
    if not asked:
        return
    known = _known(record.base, cases)
    if study.sampling.method == "trials":  # whose figures are those of noisy measurements
        known = {name for name in known if not is_bound_name(name)}
    for where, name in asked:
        if name.removeprefix(TRUE_RIG) not in known:
            close = difflib.get_close_matches(name, known, n=2, cutoff=0.5)
            hint = f"; did you mean {' or '.join(close)}?" if close else ""
            raise InputError(
                f"{where}: no case of this study has a figure '{name}'{hint} docs/evaluation.md "
                "and docs/sweeps.md tell all"
            )


def _known(base: Experiment, cases: Iterable[Case]) -> set[str]:
    """Return the figures of all cases; those that differ in numbers alone are asked once."""
    found, seen = set(DERIVED), set[str]()
    for experiment in (base, *(case.experiment for case in cases)):
        kind = _kind_of(experiment)
        if kind not in seen:
            seen.add(kind)
            found |= figure_names(experiment)
    return found


def _kind_of(experiment: Experiment) -> str:
    of_object = {"modality", "specimen", "measurand", "score"}
    return experiment.model_dump_json(include=of_object)
