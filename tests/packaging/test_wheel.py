"""The wheel works far from the checkout: built, installed into a clean environment, used there."""

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
USE = """
import tomllib
from pathlib import Path
import reconstruction, twin
from twin.assets import asset_path, list_assets
from twin.config.loading import load_experiment

site = Path(twin.__file__).parents[1]
material = asset_path("materials", "elastomers/silicone_c")
assert material.is_relative_to(site), material
assert tomllib.loads(material.read_text())
assert asset_path("scenes", "examples/slab_balls").is_relative_to(site)
assert load_experiment("examples/slab_balls")
assert Path(reconstruction.__file__).is_relative_to(site)
print(len(list_assets("scenes")), len(list_assets("materials")))
"""


def run(*command: str | Path, cwd: Path) -> str:
    env = {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONPATH", "TWIN_ASSETS")
    }
    ended = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        folder,
        ROOT,
        cwd=folder,
    )
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory) -> Path:
    """Interpreter of an environment that has the wheel and borrows its dependencies from ours."""
    folder = tmp_path_factory.mktemp("clean")
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    interpreter = folder / "venv" / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", interpreter, "--disable-pip-version-check"]
    run(*pip, "install", "-q", "--no-deps", "--no-index", wheel, cwd=folder)
    # Points to the packages only: an editable install's own .pth over there is not followed.
    (site,) = (folder / "venv" / "lib").glob("python*/site-packages")
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return interpreter


def names(wheel: Path) -> list[str]:
    with zipfile.ZipFile(wheel) as archive:
        return archive.namelist()


def test_wheel_holds_the_two_packages_only(wheel):
    tops = {name.partition("/")[0] for name in names(wheel)}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"twin", "reconstruction"}


@pytest.mark.parametrize("collection", ["scenes", "materials"])
def test_wheel_holds_all_data(wheel, collection):
    here = {
        f"twin/_assets/{path.relative_to(ROOT).as_posix()}"
        for path in (ROOT / collection).rglob("*")
        if path.is_file()
    }
    assert here
    assert here <= set(names(wheel))


def test_wheel_holds_the_type_markers(wheel):
    assert {"twin/py.typed", "reconstruction/py.typed"} <= set(names(wheel))


def test_installed_wheel_loads_a_scene_and_a_material(python, tmp_path):
    scenes, materials = run(python, "-P", "-c", USE, cwd=tmp_path).split()
    assert int(scenes) > 0
    assert int(materials) > 0


def test_installed_wheel_has_the_command(python, tmp_path):
    assert shutil.which("twin", path=str(python.parent))
    assert "press" in run(python.parent / "twin", "--help", cwd=tmp_path)
