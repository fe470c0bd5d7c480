"""Nominal measurement of a study of trials: it runs first, and its failure stops the study.

Trials are variations of the nominal measurement. If that fails, most trials would fail for the
same reason.
"""

import difflib
from typing import Any

from reconstruction.errors import InputError
from twin.config.study import Study
from twin.results.figures import why_absent
from twin.results.rows import is_number
from twin.study.cases import Case, Cases
from twin.study.measuring import TRUE_RIG
from twin.study.record import StudyRecord
from twin.study.store import FAILURE_FILE, Store
from twin.study.trials import PART, TRIAL, TRIALS


def nominal_case(cases: Cases) -> Case:
    """Return the case of the nominal measurement, which is trial 0."""
    return next(
        case for case in cases.run if case.settings[PART] == TRIALS and not case.settings[TRIAL]
    )


def check_nominal(record: StudyRecord, case: Case, store: Store) -> None:
    """Raise InputError if the nominal measurement of trials failed or lacks a measurand.

    Parameters
    ----------
    case : the nominal case. If it is not in the store, the check is omitted: another run
        computes the case, or it could not be saved

    Raises
    ------
    InputError : the nominal measurement failed, or lacks a measurand; the message states the
        reason
    """
    content = store.read(case.digest)
    if content is None:
        return
    name = case.experiment.name
    if "failure" in content:
        file = store.path_of(case.digest) / FAILURE_FILE
        raise InputError(
            f"{name}: the nominal measurement failed, so no trial is measured: "
            f"{content['failure']} (see {file}); change the experiment"
        )
    for line in _lacking(record.study, content.get("metrics") or {}):
        raise InputError(f"{name}: {line}; no trial is measured")


def _lacking(study: Study, figures: dict[str, Any]) -> list[str]:
    """Return a message for each measurand without a value in the nominal measurement.

    If the study names no measurand, the measurement lacks a value if no point is valid.
    """
    absent = why_absent(figures)
    if not study.metrics:
        return [f"the nominal measurement has {absent}"] if absent else []
    return [_missing(name, figures, absent) for name in study.metrics if _has_none(name, figures)]


def _has_none(name: str, figures: dict[str, Any]) -> bool:
    """Return True if a figure is missing or None."""
    return figures.get(name.removeprefix(TRUE_RIG)) is None


def _missing(name: str, figures: dict[str, Any], absent: str) -> str:
    if name in figures:
        return f"measurand {name}: the nominal measurement has no value of it" + (
            f" ({absent})" if absent else ""
        )
    known = [figure for figure, value in figures.items() if is_number(value)]
    close = difflib.get_close_matches(name, known, n=2, cutoff=0.5)
    hint = f"did you mean {' or '.join(close)}" if close else f"allowed {', '.join(sorted(known))}"
    return f"measurand {name}: the nominal measurement has no such figure; {hint}"
