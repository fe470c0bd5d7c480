"""Run the cases of a study that its store lacks, on any executor, to the end.

One case per worker is computed ahead and tells which fields its stages look at; the others follow
in batches that share stages. A dead worker costs the case it was at: the rest of its batch is
handed out again, that case by itself, and one that kills its worker three times is recorded as
failed.

Several studies run together (`run_together`): where the first has nothing to hand out, because its
first cases or its last ones are still at work, the next one's go ahead.
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
from twin.study.measuring import PLAINLY, StageReads
from twin.study.order import batches_of, in_sharing_order
from twin.study.outcome import SweepOutcome
from twin.study.store import Store, write_failure
from twin.study.worker import DIED, Batch, BatchReport, MakeMeasurer, Report, compute
from twin.study.workers import Workers

_STRIKES = 3
_ROUNDS_AHEAD = 4  # where those computed ahead fail, or are at another run
_MOST_DEATHS = 10  # one after another, without any case finished between them
_FIRST_REASONS = 3
_AHEAD = 2  # batches per worker that wait in the executor
_WAIT_FOR_OTHERS_S = 0.2


@dataclass
class Run:
    """Runs of a study's cases into a store; what stages look at is known after the first.

    Attributes
    ----------
    done : told about every batch, for example to enter it into an index
    tell : told in a sentence, once each, the first reasons why cases fail, while others still run
    """

    store: Store
    workers: Workers
    keep: tuple[str, ...] = ()
    make_measurer: MakeMeasurer = PLAINLY
    watch: ProgressCallback = no_progress
    done: Callable[[Sequence[Report]], None] = lambda _: None
    tell: Callable[[str], None] = lambda _: None
    _missing: list[Case] = field(default_factory=list)
    _queue: deque[list[Case]] = field(default_factory=deque)
    _alone: deque[Case] = field(default_factory=deque)
    _strikes: Counter[str] = field(default_factory=Counter)
    _reports: dict[str, Report] = field(default_factory=dict)
    _reads: StageReads = ()
    _rounds_left: int = 0
    _batched: bool = False
    _at_work: int = 0
    _told: set[str] = field(default_factory=set)

    def __call__(self, cases: Iterable[Case]) -> SweepOutcome:
        """Compute what is not in the store yet.

        Raises
        ------
        MissingBackend : no usable Dr.Jit backend
        """
        return run_together([(self, cases)], self.workers, self.watch)[0]

    def begin(self, cases: Iterable[Case]) -> None:
        """Look up which cases the store lacks."""
        self._reports = {}
        self.store.abandoned()
        known = self.store.finished()
        self._missing = [case for case in cases if case.digest not in known]
        self._rounds_left, self._batched, self._at_work = _ROUNDS_AHEAD, False, 0

    @property
    def total(self) -> int:
        """Cases that the store lacked."""
        return len(self._missing)

    @property
    def ended(self) -> int:
        """How many of them have ended."""
        return sum(report.state != "elsewhere" for report in self._reports.values())

    def outcome(self, seconds: float) -> SweepOutcome:
        """Return what became of the cases, after so many seconds."""
        reports = self._reports.values()
        return SweepOutcome(
            states=Counter(report.state for report in reports),
            unsaved={r.digest: r.reason for r in reports if r.state == "unsaved"},
            seconds=seconds,
            busy_seconds=sum(report.seconds for report in reports),
        )

    def next_batch(self) -> list[Case] | None:
        """Take what can be handed out now; None: nothing, or the rest waits for what is out."""
        if not (self._queue or self._alone or self._at_work):
            self._refill()
        if not self._queue:
            return None
        self._at_work += 1
        return self._queue.popleft()

    def put_back(self, batch: list[Case]) -> None:
        """Take back a batch that could not be handed out."""
        self._at_work -= 1
        self._queue.appendleft(batch)

    def next_alone(self) -> Case | None:
        """Take a case that has to run by itself, for a worker died at it."""
        return self._alone.popleft() if self._alone else None

    def _refill(self) -> None:
        """Queue cases ahead; once stages are known all others; then what another run was at."""
        left = [case for case in self._missing if case.digest not in self._reports]
        if left and not self._reads and self._rounds_left:
            # One per worker and far apart.
            self._rounds_left -= 1
            step = max(1, len(left) // self.workers.count)
            self._queue.extend([case] for case in left[::step][: self.workers.count])
        elif left and not self._batched:
            self._batched = True
            self._queue.extend(batches_of(in_sharing_order(left, self._reads), self.workers.count))
        else:
            self._queue_elsewhere()

    def _queue_elsewhere(self) -> None:
        """Hand out again what another run was at."""
        states = {digest: report.state for digest, report in self._reports.items()}
        left = [case for case in self._missing if states.get(case.digest) == "elsewhere"]
        if left:
            time.sleep(_WAIT_FOR_OTHERS_S)
            self._queue.append(left)

    def enter_batch(self, found: BatchReport) -> None:
        """Take the report of a batch."""
        self._at_work -= 1
        self._note(found)

    def enter_alone(self, found: BatchReport) -> None:
        """Take the report of a case that ran by itself."""
        self._note(found)

    def _note(self, found: BatchReport) -> None:
        # A case that failed has not been through all stages.
        if not self._reads and found.cases[-1].state in ("done", "unsaved"):
            self._reads = found.reads if any(found.reads) else ()
        self._enter(found.cases)

    def lost(self, batches: list[list[Case]]) -> None:
        """Queue anew what a dead worker took along; what was being computed runs by itself."""
        suspects, known = set(self.store.abandoned()), self.store.finished()
        for batch in batches:
            self._at_work -= 1
            self._enter([Report(case.digest, "done") for case in batch if case.digest in known])
            left = [case for case in batch if case.digest not in known]
            self._alone.extend(case for case in left if case.digest in suspects)
            innocent = [case for case in left if case.digest not in suspects]
            if innocent:
                self._queue.appendleft(innocent)

    def lost_alone(self, case: Case) -> None:
        """Try a case again that its worker died at, but not for ever."""
        self._strikes[case.digest] += 1
        self.store.abandoned()
        if case.digest in self.store.finished():
            self._enter([Report(case.digest, "done")])
        elif self._strikes[case.digest] >= _STRIKES:
            self._give_up(case)
        else:
            self._alone.append(case)

    def _give_up(self, case: Case) -> None:
        reason = f"its worker died {_STRIKES} times (killed, out of memory, or a crash)"
        try:
            with self.store.claimed(case.digest), self.store.writing(case.digest) as folder:
                write_failure(folder, case.experiment, DIED, reason)
        except OSError as error:
            self._enter([Report(case.digest, "unsaved", reason=f"{reason}; {error.strerror}")])
            return
        self._enter([Report(case.digest, "failed", reason=reason)])

    def _enter(self, reports: Sequence[Report]) -> None:
        self._reports |= {report.digest: report for report in reports}
        self._tell_new(reports)
        self.done(reports)

    def _tell_new(self, reports: Sequence[Report]) -> None:
        for reason in dict.fromkeys(one.reason for one in reports if one.state == "failed"):
            if reason not in self._told and len(self._told) < _FIRST_REASONS:
                self._told.add(reason)
                self.tell(f"a case failed: {reason}")

    def batch(self, cases: list[Case]) -> Batch:
        """Return what a worker is told of some cases."""
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
    """Compute what the stores of several runs lack, on the same workers.

    Parameters
    ----------
    parts : in the order in which they are handed out; a later one fills the gaps of the earlier
    watch : told of the cases of all

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    """
    start = time.perf_counter()
    for run, cases in parts:
        run.begin(cases)
    runs = [run for run, _ in parts]
    if any(run.total for run in runs):
        _Together(runs, workers, watch).to_the_end()
    seconds = time.perf_counter() - start
    return [run.outcome(seconds) for run in runs]


_Pending = dict["Future[BatchReport]", tuple[Run, list[Case]]]


@dataclass
class _Together:
    """Runs at work on one executor."""

    runs: list[Run]
    workers: Workers
    watch: ProgressCallback
    _deaths: int = 0

    def to_the_end(self) -> None:
        executor = self.workers.open()
        try:
            while True:
                executor = self._drain(executor)
                alone = self._next_alone()
                if alone is None:
                    break
                executor = self._one_alone(executor, *alone)
        finally:
            (self.workers.release or self.workers.close)(executor)

    def _next(self) -> tuple[Run, list[Case]] | None:
        for run in self.runs:
            batch = run.next_batch()
            if batch is not None:
                return run, batch
        return None

    def _next_alone(self) -> tuple[Run, Case] | None:
        found = ((run, run.next_alone()) for run in self.runs)
        return next(((run, case) for run, case in found if case is not None), None)

    def _drain(self, executor: Executor) -> Executor:
        """Work off the queues."""
        pending: _Pending = {}
        while True:
            broken = not self._hand_out(executor, pending)
            if not (pending or broken):
                return executor
            if self._take_in(pending) or broken:
                executor = self._after_death(executor, list(pending.values()))
                pending.clear()

    def _hand_out(self, executor: Executor, pending: _Pending) -> bool:
        """Let some batches per worker wait in the executor; False: it takes none and has none."""
        while len(pending) < _AHEAD * self.workers.count:
            found = self._next()
            if found is None:
                break
            run, batch = found
            try:
                pending[executor.submit(compute, run.batch(batch))] = found
            except BrokenProcessPool:
                run.put_back(batch)
                return bool(pending)
        return True

    def _take_in(self, pending: _Pending) -> bool:
        """Wait for reports; tells whether a worker died."""
        died = False
        for future in wait(pending, return_when=FIRST_COMPLETED).done:
            try:
                report = future.result()
            except Exception as error:
                if not is_death(error):
                    raise
                died = True
                continue
            run, _ = pending.pop(future)
            run.enter_batch(report)
            self._entered()
        return died

    def _one_alone(self, executor: Executor, run: Run, case: Case) -> Executor:
        try:
            run.enter_alone(executor.submit(compute, run.batch([case])).result())
        except Exception as error:
            if not is_death(error):
                raise
            executor, before = self._after_death(executor, []), run.ended
            run.lost_alone(case)
            if run.ended == before:
                return executor
        self._entered()
        return executor

    def _entered(self) -> None:
        """Tell how far all are; workers do not die one after another."""
        self._deaths = 0
        total = sum(run.total for run in self.runs)
        self.watch("cases", sum(run.ended for run in self.runs) / max(total, 1))

    def _after_death(self, executor: Executor, lost: list[tuple[Run, list[Case]]]) -> Executor:
        """Start anew."""
        self.workers.close(executor)
        self._deaths += 1
        if self._deaths > _MOST_DEATHS:
            raise InputError("workers: found dying one after another; use -j 1 to see why")
        for run in self.runs:
            run.lost([batch for of, batch in lost if of is run])
        return self.workers.open()


def is_death(error: Exception) -> bool:
    """Tell whether an executor's error means that a worker was lost."""
    return isinstance(error, BrokenProcessPool) or type(error).__name__ == "KilledWorker"
