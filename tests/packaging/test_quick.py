"""`--quick` leaves out what tests/slow.txt names: existing tests, and never a whole folder."""

import re
from collections import Counter

import pytest

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
