"""Record of the latest run of a study in its store: the study, base experiment and points."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from reconstruction.errors import InputError
from reconstruction.reading import read_json
from twin.config import Experiment
from twin.config.axis import Axis, Level
from twin.config.study import Study
from twin.output import adding, write_json
from twin.study.cases import Cases, Point, cases_of, cases_per_point, points_of
from twin.study.trials import trial_cases

STUDY_FILE = "study.json"
# Number of cases that are validated and checked in about 1 s.
_MOST_LOOKED_AT = 500


@dataclass(frozen=True, eq=False)
class StudyRecord:
    """A study, the experiment that it varies and, for a search, the points proposed so far.

    Attributes
    ----------
    study : the study
    base : experiment that the study varies
    points : points of a search in the order of the proposals; None: the points of the sampling
    """

    study: Study
    base: Experiment
    points: tuple[Point, ...] | None = None

    def cases(self) -> Cases:
        """Return the cases of the study; for a search, the cases at the points proposed so far.

        Those of a gradient search include cases that violate the constraints.
        """
        if self.study.sampling.method == "trials":
            return trial_cases(self.study, self.base)
        if self.study.gradient is not None:
            return cases_of(unbounded(self.study), self.base, self.points)
        return cases_of(self.study, self.base, self.points)

    def first_look(self) -> Cases:
        """Return all cases of a small study; for a large study, the cases of every n-th point.

        At most about 500 cases are returned. For a search that has started and for trials, all
        cases are returned.
        """
        if self.study.sampling.method == "trials" or self.points is not None:
            return self.cases()
        points = points_of(self.study)
        step = -(-len(points) * cases_per_point(self.study) // _MOST_LOOKED_AT)
        while math.gcd(step, len(points)) > 1:  # else some levels of an axis are never included
            step += 1
        return replace(cases_of(self.study, self.base, points[::step]), step=step)


def unbounded(study: Study) -> Study:
    """Return a study without its constraints, which a gradient search applies itself.

    The search may measure points that violate a constraint. Such a case is in the table as not
    feasible.
    """
    return study.model_copy(update={"constraint": ()})


def write_record(folder: Path, record: StudyRecord) -> None:
    """Write the record into a store in one atomic step.

    Raises
    ------
    InputError : the store cannot be written, or contains a study.json that `twin` did not write
    """
    labels = None
    if record.points is not None:
        labels = [[level.label for level in point] for point in record.points]
    content = {
        "schema_version": 1,
        "study": record.study.model_dump(mode="json"),
        "base": record.base.model_dump(mode="json"),
        "points": labels,
    }
    with adding(folder, STUDY_FILE) as made:
        write_json(made / STUDY_FILE, content)


def read_record(folder: Path) -> StudyRecord:
    """Read the record of a store.

    Raises
    ------
    InputError : the record is missing or damaged
    """
    content = read_json(folder / STUDY_FILE)
    try:
        study = Study.model_validate(content["study"])
        base = Experiment.model_validate(content["base"])
        return StudyRecord(study, base, _points(study, content["points"]))
    except (KeyError, TypeError, ValidationError) as error:
        raise InputError(
            f"{folder / STUDY_FILE}: damaged ({type(error).__name__}); run twin sweep again"
        ) from None


def _points(study: Study, labels: Sequence[Sequence[Any]] | None) -> tuple[Point, ...] | None:
    if labels is None:
        return None
    return tuple(
        tuple(_level(axis, label) for axis, label in zip(study.axis, row, strict=True))
        for row in labels
    )


def _level(axis: Axis, label: Any) -> Level:
    if axis.is_continuous:
        return axis.level_of(label)
    return next(level for level in axis.levels() if level.label == label)
