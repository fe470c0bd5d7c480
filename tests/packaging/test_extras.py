"""Install advice to a user: the named extras and packages must exist."""

import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest

from reconstruction.errors import InputError
from twin.extras import install, missing

ROOT = Path(__file__).resolve().parents[2]
NAMED = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *(ROOT / "twin").rglob("*.py")]


def test_no_text_installs_the_project_from_an_index():
    """The project is in none; extras that a text names are extras of pyproject.toml."""
    known = set(
        tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    )
    for path in NAMED:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"""pip install ['"]?fringe-twin""", text), path
        for names in re.findall(r"pip install -e '\.\[([a-z,]+)\]'", text):
            assert set(names.split(",")) <= known, path


@pytest.mark.parametrize("extra", ["sweep", "view"])
def test_the_command_installs_this_checkout_into_this_python(extra):
    words = shlex.split(install(extra))
    assert words[:5] == [sys.executable, "-m", "pip", "install", "-e"]
    assert words[5] == f"{ROOT}[{extra}]"
    error = missing("--parquet", "pyarrow", extra, "on the workers, too")
    assert isinstance(error, InputError)
    assert str(error).count("\n") == 0


def test_without_a_checkout_the_advice_names_one(monkeypatch):
    monkeypatch.setattr("twin.extras._checkout", lambda: None)
    assert install("view") == (
        f"in a checkout of fringe-twin: {shlex.quote(sys.executable)} -m pip install '.[view]'"
    )
