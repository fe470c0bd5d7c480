"""Run a study into its store; estimate its run time and disk space, find unmeasurable cases."""

import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError, counted
from reconstruction.reading import read_json
from twin.config import ConfigError, Experiment
from twin.config.board import load_board
from twin.config.study import Study
from twin.mechanics.choice import possible_models
from twin.mechanics.models import PressInput
from twin.optics.light import pattern_set
from twin.pipeline.memory import Path as FieldPath
from twin.pipeline.memory import Reads, values_at, watched
from twin.pipeline.methods import check_measurable
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.study.cases import Case, Cases, Point, cases_of
from twin.study.engine import Run, SweepOutcome, run_together
from twin.study.gradient import descend
from twin.study.index import DAMAGED, Index, entry_of
from twin.study.measuring import CALIBRATION_FILE, DEFAULT_MEASURING, Measuring, calibrated
from twin.study.nominal import check_nominal, nominal_case
from twin.study.optimise import optimise
from twin.study.record import StudyRecord, write_record
from twin.study.remarks import remarks_of
from twin.study.store import FAILURE_FILE, Store
from twin.study.trials import nominal
from twin.study.worker import DIED, UNEXPECTED, MakeMeasurer
from twin.study.workers import Workers, lasting

# Measured on two cores of 2.5 GHz: camera noise dominates, then loading a pressed face.
_SECONDS_PER_FRAME_PIXEL = 9e-8
_SECONDS_PER_CASE = 0.3
_SECONDS_PER_PRESS, _SECONDS_PER_SHEET = 3.0, 20.0
_BYTES_PER_CASE = 24_000
_BYTES_PER_PIXEL = {"points": 160, "capture": 0, "press": 0}
_BYTES_PER_FRAME_PIXEL = 2
_PRESS_BYTES = 80_000_000


@dataclass(frozen=True)
class Estimate:
    """Run time and disk space of a run, within a factor of two for slabs and sheets.

    Attributes
    ----------
    step : 1 if all cases were examined; n if every n-th was examined, and the sums were scaled
    """

    cases: int
    known: int
    excluded: int
    seconds: float
    disk_bytes: float
    free_bytes: int
    step: int = 1


def estimate(record: StudyRecord, cases: Cases, store: Store, workers: int) -> Estimate:
    """Estimate run time and disk space of the cases that are not in the store."""
    known = store.finished() if store.exists() else set()
    unique = cases.unique()
    missing = [case for case in unique if case.digest not in known]
    presses = {_pressing(case.experiment): press_seconds(case.experiment) for case in missing}
    work = sum(_case_seconds(case.experiment) for case in missing) + sum(presses.values())
    folder = next(p for p in (store.folder, *store.folder.parents) if p.exists())
    return Estimate(
        cases=len(unique) * cases.step,
        known=(len(unique) - len(missing)) * cases.step,
        excluded=cases.excluded * cases.step,
        seconds=work * cases.step / workers + _calibration_seconds(record, store),
        disk_bytes=cases.step * sum(_case_bytes(record.study, case.experiment) for case in missing),
        free_bytes=shutil.disk_usage(folder).free,
        step=cases.step,
    )


def _calibration_seconds(record: StudyRecord, store: Store) -> float:
    """Return the time (s, one process) of the calibration for drawn rigs; 0 if it is cached."""
    board = drawn_board(record)
    if not board or (store.folder / CALIBRATION_FILE).is_file():
        return 0.0
    return len(load_board(board).poses) * _case_seconds(record.base)


def _pressing(experiment: Experiment) -> str:
    parts = {"mechanics", "specimen", "elastomer", "press"}
    return experiment.model_dump_json(include=parts)


def press_seconds(experiment: Experiment) -> float:
    """Return the approximate time of a press, s."""
    scene = experiment
    case = PressInput(scene.mechanics, scene.specimen, scene.elastomer, scene.press)
    wraps = any(model.wraps for model in possible_models(case))
    return _SECONDS_PER_SHEET if wraps else _SECONDS_PER_PRESS


