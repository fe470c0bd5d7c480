"""Several methods on one press in one sample: names, one press, content of the files, faults."""

import io
import json
import tarfile
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from reconstruction.errors import InputError
from tests.dataset.conftest import SMALL
from twin.cli import run
from twin.config import load_experiment
from twin.config.base import ConfigError
from twin.config.dataset import SampleContent, load_recipe
from twin.dataset.draws import draw_sample
from twin.dataset.methods import check_content, parts_of
from twin.dataset.quantities import quantity_of
from twin.dataset.taking import SAMPLE_FOLDER, SampleMeasurer, take_sample
from twin.pipeline import Memory
from twin.study.measuring import Conditions

# As tests/dataset/test_photometric.py, with a coarser camera of equal field and exposure.
SENSOR = {
    "photometric.presses.count": 5,
    "photometric.presses.backgrounds": 2,
    "photometric.presses.smallest_diameter_mm": 5.5,
    "photometric.width_px": 160,
    "photometric.height_px": 120,
    "camera.width_px": 820,
    "camera.height_px": 616,
    "camera.pixel_pitch_um": 4.48,
    "camera.exposure_ms": 1.125,
    "patterns.steps": 3,
    "patterns.axes": ["column"],
    "specimen.material": {"kind": "diffuse", "albedo": 0.45},
}
THREE = ("contact_fpp", "photometric_stereo", "direct_fpp")
RECIPE = f"""
name = "two"
seed = 3
[[scene]]
name = "ball"
base = "examples/slab_ball"
{SMALL}
[[axis]]
path = "specimen.diameter_mm"
low = 6.0
high = 9.0
[sample]
methods = ["contact_fpp", "direct_fpp"]
hold = ["frames", "depth_mm", "contact", "label", "decoded_depth_mm"]
[split]
train = 0.0
validation = 0.0
test = 1.0
"""


def test_three_methods_of_one_sensor_press_once(tmp_path: Path) -> None:
    """Expected: one press in the cache, equal forces, and a pressure field that gives the force."""
    hold = ("frames", "image", "albedo", "depth_mm", "label", "pressure_kpa", "point_world_mm")
    content = SampleContent(hold=hold, methods=THREE)
    experiment = load_experiment("examples/gelsight_ball", SENSOR)
    measurer = SampleMeasurer(content=content)
    result = measurer(experiment, Conditions(trial=1))
    computed = {name: count for name, count, *_ in measurer.memory.stages()}
    assert computed["shape"] + computed["press"] == 1
    figures = result.figures
    assert figures["contact_fpp_force_n"] == figures["photometric_stereo_force_n"] > 0
    assert any(warning.startswith("contact_fpp: ") for warning in figures["warnings"])
    result.write(tmp_path)
    files = {path.name for path in (tmp_path / SAMPLE_FOLDER).iterdir()}
    without = {"contact_fpp": {"image"}, "direct_fpp": {"image", "pressure_kpa"}}
    without["photometric_stereo"] = {"frames", "albedo"}
    expected = {f"{m}_{name}.npy" for m in THREE for name in hold if name not in without[m]}
    rigs = {"contact_fpp_calibration.json", "direct_fpp_calibration.json"}
    assert files == expected | rigs
    for method in ("contact_fpp", "photometric_stereo"):
        pressure, points = (
            np.load(tmp_path / SAMPLE_FOLDER / f"{method}_{name}.npy").astype(np.float64)
            for name in ("pressure_kpa", "point_world_mm")
        )
        down, right = np.gradient(points[..., :2], axis=(0, 1))
        area_mm2 = np.abs(down[..., 0] * right[..., 1] - down[..., 1] * right[..., 0])
        force_n = 1e-3 * float((pressure * area_mm2).sum())
        assert force_n == pytest.approx(figures["contact_fpp_force_n"], rel=0.03)
    ball = np.load(tmp_path / SAMPLE_FOLDER / "direct_fpp_albedo.npy")
    shown = np.load(tmp_path / SAMPLE_FOLDER / "direct_fpp_label.npy") == 2
    assert np.allclose(ball[shown], 0.45, rtol=1e-5)


