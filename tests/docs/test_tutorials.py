"""The tutorials: every command and every block of code, run unchanged in the order of the page."""

import contextlib
import io
import re
from pathlib import Path

import pytest

from reconstruction.reading import read_json
from tests.docs.documents import DOCS, blocks
from twin.cli import run
from twin.config import ConfigError, load_experiment
from twin.config.rig import shipped_lenses
from twin.results.layout import layout_figures


def follow(page: str) -> None:
    """Run the commands and code of the page in the current folder."""
    variables: dict[str, object] = {}
    for block in blocks(DOCS / page):
        language, caption, text = block.language, block.caption, block.text
        if language == "toml" and caption:
            Path(caption).write_text(text, encoding="utf-8")
        elif language == "sh":
            for line in text.splitlines():
                command, *words = line.split()
                assert command in ("twin", "./run"), line
                if command == "twin":
                    assert run(words) == 0, line
        elif language == "python":
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile(text, page, "exec"), variables)
            expected = said(text)
            assert printed.getvalue().splitlines()[-len(expected) :] == expected


def said(text: str) -> list[str]:
    """Return the expected output of a block: comments after a print, or below the block."""
    below = [line.removeprefix("# ") for line in text.splitlines() if re.match(r"# [\d.]", line)]
    behind = re.findall(r"print\(.*\)  # (.*)$", text, re.MULTILINE)
    return below or behind


PRINTED = {
    "getting_started.md": (
        (r"    object: radius 1: ([\d.]+) mm", "object_radius_1_mm", 1.0, 2e-4),
        (r"    object: radius 1: .* mm \+- ([\d.]+) um", "object_radius_1_expanded_um", 1.0, 0.15),
        (r"apparent in the coat: ([\d.]+) mm", "object_radius_1_coat_mm", 1.0, 1e-3),
        (r"deviation of its points ([\d.]+) um RMS", "object_rms_um", 1.0, 0.15),
        (r"um RMS on the ([\d.]+) % of it", "object_coverage_share", 0.01, 0.01),
    )
}
"""Numbers that a page prints as the output of its command: text, figure, unit, tolerance."""


@pytest.mark.parametrize("page", ["getting_started.md", "tutorial_design.md"])
def test_a_tutorial_runs_with_the_printed_output(mi, tmp_path, monkeypatch, page):
    monkeypatch.chdir(tmp_path)
    follow(page)
    assert (tmp_path / "out" / "report.html").is_file()
    for text, figure, unit, digits in PRINTED.get(page, ()):
        (number,) = re.findall(text, (DOCS / page).read_text(encoding="utf-8"))
        metrics = read_json(tmp_path / "out" / "result.json")["metrics"]
        assert metrics[figure] == pytest.approx(unit * float(number), abs=digits), figure


def test_the_page_on_field_lens_and_distance_runs(tmp_path, monkeypatch, capsys):
    """Its commands run, its request is met, and its message is the one that is printed."""
    monkeypatch.chdir(tmp_path)
    follow("optics.md")
    printed = capsys.readouterr().out
    assert "scenes/lenses/kowa_lm35jc10m" in printed
    assert "frames" in printed
    experiment = load_experiment("sensor.toml")
    assert layout_figures(experiment)["depth_of_field_mm"] == pytest.approx(1.0, rel=0.02)
    text = (DOCS / "optics.md").read_text(encoding="utf-8")
    message = re.search(r"^    (optics.field_mm: .*?)\.\.\.$", text, re.DOTALL | re.M)
    lens = {"optics.lens": shipped_lenses()["scenes/lenses/fujinon_hf50xa_5m"].model_dump()}
    with pytest.raises(ConfigError) as failure:
        load_experiment(
            "sensor.toml", lens | {"optics.field_mm": [12, 9], "optics.depth_mm": "absent"}
        )
    assert " ".join(message[1].split()) in str(failure.value)


def test_tutorials_have_something_to_run():
    for page in ("getting_started.md", "tutorial_design.md"):
        languages = [block.language for block in blocks(DOCS / page)]
        assert {"toml", "sh", "python"} <= set(languages), page
    assert sum(len(said(block.text)) for block in blocks(DOCS / "tutorial_design.md")) >= 8
