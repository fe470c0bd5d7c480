"""The examples of docs/extend.md as one installed package: a kind of every seam.

The package is found only by its entry points, in a separate process.
"""

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from reconstruction.errors import InputError
from reconstruction.photometric import read_sensor_calibration
from reconstruction.rig.calibration import read_calibration
from twin.results.folder import read_measurement

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs/extend"
POINTS = """
[fringe_twin.specimens]
lens = lens:Lens
[fringe_twin.coatings]
enamel = enamel:Enamel
[fringe_twin.materials]
lacquer = lacquer:Lacquer
[fringe_twin.elastomer_models]
winkler = winkler:WINKLER
[fringe_twin.noise_models]
row_noise = row_noise:RowNoise
[fringe_twin.codes]
residue = residue_code:RESIDUE
[fringe_twin.words]
scattered = scattered_word:SCATTERED
[fringe_twin.measurands]
sagitta = sagitta:SAGITTA
[fringe_twin.importers]
calibration_text = calibration_text:CALIBRATION_TEXT
[fringe_twin.colour_maps]
nearest = nearest_colours:NearestColours
[fringe_twin.integrations]
frankot_chellappa = frankot_chellappa:FRANKOT_CHELLAPPA
"""
EXPERIMENT = """
name = "all_kinds"
use = "scenes/examples/slab_ball"

[specimen]
kind = "lens"
radius_mm = 4.0
[specimen.material]
kind = "lacquer"

[coating]
kind = "enamel"
albedo = 0.4

[patterns]
code = "residue"
steps = 4
period_px = 17
further_periods_px = [23]

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
pixel_pitch_um = { value = 90.0, source = "test" }
"""
SPRINGS = """
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

[press]
control = "depth"
depth_mm = 0.4

[mechanics]
model = "winkler"
"""
STUDY = """
name = "lenses"
base = "{base}"
[[axis]]
path = "specimen.radius_mm"
values = [3.0, 4.0]
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the examples' modules and the metadata of their package."""
    folder = tmp_path_factory.mktemp("site")
    for file in EXAMPLES.glob("*.py"):
        (folder / file.name).write_text(file.read_text(encoding="utf-8"), encoding="utf-8")
    metadata = folder / "kinds_of_docs-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: kinds-of-docs\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(POINTS)
    return folder


LINES = (
    "import json, sys; from twin.cli import run; sys.exit(sum(map(run, json.loads(sys.argv[1]))))"
)


def twin(installed: Path, *lines: tuple[object, ...]) -> str:
    """Run command lines in one separate process with the package installed; return the output."""
    return python(installed, LINES, json.dumps([list(map(str, line)) for line in lines]))


def python(installed: Path, code: str, *words: object) -> str:
    """Run code in a separate process with the package installed; return its output."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(installed)])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("experiment") / "all_kinds.toml"
    file.write_text(EXPERIMENT, encoding="utf-8")
    return file


def test_an_experiment_is_measured_and_reported(
    mi: object, installed: Path, experiment: Path, tmp_path: Path
) -> None:
    """Coat by contact, lacquer directly; the page names specimen, coat or material, and code."""
    kinds = {"contact_fpp": "enamel", "direct_fpp": "lacquer"}
    outs = {modality: tmp_path / modality for modality in kinds}
    line = "measure", experiment
    twin(installed, *((*line, "-s", f"modality={m}", "-o", out) for m, out in outs.items()))
    for modality, out in outs.items():
        metrics = json.loads((out / "result.json").read_text("utf-8"))["metrics"]
        assert metrics["points"] > 300
        glare = 0.05 if modality == "direct_fpp" else 0.0  # the lacquer mirrors the projector
        assert metrics["wrong_order_pixels"] <= glare * metrics["points"]
        page = (out / "report.html").read_text("utf-8")
        assert "residues of two periods" in page
        for name in ("lens", kinds[modality]):
            assert re.search(rf"\b{name}\b", page), name


def test_a_ball_presses_a_winkler_bed(installed: Path, tmp_path: Path) -> None:
    """Springs of stiffness k: force k pi d^2 (R - d / 3), from the volume of the ball's cap."""
    file, out = tmp_path / "springs.toml", tmp_path / "out"
    file.write_text(SPRINGS, encoding="utf-8")
    twin(installed, ("press", file, "-o", out, "--no-report"))
    metrics = json.loads((out / "result.json").read_text("utf-8"))["metrics"]
    k_kpa_mm = 100 * (1 - 0.45) / ((1 + 0.45) * (1 - 0.9)) / 4.0
    force_n = 1e-3 * k_kpa_mm * np.pi * 0.4**2 * (4.0 - 0.4 / 3)
    assert metrics["mechanics_model"] == "winkler"
    assert metrics["force_n"] == pytest.approx(force_n, rel=0.01)
    assert metrics["relief_peak_mm"] == pytest.approx(0.4, abs=1e-3)


