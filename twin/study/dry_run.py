"""What can be said of a study before it runs: which of its cases cannot be measured, and why."""

from collections.abc import Iterator, Sequence
from itertools import chain

from reconstruction.errors import InputError
from twin.config import ConfigError
from twin.pipeline.methods import check_measurable
from twin.pipeline.reads import Path, Reads, values_at, watched
from twin.study.cases import Case, cases_of
from twin.study.design import Point
from twin.study.record import StudyRecord


def unmeasurable(cases: Sequence[Case]) -> dict[str, list[Case]]:
    """Return the cases that no run can measure, by reason.

    The checks are watched for the fields that they read, so that cases with the same values there
    are checked once: seeds, codes and exposures cost nothing.
    """
    known: dict[tuple[Path, ...], dict[tuple[bytes, ...], str]] = {}
    found: dict[str, list[Case]] = {}
    for case in cases:
        seen = ((told, values_at(case.experiment, paths)) for paths, told in known.items())
        reason = next((told[values] for told, values in seen if values in told), None)
        if reason is None:
            reads = Reads()
            reason = _problem(case, reads)
            paths = reads.paths
            known.setdefault(paths, {})[values_at(case.experiment, paths)] = reason
        if reason:
            found.setdefault(reason, []).append(case)
    return found


def _problem(case: Case, reads: Reads) -> str:
    try:
        check_measurable(watched(case.experiment, reads))
    except InputError as error:
        return " ".join(str(error).split())
    return ""


def probes_of(record: StudyRecord) -> list[Case]:
    """Return cases along the axes of a search: ends and middle, the other axes in their middle.

    Raises
    ------
    ConfigError
        None of them is a valid experiment that the constraints admit.
    """
    cases, told = list[Case](), ""
    for point in dict(_along_axes(record)).values():
        try:
            cases += cases_of(record.study, record.base, [point]).run
        except ConfigError as error:
            told = str(error)
    if not cases:
        raise ConfigError(told)
    return cases


def _along_axes(record: StudyRecord) -> Iterator[tuple[str, Point]]:
    axes = record.study.axis
    middle = tuple(axis.level_at(0.5) for axis in axes)
    for number, axis in enumerate(axes):
        ends = (axis.level_at(share) for share in (0.0, 0.5, 1.0))
        for level in chain(axis.levels(), ends if axis.is_continuous else ()):
            point = (*middle[:number], level, *middle[number + 1 :])
            yield repr([one.label for one in point]), point
