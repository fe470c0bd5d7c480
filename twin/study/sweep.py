"""Run a study: compute the cases that its store lacks."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from reconstruction.reading import read_json
from twin.pipeline.methods import check_measurable
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.study.cases import Case, Cases
from twin.study.engine import Run, run_together
from twin.study.gradient import descend
from twin.study.index import DAMAGED, Index, entry_of
from twin.study.measuring import DEFAULT_MEASURING, Measuring, calibrated
from twin.study.nominal import check_nominal, nominal_case
from twin.study.optimise import optimise
from twin.study.outcome import SweepOutcome
from twin.study.record import StudyRecord, write_record
from twin.study.remarks import remarks_of
from twin.study.store import FAILURE_FILE, Store
from twin.study.trials import drawn_board, nominal
from twin.study.worker import DIED, UNEXPECTED, MakeMeasurer
from twin.study.workers import Workers, lasting


def forget_failures(store: Store, cases: Sequence[Case], every: bool = False) -> int:
    """Remove failed cases from a store so that they run again; return their number.

    A failure that is due to the experiment would occur again. So only crashes and unexpected
    errors are removed, unless `every` is True.
    """
    forgotten = 0
    for case in cases:
        failure = store.path_of(case.digest) / FAILURE_FILE
        if failure.is_file() and (every or _kind_of(failure) in (DIED, UNEXPECTED)):
            store.forget(case.digest)
            forgotten += 1
    return forgotten


def forget_damaged(store: Store, cases: Sequence[Case]) -> dict[str, str]:
    """Remove cases with unreadable files so that they run again; return reasons by digest."""
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
    """A store during a run, with the cases that were requested.

    Attributes
    ----------
    store : the store
    compute : computes cases into the store
    retry : True: also run cases again that failed because of their experiment
    requested : the requested cases by digest
    damaged : reasons, by digest, why damaged cases run again
    """

    store: Store
    compute: Run
    retry: bool
    requested: dict[str, Case] = field(default_factory=dict)
    damaged: dict[str, str] = field(default_factory=dict)

    def run(self, cases: Cases) -> SweepOutcome:
        return self.compute(self.wanted(cases))

    def wanted(self, cases: Cases) -> list[Case]:
        """Return the cases without duplicates; remove from the store those that must run again."""
        wanted = cases.unique()
        self.requested.update((case.digest, case) for case in wanted)
        self.damaged.update(forget_damaged(self.store, wanted))
        forget_failures(self.store, wanted, every=self.retry)
        return wanted

    def whole(self, outcome: SweepOutcome) -> SweepOutcome:
        """Return an outcome, completed by results, warnings and failures of all requested cases."""
        standing = _standing(Index(self.store), self.requested)
        return replace(outcome, damaged=self.damaged, folder=self.store.folder, **standing)


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
    """Compute all cases of a study that are not yet in its store; return the outcome.

    Parameters
    ----------
    record : the study with its base experiment
    folder : the store; it is created if it does not exist
    workers : processes that compute the cases
    cases : cases of the record, if the caller has already built them; default: they are built
    retry : also run cases again that failed because of their experiment
    make_measurer : importable function that returns each worker's measurer; None: a `Measuring`
    inputs : files that the study reads; InputError if the folder is one of them or contains one
    tell : called with a sentence if another run uses the store, and for the first failed cases

    Raises
    ------
    InputError : the folder cannot be used, or the nominal measurement of trials fails
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
    InputError : the nominal measurement fails, or lacks a measurand
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
    """Cases that are computed into one store, and the factory of their measurer.

    Attributes
    ----------
    folder : the store
    record : study of the cases, which is written into the store; None: the cases do not belong to
        a study
    """

    folder: Path
    cases: Cases
    make_measurer: MakeMeasurer = DEFAULT_MEASURING
    record: StudyRecord | None = None


def run_groups(
    groups: Sequence[CaseGroup],
    workers: Workers,
    watch: ProgressCallback = no_progress,
    *,
    retry: bool = False,
) -> list[SweepOutcome]:
    """Compute the missing cases of several stores on the same workers; return the outcomes.

    Parameters
    ----------
    groups : cases, each group with its own folder, in order of priority (see `run_together`)
    retry : also run cases again that failed because of their experiment

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
        sessions = [
            stack.enter_context(_session_of(group, workers, watch, retry)) for group in groups
        ]
        parts = [
            (session.compute, session.wanted(group.cases))
            for session, group in zip(sessions, groups, strict=True)
        ]
        outcomes = run_together(parts, workers, watch)
    return [session.whole(outcome) for session, outcome in zip(sessions, outcomes, strict=True)]


def _session_of(
    group: CaseGroup, workers: Workers, watch: ProgressCallback, retry: bool
) -> AbstractContextManager[_Session]:
    keep = () if group.record is None else group.record.study.keep
    return _session(Store(group.folder), workers, keep, group.make_measurer, watch, retry=retry)


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
        store.abandoned()  # removes incomplete cases of terminated workers


def _measuring(record: StudyRecord, folder: Path, watch: ProgressCallback) -> Measuring:
    """Return the measurer factory of a study; calibrate the rig if the trials draw rigs.

    The rig is calibrated in this process. The last digits of a calibration depend on the number of
    threads of the linear algebra, and the result must not depend on the number of workers.
    """
    board = drawn_board(record.study, record.base)
    if not board:
        return DEFAULT_MEASURING
    return Measuring(calibrated(folder, nominal(record.study, record.base), board, watch))


def _standing(index: Index, requested: Mapping[str, Case]) -> dict[str, Any]:
    """Return number of results, warnings and reasons of failure of the requested cases."""
    entries = index.entries()
    stored = [entries[digest] for digest in requested if digest in entries]
    failures: dict[str, list[str]] = {}
    for entry in stored:
        if entry.state == "failed":
            failures.setdefault(entry.reason, []).append(entry.digest)
    done = {entry.digest: entry.figures for entry in stored if entry.state == "done"}
    return {
        "finished": len(done),
        "failures": failures,
        "remarks": remarks_of(done, requested.values()),
    }
