"""A coating from a user's file: found from TOML, the command line, keys, schema and a study."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from twin.cli.plugins import without_plugins

ROOT = Path(__file__).parents[2]
PLUGIN = ROOT / "docs/extend/enamel.py"
EXPERIMENT = """
name = "enamelled"
use = "scenes/examples/slab_ball"

[coating]
kind = "enamel"
albedo = {albedo}

[press]
solver_pitch_mm = 0.16
relief_pitch_mm = 0.05

[projector]
width_px = 320
height_px = 180

[camera]
width_px = 96
height_px = 72
binning = 1
pixel_pitch_um = {{ value = 90.0, source = "test" }}

[patterns]
steps = 3
period_px = 32
"""
STUDY = """
name = "coats"
base = "{base}"

[[axis]]
path = "coating.albedo"
values = [0.2, 0.6]
"""


def twin(*words, code=0):
    """Run a command of its own process, without plug-ins of this one; return stdout and stderr."""
    done = subprocess.run(
        [sys.executable, "-c", "from twin.cli import main; main()", *map(str, words)],
        cwd=ROOT,
        env={name: value for name, value in os.environ.items() if name != "FRINGE_TWIN_PLUGINS"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stderr
    return done.stdout, done.stderr


@pytest.fixture
def experiment(tmp_path):
    file = tmp_path / "enamelled.toml"
    file.write_text(EXPERIMENT.format(albedo=0.4), encoding="utf-8")
    return file


def test_the_example_is_short():
    assert len(PLUGIN.read_text(encoding="utf-8").splitlines()) <= 60


def test_without_the_plugin_the_kind_is_unknown_in_one_line(experiment, tmp_path):
    _, message = twin("render", experiment, "-o", tmp_path / "out", code=2)
    assert message.count("\n") == 1
    assert "coating.kind: found 'enamel', allowed: " in message
    assert "'flakes', 'matte', 'measured'" in message


def test_an_experiment_is_rendered_with_it(mi, experiment, tmp_path):
    out = tmp_path / "out"
    twin("render", "--plugin", PLUGIN, experiment, "-o", out)
    assert 'kind = "enamel"' in (out / "experiment.toml").read_text(encoding="utf-8")


def test_a_range_of_it_is_refused_in_one_line(experiment, tmp_path):
    words = ("render", experiment, f"--plugin={PLUGIN}", "-o", tmp_path / "out")
    _, message = twin(*words, "-s", "coating.albedo=1.5", code=2)
    assert message.strip().endswith("coating.albedo: found 1.5, should be less than 1")


def test_its_keys_are_listed():
    keys, _ = twin("--plugin", PLUGIN, "keys", "pigment")
    assert "coating(enamel).albedo" in keys.splitlines()


def test_a_study_on_two_processes_measures_with_it(mi, experiment, tmp_path):
    study, out = tmp_path / "study.toml", tmp_path / "out"
    study.write_text(STUDY.format(base=experiment), encoding="utf-8")
    twin("sweep", study, "-o", out, "-j", 2, "--plugin", PLUGIN)
    results = [json.loads(file.read_text("utf-8")) for file in out.rglob("result.json")]
    assert len(results) == 2
    exposures = sorted(result["metrics"]["exposure_ms"] for result in results)
    assert exposures[1] > exposures[0]  # the darker enamel needs more


def test_a_file_that_fails_is_named_with_its_line(tmp_path):
    broken = tmp_path / "broken.py"
    broken.write_text("import math\nmath.nothing\n", encoding="utf-8")
    _, message = twin("keys", "--plugin", broken, code=2)
    assert f"{broken}:2: AttributeError" in message
    _, message = twin("keys", "--plugin", tmp_path / "absent.py", code=2)
    assert "found no file there" in message
    _, message = twin("keys", "--plugin", code=2)
    assert "--plugin: found no file" in message


def test_the_option_may_be_anywhere_but_after_the_end_of_options():
    assert without_plugins(["a", "--plugin", "x.py", "b", "--plugin=y.py"]) == (
        ["a", "b"],
        ["x.py", "y.py"],
    )
    assert without_plugins(["a", "--", "--plugin", "x"]) == (["a", "--", "--plugin", "x"], [])


def test_an_installed_package_brings_a_kind(tmp_path):
    """Only the package's entry point registers it: no plug-in is named."""
    (tmp_path / "enamel.py").write_text(PLUGIN.read_text(encoding="utf-8"), encoding="utf-8")
    installed = tmp_path / "enamel-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: enamel\nVersion: 1.0\n")
    points = "[fringe_twin.coatings]\nenamel = enamel:Enamel\n"
    (installed / "entry_points.txt").write_text(points)
    code = "from twin.config.coatings import COATINGS; print(*COATINGS.names())"
    path = os.pathsep.join([str(ROOT), str(tmp_path)])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["enamel", "flakes", "matte", "measured"]


def test_documents_that_are_in_use_take_a_kind_that_comes_later():
    code = f"""
import twin
from twin.config.models import Experiment
changes = {{"coating": {{"kind": "enamel", "albedo": 0.4}}}}
slab = twin.load_experiment("examples/slab_ball")
try:
    twin.vary(slab, changes)
except Exception as error:
    print("unknown" if "enamel" in str(error) else error)
twin.plugin({str(PLUGIN)!r})
print(twin.vary(slab, changes).coating)
print("Enamel" in Experiment.model_json_schema()["$defs"])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    first, coating, in_schema = done.stdout.splitlines()
    assert (first, in_schema) == ("unknown", "True")
    assert coating == "kind='enamel' texture=None albedo=0.4 gloss_roughness=0.1"
