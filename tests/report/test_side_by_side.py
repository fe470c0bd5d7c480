"""Figures that a second process draws are those that this one draws, to the last byte."""

import pytest

from twin.report import side_by_side
from twin.report.measurement import write_report
from twin.report.side_by_side import second_process


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr(side_by_side, "threads", lambda: 2)


@pytest.fixture(scope="module")
def alone(finished, tmp_path_factory):
    """Every file of the report that one process draws, by name."""
    return _written(finished, tmp_path_factory.mktemp("alone"))


def _written(finished, into, second=None):
    write_report(finished, into=into, second=second)
    return {
        path.relative_to(into).as_posix(): path.read_bytes()
        for path in sorted(into.rglob("*"))
        if path.is_file()
    }


def test_two_processes_write_the_report_of_one(two_cores, finished, alone, tmp_path):
    drawn = []
    with second_process() as second:
        take, second.drawn = second.drawn, lambda wait: take(wait) and not drawn.append(wait)
        assert _written(finished, tmp_path, second) == alone
    assert drawn, "the second process drew nothing"
    assert not second.asked


def test_a_second_process_that_ends_costs_nothing_but_time(two_cores, finished, alone, tmp_path):
    with second_process() as second:
        second._process.kill()
        second._process.wait()
        assert _written(finished, tmp_path, second) == alone


def test_one_core_draws_alone(monkeypatch):
    monkeypatch.setattr(side_by_side, "threads", lambda: 1)
    with second_process() as second:
        assert second is None


def test_the_process_ends_with_its_work(two_cores):
    with second_process() as second:
        process = second._process
        assert process.poll() is None
    assert process.returncode is not None
