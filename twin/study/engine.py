"""Compute the cases of a study that its store lacks, on any `concurrent.futures.Executor`.

First one case per worker is computed, which reports the fields that its stages read. The other
cases follow in batches that share stages. If a worker dies, its batch is queued again. The case
that it was computing is repeated in isolation: no other case runs at the same time. If its worker
dies three times in isolation, the case is recorded as failed.

Several studies can run together (`run_together`). While the first or last cases of a study are
computed, the study may have no batch to submit; then batches of the next study are submitted.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field

from reconstruction.errors import InputError
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.study.cases import Case
from twin.study.measuring import DEFAULT_MEASURING, StageReads
from twin.study.order import batches_of, in_sharing_order
from twin.study.outcome import SweepOutcome
from twin.study.store import Store, write_failure
from twin.study.worker import DIED, Batch, BatchReport, MakeMeasurer, Report, compute
from twin.study.workers import Workers

_MOST_DEATHS_EACH = 3
_ROUNDS_AHEAD = 4  # rounds of first cases: these may fail, or another run may compute them
_MOST_DEATHS = 10  # consecutive deaths of workers without a finished case between them
_FIRST_REASONS = 3
_AHEAD = 2  # batches per worker that are submitted to the executor at the same time
_WAIT_FOR_OTHERS_S = 0.2


@dataclass
class Run:
    """Computation of the cases of one study into its store.

    Attributes
    ----------
    store : store of the study
    workers : processes that compute the cases
    keep : names of the arrays to write for each case
    make_measurer : makes the measurer of a worker process
    watch : called with the share of all cases that have ended
    done : called with the reports of every batch, for example to enter them into an index
    tell : called with a message for each of the first three reasons of failure, while cases still
        run
    """

    store: Store
    workers: Workers
    keep: tuple[str, ...] = ()
    make_measurer: MakeMeasurer = DEFAULT_MEASURING
    watch: ProgressCallback = no_progress
    done: Callable[[Sequence[Report]], None] = lambda _: None
    tell: Callable[[str], None] = lambda _: None
    _missing: list[Case] = field(default_factory=list)
    _queue: deque[list[Case]] = field(default_factory=deque)
    _isolated: deque[list[Case]] = field(default_factory=deque)
    _isolated_deaths: Counter[str] = field(default_factory=Counter)
    _reports: dict[str, Report] = field(default_factory=dict)
    _reads: StageReads = ()
    _rounds_left: int = 0
    _batched: bool = False
    _running: int = 0
    _reported: set[str] = field(default_factory=set)

    def __call__(self, cases: Iterable[Case]) -> SweepOutcome:
        """Compute the cases that the store lacks, and return the outcome of the run.

        Raises
        ------
        MissingBackend : no usable Dr.Jit backend
        """
        return run_together([(self, cases)], self.workers, self.watch)[0]

    def begin(self, cases: Iterable[Case]) -> None:
        """Start a run: determine the cases that are not in the store."""
        self._reports = {}
        self.store.abandoned()
        known = self.store.finished()
        self._missing = [case for case in cases if case.digest not in known]
        self._rounds_left, self._batched, self._running = _ROUNDS_AHEAD, False, 0

    @property
    def total(self) -> int:
        """Number of cases that were not in the store when the run began."""
        return len(self._missing)

    @property
    def ended(self) -> int:
        """Number of cases of this run that have ended: computed, failed or not saved."""
        return sum(report.state != "elsewhere" for report in self._reports.values())

    def outcome(self, seconds: float) -> SweepOutcome:
        """Return the outcome of the run, which took `seconds` of wall-clock time."""
        reports = self._reports.values()
        return SweepOutcome(
            states=Counter(report.state for report in reports),
            unsaved={r.digest: r.reason for r in reports if r.state == "unsaved"},
            seconds=seconds,
            busy_seconds=sum(report.seconds for report in reports),
        )

    def next_batch(self) -> list[Case] | None:
        """Take the next batch from the queue and return it.

        None if there is no batch, or if the further cases depend on batches that are still running.
        """
        if not (self._queue or self._isolated or self._running):
            self._refill()
        return self._taken(self._queue)

    def next_isolated(self) -> list[Case] | None:
        """Take a batch with one case during which a worker died; None if there is none.

        No other case may run at the same time.
        """
        return self._taken(self._isolated)

    def _taken(self, queue: deque[list[Case]]) -> list[Case] | None:
        if not queue:
            return None
        self._running += 1
        return queue.popleft()

    def put_back(self, batch: list[Case], *, isolated: bool) -> None:
        """Put a batch back at the front of its queue, as the executor did not accept it."""
        self._running -= 1
        (self._isolated if isolated else self._queue).appendleft(batch)

    def _refill(self) -> None:
        """Queue the first cases, then all others, then those that another run was computing."""
        left = [case for case in self._missing if case.digest not in self._reports]
        if left and not self._reads and self._rounds_left:
            # One case per worker, evenly spaced over the remaining cases.
            self._rounds_left -= 1
            step = max(1, len(left) // self.workers.count)
            self._queue.extend([case] for case in left[::step][: self.workers.count])
        elif left and not self._batched:
            self._batched = True
            self._queue.extend(batches_of(in_sharing_order(left, self._reads), self.workers.count))
        else:
            self._queue_elsewhere()

    def _queue_elsewhere(self) -> None:
        """Queue again the cases that another run was computing."""
        states = {digest: report.state for digest, report in self._reports.items()}
        left = [case for case in self._missing if states.get(case.digest) == "elsewhere"]
        if left:
            time.sleep(_WAIT_FOR_OTHERS_S)
            self._queue.append(left)

    def enter(self, report: BatchReport) -> None:
        """Record the reports of the cases of a batch."""
        self._running -= 1
        # A failed case has not run all stages.
        if not self._reads and report.cases[-1].state in ("done", "unsaved"):
            self._reads = report.reads if any(report.reads) else ()
        self._enter(report.cases)

    def lost(self, batches: list[list[Case]], *, isolated: bool) -> None:
        """Queue the batches of a dead worker again; its current case is repeated in isolation.

        Parameters
        ----------
        batches : the batches that were submitted to the executor when the worker died
        isolated : True if the batch was a case in isolation; the death is then counted for this
            case
        """
        suspects, known = set(self.store.abandoned()), self.store.finished()
        for batch in batches:
            self._running -= 1
            self._enter([Report(case.digest, "done") for case in batch if case.digest in known])
            left = [case for case in batch if case.digest not in known]
            if isolated:
                self._charge(left)
                continue
            self._isolated.extend([case] for case in left if case.digest in suspects)
            innocent = [case for case in left if case.digest not in suspects]
            if innocent:
                self._queue.appendleft(innocent)

    def _charge(self, cases: list[Case]) -> None:
        for case in cases:
            self._isolated_deaths[case.digest] += 1
            if self._isolated_deaths[case.digest] >= _MOST_DEATHS_EACH:
                self._give_up(case)
            else:
                self._isolated.append([case])

    def _give_up(self, case: Case) -> None:
        reason = f"its worker died {_MOST_DEATHS_EACH} times (killed, out of memory, or a crash)"
        try:
            with self.store.claimed(case.digest), self.store.writing(case.digest) as folder:
                write_failure(folder, case.experiment, DIED, reason)
        except OSError as error:
            self._enter([Report(case.digest, "unsaved", reason=f"{reason}; {error.strerror}")])
            return
        self._enter([Report(case.digest, "failed", reason=reason)])

    def _enter(self, reports: Sequence[Report]) -> None:
        self._reports |= {report.digest: report for report in reports}
        self._report_failures(reports)
        self.done(reports)

    def _report_failures(self, reports: Sequence[Report]) -> None:
        for reason in dict.fromkeys(
            report.reason for report in reports if report.state == "failed"
        ):
            if reason not in self._reported and len(self._reported) < _FIRST_REASONS:
                self._reported.add(reason)
                self.tell(f"a case failed: {reason}")

    def batch(self, cases: list[Case]) -> Batch:
        """Return a batch: the cases and the options that a worker needs to compute them."""
        return Batch(
            store=self.store.folder,
            cases=tuple((case.digest, case.experiment, case.conditions) for case in cases),
            keep=self.keep,
            make_measurer=self.make_measurer,
        )


def run_together(
    parts: Sequence[tuple[Run, Iterable[Case]]],
    workers: Workers,
    watch: ProgressCallback = no_progress,
) -> list[SweepOutcome]:
    """Compute the cases that the stores of several runs lack, on the same workers.

    Parameters
    ----------
    parts : runs with their cases, in order of priority: batches of a later run are submitted while
        the earlier runs have none
    workers : processes that compute the cases of all runs
    watch : called with the share of all cases that have ended

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    """
    start = time.perf_counter()
    for run, cases in parts:
        run.begin(cases)
    runs = [run for run, _ in parts]
    if any(run.total for run in runs):
        _Together(runs, workers, watch).run_to_end()
    seconds = time.perf_counter() - start
    return [run.outcome(seconds) for run in runs]


@dataclass
class _Together:
    """Runs that share an executor.

    Attributes
    ----------
    runs : the runs in order of priority
    workers : processes that compute the cases of all runs
    watch : called with the share of all cases that have ended
    _pending : run and cases of each batch that was submitted to the executor, by its future
    _isolated : True if the only pending batch is a case during which a worker died before
    _deaths : number of consecutive deaths of workers without a finished case between them
    """

    runs: list[Run]
    workers: Workers
    watch: ProgressCallback
    _pending: dict["Future[BatchReport]", tuple[Run, list[Case]]] = field(default_factory=dict)
    _isolated: bool = False
    _deaths: int = 0

    def run_to_end(self) -> None:
        executor = self.workers.open()
        try:
            while True:
                broken = not self._submit(executor)
                if not (self._pending or broken):
                    return
                if self._collect() or broken:
                    executor = self._after_death(executor)
        finally:
            (self.workers.release or self.workers.close)(executor)

    def _submit(self, executor: Executor) -> bool:
        """Submit batches until there are two per worker; return False if that is impossible.

        False means that the executor is broken and has no pending batch.
        """
        while len(self._pending) < (1 if self._isolated else _AHEAD * self.workers.count):
            assigned = self._next()
            if assigned is None:
                break
            run, batch = assigned
            try:
                self._pending[executor.submit(compute, run.batch(batch))] = assigned
            except BrokenProcessPool:
                run.put_back(batch, isolated=self._isolated)
                return bool(self._pending)
        return True

    def _next(self) -> tuple[Run, list[Case]] | None:
        """Take the next batch of any run, or a case to be run in isolation.

        Such a case is taken only if no run has a batch and no batch is pending. None if there is
        nothing to take.
        """
        self._isolated = False
        for run in self.runs:
            if (batch := run.next_batch()) is not None:
                return run, batch
        for run in self.runs if not self._pending else ():
            if (batch := run.next_isolated()) is not None:
                self._isolated = True
                return run, batch
        return None

    def _collect(self) -> bool:
        """Wait for the next reports and record them; return True if a worker died."""
        died = False
        for future in wait(self._pending, return_when=FIRST_COMPLETED).done:
            try:
                report = future.result()
            except Exception as error:
                if not is_death(error):
                    raise
                died = True
                continue
            run, _ = self._pending.pop(future)
            run.enter(report)
            self._report_progress()
        return died

    def _report_progress(self) -> None:
        """Report the share of all cases that have ended, and reset the count of deaths to 0."""
        self._deaths = 0
        total = sum(run.total for run in self.runs)
        self.watch("cases", self._ended() / max(total, 1))

    def _ended(self) -> int:
        return sum(run.ended for run in self.runs)

    def _after_death(self, executor: Executor) -> Executor:
        """Queue the lost batches again, start new workers and return their executor."""
        self.workers.close(executor)
        self._deaths += 1
        if self._deaths > _MOST_DEATHS:
            raise InputError("workers: died one after another; use -j 1 to see the reason")
        before = self._ended()
        for run in self.runs:
            lost = [batch for owner, batch in self._pending.values() if owner is run]
            run.lost(lost, isolated=self._isolated)
        self._pending.clear()
        if self._ended() > before:
            self._report_progress()
        return self.workers.open()


def is_death(error: Exception) -> bool:
    """Return True if an error of an executor means that a worker died."""
    return isinstance(error, BrokenProcessPool) or type(error).__name__ == "KilledWorker"
