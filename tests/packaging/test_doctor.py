"""The diagnosis runs to its end, independent of the broken part."""

import importlib.metadata
import sys

import pytest

from twin import doctor
from twin.doctor import diagnose
from twin.optics import backend


@pytest.fixture
def without_backend(monkeypatch):
    def missing():
        raise backend.MissingBackend("no usable renderer backend (no libLLVM found): install LLVM")

    monkeypatch.setattr(backend, "find_backend", missing)


def by_name() -> dict[str, doctor.Finding]:
    return {finding.name: finding for finding in diagnose()}


def test_this_machine_is_fit():
    findings = by_name()
    expected = {"python", "renderer backend", "cuda", "cores", "memory", "numba cache", "disk"}
    assert expected | {"scenes", "materials", "mitsuba", "numpy"} <= set(findings)
    assert [finding for finding in findings.values() if not finding.ok] == []


def test_missing_backend_is_a_finding_with_advice(without_backend):
    finding = by_name()["renderer backend"]
    assert not finding.ok
    assert finding.detail == "no usable renderer backend (no libLLVM found)"
    assert finding.advice == "install LLVM"


def test_old_package_is_a_finding(monkeypatch):
    monkeypatch.setattr(importlib.metadata, "version", lambda _: "1.9.2")
    assert not doctor._package("numpy>=2.4").ok
    assert doctor._package("numpy>=1.9").ok


def test_absent_package_is_a_finding():
    finding = doctor._package("no-such-package-here>=1")
    assert not finding.ok
    assert finding.advice == f"{sys.executable} -m pip install 'no-such-package-here>=1'"


def test_broken_check_is_a_finding(monkeypatch):
    def broken():
        raise PermissionError("/proc")

    assert [finding.ok for finding in doctor._safely(broken)] == [False]


def test_unwritable_numba_cache_is_reported(monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/numba")
    finding = by_name()["numba cache"]
    assert not finding.ok
    assert "NUMBA_CACHE_DIR" in finding.advice


def test_the_linear_solver_of_thin_sheets_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without PARDISO the command that installs it is printed."""
    monkeypatch.setattr("twin.mechanics.sheet.linear_solver.has_pardiso", lambda: False)
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    slow = by_name()["thin-sheet solver"]
    assert slow.ok
    assert "nested dissection" in slow.detail
    assert "[fast]" in slow.detail
    monkeypatch.setattr("twin.mechanics.sheet.linear_solver.has_pardiso", lambda: True)
    assert by_name()["thin-sheet solver"].detail.startswith("PARDISO")
