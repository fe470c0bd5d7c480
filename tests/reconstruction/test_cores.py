"""Threads side by side: as many as cores, or as the environment allows."""

import pytest

from reconstruction import machine


@pytest.mark.parametrize(
    ("message", "expected"), [("1", 1), ("3", 3), ("64", 4), ("0", 1), ("", 4), ("many", 4)]
)
def test_threads(monkeypatch, message, expected):
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda _: set(range(4)))
    monkeypatch.setenv(machine.VARIABLE, message)
    assert machine.threads() == expected
