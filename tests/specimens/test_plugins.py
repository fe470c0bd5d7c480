"""Specimens from outside the package: a plug-in file, pressed like a built-in kind.

Each test runs in its own process, because a registered kind remains until its process ends.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from twin.config.specimen_base import SPECIMENS, Specimen

ROOT = Path(__file__).parents[2]
LENS = (ROOT / "docs/extend/lens.py").read_text(encoding="utf-8")
FILE = """
name = "lens"
use = "scenes/examples/slab_ball"
[specimen]
kind = "lens"
radius_mm = {radius_mm}
[press]
relief_pitch_mm = 0.05
solver_pitch_mm = 0.2
"""
COARSE = {"press.relief_pitch_mm": 0.05, "press.solver_pitch_mm": 0.2}


def run(code: str, folder: Path) -> str:
    """Run code in a new process, in a folder with lens.py and lens.toml; return its output."""
    (folder / "lens.py").write_text(LENS)
    (folder / "lens.toml").write_text(FILE.format(radius_mm=4.0))
    (folder / "main.py").write_text(code)
    command = [sys.executable, "main.py"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, env=environment
    )
    assert not done.returncode, done.stderr
    return done.stdout


def test_a_plug_in_specimen_is_pressed_like_the_ball_that_it_is(tmp_path: Path) -> None:
    code = f"""
import numpy as np
import twin
from reconstruction.registry import load_plugin
from twin.config.schema import experiment_keys
from twin.results.quantities import measurands_of

ball = twin.load_experiment("examples/slab_ball", {COARSE})  # before the plug-in is known
load_plugin("lens.py")
lens = twin.load_experiment("lens.toml")
assert 2 * lens.specimen.radius_mm == ball.specimen.diameter_mm
first, second = twin.press(ball), twin.press(lens)
np.testing.assert_array_equal(first.face_z_mm, second.face_z_mm)
assert first.force_n == second.force_n
assert [one.name for one in measurands_of(lens)] == ["radius_1"]
assert "specimen(lens).radius_mm" in {{key.path for key in experiment_keys()}}
assert twin.vary(lens, {{"specimen.radius_mm": 3.0}}).specimen.radius_mm == 3.0
group = {{"specimen": {{"kind": "group", "parts": {{"a": {{"kind": "lens"}}}}}}}}
assert twin.vary(ball, group).specimen.parts["a"].kind == "lens"
"""
    run(code, tmp_path)


def test_reading_a_file_runs_no_plug_in(tmp_path: Path) -> None:
    code = """
import twin
try:
    twin.load_experiment("lens.toml", {"specimen.plugin": "lens.py"})
except twin.config.ConfigError as error:
    print(error)
"""
    assert "specimen.kind: found 'lens', allowed: 'ball', " in run(code, tmp_path)


def test_a_package_adds_a_specimen_by_an_entry_point(tmp_path: Path) -> None:
    metadata = tmp_path / "lenses-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: lenses\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[fringe_twin.specimens]\nlens = lens:Lens\n")
    code = "import twin; print(twin.load_experiment('lens.toml').specimen.radius_mm)"
    assert run(code, tmp_path) == "4.0\n"


def test_an_experiment_is_loaded_without_the_geometry_libraries(tmp_path: Path) -> None:
    code = """
import sys
import twin
twin.load_experiment("examples/wrapped_nut")
print({"trimesh", "manifold3d", "numba", "mitsuba"} & set(sys.modules))
"""
    assert run(code, tmp_path) == "set()\n"


def test_only_specimens_with_a_shape_are_registered() -> None:
    class Shapeless(Specimen):
        kind: str = "shapeless"

    with pytest.raises(ValueError, match=r"^specimens: Shapeless has no shape; define shape"):
        SPECIMENS.register(Shapeless)
    with pytest.raises(ValueError, match=r"^specimens: found <class 'int'>, allowed subclasses"):
        SPECIMENS.register(int)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", SPECIMENS.names())
def test_every_kind_is_one_documented_file(kind: str) -> None:
    model = SPECIMENS[kind]
    assert model.__module__ == f"twin.specimens.kinds.{kind}"
    assert model.__doc__
    assert f"| `{kind}` |" in (ROOT / "docs" / "specimens.md").read_text(encoding="utf-8")
    for path in model.slab_fit_paths:
        assert path in model.model_fields
