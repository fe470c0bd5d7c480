"""The first examples of the README measure their object: its statements as assertions."""

import re
from pathlib import Path

import pytest

from reconstruction.reading import read_json
from tests.docs.documents import DOCS, ROOT, blocks
from twin.cli import run
from twin.config import load_experiment

README = ROOT / "README.md"
PROMISED_UM = 20.0


def minimal_experiment() -> str:
    (result,) = (block.text for block in blocks(README) if block.language == "toml")
    return result


@pytest.fixture
def minimal(tmp_path) -> Path:
    file = tmp_path / "my.toml"
    file.write_text(minimal_experiment(), encoding="utf-8")
    return file


def test_the_minimal_experiment_of_the_readme_reads_its_ball(mi, minimal, tmp_path, capsys):
    """Setup: as printed, on a sixteenth of the pixels.

    Expected: the radius of the object, 3 mm, within the 20 um that the README promises, in
    result.json and as the first figure on the terminal, before the figures of the coat.
    """
    out = tmp_path / "out"
    command = ["measure", str(minimal), "-o", str(out), "-s", "camera.binning=4", "--no-report"]
    assert run(command) == 0
    figures = read_json(out / "result.json")["metrics"]
    radius_mm = load_experiment(minimal).specimen.diameter_mm / 2
    assert abs(figures["object_radius_1_mm"] - radius_mm) < 1e-3 * PROMISED_UM
    assert figures["object_radius_1_expanded_um"] < PROMISED_UM
    assert figures["object_radius_1_mm"] == figures["compensated_sphere_1_radius_mm"]
    assert "within 20 um" in README.read_text("utf-8")
    first, *_ = re.findall(r"[\d.]+ mm", capsys.readouterr().out)
    assert first == f"{figures['object_radius_1_mm']:.4f} mm"


def test_getting_started_begins_with_the_same_experiment(minimal, tmp_path):
    page = tmp_path / "page.toml"
    started = blocks(DOCS / "getting_started.md")
    (text,) = (block.text for block in started if block.caption == "my.toml")
    page.write_text(text, encoding="utf-8")
    assert load_experiment(page) == load_experiment(minimal, {"camera.binning": 4})


def test_without_air_the_terminal_prints_a_line_with_which_the_object_is_measured(
    mi, minimal, tmp_path, capsys
):
    """Setup: the experiment without air, and again with the printed line of TOML in its table.

    Expected: the radius is not measured without the line, and within 20 um with it.
    """
    text = minimal.read_text(encoding="utf-8")
    minimal.write_text(re.sub(r"back_pressure_kpa = .*", "", text), encoding="utf-8")
    few = ["camera.binning=4", "press.cell_mm=0.3", "press.relief_pitch_mm=0.05"]
    command = ["measure", str(minimal), "-o", str(tmp_path / "out"), "--no-report"]
    command += [word for setting in few for word in ("-s", setting)]
    assert run(command) == 0
    printed = capsys.readouterr().out
    assert "not measured" in printed
    (line,) = re.findall(r"^    (back_pressure_kpa = .*)$", printed, re.M)
    assert "# in [press]: touches" in line
    with minimal.open("a", encoding="utf-8") as file:
        file.write(f"{line}\n")
    assert run(command) == 0
    assert "remedy" not in capsys.readouterr().out
    figures = read_json(tmp_path / "out" / "result.json")["metrics"]
    assert abs(figures["object_radius_1_mm"] - 3.0) < 1e-3 * PROMISED_UM