SAGITTA = """
name = "sagitta"
use = "scenes/examples/gel_on_window"
[specimen]
kind = "ball"
diameter_mm = 8.0
[[measurand]]
name = "sag"
quantity = "sagitta"
plus_minus_um = 50.0
[camera]
binning = 4
"""


def test_a_measurand_has_its_figures_and_its_row(
    mi: object, installed: Path, tmp_path: Path
) -> None:
    """The sagitta is the drawing's within a micrometre, and stated with U and a verdict."""
    file, out = tmp_path / "sagitta.toml", tmp_path / "out"
    file.write_text(SAGITTA, encoding="utf-8")
    twin(installed, ("measure", file, "-o", out))
    metrics = json.loads((out / "result.json").read_text("utf-8"))["metrics"]
    assert metrics["object_sag_mm"] == pytest.approx(4.0 - math.sqrt(4.0**2 - 1.0), abs=1e-3)
    assert 0.0 < metrics["object_sag_expanded_um"] < 2.0
    assert 0.0 < metrics["object_sag_crb_um"] < metrics["object_sag_noise_um"]
    assert metrics["object_sag_verdict"] == "within tolerance"
    page = (out / "report.html").read_text("utf-8")
    row = re.search(r">sag</th>.*?</tr>", page, re.DOTALL)
    assert row is not None
    for shown in ("{object_sag_mm:.4f} mm", "{object_sag_expanded_um:.2g}"):
        assert shown.format(**metrics) in row.group()


CALIBRATION = """
cam_K 1800 0 321.5 0 1795 238.25 0 0 1
cam_kc -0.11 0.07 4e-4 -3e-4 0.02
cam_size 640 480
proj_K 1400 0 455 0 2790 1139.5 0 0 1
proj_kc 0.01 -0.02 1e-4 2e-4 0
proj_size 912 1140
R 0.05 -0.42 0.02
T 98 6 21
"""


def test_a_calibration_of_another_format_is_imported(installed: Path, tmp_path: Path) -> None:
    (tmp_path / "rig.cal").write_text(CALIBRATION, encoding="utf-8")
    printed = twin(installed, ("import-calibration", tmp_path / "rig.cal", "-o", tmp_path / "out"))
    assert "camera cameramatrix: cam_K" in printed
    assert read_calibration(tmp_path / "out/calibration.yaml").projector.fy_px == 2790.0


PERIODIC_SURFACE = """
import numpy as np
from reconstruction.photometric import PhotometricOptions, integrate

turn = 2 * np.pi / 64
row, col = turn * np.arange(64)[:, None], turn * np.arange(64)
height_mm = 0.3 * np.cos(row) * np.sin(2 * col)
slopes = np.stack([
    -0.3 * turn / 0.05 * np.sin(row) * np.sin(2 * col),
    0.6 * turn / 0.05 * np.cos(row) * np.cos(2 * col),
])
name = PhotometricOptions(integration="frankot_chellappa").integration
np.testing.assert_allclose(integrate(slopes, 0.05, name), height_mm, atol=1e-12)

from twin.cli import run
run(["keys", "photometric.integration"])
"""


def test_slopes_are_integrated_by_another_scheme(installed: Path) -> None:
    """A periodic surface is integrated exactly, including its scale."""
    assert "'frankot_chellappa'" in python(installed, PERIODIC_SURFACE)


