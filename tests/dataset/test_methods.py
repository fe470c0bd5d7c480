"""Several methods on one press in one sample: names, one press, content of the files, faults."""

import io
import json
import tarfile
from pathlib import Path
from typing import get_args

import numpy as np
import pyarrow.parquet
import pytest

from reconstruction.errors import InputError
from reconstruction.evaluate.baselines import BASELINES
from reconstruction.evaluate.samples import read_samples
from tests.browser import assert_readable
from tests.dataset.conftest import SMALL
from twin.cli import run
from twin.config import load_experiment
from twin.config.base import ConfigError
from twin.config.dataset import Recipe, SampleContent, load_recipe
from twin.dataset.draws import draw_sample
from twin.dataset.make import draw_all, pack, work_folder
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
baseline = "decoded"
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
hold = ["frames", "depth_mm", "contact", "label", "decoded_depth_mm", "decoded_reason"]
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
    without["photometric_stereo"] = {"frames"}
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
    gel, pressure = (
        np.load(tmp_path / SAMPLE_FOLDER / f"photometric_stereo_{name}.npy")
        for name in ("albedo", "pressure_kpa")
    )
    # Translucent ink: its own albedo, and that in front of the ball where the ball touches it.
    bare, touched = (experiment.coating.albedo_over(albedo) for albedo in (0.0, 0.45))
    assert touched > 1.02 * bare
    middle = gel.shape[0] // 2, gel.shape[1] // 2
    assert pressure[middle] > 0
    assert gel[middle] == pytest.approx(touched, rel=1e-5)
    assert gel[0, 0] == pytest.approx(bare, rel=1e-5)
    assert gel.min() > bare * (1 - 1e-5)
    ball = np.load(tmp_path / SAMPLE_FOLDER / "direct_fpp_albedo.npy")
    shown = np.load(tmp_path / SAMPLE_FOLDER / "direct_fpp_label.npy") == 2
    assert np.allclose(ball[shown], 0.45, rtol=1e-5)


@pytest.fixture(scope="module")
def two(tmp_path_factory) -> Path:
    """Return a data set of one sample by two methods; its recipe is next to it."""
    out = tmp_path_factory.mktemp("two") / "set"
    file = out.with_name("two.toml")
    file.write_text(RECIPE.replace("[sample]", MATERIAL + "[sample]"), encoding="utf-8")
    assert run(["dataset", str(file), "-n", "1", "-o", str(out), "-j", "1"]) == 0
    return out


def test_a_data_set_of_two_methods(two: Path) -> None:
    """Expected: the arrays of the two experiments, measured alone, under the prefixed names."""
    file, out = two.with_name("two.toml"), two
    with tarfile.open(out / "test-000000.tar") as tar:
        members = {m.name.partition(".")[2]: tar.extractfile(m).read() for m in tar}
    described = json.loads((out / "schema.json").read_text(encoding="utf-8"))
    assert described["methods"] == ["contact_fpp", "direct_fpp"]
    assert described["baseline"] == "decoded"
    schema = described["files"]
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


@pytest.mark.parametrize("kind", ["webdataset", "hdf5", "parquet"])
def test_predictions_of_each_method_are_scored(
    two: Path, tmp_path: Path, kind: str, capsys
) -> None:
    """Expected: the known offset of each method as bias; the decoder with its own figures."""
    recipe, bases = load_recipe(two.with_name("two.toml"))
    draws, out = draw_all(recipe, bases, 1), tmp_path / "set"
    pack(recipe.model_copy(update={"format": kind}), bases, draws, work_folder(two), out)
    for method, offset_mm in (("contact_fpp", 0.002), ("direct_fpp", 0.03)):
        (sample,) = read_samples(out, "test", ("depth_mm", "label"), method)
        folder = tmp_path / "predictions" / method
        folder.mkdir(parents=True)
        values = sample.arrays["depth_mm"].astype(np.float64) + offset_mm
        np.save(folder / f"{sample.key}.npy", values)
    words = ["score", str(tmp_path / "predictions"), str(out), "-o", str(tmp_path / "score")]
    assert run(words) == 0
    assert "baseline: decoded" in capsys.readouterr().out
    result = json.loads((tmp_path / "score" / "result.json").read_text(encoding="utf-8"))
    figures = result["metrics"]
    assert figures["contact_fpp_depth_bias_um"] == pytest.approx(2.0, rel=1e-6)
    assert figures["direct_fpp_depth_bias_um"] == pytest.approx(30.0, rel=1e-6)
    assert figures["contact_fpp_baseline_depth_completeness"] > 0.99
    assert 0.0 < figures["contact_fpp_baseline_depth_rms_um"] < 5.0
    assert result["baseline"] == "decoded"
    rows = (tmp_path / "score" / "objects.csv").read_text(encoding="utf-8").splitlines()
    assert [row.partition(",")[0] for row in rows] == ["method", "contact_fpp", "direct_fpp"]
    page = (tmp_path / "score" / "report.html").read_text(encoding="utf-8")
    assert "direct_fpp" in page
    assert "baseline: decoded" in page


def test_the_page_of_a_score_is_readable_and_repeats(two: Path, tmp_path: Path) -> None:
    """Expected: no element wider than a phone's window; the same bytes in a second run."""
    for name in ("one", "two"):
        assert run(["score", str(two), "-o", str(tmp_path / name)]) == 0
    one, again = tmp_path / "one", tmp_path / "two"
    files = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert Path("figures/contact_fpp_samples.png") in files
    assert [
        file for file in files if (one / file).read_bytes() != (again / file).read_bytes()
    ] == []
    assert_readable(one / "report.html", tmp_path / "profile")


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
    for methods in ('["direct_fpp"]', '["direct_fpp", "direct_fpp"]'):
        file = tmp_path / "recipe.toml"
        file.write_text(RECIPE.replace('["contact_fpp", "direct_fpp"]', methods), encoding="utf-8")
        with pytest.raises(ConfigError, match="allowed two or three different methods"):
            load_recipe(file)


def test_a_recipe_without_methods_has_its_old_content(tmp_path: Path) -> None:
    """Expected: the key is in no file and in no digest, so that old data sets keep their bytes."""
    file = tmp_path / "recipe.toml"
    file.write_text(RECIPE.replace('methods = ["contact_fpp", "direct_fpp"]', ""), encoding="utf-8")
    recipe, _ = load_recipe(file)
    assert set(recipe.sample.model_dump(mode="json")) == {"hold", "frames"}
    file.write_text(file.read_text(encoding="utf-8").replace('baseline = "decoded"', ""))
    assert "baseline" not in load_recipe(file)[0].model_dump(mode="json")


def test_a_baseline_needs_its_input(tmp_path: Path) -> None:
    recipe, bases = load_recipe("datasets/single_shot_fpp")
    changed = recipe.model_copy(update={"baseline": "spatial_unwrapping"})
    with pytest.raises(
        InputError, match="baseline: 'spatial_unwrapping' needs phase_column_rad wi"
    ):
        draw_all(changed, bases, 1)


def test_a_recipe_may_state_each_classical_method() -> None:
    kind = Recipe.model_fields["baseline"].annotation
    assert set(get_args(kind)) == {"", *BASELINES}
