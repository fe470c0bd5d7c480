"""The thread that sends tasks to workers ends after a worker died, whether blocked or not."""

import multiprocessing
from typing import Any

import pytest

from twin.study.workers import _fail_blocked_writer


@pytest.fixture
def queue() -> Any:
    """Return the tasks' queue of a process pool that has no worker."""
    tasks: Any = multiprocessing.get_context("spawn").Queue()
    tasks._ignore_epipe = True  # as concurrent.futures sets it
    return tasks


def test_a_blocked_writer_fails(queue: Any) -> None:
    """1 MB is more than a pipe holds, so that the thread waits for a reader."""
    queue.put(bytes(1_000_000))
    _fail_blocked_writer(queue)
    queue._thread.join(10)
    assert not queue._thread.is_alive()


def test_a_writer_that_ends_closes_the_reader_itself(queue: Any) -> None:
    queue.put(b"task")
    queue.close()
    _fail_blocked_writer(queue)
    assert not queue._thread.is_alive()
    assert queue._reader.closed


def test_a_queue_without_tasks_has_no_writer(queue: Any) -> None:
    _fail_blocked_writer(queue)
    assert not queue._reader.closed
