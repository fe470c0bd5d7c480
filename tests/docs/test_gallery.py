"""The gallery shows exactly the shipped examples."""

import re
import tomllib
from pathlib import Path
from typing import Any

from twin.config import load_experiment

ROOT = Path(__file__).parents[2]
GALLERY = ROOT / "docs" / "gallery"


def shipped() -> set[str]:
    """Return the names of the files in scenes/examples and scenes/paper that are experiments."""
    return {
        file.relative_to(ROOT / "scenes").with_suffix("").as_posix()
        for folder in ("examples", "paper")
        for file in (ROOT / "scenes" / folder).glob("*.toml")
        if is_experiment(tomllib.loads(file.read_text(encoding="utf-8")))
    }


def is_experiment(tree: dict[str, Any]) -> bool:
    """Problems of an identification have rows, and may extend another problem."""
    return {"name", "use"} <= set(tree) and "rows" not in tree


def test_every_experiment_has_a_picture():
    names = shipped()
    assert len(names) > 30
    pictures = {file.stem for file in GALLERY.iterdir()}
    assert {name.replace("/", "_") for name in names} == pictures


def test_every_experiment_has_a_line():
    assert [name for name in shipped() if not load_experiment(name).description] == []


def test_pictures_are_small():
    sizes = [file.stat().st_size for file in GALLERY.iterdir()]
    assert max(sizes) < 40_000
    assert sum(sizes) < 1_000_000


def test_the_front_page_links_the_first_steps():
    """README and the site's first page lead to the same beginnings."""
    for page in (ROOT / "README.md", ROOT / "docs" / "index.md"):
        targets = re.findall(r"\]\((?:docs/)?(\w+)\.md\)", page.read_text(encoding="utf-8"))
        assert {"getting_started", "layouts", "tutorial_design", "real_rig"} <= set(targets)
