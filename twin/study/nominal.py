"""The nominal measurement of a study of trials: it is made first, and stops the study if it fails.

Trials are variations of it: where it cannot be measured, hardly any of them can, and each would
fail for the same reason.
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
    """Return trial 0 of the cases of a study of trials."""
    return next(
        one for one in cases.run if one.settings[PART] == TRIALS and not one.settings[TRIAL]
    )


def check_nominal(record: StudyRecord, case: Case, store: Store) -> None:
    """Refuse a study of trials whose nominal measurement failed or lacks the measurands.

    Parameters
    ----------
    case : the nominal one; nothing is checked where the store does not hold it, because another run
        computes it or it could not be saved

    Raises
    ------
    InputError : the reason, and the file that describes it
    """
    content = store.read(case.digest)
    if content is None:
        return
    name = case.experiment.name
    if "failure" in content:
        file = store.path_of(case.digest) / FAILURE_FILE
        raise InputError(
            f"{name}: the nominal measurement failed, so nothing else is measured: "
            f"{content['failure']} (see {file}); change the experiment"
        )
    for line in _lacking(record.study, content.get("metrics") or {}):
        raise InputError(f"{name}: {line}; nothing else is measured")


def _lacking(study: Study, figures: dict[str, Any]) -> list[str]:
    """Return what the nominal measurement lacks of the measurands, or of any point."""
    absent = why_absent(figures)
    if not study.metrics:
        return [f"the nominal measurement has {absent}"] if absent else []
    return [_missing(one, figures, absent) for one in study.metrics if _has_none(one, figures)]


def _has_none(name: str, figures: dict[str, Any]) -> bool:
    """Whether a figure is neither a number nor words, as the press model is."""
    return figures.get(name.removeprefix(TRUE_RIG)) is None


def _missing(name: str, figures: dict[str, Any], absent: str) -> str:
    if name in figures:
        return f"measurand {name}: the nominal measurement has no value of it" + (
            f" ({absent})" if absent else ""
        )
    known = [one for one, value in figures.items() if is_number(value)]
    close = difflib.get_close_matches(name, known, n=2, cutoff=0.5)
    hint = f"did you mean {' or '.join(close)}" if close else f"allowed {', '.join(sorted(known))}"
    return f"measurand {name}: the nominal measurement has no such figure; {hint}"
