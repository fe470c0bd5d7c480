"""Threads side by side: as many as cores, or as the environment allows."""

import pytest

from reconstruction import machine


@pytest.mark.parametrize(
    ("told", "expected"), [("1", 1), ("3", 3), ("64", 4), ("0", 1), ("", 4), ("many", 4)]
)
def test_threads(monkeypatch, told, expected):
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda _: set(range(4)))
    monkeypatch.setenv(machine.VARIABLE, told)
    assert machine.threads() == expected
