"""`import twin` gives the public names, and costs nothing before one is used."""

import subprocess
import sys
from pathlib import Path

import pytest

import twin

ROOT = Path(__file__).parents[2]
HEAVY = ("mitsuba", "drjit", "numba", "scipy", "numpy", "trimesh", "pydantic", "matplotlib")


def test_import_alone_loads_nothing() -> None:
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
    found = getattr(twin, name)
    assert found.__doc__
    assert f"`{name}`" in str(twin.__doc__)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="'measurement'"):
        twin.measurement  # noqa: B018 - the access is what is tested
