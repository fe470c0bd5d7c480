"""Files to begin with: each one is listed, commented, valid, and measures its object."""

import pytest

from reconstruction.reading import read_json
from twin.cli import run
from twin.config import load_experiment
from twin.config.specimen_base import SPECIMENS
from twin.config.study import load_study
from twin.config.templates import read_template, templates
from twin.study.record import StudyRecord

SMALL = ("camera.binning=4", "camera.width_px=1280", "camera.height_px=960")
COARSE = ("press.relief_pitch_mm=0.05", "press.solver_pitch_mm=0.16")
THICK = ('elastomer.thickness_mm={value=0.3, source="test"}', "press.relief_pitch_mm=0.05",
         "press.cell_mm=0.3", *SMALL)  # fmt: skip
FEW_PRESSES = (
    "press.relief_pitch_mm=0.05",
    "press.solver_pitch_mm=0.16",
    "photometric.presses.count=5",
    "photometric.presses.backgrounds=2",
    "photometric.presses.smallest_diameter_mm=5.5",
)
MEASURED = {
    "gel": SMALL + COARSE,
    "part": SMALL + COARSE,
    "rig": SMALL + COARSE,
    "sheet": THICK,
    "gelsight": FEW_PRESSES,
}


def test_every_template_is_listed_with_its_description(capsys):
    assert run(["init", "--list"]) == 0
    shown = capsys.readouterr().out
    assert {item.name for item in templates()} == {*MEASURED, "study"}
    for item in templates():
        assert item.name in shown
        assert len(item.description) > 20
        comments = [line for line in read_template(item.name).splitlines() if "#" in line]
        assert len(comments) >= 6


def test_the_first_one_names_every_kind():
    text = read_template("gel")
    for kind in SPECIMENS.names():
        assert f" {kind} " in text.replace("\n", " ").replace(",", " "), kind


def test_an_unknown_template_is_one_line(tmp_path, capsys):
    assert run(["init", str(tmp_path / "x.toml"), "--template", "gell"]) == 2
    assert "did you mean gel?" in capsys.readouterr().err
    assert not (tmp_path / "x.toml").exists()


@pytest.mark.parametrize("name", MEASURED)
def test_each_template_measures_its_object(mi, name, tmp_path, capsys):
    """From `init` to a verdict, small and coarse; the report opens with it."""
    file, out = tmp_path / "experiment.toml", tmp_path / "out"
    assert run(["init", str(file), "--template", name]) == 0
    settings = [part for item in MEASURED[name] for part in ("-s", item)]
    pages = [] if name == "gelsight" else ["--no-report"]
    assert run(["measure", str(file), "-o", str(out), *settings, *pages]) == 0
    figures = read_json(out / "result.json")["metrics"]
    assert figures["measurands_judged"] == len(load_experiment(file).measurand)
    assert figures["measurands_within"] == figures["measurands_judged"]
    shown = " ".join(capsys.readouterr().out.split())
    assert "object: " in shown
    assert "within tolerance" in shown
    assert "not within" not in shown
    if name == "gel":
        assert "object: height: 0." in shown
    if pages:
        return
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "How accurately is the object measured?" in page
    assert page.index("within tolerance") < page.index('id="object"')


def test_the_study_is_valid_and_ranks_by_the_object(tmp_path):
    file = tmp_path / "study.toml"
    assert run(["init", str(file), "--template", "study"]) == 0
    study, base = load_study(file)
    assert [item.metric for item in study.objectives] == ["least_margin_um"]
    assert len(StudyRecord(study, base).cases().unique()) == 9
