"""Mutants of a source: changed and skipped expressions, names, and the draw."""

import ast
from collections import Counter

import pytest

from benchmarks.mutants import MODULE, ROOT, drawn, mutants_of, read_known, summary

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


DEFAULT = "def area(radius_mm: float, margin: int = 1) -> float:"


@pytest.fixture
def mutants(tmp_path):
    (tmp_path / "one.py").write_text(SOURCE, encoding="utf-8")
    return mutants_of(tmp_path, "one.py")


def changes(mutants, function):
    return {
        (mutant.operator, mutant.before, mutant.after)
        for mutant in mutants
        if mutant.function == function
    }


def test_each_operator_changes_what_it_names(mutants):
    assert changes(mutants, MODULE) == {("constant", "HALF = 0.5", "HALF = (0.51)")}
    whole = "return -radius_mm * np.sin(radius_mm - HALF)"
    assert changes(mutants, "area") == {
        ("off_by_one", DEFAULT, DEFAULT.replace("= 1)", "= (2))")),
        ("multiply_divide", whole, "return (-radius_mm / np.sin(radius_mm - HALF))"),
        ("drop_factor", whole, "return (-radius_mm)"),
        ("sign", whole, "return (radius_mm) * np.sin(radius_mm - HALF)"),
        ("sine_cosine", whole, "return -radius_mm * (np.cos(radius_mm - HALF))"),
        ("add_subtract", whole, "return -radius_mm * np.sin((radius_mm + HALF))"),
        ("drop_term", whole, "return -radius_mm * np.sin((radius_mm))"),
    }
    assert {change[0] for change in changes(mutants, "Disc.sums")} == {
        "add_subtract", "axis", "arguments", "comparison", "off_by_one"
    }  # fmt: skip


def test_messages_checks_and_drawing_are_left_alone(mutants):
    assert {mutant.function for mutant in mutants} == {MODULE, "area", "Disc.sums"}
    assert not any("- 1" in mutant.before or "< 0" in mutant.before for mutant in mutants)


def test_a_mutant_is_one_change_of_the_source(mutants):
    for mutant in mutants:
        text = mutant.applied(SOURCE)
        assert ast.dump(ast.parse(text)) != ast.dump(ast.parse(SOURCE))
        same = [a == b for a, b in zip(text.split("\n"), SOURCE.split("\n"), strict=True)]
        assert same.count(False) == 1
        assert not same[mutant.place[0] - 1]


def test_names_survive_when_lines_move(mutants, tmp_path):
    (tmp_path / "one.py").write_text("# one\n# two\n" + SOURCE, encoding="utf-8")
    moved = mutants_of(tmp_path, "one.py")
    assert [mutant.name for mutant in moved] == [mutant.name for mutant in mutants]
    assert [mutant.place[0] for mutant in moved] == [mutant.place[0] + 2 for mutant in mutants]
    assert len({mutant.name for mutant in mutants}) == len(mutants)


def test_a_draw_depends_on_names_and_seed(mutants):
    assert drawn(mutants, 99, 1) != drawn(mutants, 99, 2)
    without = [mutant for mutant in mutants if mutant.function != "area"]
    left = [mutant for mutant in drawn(mutants, 99, 1) if mutant.function != "area"]
    assert left == drawn(without, 99, 1)


def test_rooms_and_known_mutants_are_of_this_tree():
    """Every source and test exists, and each known mutant can still be made."""
    rooms, equivalent, accepted = read_known()
    assert all(room["sources"] and room["tests"] for room in rooms.values())
    assert not set(equivalent) & set(accepted)
    known = equivalent | accepted
    sources = {name.split("::")[0] for name in known}
    assert sources <= {file for room in rooms.values() for file in room["sources"]}
    made = {mutant.name for file in sources for mutant in mutants_of(ROOT, file)}
    assert set(known) <= made
    assert all(len(reason) > 10 for reason in known.values())


def test_those_killed_by_time_are_killed():
    ends = ("killed", "timed_out", "survived", "unseen", "equivalent", "equivalent")
    counts = summary({"room": Counter(ends)})
    assert (counts["judged"], counts["killed"], counts["equivalent"]) == (4, 2, 2)
    assert (counts["timed_out"], counts["shares"]) == (1, {"room": 0.5})
