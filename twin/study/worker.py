"""Worker process of a study: compute a batch of cases, each into its folder of the store."""

import os
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import isfinite
from pathlib import Path
from typing import Any, Literal, Protocol

from reconstruction.errors import InputError
from reconstruction.machine import is_disk_full, threads
from reconstruction.registry import load_inherited_plugins, load_plugin, plugin_files
from twin.config import Experiment
from twin.pipeline import Memory
from twin.results.parts import write_result, write_timings
from twin.study.measuring import (
    DEFAULT_MEASURING,
    NOMINAL_CONDITIONS,
    CaseMeasurer,
    CaseResult,
    Conditions,
    StageReads,
)
from twin.study.store import Store, write_failure

State = Literal["done", "failed", "elsewhere", "known", "unsaved"]
UNEXPECTED, DIED = "unexpected", "died"
_WATCH_EVERY_S = 0.5

# Only one case at a time can use renderer and caches of a process, but an executor may have
# several threads.
_one_at_a_time = threading.Lock()


class Measurer(Protocol):
    """Interface of an object that measures the cases of a study in a worker process."""

    def __call__(
        self, experiment: Experiment, conditions: Conditions = NOMINAL_CONDITIONS, /
    ) -> CaseResult:
        """Measure one case and return its figures."""

    def reads(self) -> StageReads:
        """Return the field paths that each stage read for the latest case, first stage first."""


MakeMeasurer = Callable[[tuple[str, ...]], Measurer]
"""Factory of a measurer, called once per process with the names of the arrays to write."""


CaseToRun = tuple[str, Experiment, Conditions]
"""Digest, experiment and conditions of a case."""


@dataclass(frozen=True)
class Batch:
    """Cases for one worker, ordered so that consecutive cases share as many stages as possible.

    Attributes
    ----------
    store : folder of the store
    cases : digest, experiment and conditions of each case
    keep : names of the arrays to write per case
    make_measurer : factory of the measurer, called once per process with `keep`
    """

    store: Path
    cases: tuple[CaseToRun, ...]
    keep: tuple[str, ...] = ()
    make_measurer: MakeMeasurer = DEFAULT_MEASURING

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the paths of the plug-in files, which are loaded before the experiments."""
        return _batch_after, (plugin_files(),), vars(self)


def _batch_after(plugins: Sequence[Path]) -> Batch:
    """Return a batch without attributes, after loading plug-ins; experiments have their classes."""
    for file in plugins:
        load_plugin(file)
    return object.__new__(Batch)


@dataclass(frozen=True)
class Report:
    """Outcome of one case of a batch.

    Attributes
    ----------
    digest : name of the case
    state : "done" or "failed": the case was computed and is in the store; "known": it was in the
        store already; "elsewhere": another run computes it; "unsaved": it could not be written
    seconds : run time, s, without that of storing; 0 if the case was not computed now
    reason : reason of a failure, or why the case could not be saved; else empty
    """

    digest: str
    state: State
    seconds: float = 0.0
    reason: str = ""


@dataclass(frozen=True)
class BatchReport:
    """Outcome of a batch: a report per case, and the fields that the stages of the last case read.

    The fields are used to sort the remaining cases.
    """

    cases: tuple[Report, ...]
    reads: StageReads = ()


def compute(batch: Batch) -> BatchReport:
    """Compute the cases of a batch that are not yet in the store; return their reports.

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    """
    with _one_at_a_time:
        measurer = _measurer(batch.make_measurer, batch.keep)
        store = Store(batch.store)
        with _limited_threads(measurer):
            reports = tuple(_computed(store, batch.cases, measurer))
        return BatchReport(reports, measurer.reads())


def die_with(parent: int) -> None:
    """Start a worker: load the parent's plug-ins, and end the process after the parent has ended.

    The process id of the parent is an argument, as the parent may end before this process reads the
    id.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_EVERY_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    # For tasks that are not a batch: unpickling an experiment needs the modules of its kinds. A
    # batch loads the plug-ins itself.
    load_inherited_plugins()


@lru_cache(maxsize=1)
def _memory() -> Memory:
    """Return the cache of the latest stage results of this process, which all measurers share.

    There is only one cache, because it contains stacks of frames, which need much memory.
    """
    return Memory()


