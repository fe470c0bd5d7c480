"""`import twin` gives the public names, and loads no module before a name is used."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import twin

ROOT = Path(__file__).parents[2]
HEAVY = ("mitsuba", "drjit", "numba", "scipy", "numpy", "trimesh", "pydantic", "matplotlib")


def test_import_loads_no_module() -> None:
    code = f"""
import sys, twin
assert set(twin.__all__) <= set(dir(twin))
loaded = [name for name in sys.modules if name.startswith("twin.")]
print(loaded + [name for name in {HEAVY} if name in sys.modules])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", twin.__all__)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    result = getattr(twin, name)
    assert result.__doc__
    assert f"`{name}`" in str(twin.__doc__)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="'measurement'"):
        twin.measurement  # noqa: B018 - the access is tested


def test_type_checkers_read_the_same_names() -> None:
    """A block for type checkers, which cannot read a table, has the same names and modules."""
    tree = ast.parse((ROOT / "twin/__init__.py").read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If)).body
    imported = {
        alias.name: node.module
        for node in block
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    (renamed,) = (node for node in block if isinstance(node, ast.Assign))
    assert isinstance(renamed.targets[0], ast.Tuple)
    assert isinstance(renamed.value, ast.Tuple)
    names = dict(zip(renamed.targets[0].elts, renamed.value.elts, strict=True))
    places = {ast.unparse(name): ast.unparse(inner) for name, inner in names.items()}
    read = {name: f"{imported.pop(inner)}:{inner}" for name, inner in places.items()} | imported
    assert read == {name: place for name, (place, _) in twin.NAMES.items()}


@pytest.mark.parametrize("name", ["uncertainty", "adopt", "compensate", "calibrate"])
def test_verbs_are_functions_after_any_import(name: str) -> None:
    import twin.adoption.adopt
    import twin.propagation.trials

    assert inspect.isfunction(getattr(twin, name))
