"""`./run bench all`: comparison with targets and baselines, and the files that it writes."""

import json

import pytest

from benchmarks import all as bench
from benchmarks.regression import registry, tables
from benchmarks.regression.baselines import (
    Baseline,
    Baselines,
    StatedRow,
    read_baselines,
    write_baselines,
)
from benchmarks.regression.figures import BenchmarkCase, GuardedFigure, MeanOfRuns, Target
from benchmarks.regression.limits import judge_target
from benchmarks.regression.registry import CASES, FIGURES, last_object, value_of
from benchmarks.regression.runs import again
from reconstruction.errors import InputError


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """Two cases with values set by a test, and files of their own."""
    return Desk(tmp_path, monkeypatch)


class Desk:
    def __init__(self, folder, monkeypatch):
        self.values = {"z_um": [1.0, 1.1, 0.9], "over": [2.0]}
        speed = GuardedFigure("over", "pace", kind="speed", target=Target(high=2.5), headline=True)
        height = GuardedFigure("z_um", "height, um", target=Target(0.5, 6.0))
        self.cases = (
            BenchmarkCase("height", "3 seeds", (height,), lambda: self.take("z_um")),
            BenchmarkCase(
                "pace", "`./run bench pace`", (speed,), lambda: self.take("over"), quick=False
            ),
        )
        self.baselines, self.readme = folder / "baselines.toml", folder / "README.md"
        self.all = folder / "benchmarks.md"
        for page in (self.readme, self.all):
            page.write_text(f"above\n{tables.BEGIN}\n{tables.END}\nbelow\n")
        for name, value in {
            "CASES": self.cases,
            "FIGURES": {figure.name: figure for case in self.cases for figure in case.figures},
            "BASELINES": self.baselines,
            "README": self.readme,
            "ALL_FIGURES": self.all,
        }.items():
            monkeypatch.setattr(bench, name, value)

    def take(self, name):
        values = self.values[name]
        if isinstance(values, Exception):
            raise values
        return {name: values}

    def bytes(self):
        return [
            path.read_bytes() if path.exists() else None
            for path in (self.baselines, self.readme, self.all)
        ]


def last_line(capsys):
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_only_update_writes(desk, capsys):
    before = desk.bytes()
    assert bench.main([]) == 0
    assert bench.main(["--check"]) == 1
    assert desk.bytes() == before
    assert last_line(capsys)["failed"] == ["z_um", "over"]
    assert bench.main(["--update"]) == 0
    after = desk.bytes()
    assert after != before
    assert bench.main(["--check"]) == 0
    assert desk.bytes() == after
    last = last_line(capsys)
    assert (last["figures"], last["failed"]) == (2, [])
    assert set(last) == {"figures", "failed", "seconds"}
    files = {path.name for path in desk.readme.parent.iterdir()}
    assert files == {"README.md", "benchmarks.md", "baselines.toml"}
    assert ("height" in desk.all.read_text(), "height" in desk.readme.read_text()) == (True, False)


def test_check_fails_outside_the_limit_and_says_which(desk, capsys):
    bench.main(["--update"])
    desk.values["z_um"] = [5.0, 5.1, 4.9]
    assert bench.main(["--check"]) == 1
    out = capsys.readouterr().out
    assert "FAILED z_um: case height, found 5, against the baseline off by 4" in out
    assert "measured again" not in out


def test_a_slow_ratio_is_measured_once_more(desk, capsys):
    bench.main(["--update"])
    desk.values["over"] = [4.0]
    assert bench.main(["--check"]) == 1
    out = capsys.readouterr().out
    assert out.count("over = 4") == 2
    assert (
        "FAILED over: case pace, found 4, target at most 2.5; against the baseline at most 3" in out
    )


@pytest.mark.parametrize(
    ("name", "beyond", "line"),
    [
        ("over", [2.6], "FAILED over: case pace, found 2.6, target at most 2.5"),
        ("z_um", [6.5, 6.4, 6.6], "FAILED z_um: case height, found 6.5, target 0.5 to 6"),
    ],
)
def test_a_missed_target_fails_whatever_the_baseline(desk, capsys, name, beyond, line):
    """Setup: the baseline is just as bad. Expected: one line with case, figure, found, target."""
    desk.values[name] = beyond
    bench.main(["--update"])
    assert bench.main([]) == 0
    capsys.readouterr()
    assert bench.main(["--check"]) == 1
    out = capsys.readouterr().out.splitlines()
    assert [text for text in out if text.startswith("FAILED")] == [line]
    assert json.loads(out[-1])["failed"] == [name]


def test_the_better_of_two_speeds_counts():
    figures = tuple(
        GuardedFigure(name, "", kind="speed", higher_is_better=name == "up")
        for name in ("up", "down")
    )
    case = BenchmarkCase("pace", "", figures, lambda: {"up": [3.0], "down": [3.0]})
    result = again(case, {"up": MeanOfRuns(2.0), "down": MeanOfRuns(2.0)})
    assert result == {"up": MeanOfRuns(3.0), "down": MeanOfRuns(2.0)}


