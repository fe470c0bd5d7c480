"""`twin paper` from the command line: parts of it, bad input, and one complete trial."""

import json

import pytest

from reconstruction.pipeline import reconstruct
from twin.cli import run
from twin.config import load_experiment
from twin.optics.rig import true_calibration
from twin.paper.repeats import measure_fringes
from twin.paper.rig_draws import RigScatter
from twin.pipeline.fringes import options_of, take
from twin.pipeline.progress import Stopwatch
from twin.results.score import metrics, score

SMALL = {
    "camera.binning": 4,
    "press.solver_pitch_mm": 0.15,
    "press.relief_pitch_mm": 0.05,
    "render.samples": 1,
    "patterns.steps": 6,
}


def test_one_table_and_one_figure(tmp_path, capsys):
    """No rendering: the mixes' hardness as table and graph, then the same again."""
    out = tmp_path / "paper"
    assert run(["paper", "-o", str(out), "--only", "hardness", "--trials", "2"]) == 0
    assert f"wrote {out / 'report.html'}" in capsys.readouterr().out
    first = (out / "tables.json").read_bytes()
    rows = json.loads(first)["tables"]["hardness"]["rows"]
    assert [row["mix"] for row in rows] == ["A", "B", "C"]
    assert {"hardness.png", "hardness.pdf"} <= {file.name for file in (out / "figures").iterdir()}
    assert "| A |" in (out / "tables.md").read_text(encoding="utf-8")
    assert json.loads((out / "result.json").read_text())["command"] == "paper"
    assert (out / "experiment.toml").is_file()
    assert run(["paper", "-o", str(out), "--only", "hardness", "--trials", "2"]) == 0
    assert (out / "tables.json").read_bytes() == first


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--only", "tabel"], "--only tabel: found no such table or figure, allowed hardness"),
        (["-j", "0"], "--workers 0: allowed 1 or more"),
        (["--trials", "1"], "--trials 1: allowed 2 to 10000"),
    ],
)
def test_bad_input_is_one_line(tmp_path, capsys, arguments, message):
    out = tmp_path / "out"
    assert run(["paper", "-o", str(out), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


def test_a_folder_of_something_else_is_left_alone(tmp_path, capsys):
    (tmp_path / "diary.txt").write_text("mine")
    assert run(["paper", "-o", str(tmp_path), "--only", "hardness"]) == 2
    assert "is no earlier run of twin paper" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["diary.txt"]


def test_a_trial_is_a_measurement_with_a_drawn_rig(mi):
    """With the true rig it equals a plain measurement; a rig 1e-4 larger scales the radius so."""
    experiment = load_experiment("paper/two_balls", SMALL)
    true = true_calibration(experiment)

    class Larger(RigScatter):
        def draw(self, seed, trial):
            # Baseline and distances 1e-4 larger: every length is.
            larger = true.T_world_from_proj.copy()
            apart = larger[:3, 3] - true.T_world_from_cam[:3, 3]
            larger[:3, 3] = true.T_world_from_cam[:3, 3] + 1.0001 * apart
            return type(true)(true.camera, true.projector, true.T_world_from_cam, larger)

    figures = measure_fringes(Larger(true, None), 1, experiment, 1)
    _, recording = take(experiment, Stopwatch(), 1)
    plain = reconstruct(recording.capture, options_of(experiment.decode))
    expected = metrics(score(experiment, plain, recording.truth))
    assert figures["true_rig_sphere_1_radius_mm"] == expected["sphere_1_radius_mm"]
    ratio = figures["sphere_1_radius_mm"] / figures["true_rig_sphere_1_radius_mm"]
    # The region of the fit is 1.5 mm in both scales: the radius grows with it, by less than 1e-4.
    assert ratio == pytest.approx(1.0001, abs=7e-5)
