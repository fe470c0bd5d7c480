"""Fixtures for all tests, `--quick`, hypothesis' profile, and the state of the process."""

import gc
import os
import signal
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# Tests side by side share the cores: with more threads than its share a press takes 1.5 times the
# processor time. Libraries read these when they are loaded: above the project's own imports.
if side_by_side := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0")):
    share = max(1, (os.cpu_count() or 1) // side_by_side)
    for library in ("NUMBA", "OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", str(share))

from twin.optics.session import activate

# The same examples in every run, and no judgement by the clock.
settings.register_profile(
    "steady", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("steady")

SLOW = Path(__file__).with_name("slow.txt")

# The garbage collector takes an eighth of the suite's processor time at Python's 700 new objects.
gc.set_threshold(20_000)


# A shell's background job ignores SIGINT, and so would every command that a test starts and ends.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--quick", action="store_true", help=f"leave out the tests of {SLOW.name}")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file whose tests are all left out: a sixth of the time until the first test."""
    file = Path(os.path.relpath(collection_path, SLOW.parents[1])).as_posix()
    return True if config.getoption("quick") and file in slow_tests() else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("quick"):
        slow = {item for item in items if is_slow(item.nodeid)}
        config.hook.pytest_deselected(items=[item for item in items if item in slow])
        items[:] = [item for item in items if item not in slow]


def pytest_collection_finish() -> None:
    """Exclude modules and tests, which exist to the end, from every later garbage collection."""
    gc.collect()
    gc.freeze()


def is_slow(test: str) -> bool:
    """Return True if the list has a test, its function without parameters, or its file."""
    file, function = test.split("::")[0], test.split("[")[0]
    return not {test, function, file}.isdisjoint(slow_tests())


@cache
def slow_tests() -> frozenset[str]:
    """Return the tests that the list names."""
    lines = SLOW.read_text(encoding="utf-8").splitlines()
    return frozenset(line for line in lines if line and not line.startswith("#"))


@pytest.fixture(autouse=True)
def new_worker() -> None:
    """Clear the stages that an earlier test cached in this process: tests count them."""
    worker = sys.modules.get("twin.study.worker")
    if worker is not None:
        worker.forget_stages()


@pytest.fixture(scope="session")
def mi() -> Any:
    """Mitsuba with the backend of this machine."""
    activate()
    import mitsuba

    return mitsuba