def test_only_and_quick_choose_cases(desk, capsys):
    assert bench.main(["--quick"]) == 0
    assert last_line(capsys)["figures"] == 1
    bench.main(["--update"])
    baseline = read_baselines(desk.baselines).figures["z_um"]
    desk.values = {"z_um": [9.0, 9.0, 9.1], "over": [2.5]}
    assert bench.main(["--update", "--only", "pace"]) == 0
    result = read_baselines(desk.baselines).figures
    assert result["z_um"] == baseline
    assert result["over"].estimate == MeanOfRuns(2.5)


@pytest.mark.parametrize("arguments", [["--only", "nothing"], ["--check", "--update"], ["--what"]])
def test_a_wrong_argument_is_status_2(desk, capsys, arguments):
    try:
        status = bench.main(arguments)
    except SystemExit as leaving:
        status = leaving.code
    assert status == 2
    message = capsys.readouterr().err.splitlines()[-1]
    assert "bench all: " in message


def test_damaged_baselines_are_status_2(desk, capsys):
    desk.baselines.write_text("[[accepted]]\ndate = '2026-01-02'\nfigures.z_um = [1.0, 0.1, 3]\n")
    assert bench.main(["--check"]) == 2
    assert "versions" in capsys.readouterr().err


def test_a_broken_case_does_not_stop_the_rest(desk, capsys):
    desk.values["z_um"] = RuntimeError("no light")
    assert bench.main([]) == 1
    result = last_line(capsys)
    assert result["failed"] == ["height"]
    assert result["figures"] == 1


def test_a_case_that_gives_other_figures_is_broken(desk, capsys):
    desk.take = lambda name: {"other_um": [1.0]}
    assert bench.main(["--only", "height"]) == 1
    assert "allowed ['z_um']" in capsys.readouterr().out


def test_baselines_come_back_as_written(tmp_path):
    path, stated = (
        tmp_path / "b.toml",
        StatedRow("demo", "demo", "120 s", "15 s", "time", "2026-01-01"),
    )
    baseline = Baseline(MeanOfRuns(1.25, 0.03, 4), "2026-01-02", "numpy 2", "2 cores")
    written = Baselines({"z_um": baseline, "gone": baseline}, (stated,))
    write_baselines(written, ["z_um"], path)
    assert read_baselines(path) == Baselines({"z_um": baseline}, (stated,))


@pytest.mark.parametrize(
    ("value", "uncertainty", "text"),
    [
        (0.5403, 0.0012, "0.5403 +- 0.0012"),
        (2450.186, 12.0, "2450 +- 12"),
        (1.6e-5, 1.3e-8, "(1.6000 +- 0.0013)e-5"),
        (0.0, 0.0, "0"),
        (0.8314, 0.0, "0.831"),
        (5123.4, 0.0, "5123"),
        (3.2708e-5, 0.0, "3.27e-05"),
    ],
)
def test_values_are_shown_as_far_as_they_are_known(value, uncertainty, text):
    assert tables.shown(MeanOfRuns(value, uncertainty, 5)) == text


def test_the_table_goes_between_its_markers():
    text = f"a\n{tables.BEGIN}\nold\n{tables.END}\nz\n"
    assert tables.with_table(text, "new") == f"a\n{tables.BEGIN}\nnew\n{tables.END}\nz\n"
    for bad in ("", text + text, f"{tables.END}{tables.BEGIN}"):
        with pytest.raises(InputError, match=r"docs/peers\.md: found no single pair"):
            tables.with_table(bad, "new")


def test_readme_and_docs_are_in_step_with_the_baselines():
    """Expected: ./run bench all --update has written the tables, without changes by hand."""
    for path, text in bench.pages(read_baselines(bench.BASELINES)).items():
        assert path.read_text(encoding="utf-8") == text


def test_every_figure_has_a_baseline_and_none_is_left_over():
    assert sorted(read_baselines(bench.BASELINES).figures) == sorted(FIGURES)
    assert len(FIGURES) == sum(len(case.figures) for case in CASES)
    assert not any("|" in figure.label for figure in FIGURES.values())


def test_no_baseline_misses_its_target():
    """Expected: ./run bench all --check passes on the accepted baselines."""
    for name, known in read_baselines(bench.BASELINES).figures.items():
        verdict = judge_target(FIGURES[name], known.estimate.value)
        assert verdict.passed, f"{name}: {verdict.text}"


def test_a_benchmark_is_read_by_its_last_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(registry, "FOLDER", tmp_path)
    (tmp_path / "good.py").write_text("print('progress')\nprint('{\"s\": 2}')\n")
    (tmp_path / "bad.py").write_text("import sys\nsys.exit('no light')\n")
    assert registry.child("good", "--quick") == {"s": 2}
    assert "progress" in capsys.readouterr().out
    with pytest.raises(InputError, match="bad: status 1, no light"):
        registry.child("bad")


def test_a_last_line_that_is_no_result_is_refused():
    result = last_object("x", '{"a": 3, "b": 2}')
    assert (value_of(result, "a / b"), value_of(result, "a")) == (1.5, 3.0)
    for line in ("", "3", "[1]", "done"):
        with pytest.raises(InputError, match="benchmark x"):
            last_object("x", line)


def test_a_real_case_agrees_with_its_baseline(capsys):
    """The decoder on exact and 8-bit frames, five seeds, against the committed figures."""
    assert bench.main(["--check", "--only", "decode"]) == 0
    assert last_line(capsys)["figures"] == 2
