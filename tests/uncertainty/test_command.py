"""`twin uncertainty` from the command line: results, report, exit codes, bad input."""

from functools import partial

import pytest

from tests.browser import assert_readable
from tests.uncertainty.models import Blank, Linear, Refusing
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
    output = capsys.readouterr().out
    assert "value_mm" in output
    assert "66 done in " in output  # the estimated number of cases, including the nominal one
    assert f"wrote {tmp_path / 'out/report.html'}" in output
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
    assert_readable(tmp_path / "out/report.html", tmp_path)
    assert run(["sweep", "table", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.count("\n") > 40
    assert run([*modelled, "-n", "40", "-m", "force_n"]) == 0
    output = capsys.readouterr().out
    assert "nothing to do" in output
    assert "force_n" in output


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["-n", "1"], "trials: found 1, allowed 2 to"),
        (["-m", "value_um", "-n", "2"], "has no such figure; did you mean value_mm"),
        (["-s", "camera.bining=2"], "did you mean 'binning'"),
        (["--calibration", "new"], "calibration"),
    ],
)
def test_bad_input_is_one_line(modelled, capsys, arguments, line):
    assert run([*modelled, *arguments]) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("twin: ")
    assert line in last


def test_unknown_inputs_are_an_error_without_a_folder(tmp_path, capsys):
    arguments = ["uncertainty", "examples/slab_balls", "-o", str(tmp_path / "out")]
    assert run([*arguments, "--inputs", "inputs/nowhere"]) == 2
    assert "inputs/nowhere" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_dry_run_lists_inputs_and_cases_without_measuring(modelled, tmp_path, capsys):
    """41 trials, two cases per normal input and the nominal case, 20 repeats, 8 (2 + 2) presses."""
    assert run([*modelled, "-n", "40", "--dry-run", "--sobol", "8"]) == 0
    said = capsys.readouterr().err
    assert "specimen.x_mm: 0, standard uncertainty 0.1 (normal)" in said
    assert "specimen.y_mm: 0, standard uncertainty 0.0408 (triangular)" in said
    assert "41 trials with the nominal one, 5 with one input varied or none" in said
    assert "20 repeats that differ only in noise\n" in said
    assert "66 cases, about " in said
    assert "Sobol' indices: 32 further presses" in said
    assert "calibration of the rig" not in said
    assert not (tmp_path / "out").exists()


def test_dry_run_names_the_calibration_and_counts_stored_cases(modelled, capsys):
    assert run([*modelled, "-n", "4"]) == 0
    assert run([*modelled, "-n", "6", "--dry-run"]) == 0
    # Two further trials and two further repeats of the noise.
    assert "18 cases, 14 of them in the store" in capsys.readouterr().err
    assert run([*modelled[:-2], "-n", "6", "--dry-run"]) == 0
    assert "a calibration of the rig on rendered poses" in capsys.readouterr().err


def test_dry_run_of_an_impossible_press_is_an_error(modelled, capsys):
    deep = 'press.depth_mm={ value = 9.0, source = "assumed: too deep" }'
    assert run([*modelled, "-n", "4", "--dry-run", "-s", deep]) == 2
    assert "cannot be measured: press.depth_mm" in capsys.readouterr().err


def test_a_nominal_measurement_that_fails_stops_at_once(modelled, monkeypatch, tmp_path, capsys):
    """Setup: 40 trials, none measurable. Expected: one was measured, with the reason it failed."""
    monkeypatch.setattr(module, "sweep", partial(module.sweep, make_measurer=Refusing))
    assert run([*modelled, "-n", "40", "-s", "specimen.x_mm=2"]) == 2
    said = capsys.readouterr().err
    assert "the nominal measurement failed, so no trial is measured: specimen: beyond" in said
    cases = list((tmp_path / "out/cases").iterdir())
    assert len(cases) == 1
    assert str(cases[0] / "failure.json") in said
    assert run([*modelled, "-n", "40", "-s", "specimen.x_mm=2"]) == 2  # not measured again
    assert len(list((tmp_path / "out/cases").iterdir())) == 1


def test_an_impossible_press_makes_no_folder(modelled, tmp_path, capsys):
    deep = 'press.depth_mm={ value = 9.0, source = "assumed: too deep" }'
    assert run([*modelled, "-n", "4", "-s", deep]) == 2
    assert "press.depth_mm" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("value", [None, "absent"])
def test_a_measurand_that_the_nominal_measurement_lacks_stops_at_once(
    modelled, monkeypatch, tmp_path, capsys, value
):
    """A misspelt figure, or a ball without points, stops the run after one measurement."""
    monkeypatch.setattr(module, "sweep", partial(module.sweep, make_measurer=Blank))
    named = "value_mm" if value is None else "valu_mm"
    assert run([*modelled, "-n", "40", "-m", named]) == 2
    assert f"measurand {named}: the nominal measurement has no" in capsys.readouterr().err
    assert len(list((tmp_path / "out/cases").iterdir())) == 1


def test_a_folder_with_foreign_files_is_not_changed(modelled, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/diary.txt").write_text("mine")
    assert run([*modelled, "-n", "2"]) == 2
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["diary.txt"]


def test_help_has_an_example(capsys):
    assert run(["uncertainty", "-h"]) == 0
    assert "For example: twin uncertainty examples/slab_balls -n 100" in " ".join(
        capsys.readouterr().out.split()
    )
