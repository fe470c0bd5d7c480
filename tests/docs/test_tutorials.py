"""The tutorials: every command and every block of code, run unchanged in the order of the page."""

import contextlib
import io
import re
from pathlib import Path

import pytest

from twin.cli import run
from twin.config import ConfigError, load_experiment
from twin.config.rig import shipped_lenses
from twin.results.layout import layout_figures

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(
    r"^```(?:\{code-block\} )?(\w+)\n(?::caption: (\S+)\n)?(.*?)^```$", re.DOTALL | re.M
)


def blocks(page: str) -> list[tuple[str, str, str]]:
    """Return the language, caption and text of every block of a page."""
    return BLOCK.findall((DOCS / page).read_text(encoding="utf-8"))


def follow(page: str) -> None:
    """Run the commands and code of the page in the current folder."""
    variables: dict[str, object] = {}
    for language, caption, text in blocks(page):
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


@pytest.mark.parametrize("page", ["getting_started.md", "tutorial_design.md"])
def test_a_tutorial_runs_with_the_printed_output(mi, tmp_path, monkeypatch, page):
    monkeypatch.chdir(tmp_path)
    follow(page)
    assert (tmp_path / "out" / "report.html").is_file()


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
        languages = [language for language, _, _ in blocks(page)]
        assert {"toml", "sh", "python"} <= set(languages), page
    assert sum(len(said(text)) for _, _, text in blocks("tutorial_design.md")) >= 8


def test_the_readmes_experiment_is_valid(tmp_path):
    text = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    whole = [block for language, _, block in BLOCK.findall(text) if language == "toml"]
    assert whole
    for block in whole:
        (tmp_path / "my.toml").write_text(block, encoding="utf-8")
        assert load_experiment(tmp_path / "my.toml").name == "my_first_press"
