"""Run the cases of a study that its store lacks, on any executor, to the end.

One case per worker is computed ahead and tells which fields its stages look at; the others follow
in batches that share stages. A dead worker costs the case it was at: the rest of its batch is
handed out again, that case by itself, and one that kills its worker three times is recorded as
failed.

What a stage looks at is known from the cases computed ahead: the others are sorted by the values in
these fields, first stage first, so that neighbours share their stages. A wrong order costs time,
never a result.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from itertools import groupby

from reconstruction.errors import InputError
from twin.pipeline.memory import values_at
from twin.pipeline.progress import ProgressCallback, no_progress
from twin.study.cases import Case
from twin.study.measuring import PLAINLY, StageReads
from twin.study.store import Store, write_failure
from twin.study.worker import DIED, Batch, BatchReport, MakeMeasurer, Report, State, compute
from twin.study.workers import Workers

_STRIKES = 3
_ROUNDS_AHEAD = 4  # where those computed ahead fail, or are at another run
_MOST_DEATHS = 10  # one after another, without any case finished between them
_FIRST_REASONS = 3
_AHEAD = 2  # batches per worker that wait in the executor
_WAIT_FOR_OTHERS_S = 0.2


@dataclass(frozen=True)
class SweepOutcome:
    """What a run did.

    Attributes
    ----------
    states : how many cases ended in which state
    unsaved : reason of every case that could not be written, by digest
    seconds : wall clock of the run
    busy_seconds : spent on cases, over all workers
    finished : cases of the study that have a result, now or before
    failures : digests of those that failed, now or before, by reason
    damaged : cases whose files could not be read and that ran again, by digest, and why
    """

    states: Mapping[State, int]
    unsaved: dict[str, str]
    seconds: float
    busy_seconds: float
    finished: int = 0
    failures: Mapping[str, Sequence[str]] = field(default_factory=dict)
    damaged: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def together(cls, parts: Sequence["SweepOutcome"]) -> "SweepOutcome":
        """Return what several runs, one after another, did."""
        states: Counter[State] = Counter()
        for part in parts:
            states.update(part.states)
        return cls(
            states=states,
            unsaved={digest: why for part in parts for digest, why in part.unsaved.items()},
            seconds=sum(part.seconds for part in parts),
            busy_seconds=sum(part.busy_seconds for part in parts),
        )


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
    _queue: deque[list[Case]] = field(default_factory=deque)
    _alone: deque[Case] = field(default_factory=deque)
    _strikes: Counter[str] = field(default_factory=Counter)
    _reports: dict[str, Report] = field(default_factory=dict)
    _reads: StageReads = ()
    _total: int = 0
    _deaths: int = 0
    _told: set[str] = field(default_factory=set)

    def __call__(self, cases: Iterable[Case]) -> SweepOutcome:
        """Compute what is not in the store yet.

        Raises
        ------
        MissingBackend : no usable Dr.Jit backend
        """
        start = time.perf_counter()
        self._reports = {}
        self.store.abandoned()
        known = self.store.finished()
        missing = [case for case in cases if case.digest not in known]
        self._total = len(missing)
        if missing:
            self._run(missing)
        states = Counter(report.state for report in self._reports.values())
        return SweepOutcome(
            states=states,
            unsaved={r.digest: r.reason for r in self._reports.values() if r.state == "unsaved"},
            seconds=time.perf_counter() - start,
            busy_seconds=sum(report.seconds for report in self._reports.values()),
        )

    def _run(self, missing: list[Case]) -> None:
        executor = self.workers.open()
        try:
            if not self._reads:
                executor = self._scout(executor, missing)
            rest = [case for case in missing if case.digest not in self._reports]
            keyed = in_sharing_order(rest, self._reads)
            self._queue.extend(batches_of(keyed, self.workers.count))
            while self._queue or self._alone or self._elsewhere(missing):
                executor = self._drain(executor)
        finally:
            (self.workers.release or self.workers.close)(executor)

    def _scout(self, executor: Executor, cases: list[Case]) -> Executor:
        """Compute some cases ahead, one per worker and far apart, until stages are known."""
        for _ in range(_ROUNDS_AHEAD):
            left = [case for case in cases if case.digest not in self._reports]
            if self._reads or not left:
                break
            step = max(1, len(left) // self.workers.count)
            self._queue.extend([case] for case in left[::step][: self.workers.count])
            executor = self._drain(executor)
        return executor

    def _elsewhere(self, missing: list[Case]) -> bool:
        """Hand out again what another run was at; tells whether there is any."""
        left = [c for c in missing if self._reports[c.digest].state == "elsewhere"]
        if left:
            time.sleep(_WAIT_FOR_OTHERS_S)
            self._queue.append(left)
        return bool(left)

    def _drain(self, executor: Executor) -> Executor:
        """Work off the queue, then the cases that have to run by themselves."""
        pending: dict[Future[BatchReport], list[Case]] = {}
        while self._queue or pending:
            while self._queue and len(pending) < _AHEAD * self.workers.count:
                batch = self._queue.popleft()
                try:
                    pending[executor.submit(compute, self._batch(batch))] = batch
                except BrokenProcessPool:
                    self._queue.appendleft(batch)
                    break
            broken = not pending
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                try:
                    self._enter_batch(future.result())
                    del pending[future]
                except Exception as error:
                    if not is_death(error):
                        raise
                    broken = True
            if broken:
                executor = self._after_death(executor, list(pending.values()))
                pending.clear()
        while self._alone:
            executor = self._one_alone(executor)
        return executor

    def _one_alone(self, executor: Executor) -> Executor:
        case = self._alone.popleft()
        try:
            self._enter_batch(executor.submit(compute, self._batch([case])).result())
        except Exception as error:
            if not is_death(error):
                raise
            self._strikes[case.digest] += 1
            executor = self._after_death(executor, [])
            if case.digest in self.store.finished():
                self._enter([Report(case.digest, "done")])
            elif self._strikes[case.digest] >= _STRIKES:
                self._give_up(case)
            else:
                self._alone.append(case)
        return executor

    def _after_death(self, executor: Executor, lost: list[list[Case]]) -> Executor:
        """Start anew; cases that were being computed run alone, the others are queued again."""
        self.workers.close(executor)
        self._deaths += 1
        if self._deaths > _MOST_DEATHS:
            raise InputError("workers: found dying one after another; use -j 1 to see why")
        suspects, known = set(self.store.abandoned()), self.store.finished()
        for batch in lost:
            self._enter([Report(case.digest, "done") for case in batch if case.digest in known])
            left = [case for case in batch if case.digest not in known]
            self._alone.extend(case for case in left if case.digest in suspects)
            innocent = [case for case in left if case.digest not in suspects]
            if innocent:
                self._queue.appendleft(innocent)
        return self.workers.open()

    def _give_up(self, case: Case) -> None:
        reason = f"its worker died {_STRIKES} times (killed, out of memory, or a crash)"
        try:
            with self.store.claimed(case.digest), self.store.writing(case.digest) as folder:
                write_failure(folder, case.experiment, DIED, reason)
        except OSError as error:
            self._enter([Report(case.digest, "unsaved", reason=f"{reason}; {error.strerror}")])
            return
        self._enter([Report(case.digest, "failed", reason=reason)])

    def _enter_batch(self, found: BatchReport) -> None:
        # A case that failed has not been through all stages.
        if not self._reads and found.cases[-1].state in ("done", "unsaved"):
            self._reads = found.reads if any(found.reads) else ()
        self._enter(found.cases)

    def _enter(self, reports: Sequence[Report]) -> None:
        self._reports |= {report.digest: report for report in reports}
        self._deaths = 0 if reports else self._deaths
        self._tell_new(reports)
        self.done(reports)
        ended = sum(report.state != "elsewhere" for report in self._reports.values())
        self.watch("cases", ended / max(self._total, 1))

    def _tell_new(self, reports: Sequence[Report]) -> None:
        for reason in dict.fromkeys(one.reason for one in reports if one.state == "failed"):
            if reason not in self._told and len(self._told) < _FIRST_REASONS:
                self._told.add(reason)
                self.tell(f"a case failed: {reason}")

    def _batch(self, cases: list[Case]) -> Batch:
        return Batch(
            store=self.store.folder,
            cases=tuple((case.digest, case.experiment, case.conditions) for case in cases),
            keep=self.keep,
            make_measurer=self.make_measurer,
        )


def is_death(error: Exception) -> bool:
    """Tell whether an executor's error means that a worker was lost."""
    return isinstance(error, BrokenProcessPool) or type(error).__name__ == "KilledWorker"


