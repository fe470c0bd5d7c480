"""The suite itself: the tests that `--quick` excludes, and no test depends on the clock."""

import re
from collections import Counter

import pytest
from hypothesis import settings

from tests.conftest import SLOW, is_slow, slow_tests

TESTS = SLOW.parent


def functions() -> list[str]:
    """Return every test function as file::function."""
    return [
        f"tests/{file.relative_to(TESTS).as_posix()}::{name}"
        for file in sorted(TESTS.rglob("test_*.py"))
        for name in re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.MULTILINE)
    ]


def test_the_list_names_tests_that_exist():
    known = set(functions())
    files = {function.split("::")[0] for function in known}
    assert {name for name in slow_tests() if name.split("[")[0] not in known | files} == set()


def test_every_folder_keeps_a_part_of_its_tests():
    every = Counter(function.split("/")[1] for function in functions())
    quick = Counter(function.split("/")[1] for function in functions() if not is_slow(function))
    assert {folder for folder, count in every.items() if quick[folder] < 0.2 * count} == set()


@pytest.mark.parametrize(
    ("name", "slow"),
    [("a/test_x.py::test_one", False), ("a/test_x.py::test_two[3]", True), ("b.py::test_y", True)],
)
def test_a_name_stands_for_all_below_it(monkeypatch, name, slow):
    monkeypatch.setattr("tests.conftest.slow_tests", lambda: {"a/test_x.py::test_two", "b.py"})
    assert is_slow(name) == slow


def test_no_test_reads_a_stopwatch():
    """`time.monotonic` may guard against a hang; speed is for benchmarks/."""
    stopwatch = re.compile(r"perf_counter|process_time|time\.time\(|getrusage|os\.times")
    files = [file for file in TESTS.rglob("*.py") if file.name != "test_suite.py"]
    assert [file for file in files if stopwatch.search(file.read_text(encoding="utf-8"))] == []


def test_hypothesis_draws_the_same_examples_and_has_no_deadline():
    assert settings().derandomize
    assert settings().deadline is None
