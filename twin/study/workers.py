"""Workers that compute cases: this process, processes of this machine, or a Dask cluster.

All are used through a `concurrent.futures.Executor`, and any other executor can be used
(`of_executor`). Batches and their reports can be pickled; the workers write results to the store.
"""

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from reconstruction.errors import InputError
from reconstruction.machine import VARIABLE, usable_cores
from twin.extras import missing
from twin.study.worker import die_with

_THREAD_VARIABLES = (
    VARIABLE,
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
)


_CONNECT_WITHIN = "20s"
_WAITS_FOR_EVER = sys.version_info < (3, 11, 5)
# Time limit for the thread that writes tasks to the workers: the thread ends within milliseconds
# unless its pipe is full.
_WRITER_ENDS_S = 1.0


def _end(executor: Executor) -> None:
    executor.shutdown(wait=True, cancel_futures=True)


@dataclass(frozen=True)
class Workers:
    """Description of the processes that compute cases, and how they are started and ended.

    Attributes
    ----------
    count : number of cases computed at the same time
    open : function that starts the processes, also again after one of them died
    close : function that ends the processes; waiting batches are not started
    release : function called at the end of a run; None: `close` is called
    """

    count: int
    open: Callable[[], Executor]
    close: Callable[[Executor], None] = _end
    release: Callable[[Executor], None] | None = None


class _Here(Executor):
    """Executor that computes each task in this process, within the call of `submit`."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def local_workers(count: int, cores: int | None = None) -> Workers:
    """Return workers on this machine: `count` processes; for 1, this process itself.

    Parameters
    ----------
    count : number of processes, which share the cores
    cores : number of cores that the processes share; if it is given, 1 worker is a separate
        process. Default: all usable cores

    Raises
    ------
    InputError : `count` is less than 1
    """
    available = cores or usable_cores()
    if count < 1:
        raise InputError(f"--workers: found {count}, allowed 1 or more, best {available} here")
    if count == 1 and cores is None:
        return Workers(1, _Here)
    threads = max(1, available // count)
    return Workers(count, lambda: _pool(count, threads))


@contextmanager
def lasting(workers: Workers) -> Iterator[Workers]:
    """Keep the worker processes and their cached stage results for all runs in the block."""
    held: list[Executor] = []
    try:
        yield replace(
            workers,
            open=lambda: held.pop() if held else workers.open(),
            release=held.append,
        )
    finally:
        for executor in held:
            (workers.release or workers.close)(executor)


@contextmanager
def opened(workers: Workers) -> Iterator[Executor]:
    """Yield an executor of the workers for other tasks; release the workers at the end."""
    executor = workers.open()
    try:
        yield executor
    finally:
        (workers.release or workers.close)(executor)


def default_count() -> int:
    """Return the default number of workers: one per two cores, but two for two or three cores."""
    cores = usable_cores()
    return max(min(cores, 2), cores // 2)


def dask_workers(address: str) -> Workers:
    """Return the workers of a running Dask cluster.

    The store must have the same path on all hosts of the cluster.

    Raises
    ------
    InputError : Dask is not installed, no scheduler answers, or it has no workers
    """
    client = _client(address)
    workers = client.scheduler_info(n_workers=-1)["workers"]
    client.close()
    if not workers:
        raise InputError(f"--cluster {address}: found no workers; start dask worker {address}")
    return Workers(len(workers), lambda: _Cluster(address))


class _Cluster(Executor):
    """Executor on a Dask cluster, with its own connection to the scheduler."""

    def __init__(self, address: str) -> None:
        self._client = _client(address)
        # `pure=False`, because Dask would otherwise compute two batches of equal content only
        # once.
        self._executor = self._client.get_executor(pure=False)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = self._executor.submit(fn, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._executor.shutdown(wait=wait)
        self._client.close()


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise missing("--cluster", "Dask", "sweep", "also on the workers") from None
    try:
        return Client(address, timeout=_CONNECT_WITHIN)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(
            f"--cluster {address}: no Dask scheduler answers ({type(error).__name__}); "
            "start one, or check the address"
        ) from None


def of_executor(executor: Executor, count: int) -> Workers:
    """Return workers that use a given executor with `count` workers; the caller ends the executor.

    If one of its workers dies, the run stops, because the executor cannot be started again here.
    """
    unused = [executor]

    def start() -> Executor:
        if not unused:
            raise InputError("executor: lost a worker; run again with a new executor to go on")
        return unused.pop()

    return Workers(count, start, lambda _: None)


def _pool(count: int, threads: int) -> Executor:
    # Not "fork": a forked child would lack the threads that Dr.Jit and Numba have started.
    return _LimitedPool(
        count,
        threads,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=die_with,
        initargs=(os.getpid(),),
    )


class _LimitedPool(ProcessPoolExecutor):
    """Pool of processes, each of which starts with a limited number of threads."""

    def __init__(self, count: int, threads: int, **options: Any) -> None:
        super().__init__(count, **options)
        self._threads_each = threads

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        with _environment(self._threads_each):  # all processes start at the first `submit`
            return super().submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        queue: Any = vars(self).get("_call_queue")
        if _WAITS_FOR_EVER and vars(self).get("_broken") and queue is not None:
            _fail_blocked_writer(queue)
        if isinstance(sys.exc_info()[1], KeyboardInterrupt):  # do not wait for running batches
            for child in multiprocessing.active_children():
                child.kill()  # SIGTERM has no effect on a stopped process
        super().shutdown(wait, cancel_futures=cancel_futures)


def _fail_blocked_writer(queue: Any) -> None:
    """Let the thread that writes to ended workers fail instead of waiting forever.

    This avoids issue 94777 of CPython; its later versions do this themselves. A thread that ends
    closes the reader itself, and two threads must not close the same descriptor. So the reader is
    closed here only if the thread is blocked.
    """
    writer = queue._thread
    if writer is None:
        return
    writer.join(_WRITER_ENDS_S)
    if writer.is_alive():
        queue._reader.close()


@contextmanager
def _environment(threads: int) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, str(threads)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
