"""`import reconstruction` gives the public names, and imports no module before one is used."""

import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import reconstruction

ROOT = Path(__file__).parents[2]
HEAVY = ("cv2", "numba", "scipy", "numpy", "h5netcdf", "imageio", "OpenEXR")


def run_python(code):
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )


def test_import_loads_no_submodule():
    code = f"""
import sys, reconstruction
assert set(reconstruction.__all__) <= set(dir(reconstruction))
loaded = [name for name in sys.modules if name.startswith("reconstruction.")]
print(loaded + [name for name in {HEAVY} if name in sys.modules])
"""
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", reconstruction.__all__)
def test_every_public_name_is_there_and_documented(name):
    result = getattr(reconstruction, name)
    assert result.__doc__
    assert name in reconstruction.__doc__


def test_rooms_do_not_take_the_place_of_functions():
    """Why: importing a module sets it as an attribute of its package, over any function."""
    for module in pkgutil.walk_packages(reconstruction.__path__, "reconstruction."):
        importlib.import_module(module.name)
    for name in ("decode", "triangulate", "reconstruct", "calibrate"):
        assert callable(getattr(reconstruction, name))


def test_unknown_names_are_rejected():
    with pytest.raises(AttributeError, match="'decoder'"):
        reconstruction.decoder  # noqa: B018 - the access is tested
