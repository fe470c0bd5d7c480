"""The newcomer: own raised text of 0.2 mm, to be measured within 10 um; which sensor does it?"""

import json
import re

import pytest

from reconstruction.reading import read_json
from tests.letters import raised_text
from twin.cli import run

PART = """
[specimen]
kind = "mesh"
file = "./text.stl"

[[measurand]]
name = "height"
quantity = "step_height"
nominal_mm = 0.2
plus_minus_um = 10.0

[[measurand]]
name = "shape"
quantity = "deviation"
upper_um = 10.0
"""
AXES = """
[set.camera]
binning = 4
width_px = 1280
height_px = 960

[set.press]
relief_pitch_mm = 0.05
solver_pitch_mm = 0.16

[[axis]]
name = "thickness_mm"
path = "elastomer.thickness_mm"
values = [2.0, 4.0]

[[axis]]
name = "force_n"
path = "press.force_n"
values = [1.0, 15.0]
"""


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """An empty folder with the newcomer's STL in it."""
    raised_text("HTL", 0.2, 0.5).export(tmp_path / "text.stl")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_from_an_stl_to_a_sensor_that_meets_10_um(mi, desk, capsys):
    """init, own part, own study, best design, its measurement: all from the command line.

    Expected: the design that presses too little is not feasible or fails a tolerance, the best one
    meets both with a margin to U; a single measurement reports that in terminal and report, and
    its figures are those of the study's table.
    """
    assert run(["init", "--template", "gel"]) == 0
    sensor = (desk / "experiment.toml").read_text(encoding="utf-8")
    cut = re.compile(r"\[specimen\].*?(?=\[elastomer\])", re.DOTALL)
    (desk / "experiment.toml").write_text(cut.sub(PART, sensor), encoding="utf-8")

    assert run(["init", "--template", "study"]) == 0
    study = (desk / "study.toml").read_text(encoding="utf-8")
    study = study.replace('"templates/part"', '"experiment.toml"')
    cut = re.compile(r"\[set\.camera\].*?(?=\[\[constraint\]\])", re.DOTALL)
    (desk / "study.toml").write_text(cut.sub(AXES, study), encoding="utf-8")

    assert run(["sweep", "study.toml", "-o", "found", "--dry-run"]) == 0
    assert run(["sweep", "study.toml", "-o", "found", "-j", "1"]) == 0
    capsys.readouterr()
    assert run(["sweep", "best", "found"]) == 0
    message = capsys.readouterr().out
    assert "least_margin_um" in message

    cases = {path.parent.name: read_json(path)["metrics"]
             for path in desk.glob("found/cases/*/result.json")}  # fmt: skip
    assert len(cases) == 4
    margins = {name: item["least_margin_um"] for name, item in cases.items()}
    feasible = [name for name, item in cases.items() if item["object_coverage_share"] >= 0.8]
    best = max(feasible, key=lambda name: margins[name] if margins[name] is not None else -1e9)
    assert len(feasible) < 4
    assert margins[best] > 0

    chosen = desk / "found" / "cases" / best / "experiment.toml"
    assert run(["measure", str(chosen), "-o", "best"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert re.search(r"object: height: 0\.\d+ mm .*, within tolerance", shown)
    assert re.search(r"object: shape: .*, within tolerance", shown)
    figures = json.loads((desk / "best" / "result.json").read_text())["metrics"]
    assert figures["least_margin_um"] == margins[best]
    assert figures["measurands_within"] == 2
    assert abs(figures["object_height_error_um"]) < 10.0
    assert figures["object_shape_um"] < 10.0
    assert "within tolerance" in (desk / "best" / "report.html").read_text(encoding="utf-8")