Key = tuple[Hashable, ...]
BATCHES_PER_WORKER, LEAST_BATCHES_PER_WORKER = 6, 3


def in_sharing_order(cases: Sequence[Case], reads: StageReads) -> list[tuple[Key, Case]]:
    """Sort cases by what each stage would see of them; the first of a kind keeps its place.

    Methods have stages of the same name, but share few: their cases are kept apart first.
    """
    reads = ((("modality",),), *reads)
    ranks: list[dict[Hashable, int]] = [{} for _ in reads]
    keyed = []
    for case in cases:
        key = tuple(
            rank.setdefault(values_at(case.experiment, paths), len(rank))
            for rank, paths in zip(ranks, reads, strict=True)
        )
        keyed.append((key, case))
    return sorted(keyed, key=lambda item: item[0])


def batches_of(keyed: Sequence[tuple[Key, Case]], workers: int) -> list[list[Case]]:
    """Cut sorted cases into batches, several per worker, rather between stages than within.

    The last ones have half the size, so that workers end at about the same time. Cases that share
    the first stage in which any differ stay together where there are enough such groups: the
    worker that has, say, the sensor's calibration is not always the one that is free.
    """
    if not keyed:
        return []
    whole, fair = _largest_group(keyed), -(-len(keyed) // (workers * LEAST_BATCHES_PER_WORKER))
    whole = whole if workers > 1 and whole <= fair else 1
    most = max(whole, -(-len(keyed) // (workers * BATCHES_PER_WORKER)))
    parts, ending = _cut(list(keyed), 0, most), 2 * workers
    halves = [
        half for part in parts[-ending:] for half in _cut(part, 0, max(whole, -(-len(part) // 2)))
    ]
    return [[case for _, case in part] for part in parts[:-ending] + halves]


def _largest_group(keyed: Sequence[tuple[Key, Case]]) -> int:
    """Return how many cases at most share the first stage in which any of them differ."""
    for level in range(len(keyed[0][0])):
        sizes = Counter(key[level] for key, _ in keyed)
        if len(sizes) > 1:
            return max(sizes.values())
    return 1


def _cut(keyed: list[tuple[Key, Case]], level: int, most: int) -> list[list[tuple[Key, Case]]]:
    """Split by the stages from `level` on; small neighbours of one stage go together."""
    if len(keyed) <= most:
        return [keyed]
    if level == len(keyed[0][0]):
        return [keyed[i : i + most] for i in range(0, len(keyed), most)]
    by_level: Callable[[tuple[Key, Case]], Hashable] = lambda item: item[0][level]  # noqa: E731
    parts: list[list[tuple[Key, Case]]] = []
    for _, group in groupby(keyed, key=by_level):
        for part in _cut(list(group), level + 1, most):
            if parts and len(parts[-1]) + len(part) <= most:
                parts[-1] += part
            else:
                parts.append(part)
    return parts
