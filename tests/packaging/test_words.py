"""Words of the field where a user looks, and one meaning for each class name."""

import ast
import contextlib
import io
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from twin.cli import run

ROOT = Path(__file__).parents[2]
INSTEAD = {
    r"\bopponents?\b": "comparison method",
    r"does not get\b": "pixels without a measurement",
    r"\bsomebody\b|\bwhoever looks\b|\bobservers?\b": "external view camera",
    r"\bladders?\b": "temporal unwrapping",
    r"\bwatchers?\b": "progress callback",
    r"\berrors? over sigma\b": "normalised error",
    r"\bmisses of\b|\bpixel misses\b": "reprojection residuals",
    r"\babsent:": "default:",
    r"\bbars? (?:is|are) met\b|\bwithin (?:its|their) bars?\b": "target",
}
COMMANDS = ("adopt", "calibrate", "compare", "compensate", "completion", "dataset", "decode",
            "demo", "describe", "doctor", "export", "identify", "init", "keys", "measure", "paper",
            "patterns", "press", "reconstruct", "render", "report", "scan", "score", "sweep",
            "uncertainty", "view")  # fmt: skip


def written() -> Iterator[tuple[str, str]]:
    """Pages that a user reads."""
    pages = sorted(ROOT.glob("docs/*.md")) + sorted(ROOT.glob("docs/physics/*.md"))
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *pages):
        yield path.name, path.read_text(encoding="utf-8")


def help_texts() -> Iterator[tuple[str, str]]:
    """Help of every command."""
    for command in ([], *([name] for name in COMMANDS), ["sweep", "table"], ["sweep", "best"]):
        shown = io.StringIO()
        with contextlib.redirect_stdout(shown):
            assert run([*command, "--help"]) == 0
        assert len(shown.getvalue()) > 60
        yield " ".join(["twin", *command]), shown.getvalue()


def captioned() -> Iterator[tuple[str, str]]:
    """Titles, captions, notes and labels: every text in the modules that make pages."""
    for folder in ("twin/report", "twin/paper"):
        for path in sorted((ROOT / folder).glob("*.py")):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            texts = [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant)]
            yield path.name, "\n".join(text for text in texts if isinstance(text, str))


@pytest.mark.parametrize("texts", [written, help_texts, captioned])
def test_users_read_the_words_of_the_field(texts):
    for name, text in texts():
        for banned, better in INSTEAD.items():
            result = re.search(banned, text, re.IGNORECASE)
            assert result is None, f"{name}: '{result.group()}'; say {better}"


def classes(indented: str = "") -> list[str]:
    """Return the names of all classes, of the outermost ones by default."""
    return [
        name
        for folder in ("twin", "reconstruction", "benchmarks")
        for path in (ROOT / folder).rglob("*.py")
        for name in re.findall(rf"^{indented}class (\w+)", path.read_text("utf-8"), re.MULTILINE)
    ]


def test_no_class_name_is_defined_twice():
    names = Counter(classes())
    assert len(names) > 500
    assert [name for name, count in names.items() if count > 1] == []


def test_names_are_words_of_the_field_too():
    """Class names are those in common use."""
    banned = {"Watcher", "Thing", "Observer", "Wish", "Opponent", "Ladder"}
    assert not banned.intersection(classes(indented=" *"))


def _assigned(tree: ast.Module) -> Iterator[str]:
    """Yield the names of functions, arguments, variables and attributes that a module defines."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr


def test_names_state_what_a_value_is():
    """A name that only states how a value was obtained does not state the value."""
    banned = {"found", "told", "asked"}
    folders = ("twin", "reconstruction", "benchmarks", "tests", "docs")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    assert len(files) > 1000
    for path in files:
        names = _assigned(ast.parse(path.read_text("utf-8")))
        vague = [n for n in names if banned & {*n.split("_")} and not n.startswith("test_")]
        assert not vague, f"{path.relative_to(ROOT)}: {vague[0]}"
