"""Find the cases of a study that cannot be measured; for a search, check cases along its axes."""

from collections.abc import Iterator, Sequence
from itertools import chain

from reconstruction.errors import InputError
from twin.config import ConfigError
from twin.pipeline.memory import Path as FieldPath
from twin.pipeline.memory import Reads, values_at, watched
from twin.pipeline.methods import check_measurable
from twin.study.cases import Case, Point, cases_of
from twin.study.record import StudyRecord


def unmeasurable(cases: Sequence[Case]) -> dict[str, list[Case]]:
    """Return lists of the cases that cannot be measured, by the text of the reason.

    The fields that the checks read are recorded. Cases with the same values of these fields are
    checked only once, for example cases that differ only in seed, code or exposure.
    """
    known: dict[tuple[FieldPath, ...], dict[tuple[bytes, ...], str]] = {}
    cases_by_reason: dict[str, list[Case]] = {}
    for case in cases:
        checked = ((reasons, values_at(case.experiment, paths)) for paths, reasons in known.items())
        reason = next(
            (reasons[values] for reasons, values in checked if values in reasons),
            None,
        )
        if reason is None:
            reads = Reads()
            reason = _problem(case, reads)
            paths = reads.paths
            known.setdefault(paths, {})[values_at(case.experiment, paths)] = reason
        if reason:
            cases_by_reason.setdefault(reason, []).append(case)
    return cases_by_reason


def _problem(case: Case, reads: Reads) -> str:
    try:
        check_measurable(watched(case.experiment, reads))
    except InputError as error:
        return " ".join(str(error).split())
    return ""


def probes_of(record: StudyRecord) -> list[Case]:
    """Return cases along each axis of a search, with all other axes at their middle.

    A continuous axis has cases at both ends and in the middle, another axis at each level.

    Raises
    ------
    ConfigError : no such case is a valid experiment that satisfies the constraints
    """
    cases, reason = list[Case](), ""
    for point in dict(_along_axes(record)).values():
        try:
            cases += cases_of(record.study, record.base, [point]).run
        except ConfigError as error:
            reason = str(error)
    if not cases:
        raise ConfigError(reason)
    return cases


def _along_axes(record: StudyRecord) -> Iterator[tuple[str, Point]]:
    axes = record.study.axis
    middle = tuple(axis.level_at(0.5) for axis in axes)
    for number, axis in enumerate(axes):
        ends = (axis.level_at(share) for share in (0.0, 0.5, 1.0))
        for level in chain(axis.levels(), ends if axis.is_continuous else ()):
            point = (*middle[:number], level, *middle[number + 1 :])
            yield repr([coordinate.label for coordinate in point]), point
