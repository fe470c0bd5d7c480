"""`twin uncertainty` from the command line: results, report, exit codes, bad input."""

from functools import partial

import pytest

from tests.uncertainty.models import Linear, Refusing
from twin.cli import run
from twin.study import sweep as module

INPUTS = """
[inputs.x]
group = "placement"
key = "specimen.x_mm"
distribution = "normal"
spread = { value = 0.1, range = [0.0, 1.0], source = "assumed: by hand" }
[inputs.y]
group = "placement"
key = "specimen.y_mm"
distribution = "triangular"
spread = 0.1
"""


@pytest.fixture
def modelled(monkeypatch, tmp_path):
    """Measure by a model; returns the arguments of a short run."""
    monkeypatch.setattr(module, "sweep", partial(module.sweep, make_measurer=Linear))
    (tmp_path / "inputs.toml").write_text(INPUTS)
    return ["uncertainty", "examples/slab_balls", "-o", str(tmp_path / "out"), "-j", "1",
            "--inputs", str(tmp_path / "inputs.toml"), "--calibration", "true"]  # fmt: skip


def test_table_files_and_report(modelled, tmp_path, capsys):
    assert run([*modelled, "-n", "40", "-m", "value_mm"]) == 0
    told = capsys.readouterr().out
    assert "value_mm" in told
    assert f"wrote {tmp_path / 'out/report.html'}" in told
    there = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"result.json", "experiment.toml", "trials.nc", "study.json", "cases"} <= there
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert "assumed: by hand" in page
    assert "noise and decoding" in page
    (tmp_path / "out/report.html").unlink()
    assert run(["report", str(tmp_path / "out")]) == 0
    again = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert again == page
    assert "force_n" not in page
    assert run(["sweep", "table", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.count("\n") > 40
    assert run([*modelled, "-n", "40", "-m", "force_n"]) == 0
    told = capsys.readouterr().out
    assert "nothing to do" in told
    assert "force_n" in told


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["-n", "1"], "trials: found 1, allowed 2 to"),
        (["-m", "value_um", "-n", "2"], "measurand value_um: found in no trial"),
        (["-s", "camera.bining=2"], "did you mean 'binning'"),
        (["--calibration", "new"], "calibration"),
    ],
)
def test_bad_input_is_one_line(modelled, capsys, arguments, line):
    assert run([*modelled, *arguments]) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("twin: ")
    assert line in last


def test_inputs_that_are_nowhere(tmp_path, capsys):
    arguments = ["uncertainty", "examples/slab_balls", "-o", str(tmp_path / "out")]
    assert run([*arguments, "--inputs", "inputs/nowhere"]) == 2
    assert "inputs/nowhere" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_nothing_measured_is_a_failure(modelled, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(module, "sweep", partial(module.sweep, make_measurer=Refusing))
    assert run([*modelled, "-n", "2", "-s", "specimen.x_mm=2"]) == 1
    assert "failed: specimen: beyond the elastomer" in capsys.readouterr().err


def test_a_folder_of_something_else_is_left_alone(modelled, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/diary.txt").write_text("mine")
    assert run([*modelled, "-n", "2"]) == 2
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["diary.txt"]


def test_help_has_an_example(capsys):
    assert run(["uncertainty", "-h"]) == 0
    assert "For example: twin uncertainty examples/slab_balls -n 100" in " ".join(
        capsys.readouterr().out.split()
    )