def _pixels(experiment: Experiment) -> int:
    camera = experiment.camera
    return (camera.width_px // camera.binning) * (camera.height_px // camera.binning)


def _frame_pixels(experiment: Experiment) -> int:
    frames = len(pattern_set(experiment.projector, experiment.patterns).frames)
    return frames * _pixels(experiment)


def _case_seconds(experiment: Experiment) -> float:
    return _SECONDS_PER_CASE + _frame_pixels(experiment) * _SECONDS_PER_FRAME_PIXEL


def _case_bytes(study: Study, experiment: Experiment) -> float:
    bytes_per_case = _BYTES_PER_CASE
    if "points" in study.keep:
        bytes_per_case += _BYTES_PER_PIXEL["points"] * _pixels(experiment)
    if "capture" in study.keep:
        bytes_per_case += _BYTES_PER_FRAME_PIXEL * _frame_pixels(experiment)
    return bytes_per_case + (_PRESS_BYTES if "press" in study.keep else 0)


def forget_failures(store: Store, cases: Sequence[Case], every: bool = False) -> int:
    """Remove failures from a store so that they run again; returns their number.

    A failure that is due to the experiment itself would occur again, so by default only crashes and
    unexpected errors are removed.
    """
    forgotten = 0
    for case in cases:
        failure = store.path_of(case.digest) / FAILURE_FILE
        if failure.is_file() and (every or _kind_of(failure) in (DIED, UNEXPECTED)):
            store.forget(case.digest)
            forgotten += 1
    return forgotten


def forget_damaged(store: Store, cases: Sequence[Case]) -> dict[str, str]:
    """Remove cases with unreadable files, so that they run again; returns reasons by digest."""
    forgotten = {}
    for case in cases:
        entry = entry_of(store, case.digest)
        if entry is None or entry.state != DAMAGED:
            continue
        with store.claimed(case.digest) as mine:
            if mine:  # else another run computes it
                store.forget(case.digest)
                forgotten[case.digest] = entry.reason
    return forgotten


def _kind_of(failure: Path) -> str:
    try:
        return str(read_json(failure).get("kind"))
    except InputError:  # another run has removed it
        return ""


@dataclass(frozen=True)
class _Session:
    """A store during a run, with the digests of the requested cases."""

    store: Store
    compute: Run
    retry: bool
    requested: list[str] = field(default_factory=list)
    damaged: dict[str, str] = field(default_factory=dict)

    def run(self, cases: Cases) -> SweepOutcome:
        return self.compute(self.wanted(cases))

    def wanted(self, cases: Cases) -> list[Case]:
        """Return the cases without duplicates; failures that are to run again are removed."""
        wanted = cases.unique()
        self.requested.extend(case.digest for case in wanted)
        self.damaged.update(forget_damaged(self.store, wanted))
        forget_failures(self.store, wanted, every=self.retry)
        return wanted

    def whole(self, outcome: SweepOutcome) -> SweepOutcome:
        """Return the outcome with the states of all requested cases."""
        standing = _standing(Index(self.store), self.requested)
        return replace(outcome, damaged=self.damaged, **standing)


def sweep(
    record: StudyRecord,
    folder: Path,
    workers: Workers,
    *,
    cases: Cases | None = None,
    retry: bool = False,
    watch: ProgressCallback = no_progress,
    make_measurer: MakeMeasurer | None = None,
    inputs: Sequence[Path] = (),
    tell: Callable[[str], None] = lambda _: None,
) -> SweepOutcome:
    """Compute all cases of a study that are not in its store.

    Parameters
    ----------
    folder : the store; created if it does not exist
    cases : of the record, if they are known already
    retry : also run cases again that failed because of their experiment
    make_measurer : factory of the measurer of a case; importable by the workers. Default:
        `Measuring`, after a calibration of the rig if trials draw their rigs
    inputs : files that the folder must not contain
    tell : called with a message if another run uses the store, and for the first failures

    Raises
    ------
    InputError : the folder cannot be used; or the nominal measurement of trials cannot be made
    MissingBackend : no usable Dr.Jit backend
    """

    def run(of: StudyRecord, batch: Cases) -> SweepOutcome:
        write_record(folder, of)
        return session.run(batch)

    store, keep = Store(folder), record.study.keep
    of_trials = record.study.sampling.method == "trials"
    if of_trials:
        check_measurable(nominal(record.study, record.base))  # before anything is written
    store.open(inputs)
    with ExitStack() as stack:
        workers = stack.enter_context(lasting(workers))
        before: list[SweepOutcome] = []
        if of_trials:
            cases = cases or record.cases()
            first, make = nominal_case(cases), make_measurer or DEFAULT_MEASURING
            before.append(
                _measure_nominal(record, store, workers, first, make=make, watch=watch, retry=retry)
            )
        make = make_measurer or _measuring(record, folder, watch)
        session = stack.enter_context(
            _session(store, workers, keep, make, watch, retry=retry, tell=tell)
        )
        if record.study.sampling.method == "optimise":
            outcome = SweepOutcome.together(optimise(record, folder, run))
        elif record.study.sampling.method == "gradient":
            outcome = SweepOutcome.together(descend(record, folder, run))
        else:
            outcome = run(record, cases or record.cases())
    return session.whole(SweepOutcome.together([*before, outcome]))


def _measure_nominal(
    record: StudyRecord,
    store: Store,
    workers: Workers,
    case: Case,
    *,
    make: MakeMeasurer,
    watch: ProgressCallback,
    retry: bool,
) -> SweepOutcome:
    """Measure the nominal case of trials, with the true rig, before any calibration.

    Raises
    ------
    InputError : it fails, or lacks a measurand
    """
    write_record(store.folder, record)

    def progress(_: str, fraction: float, /) -> None:
        watch("nominal", fraction)

    keep = record.study.keep
    with _session(store, workers, keep, make, progress, retry=retry) as session:
        outcome = session.run(Cases((case,), 0))
    check_nominal(record, case, store)
    return outcome


@dataclass(frozen=True, eq=False)
class CaseGroup:
    """Cases of one store, and the factory of their measurer.

    Attributes
    ----------
    record : study of the cases, which is written into the store; None: the cases are no study
    """

    folder: Path
    cases: Cases
    make_measurer: MakeMeasurer = DEFAULT_MEASURING
    record: StudyRecord | None = None


def run_groups(
    groups: Sequence[CaseGroup], workers: Workers, watch: ProgressCallback = no_progress
) -> list[SweepOutcome]:
    """Compute the missing cases of several stores on the same workers: `run_together`.

    Parameters
    ----------
    groups : each with its own folder; in order of priority

    Raises
    ------
    InputError : a folder cannot be used
    MissingBackend : no usable Dr.Jit backend
    """
    for group in groups:
        Store(group.folder).open()
        if group.record is not None:
            write_record(group.folder, group.record)
    with ExitStack() as stack:
        sessions = [stack.enter_context(_session_of(group, workers, watch)) for group in groups]
        parts = [
            (session.compute, session.wanted(group.cases))
            for session, group in zip(sessions, groups, strict=True)
        ]
        outcomes = run_together(parts, workers, watch)
    return [session.whole(outcome) for session, outcome in zip(sessions, outcomes, strict=True)]


def _session_of(
    group: CaseGroup, workers: Workers, watch: ProgressCallback
) -> AbstractContextManager[_Session]:
    keep = () if group.record is None else group.record.study.keep
    return _session(Store(group.folder), workers, keep, group.make_measurer, watch, retry=False)


@contextmanager
def _session(
    store: Store,
    workers: Workers,
    keep: tuple[str, ...],
    make: MakeMeasurer,
    watch: ProgressCallback,
    *,
    retry: bool,
    tell: Callable[[str], None] = lambda _: None,
) -> Iterator[_Session]:
    try:
        with store.exclusive() as exclusive, lasting(workers) as lasting_workers:
            if not exclusive:
                tell(f"{store.folder}: another run is active; both share the remaining cases")
            run = Run(store, lasting_workers, keep, make, watch, Index(store).enter, tell)
            yield _Session(store, run, retry)
    finally:
        store.abandoned()  # incomplete cases of terminated workers


def _measuring(record: StudyRecord, folder: Path, watch: ProgressCallback) -> Measuring:
    """Return the measurer factory of a study; calibrates the rig if its trials draw rigs.

    The rig is calibrated in this process: its last digits depend on the number of threads of the
    linear algebra, which must not depend on the workers.
    """
    board = drawn_board(record)
    if not board:
        return DEFAULT_MEASURING
    return Measuring(calibrated(folder, nominal(record.study, record.base), board, watch))


def drawn_board(record: StudyRecord) -> str:
    """Return the board of the calibration from which trials draw rigs; empty: the true rig."""
    plan = record.study.sampling
    if plan.method != "trials" or plan.calibration == "true":
        return ""
    return plan.board if nominal(record.study, record.base).method.fringes else ""


def _standing(index: Index, requested: Sequence[str]) -> dict[str, Any]:
    """Return the number of finished requested cases, their warnings, and reasons of failure."""
    entries = index.entries()
    stored = [entries[digest] for digest in dict.fromkeys(requested) if digest in entries]
    failures: dict[str, list[str]] = {}
    for entry in stored:
        if entry.state == "failed":
            failures.setdefault(entry.reason, []).append(entry.digest)
    done = {entry.digest: entry.figures for entry in stored if entry.state == "done"}
    return {"finished": len(done), "failures": failures, "remarks": remarks_of(done)}


def estimate_text(estimated: Estimate) -> str:
    """Return an estimate as text in one line."""
    preview = f"about {counted(estimated.cases, 'case')}, from one point in {estimated.step}"
    parts = [counted(estimated.cases, "case") if estimated.step == 1 else preview]
    if estimated.excluded:
        parts.append(f"{estimated.excluded} more excluded by constraints")
    if estimated.known:
        parts.append(f"{estimated.known} of them in the store")
    parts.append(f"about {duration(estimated.seconds)}")
    parts.append(f"{_size(estimated.disk_bytes)} of {_size(estimated.free_bytes)} free disk")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Write a time in seconds, minutes or hours."""
    if seconds < 90:
        return f"{math.ceil(seconds)} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _size(count: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count / 1e3:.0f} kB"


def unmeasurable(cases: Sequence[Case]) -> dict[str, list[Case]]:
    """Return the cases that cannot be measured, by reason.

    The fields that the checks read are recorded, so that cases with the same values of these fields
    are checked once: cases that differ in seed, code or exposure only need no further check.
    """
    known: dict[tuple[FieldPath, ...], dict[tuple[bytes, ...], str]] = {}
    cases_by_reason: dict[str, list[Case]] = {}
    for case in cases:
        checked = ((reasons, values_at(case.experiment, paths)) for paths, reasons in known.items())
        reason = next((reasons[values] for reasons, values in checked if values in reasons), None)
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
    """Return cases along each axis of a search: ends and middle, all other axes at their middle.

    Raises
    ------
    ConfigError : none of them is a valid experiment that the constraints admit
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