SHADED_PLANE = """
import sys
import numpy as np
from reconstruction.colour_maps import COLOUR_MAPS, Samples
from reconstruction.photometric import (
    SensorCalibration, read_sensor_calibration, write_sensor_calibration
)

lamps = np.array([[0.5, 0.0], [-0.25, 0.4], [-0.25, -0.4]])
steps = np.linspace(-0.3, 0.3, 31)
slopes = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
levels = (100 * (1 + slopes @ lamps.T)).astype(np.float32)
samples = Samples(levels, np.full_like(levels, 100), np.zeros_like(slopes), slopes)
still = np.full((6, 8, 3), 50, np.float32)
fitted = COLOUR_MAPS["nearest"].fit(samples, still)
write_sensor_calibration(sys.argv[1], SensorCalibration(fitted, still, 0.06))

colours = read_sensor_calibration(sys.argv[1]).colour_map.bound_to(still)
plane = (still * (1 + lamps @ [0.1, -0.06])).astype(np.float32)
plane[0, 0] = 200
measured, known = colours.slopes(plane)
np.testing.assert_allclose(measured[:, 1:], np.full((2, 5, 8), [[[0.1]], [[-0.06]]]), atol=0.01)
assert known.sum() == 47 and not known[0, 0]

from twin.cli import run
run(["keys", "photometric.colour_map"])
"""
FEW_PRESSES = (
    "photometric.presses.count=5",
    "photometric.presses.backgrounds=2",
    "photometric.presses.smallest_diameter_mm=5.5",
)


def test_colours_are_mapped_by_another_map(installed: Path, tmp_path: Path) -> None:
    """Slopes on a lattice of 0.02 calibrate it; it is stored, read and bound to weaker light."""
    keys = python(installed, SHADED_PLANE, tmp_path / "sensor.npz")
    assert "'nearest' | 'polynomial'" in keys


def test_a_measurement_compares_another_map(mi: object, installed: Path, tmp_path: Path) -> None:
    """Without the package the folder is an error of one line, which names the allowed maps."""
    settings = *FEW_PRESSES, "photometric.colour_map=nearest"
    options = [word for setting in settings for word in ("-s", setting)]
    out = tmp_path / "out"
    measure = "measure", "examples/gelsight_ball", "-o", out, *options, "--no-report"
    twin(installed, measure, ("report", out))
    rows = (out / "decoders.csv").read_text("utf-8").splitlines()[1:]
    maps = [row.partition(",")[0] for row in rows]
    assert list(dict.fromkeys(maps)) == ["polynomial", "table", "nearest"]
    assert (out / "other_calibration_2.npz").is_file()
    page = (out / "report.html").read_text("utf-8")
    assert "by the nearest colours map" in page
    with pytest.raises(InputError, match=r"found 'nearest', allowed: polynomial, table$"):
        read_measurement(out)
    with pytest.raises(InputError, match=r"map is 'nearest'; .* polynomial, table$"):
        read_sensor_calibration(out / "sensor_calibration.npz")


def test_the_keys_of_all_kinds_are_listed(installed: Path) -> None:
    keys = twin(installed, ("keys",), ("keys", "mechanics.model")).splitlines()
    for key in ("specimen(lens).radius_mm", "coating(enamel).albedo"):
        assert key in keys
    assert any(key.endswith("material(lacquer).albedo") for key in keys)
    assert any("'winkler'" in line for line in keys)
    assert "camera.noise_model(row_noise).row_sigma_e" in keys
    assert "mechanics.settings.winkler.stiffness_kpa_per_mm" in keys


def test_a_study_varies_a_number_of_a_kind(
    mi: object, installed: Path, experiment: Path, tmp_path: Path
) -> None:
    study, out = tmp_path / "study.toml", tmp_path / "out"
    study.write_text(STUDY.format(base=experiment), encoding="utf-8")
    twin(installed, ("sweep", study, "-o", out, "-j", 1))
    results = [json.loads(file.read_text("utf-8")) for file in out.rglob("result.json")]
    assert len({result["metrics"]["force_n"] for result in results}) == 2


def test_the_page_states_the_length_of_each_example() -> None:
    page = (ROOT / "docs/extend.md").read_text(encoding="utf-8")
    for file in EXAMPLES.glob("*.py"):
        assert f"| {len(file.read_text(encoding='utf-8').splitlines())} lines |" in page, file.name
        assert f"extend/{file.name}" in page