def forget_stages() -> None:
    """Clear the cached stage results and measurers, so that the next case starts without them."""
    _measurer.cache_clear()
    _memory.cache_clear()


@lru_cache(maxsize=1)
def _measurer(make: MakeMeasurer, keep: tuple[str, ...]) -> Measurer:
    measurer = make(keep)
    if isinstance(measurer, CaseMeasurer):
        measurer.memory = _memory()
    return measurer


def _limited_threads(measurer: Measurer) -> AbstractContextManager[None]:
    """Limit the renderer to the number of threads of this process, if the measurer renders."""
    if not isinstance(measurer, CaseMeasurer):
        return nullcontext()
    from twin.optics.session import renderer_threads

    return renderer_threads(threads())


def _computed(store: Store, cases: Sequence[CaseToRun], measurer: Measurer) -> Iterator[Report]:
    """Compute cases; while one is computed, a second thread stores the previous one.

    To synchronise a sample of a data set to the disk takes a tenth of the time of its computation.
    """
    with ThreadPoolExecutor(1) as storing:
        waiting: list[Future[Report]] = []
        for case in cases:
            store_it = _compute_case(store, *case, measurer)
            yield from (stored.result() for stored in waiting)
            waiting = [storing.submit(store_it)]
        yield from (stored.result() for stored in waiting)


def _compute_case(
    store: Store, digest: str, experiment: Experiment, conditions: Conditions, measurer: Measurer
) -> Callable[[], Report]:
    """Compute a case into a part of the store; return the function that stores it."""
    start = time.perf_counter()
    with ExitStack() as stack:
        mine = stack.enter_context(store.claimed(digest))
        if store.path_of(digest).is_dir():
            return partial(Report, digest, "known")
        if not mine:
            return partial(Report, digest, "elsewhere")
        try:
            part = stack.enter_context(store.part(digest))
            report = _into_part(part, digest, experiment, conditions, measurer)
        except OSError as error:
            return partial(Report, digest, "unsaved", reason=_unsaved(error))
        held = stack.pop_all()
    report = replace(report, seconds=time.perf_counter() - start)
    return partial(_stored, store, part, report, held)


def _stored(store: Store, part: Path, report: Report, held: ExitStack) -> Report:
    """Publish the part of a computed case, then release what is held; return its report."""
    with held:
        try:
            store.publish(part, report.digest)
        except OSError as error:
            return Report(report.digest, "unsaved", reason=_unsaved(error))
    return report


def _into_part(
    part: Path, digest: str, experiment: Experiment, conditions: Conditions, measurer: Measurer
) -> Report:
    start = time.perf_counter()
    result = _measured(measurer, experiment, conditions)
    if isinstance(result, _Failure):
        write_failure(part, experiment, result.kind, result.reason, result.trace)
    else:
        write_result(part, "measure", experiment, result.figures)
        result.write(part)
    write_timings(part, {"case": time.perf_counter() - start})
    if isinstance(result, _Failure):
        return Report(digest, "failed", reason=result.reason)
    return Report(digest, "done")


@dataclass(frozen=True)
class _Failure:
    kind: str
    reason: str
    trace: str = ""


def _measured(
    measurer: Measurer, experiment: Experiment, conditions: Conditions
) -> CaseResult | _Failure:
    """Measure a case; return its failure instead of raising, so that the batch continues.

    Only a missing backend and a full disk are raised.
    """
    try:
        result = measurer(experiment, conditions)
        wrong = [n for n, v in result.figures.items() if isinstance(v, float) and not isfinite(v)]
        reason = f"{', '.join(wrong)}: not finite"
        return _Failure(UNEXPECTED, reason) if wrong else result
    except InputError as error:
        return _Failure(type(error).__name__, " ".join(str(error).split()))
    except Exception as error:
        if type(error).__name__ == "MissingBackend" or is_disk_full(error):
            raise
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return _Failure(UNEXPECTED, reason, traceback.format_exc())


def _unsaved(error: OSError) -> str:
    place = f" ({error.filename})" if error.filename else ""
    return f"{error.strerror or error}{place}; make room and run the sweep again"
