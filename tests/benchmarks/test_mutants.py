"""Mutants of a source: what is changed, what is left alone, names, and the draw."""

import ast

import pytest

from benchmarks.mutants import KNOWN, ROOT, MutantVerdict, affordable, read_known, summary
from benchmarks.mutation.operators import MODULE, drawn, mutants_of
from benchmarks.mutation.runs import TestRun, changed, kernels_reached_by

SOURCE = '''
"""Docstring of 3 lines."""
HALF = 0.5


def area(radius_mm: float, margin: int = 1) -> float:
    """Return 2 things."""
    if radius_mm < 0.0:
        raise ValueError(f"radius {radius_mm - 1}")
    return -radius_mm * np.sin(radius_mm - HALF)


class Disc:
    def sums(self, other):
        self.total += np.sum(other, axis=0)
        return arctan2(self.y, other.x) if self.n <= 2 else self.n


def draw_disc(axes):
    axes.plot(1.0 + 2.0)
'''


@pytest.fixture
def found(tmp_path):
    (tmp_path / "one.py").write_text(SOURCE, encoding="utf-8")
    return mutants_of(tmp_path, "one.py")


def changes(found, function):
    return {(one.operator, one.before, one.after) for one in found if one.function == function}


def test_each_operator_changes_what_it_names(found):
    assert changes(found, MODULE) == {("constant", "HALF = 0.5", "HALF = 0.51")}
    whole = "-radius_mm * np.sin(radius_mm - HALF)"
    assert changes(found, "area") == {
        ("off_by_one", "1", "2"),
        ("multiply_divide", whole, "-radius_mm / np.sin(radius_mm - HALF)"),
        ("drop_factor", whole, "-radius_mm"),
        ("sign", whole, "radius_mm * np.sin(radius_mm - HALF)"),
        ("sine_cosine", "np.sin(radius_mm - HALF)", "np.cos(radius_mm - HALF)"),
        ("add_subtract", "radius_mm - HALF", "radius_mm + HALF"),
        ("drop_term", "radius_mm - HALF", "radius_mm"),
    }
    assert {one[0] for one in changes(found, "Disc.sums")} == {
        "add_subtract", "axis", "arguments", "comparison", "off_by_one"
    }  # fmt: skip


def test_messages_checks_and_drawing_are_left_alone(found):
    assert {one.function for one in found} == {MODULE, "area", "Disc.sums"}
    assert not any("- 1" in one.before or "< 0" in one.before for one in found)


def test_a_mutant_is_one_change_of_the_source(found):
    for one in found:
        text = one.applied(SOURCE)
        assert ast.dump(ast.parse(text)) != ast.dump(ast.parse(SOURCE))
        same = [a == b for a, b in zip(text.split("\n"), SOURCE.split("\n"), strict=True)]
        assert same.count(False) == 1
        assert not same[one.place[0] - 1]


def test_names_survive_when_lines_move(found, tmp_path):
    (tmp_path / "one.py").write_text("# one\n# two\n" + SOURCE, encoding="utf-8")
    moved = mutants_of(tmp_path, "one.py")
    assert [one.name for one in moved] == [one.name for one in found]
    assert [one.place[0] for one in moved] == [one.place[0] + 2 for one in found]
    assert len({one.name for one in found}) == len(found)


def test_functions_take_turns_in_the_draw(found):
    assert {one.function for one in drawn(found, 3, 1)} == {MODULE, "area", "Disc.sums"}
    assert drawn(found, 99, 1) != drawn(found, 99, 2)
    without = [one for one in found if one.function != "area"]
    left = [one for one in drawn(found, 99, 1) if one.function == "Disc.sums"]
    assert left == [one for one in drawn(without, 99, 1) if one.function == "Disc.sums"]


def test_a_changed_file_is_restored(tmp_path):
    file = tmp_path / "a.py"
    file.write_text("x = 1\n")
    before = file.stat().st_mtime_ns
    with changed(file, "x = 2\n"):
        assert file.read_text() == "x = 2\n"
    assert (file.read_text(), file.stat().st_mtime_ns) == ("x = 1\n", before)


def test_tests_that_import_the_source_come_first_and_time_is_limited():
    seconds = {"far.py::a": 0.1, "near.py::b": 5.0, "near.py::c": 0.2, "slow.py::d": 90.0}
    tests = [TestRun(name, True, one) for name, one in seconds.items()]
    chosen = affordable(tests, lambda test: test.test.startswith("near"), 20.0)
    assert [one.test for one in chosen] == ["near.py::c", "near.py::b", "far.py::a"]


def test_rooms_and_known_mutants_are_of_this_tree():
    """Every source and test exists, and what is known of a mutant names such a source."""
    rooms, known = read_known(KNOWN)
    assert all(room.sources and room.tests for room in rooms.values())
    assert not set(known.equivalent) & set(known.accepted)
    told = known.equivalent | known.accepted
    sources = {name.split("::")[0] for name in told}
    assert sources <= {file for room in rooms.values() for file in room.sources}
    assert all(len(reason) > 10 for reason in told.values())


def test_a_kernel_is_reached_through_its_imports():
    """Constants of the sensor are in the decoder's kernels; what is scored is in none."""
    reached = kernels_reached_by(ROOT, "reconstruction/rig/sensor.py")
    assert {"reconstruction.decoding._sum", "reconstruction.decoding._decode"} <= reached
    assert kernels_reached_by(ROOT, "twin/results/score.py") == frozenset()


def test_those_killed_by_time_are_killed():
    ends = ("killed", "timed_out", "survived", "unseen")
    verdicts = [MutantVerdict("n", "room", end, "", 1, 0.0, "", "") for end in ends]
    found = summary(verdicts, 2)
    assert (found["judged"], found["killed"], found["equivalent"]) == (4, 2, 2)
    assert (found["timed_out"], found["shares"]) == (1, {"room": 0.5})
