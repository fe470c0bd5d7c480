"""Settings of plug-ins in experiments: an elastomer model's table, and a kind of camera noise."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
WINKLER, ROW_NOISE = (ROOT / f"docs/extend/{name}.py" for name in ("winkler", "row_noise"))
EXPERIMENT = """
name = "springs"
use = "scenes/rigs/slab"

[specimen]
kind = "ball"
diameter_mm = 8.0

[elastomer]
layout = "contact_face"
thickness_mm = 4.0
young_modulus_kpa = 100.0
poisson_ratio = 0.45

[layers.gel]
bottom_mm = 0.0
thickness_mm = 4.0
ior = 1.41

[press]
control = "depth"
depth_mm = 0.4
solver_pitch_mm = 0.16
relief_pitch_mm = 0.05

[mechanics]
model = "winkler"

[mechanics.settings.winkler]
stiffness_kpa_per_mm = {{ value = {stiffness}, source = "assumed: test" }}

[projector]
width_px = 320
height_px = 180

[patterns]
steps = 3
period_px = 32

[camera]
width_px = 96
height_px = 72
binning = 1
pixel_pitch_um = {{ value = 90.0, source = "test" }}
noise_model = {{ kind = "row_noise", row_sigma_e = 300.0 }}
"""
STUDY = """
name = "springs_and_rows"
base = "{base}"

[[axis]]
path = "mechanics.settings.winkler.stiffness_kpa_per_mm"
values = [20.0, 40.0]

