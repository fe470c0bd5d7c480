"""A coating from a user's file: found from TOML, the command line, keys and schema."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from twin.cli import run
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


def twin(*words, code=0):
    """Run a command of its own process, without plug-ins of this one; return stdout and stderr."""
    return python("from twin.cli import main; main()", *words, code=code)


def python(program, *words, code=0):
    """Run code in a process of its own, without plug-ins of this one; return stdout and stderr."""
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, words)],
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


def test_without_the_plugin_the_kind_is_unknown_in_one_line(experiment, tmp_path, capsys):
    assert run(["render", str(experiment), "-o", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "coating.kind: found 'enamel', allowed: " in message
    assert "'flakes', 'matte', 'measured'" in message


def test_an_experiment_is_rendered_with_it(mi, experiment, tmp_path):
    out = tmp_path / "out"
    twin("render", "--plugin", PLUGIN, experiment, "-o", out)
    assert 'kind = "enamel"' in (out / "experiment.toml").read_text(encoding="utf-8")


TWO_LINES = """
import sys
from twin.cli import run
plugin, *line = sys.argv[1:]
run(["keys", "pigment", "--plugin", plugin])
sys.exit(run([*line, f"--plugin={plugin}"]))
"""


def test_its_keys_are_listed_and_a_range_is_refused_in_one_line(experiment, tmp_path):
    line = "render", experiment, "-o", tmp_path / "out", "-s", "coating.albedo=1.5"
    keys, message = python(TWO_LINES, PLUGIN, *line, code=2)
    assert "coating(enamel).albedo" in keys.splitlines()
    assert message.strip().endswith("coating.albedo: found 1.5, should be less than 1")


def test_a_file_that_fails_is_named_with_its_line(tmp_path, capsys):
    broken = tmp_path / "broken.py"
    broken.write_text("import math\nmath.nothing\n", encoding="utf-8")
    for file, message in (
        (str(broken), f"{broken}:2: AttributeError"),
        (str(tmp_path / "absent.py"), "found no file there"),
        ("", "--plugin: found no file"),
    ):
        assert run(["keys", "--plugin", *([file] if file else [])]) == 2
        assert message in capsys.readouterr().err


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
    first, coating, in_schema = python(code)[0].splitlines()
    assert (first, in_schema) == ("unknown", "True")
    assert coating == "kind='enamel' texture=None albedo=0.4 gloss_roughness=0.1"
