"""`twin paper` from the command line: parts of it, and bad input."""

import json
import re

import pytest

from twin.cli import run
from twin.paper.figures import FIGURES
from twin.paper.run import TABLE_GROUPS


def test_one_table_and_one_figure(tmp_path, capsys):
    """No rendering: hardness as table and graph, the same with one worker and with two."""
    out = tmp_path / "paper"
    assert run(["paper", "-o", str(out), "--only", "hardness", "--trials", "2", "-j", "1"]) == 0
    assert f"wrote {out / 'report.html'}" in capsys.readouterr().out
    first = (out / "tables.json").read_bytes()
    rows = json.loads(first)["tables"]["hardness"]["rows"]
    assert [row["mix"] for row in rows] == ["A", "B", "C"]
    assert {"hardness.png", "hardness.pdf"} <= {file.name for file in (out / "figures").iterdir()}
    assert "| A |" in (out / "tables.md").read_text(encoding="utf-8")
    assert json.loads((out / "result.json").read_text())["command"] == "paper"
    assert (out / "experiment.toml").is_file()
    assert run(["paper", "-o", str(out), "--only", "hardness", "--trials", "2", "-j", "2"]) == 0
    assert (out / "tables.json").read_bytes() == first


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--only", "tabel"], "--only tabel: found no such table or figure, allowed identified"),
        (["--only", "tables/rodz"], "found no such table or figure; did you mean tables/rods? ("),
        (["-j", "0"], "--workers 0: allowed 1 or more"),
        (["--trials", "1"], "--trials 1: allowed 2 to 10000"),
    ],
)
def test_bad_input_is_one_line(tmp_path, capsys, arguments, message):
    out = tmp_path / "out"
    assert run(["paper", "-o", str(out), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_the_help_names_every_group_and_figure(capsys):
    assert run(["paper", "--help"]) == 0
    words = set(re.findall(r"\w+", capsys.readouterr().out))
    assert {*TABLE_GROUPS, *FIGURES} <= words


def test_a_folder_with_foreign_files_is_not_changed(tmp_path, capsys):
    (tmp_path / "diary.txt").write_text("mine")
    assert run(["paper", "-o", str(tmp_path), "--only", "hardness"]) == 2
    assert "is no earlier run of twin paper" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["diary.txt"]