[[axis]]
path = "camera.noise_model.kind"
values = ["emva1288", "row_noise"]
"""


def python(code: str, *words: object, status: int = 0) -> str:
    """Run code in a process of its own, without plug-ins of this one; return its output."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        cwd=ROOT,
        env={name: value for name, value in os.environ.items() if name != "FRINGE_TWIN_PLUGINS"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == status, done.stderr
    return done.stderr if status else done.stdout


def twin(*words: object, status: int = 0) -> str:
    """Run a command with both plug-ins."""
    plugins = "--plugin", WINKLER, "--plugin", ROW_NOISE
    return python("from twin.cli import main; main()", *words, *plugins, status=status)


@pytest.fixture
def experiment(tmp_path: Path) -> Path:
    file = tmp_path / "springs.toml"
    file.write_text(EXPERIMENT.format(stiffness=20.0), encoding="utf-8")
    return file


def test_the_table_of_a_model_is_used_and_written(experiment: Path, tmp_path: Path) -> None:
    """Force k pi d^2 (R - d / 3) of a ball on springs of stiffness k, 20 kPa/mm."""
    out = tmp_path / "out"
    twin("press", experiment, "-o", out)
    metrics = json.loads((out / "result.json").read_text("utf-8"))["metrics"]
    force_n = 1e-3 * 20.0 * np.pi * 0.4**2 * (4.0 - 0.4 / 3)
    assert metrics["force_n"] == pytest.approx(force_n, rel=0.02)
    resolved = (out / "experiment.toml").read_text("utf-8")
    assert "[mechanics.settings.winkler]\nstiffness_kpa_per_mm = 20.0" in resolved
    assert '[camera.noise_model]\nkind = "row_noise"\nrow_sigma_e = 300.0' in resolved
    assert '[provenance."mechanics.settings.winkler.stiffness_kpa_per_mm"]' in resolved


WRONG = f"""
import sys
import twin

twin.plugin({str(WINKLER)!r})
twin.plugin({str(ROW_NOISE)!r})
for key in (
    "mechanics.settings.winkler.stiffness_kpa_per_mm",
    "mechanics.settings.winkler.stiffness_kpa",
    "mechanics.settings.winklr.stiffness_kpa_per_mm",
    "mechanics.settings.sheet.tack",
    "mechanics.settings",
    "camera.noise_model.row_sigma_e",
):
    try:
        twin.load_experiment(sys.argv[1], {{key: -1.0}})
    except twin.config.ConfigError as error:
        print(str(error).removeprefix(sys.argv[1] + ": "))
"""
MESSAGES = """\
mechanics.settings.winkler.stiffness_kpa_per_mm: found -1.0, should be greater than 0
unknown key 'stiffness_kpa' in [mechanics.settings.winkler]; did you mean 'stiffness_kpa_per_mm'?
unknown key 'winklr' in [mechanics.settings]; did you mean 'winkler'?
unknown key 'sheet' in [mechanics.settings]; remove it
mechanics.settings: found -1.0, allowed tables by name
camera.noise_model.row_sigma_e: found -1.0, should be greater than or equal to 0
"""


def test_wrong_settings_are_one_line(experiment: Path) -> None:
    assert python(WRONG, experiment) == MESSAGES


KEYS_AND_SCHEMA = f"""
import twin
from twin.config import digest
from twin.config.models import Experiment
from twin.config.schema import experiment_keys

slab = twin.load_experiment("examples/slab_ball")
before = digest(slab), set(Experiment.model_json_schema()["$defs"])
for file in ({str(WINKLER)!r}, {str(ROW_NOISE)!r}):
    twin.plugin(file)
assert digest(slab) == digest(twin.load_experiment("examples/slab_ball")) == before[0]
defaults = twin.vary(slab, {{"mechanics.model": "winkler"}})
assert defaults.mechanics.settings["winkler"].stiffness_kpa_per_mm is None
assert digest(twin.vary(defaults, {{"mechanics.model": "auto"}})) != before[0]
keys = {{key.path: key for key in experiment_keys()}}
assert "of the springs" in keys["mechanics.settings.winkler.stiffness_kpa_per_mm"].meaning
assert keys["camera.noise_model(row_noise).row_sigma_e"].default == "2.0"
print(*set(Experiment.model_json_schema()["$defs"]) - before[1])
"""


def test_keys_and_schema_have_the_settings_and_digests_are_the_same() -> None:
    assert set(python(KEYS_AND_SCHEMA).split()) == {"Foundation", "RowNoise"}


PRESSES = f"""
import sys
import twin
from twin.pipeline.press import press

twin.plugin({str(WINKLER)!r})
twin.plugin({str(ROW_NOISE)!r})
memory, base = twin.Memory(), twin.load_experiment(sys.argv[1])
forces = []
for changes in (
    {{}},
    {{"mechanics.settings.winkler.stiffness_kpa_per_mm": 40.0}},
    {{"camera.noise_model.row_sigma_e": 1.0}},
    {{"mechanics.model": "spectral"}},
    {{"mechanics.model": "spectral", "mechanics.settings.winkler.stiffness_kpa_per_mm": 40.0}},
):
    forces.append(press(twin.vary(base, changes), memory).pressed.force_n)
assert forces[1] == 2 * forces[0] == 2 * forces[2]
assert forces[3] == forces[4]
print([(name, *counts) for name, *counts, _ in memory.stages() if name in ("press", "shape")])
"""


def test_a_press_is_repeated_for_another_setting_of_its_own_model_only(experiment: Path) -> None:
    """Two presses by springs, none by the linear slab, whose shape is solved once for all moduli.

    The stage "shape" returns nothing for springs, and does not read their settings.
    """
    assert python(PRESSES, experiment) == "[('shape', 2, 3), ('press', 2, 1)]\n"


@pytest.fixture
def case_folders(mi: object, experiment: Path, tmp_path: Path) -> list[Path]:
    study, out = tmp_path / "study.toml", tmp_path / "out"
    study.write_text(STUDY.format(base=experiment), encoding="utf-8")
    twin("sweep", study, "-o", out, "-j", 2)
    return [file.parent for file in out.rglob("result.json")]


def test_a_study_on_two_processes_varies_both(case_folders: list[Path]) -> None:
    """Force is proportional to stiffness; a warning names noise other than that of EMVA 1288."""
    results = [json.loads((path / "result.json").read_text("utf-8")) for path in case_folders]
    metrics = [result["metrics"] for result in results]
    assert len(metrics) == 4
    soft_n, stiff_n = sorted({result["force_n"] for result in metrics})
    assert stiff_n == pytest.approx(2 * soft_n)
    named = [any("of the kind row_noise" in w for w in result["warnings"]) for result in metrics]
    assert sorted(named) == [False, False, True, True]


BATCH = f"""
import pickle, sys
from pathlib import Path
import twin
from twin.study.measuring import NOMINAL_CONDITIONS
from twin.study.worker import Batch

for file in ({str(WINKLER)!r}, {str(ROW_NOISE)!r}):
    twin.plugin(file)
case = "0123456789abcdef", twin.load_experiment(sys.argv[1]), NOMINAL_CONDITIONS
Path(sys.argv[2]).write_bytes(pickle.dumps(Batch(Path("store"), (case,), ("points",))))
"""
OTHER_PROCESS = """
import pickle, sys
from pathlib import Path
batch = pickle.loads(Path(sys.argv[1]).read_bytes())
camera = batch.cases[0][1].camera
print(batch.store, batch.keep, type(camera.noise_model).__name__, camera.noise_model.row_sigma_e)
"""


def test_a_batch_loads_the_plug_ins_of_its_study_in_any_process(
    experiment: Path, tmp_path: Path
) -> None:
    """As on a Dask worker, which no process of the study starts."""
    python(BATCH, experiment, tmp_path / "batch")
    assert python(OTHER_PROCESS, tmp_path / "batch") == "store ('points',) RowNoise 300.0\n"
