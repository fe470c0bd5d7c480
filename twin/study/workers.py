"""Who computes: this process, a pool of processes on this machine, or a Dask cluster.

Anything with the interface of `concurrent.futures.Executor` will do (`of_executor`): batches and
their reports are plain data, and results go to the store, not through the executor.
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


@dataclass(frozen=True)
class Workers:
    """Computing processes.

    Attributes
    ----------
    count : how many compute at once
    open : starts them, and again after one of them died
    close : ends them; what still waits is not begun
    release : takes them back at the end of a run, by default to end them
    """

    count: int
    open: Callable[[], Executor]
    close: Callable[[Executor], None]
    release: Callable[[Executor], None] | None = None


class _Here(Executor):
    """Computes in this process, at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def local_workers(count: int, cores: int | None = None) -> Workers:
    """Return `count` processes that share the machine; 1 is this process itself.

    Parameters
    ----------
    cores : how many they share; 1 worker then is a process of its own. Default: all

    Raises
    ------
    InputError : fewer than one
    """
    available = cores or usable_cores()
    if count < 1:
        raise InputError(f"--workers: found {count}, allowed 1 or more, best {available} here")
    if count == 1 and cores is None:
        return Workers(1, _Here, _end)
    threads = max(1, available // count)
    return Workers(count, lambda: _pool(count, threads), _end)


@contextmanager
def lasting(workers: Workers) -> Iterator[Workers]:
    """Keep the workers, and what they have in memory, from one run to the next."""
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
    """Use the workers for tasks of one's own; they are taken back at the end."""
    executor = workers.open()
    try:
        yield executor
    finally:
        (workers.release or workers.close)(executor)


def default_count() -> int:
    """Return one worker per two cores, but two where there are two or three."""
    cores = usable_cores()
    return max(min(cores, 2), cores // 2)


def dask_workers(address: str) -> Workers:
    """Return the workers of a running Dask cluster; they must see the store under its path.

    Raises
    ------
    InputError : dask is not installed, or no scheduler answers
    """
    client = _client(address)
    found = client.scheduler_info(n_workers=-1)["workers"]
    client.close()
    if not found:
        raise InputError(f"--cluster {address}: found no workers; start dask worker {address}")
    cluster = _Cluster(address)
    return Workers(len(found), cluster.open, cluster.close)


class _Cluster:
    """Connections to a Dask scheduler, one per executor."""

    def __init__(self, address: str) -> None:
        self._address, self._clients = address, dict[int, Any]()

    def open(self) -> Executor:
        client = _client(self._address)
        # Never pure: Dask would take two batches of the same content for one.
        executor: Executor = client.get_executor(pure=False)
        self._clients[id(executor)] = client
        return executor

    def close(self, executor: Executor) -> None:
        client = self._clients.pop(id(executor), None)
        if client is not None:
            executor.shutdown(wait=True)
            client.close()


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
    """Use an executor of one's own, of `count` workers; who made it ends it.

    When one of its workers dies the run stops, for it cannot be started again here.
    """
    unused = [executor]

    def start() -> Executor:
        if not unused:
            raise InputError("executor: lost a worker; run again with a new executor to go on")
        return unused.pop()

    return Workers(count, start, lambda _: None)


def _end(executor: Executor) -> None:
    # Interrupted: nobody waits until the workers have finished what they are at.
    if isinstance(sys.exc_info()[1], KeyboardInterrupt):
        for child in multiprocessing.active_children():
            child.terminate()
    executor.shutdown(wait=True, cancel_futures=True)


def _pool(count: int, threads: int) -> Executor:
    # Not fork: Dr.Jit and numba hold threads that a forked child would lack.
    return _LimitedPool(
        count,
        threads,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=die_with,
        initargs=(os.getpid(),),
    )


class _LimitedPool(ProcessPoolExecutor):
    """Processes that start with a limited number of threads each."""

    def __init__(self, count: int, threads: int, **options: Any) -> None:
        super().__init__(count, **options)
        self._threads_each = threads

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        with _environment(self._threads_each):  # all processes start with the first task
            return super().submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        queue: Any = vars(self).get("_call_queue")
        if _WAITS_FOR_EVER and vars(self).get("_broken") and queue is not None:
            # The workers are ended, and what is still being written to them must fail instead of
            # waiting for a reader (CPython's issue 94777; its later versions close it themselves).
            queue._reader.close()
        super().shutdown(wait, cancel_futures=cancel_futures)


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