def test_a_data_set_of_two_methods(tmp_path: Path) -> None:
    """Expected: the arrays of the two experiments, measured alone, under the prefixed names."""
    file, out = tmp_path / "two.toml", tmp_path / "set"
    file.write_text(RECIPE.replace("[sample]", MATERIAL + "[sample]"), encoding="utf-8")
    assert run(["dataset", str(file), "-n", "1", "-o", str(out), "-j", "1"]) == 0
    with tarfile.open(out / "test-000000.tar") as tar:
        members = {m.name.partition(".")[2]: tar.extractfile(m).read() for m in tar}
    schema = json.loads((out / "schema.json").read_text(encoding="utf-8"))["files"]
    assert set(schema) == set(members)
    assert schema["direct_fpp_depth_mm.npy"]["unit"] == "mm"
    assert "direct_fpp_contact.npy" not in members
    described = json.loads(members["sample.json"])
    assert described["methods"] == ["contact_fpp", "direct_fpp"]
    recipe, bases = load_recipe(file)
    case = draw_sample(recipe, bases, 0).case
    for part in parts_of(recipe.sample, case.experiment):
        taken, figures = take_sample(part.experiment, Memory(), 1, decode=True)
        for name in part.held:
            values = np.load(io.BytesIO(members[f"{part.prefix}{name}.npy"]))
            assert np.array_equal(values, quantity_of(name).values(taken)), part.prefix + name
        rms = f"{part.prefix}z_rmse_um"
        assert described["figures"][rms] == figures["z_rmse_um"]
    (row,) = pyarrow.parquet.read_table(out / "index.parquet").to_pylist()
    assert row["methods"] == "contact_fpp, direct_fpp"
    card = (out / "README.md").read_text(encoding="utf-8")
    assert "several methods on one press: contact-FPP (`contact_fpp_...`)" in card
    assert "contact_fpp_depth_mm" in card


MATERIAL = """
[[scene.axis]]
name = "material"
[scene.axis.choices]
gray = { "specimen.material" = { use = "materials/diffuse/gray_print" } }
"""


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"hold": ("image", "frames")}, "image: found in none of the methods contact_fpp, dir"),
        ({"hold": ("contact",)}, "found no quantity of the method direct_fpp"),
        ({"hold": ("dept_mm",)}, "found 'dept_mm', allowed: frames"),
        ({"methods": ("contact_fpp", "photometric_stereo")}, "no lamp has channel"),
    ],
)
def test_faults_of_methods(content: dict, message: str) -> None:
    given = {"hold": ("depth_mm",), "methods": ("contact_fpp", "direct_fpp")} | content
    with pytest.raises(InputError, match=message):
        check_content(SampleContent(**given), load_experiment("examples/slab_ball"))


def test_methods_are_two_or_more_and_different(tmp_path: Path) -> None:
    for found in ('["direct_fpp"]', '["direct_fpp", "direct_fpp"]'):
        file = tmp_path / "recipe.toml"
        file.write_text(RECIPE.replace('["contact_fpp", "direct_fpp"]', found), encoding="utf-8")
        with pytest.raises(ConfigError, match="allowed two or three different methods"):
            load_recipe(file)


def test_a_recipe_without_methods_has_its_old_content(tmp_path: Path) -> None:
    """Expected: the key is in no file and in no digest, so that old data sets keep their bytes."""
    file = tmp_path / "recipe.toml"
    file.write_text(RECIPE.replace('methods = ["contact_fpp", "direct_fpp"]', ""), encoding="utf-8")
    recipe, _ = load_recipe(file)
    assert set(recipe.sample.model_dump(mode="json")) == {"hold", "frames"}
