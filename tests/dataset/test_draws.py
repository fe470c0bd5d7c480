"""Draws: each depends on seed, quantity and number only, and has the distribution of the recipe."""

import numpy as np
import pytest
from scipy import stats

from tests.dataset.conftest import RECIPE
from twin.camera.sensor import noise_model
from twin.config import load_experiment, vary
from twin.config.base import ConfigError
from twin.config.dataset import Recipe, SplitShares, load_recipe
from twin.config.inputs import Input
from twin.dataset.draws import draw_sample, levels_of, object_digest, scene_of, share_of
from twin.optics.rig import true_calibration
from twin.study.trials import drawn_values

SEED_AXIS = {"path": "specimen.seed", "low": 0, "high": 1000, "integer": True}
ALBEDO = {"path": "coating.base_albedo", "low": 0.1, "high": 0.4}
TILT = {"path": "specimen.tilt_deg", "low": 0.1, "high": 10.0, "scale": "log"}
KINDS = {"name": "kind", "values": ["a", "b", "c"], "path": "description"}


def recipe_of(*axes: dict, **keys: object) -> Recipe:
    scenes = keys.pop("scene", [{"name": "one", "base": "examples/slab_ball"}])
    sample = {"hold": ["depth_mm"]}
    keys = {"seed": 1} | keys
    return Recipe(name="test", scene=scenes, axis=axes, sample=sample, **keys)


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        (ALBEDO, stats.uniform(0.1, 0.3)),
        (TILT, stats.loguniform(0.1, 10.0)),
    ],
)
def test_ranges_are_drawn_uniformly(axis: dict, expected: object) -> None:
    recipe = recipe_of(axis)
    drawn = [
        levels_of(recipe, recipe.scene[0], number)[axis["path"]].label for number in range(1000)
    ]
    assert stats.kstest(drawn, expected.cdf).pvalue > 0.01


def test_all_whole_numbers_of_a_range_are_equally_frequent() -> None:
    """Rounded values gave the two ends half the share of the others."""
    recipe = recipe_of({"path": "specimen.seed", "low": 0, "high": 2, "integer": True})
    scene = recipe.scene[0]
    drawn = [levels_of(recipe, scene, number)["specimen.seed"].label for number in range(600)]
    assert set(drawn) == {0, 1, 2}
    assert stats.chisquare([drawn.count(value) for value in (0, 1, 2)]).pvalue > 0.01


def test_levels_and_scenes_are_drawn_with_their_weights() -> None:
    scenes = [{"name": n, "base": "x", "weight": w} for n, w in (("a", 1.0), ("b", 3.0))]
    recipe = recipe_of(KINDS, scene=scenes)
    numbers = range(1200)
    kinds = [levels_of(recipe, recipe.scene[0], n)["kind"].label for n in numbers]
    assert stats.chisquare([kinds.count(kind) for kind in "abc"]).pvalue > 0.01
    second = sum(scene_of(recipe, number) for number in numbers)
    assert stats.binomtest(second, len(numbers), 0.75).pvalue > 0.01


def test_inputs_have_their_distribution() -> None:
    given = Input(group="optics", key="camera.auto_level", distribution="normal", spread=0.02)
    base = load_experiment("examples/slab_ball")
    drawn = [
        drawn_values(base, {"level": given}, 5, number)["camera.auto_level"]
        for number in range(1, 301)
    ]
    assert stats.kstest(drawn, stats.norm(base.camera.auto_level, 0.02).cdf).pvalue > 0.01


def test_quantities_and_samples_are_independent() -> None:
    shares = np.array(
        [[share_of(seed, name, n) for n in range(400)] for seed in (1, 2) for name in ("a", "b")]
    )
    correlation = np.corrcoef(shares) - np.eye(4)
    assert np.abs(correlation).max() < 4 / np.sqrt(400)
    lagged = np.corrcoef(shares[:, 1:].ravel(), shares[:, :-1].ravel())[0, 1]
    assert abs(lagged) < 4 / np.sqrt(1600)


def test_a_draw_does_not_depend_on_other_axes() -> None:
    one, two = recipe_of(ALBEDO), recipe_of(TILT, ALBEDO)
    for number in (0, 7):
        alone = levels_of(one, one.scene[0], number)["coating.base_albedo"]
        assert levels_of(two, two.scene[0], number)["coating.base_albedo"] == alone


def test_samples_of_equal_values_differ_in_their_noise() -> None:
    recipe = recipe_of({"path": "specimen.diameter_mm", "values": [8.0]}, KINDS)
    bases = (load_experiment("examples/slab_ball"),)
    cases = [draw_sample(recipe, bases, number).case for number in range(2)]
    assert cases[0].conditions.trial == 1
    assert cases[1].conditions.trial == 2
    assert cases[0].digest != cases[1].digest


def test_the_content_of_a_sample_is_part_of_its_name() -> None:
    bases = (load_experiment("examples/slab_ball"),)
    one = recipe_of(ALBEDO)
    two = one.model_copy(update={"sample": one.sample.model_copy(update={"hold": ("lit",)})})
    names = {draw_sample(recipe, bases, 0).case.digest for recipe in (one, two)}
    assert len(names) == 2


def test_an_invalid_draw_is_kept_with_its_reason() -> None:
    recipe = recipe_of({"path": "specimen.diameter_mm", "values": [-1.0]})
    draw = draw_sample(recipe, (load_experiment("examples/slab_ball"),), 3)
    assert draw.case is None
    assert "specimen.diameter_mm: found -1" in draw.reason
    assert draw.settings == {"specimen.diameter_mm": -1.0}


def test_an_object_is_its_form(tmp_path) -> None:
    base = load_experiment("examples/slab_ball")
    view = {"specimen.x_mm": 1.0, "specimen.yaw_deg": 30.0, "camera.binning": 4}
    assert object_digest(vary(base, view)) == object_digest(base)
    assert object_digest(vary(base, {"specimen.diameter_mm": 8.1})) != object_digest(base)
    digests = []
    for number in (1.0, 2.0, 1.0):
        np.save(tmp_path / "map.npy", np.full((4, 4), number))
        keys = {"kind": "height_map", "file": str(tmp_path / "map.npy"), "pixel_mm": 1.0}
        digests.append(object_digest(vary(base, {"specimen": keys})))
    assert digests[0] == digests[2] != digests[1]


def test_an_object_is_in_one_split() -> None:
    kinds = {"path": "specimen.diameter_mm", "values": [5.0 + 0.1 * n for n in range(40)]}
    pose = {"path": "specimen.x_mm", "low": -1.0, "high": 1.0}
    recipe = recipe_of(kinds, pose, split={"train": 0.4, "validation": 0.3, "test": 0.3})
    bases = (load_experiment("examples/slab_ball"),)
    draws = [draw_sample(recipe, bases, number) for number in range(60)]
    splits: dict[str, set[str]] = {}
    for draw in draws:
        splits.setdefault(draw.object_digest, set()).add(draw.split)
    assert len(splits) < len(draws)
    assert all(len(parts) == 1 for parts in splits.values())
    assert set.union(*splits.values()) == {"train", "validation", "test"}


def test_shares_of_splits() -> None:
    shares = SplitShares()
    parts = [shares.split_at(share) for share in (np.arange(100) + 0.5) / 100]
    assert [parts.count(name) for name in ("train", "validation", "test")] == [80, 10, 10]


def test_files_of_a_folder_are_drawn_in_their_order(tmp_path) -> None:
    (tmp_path / "maps").mkdir()
    for name in ("b", "a"):
        np.save(tmp_path / "maps" / f"{name}.npy", np.eye(4))
    text = """
name = "maps"
[[scene]]
name = "maps"
base = "examples/slab_ball"
set = { specimen = { kind = "height_map", file = "./maps/a.npy", pixel_mm = 1.0 } }
[[scene.axis]]
path = "specimen.file"
files = "./maps/*.npy"
[sample]
hold = ["depth_mm"]
"""
    (tmp_path / "recipe.toml").write_text(text, encoding="utf-8")
    recipe, bases = load_recipe(tmp_path / "recipe.toml")
    values = recipe.scene[0].axis[0].values
    assert [value.rpartition("/")[2] for value in values] == ["a.npy", "b.npy"]
    drawn = {
        draw_sample(recipe, bases, number).case.experiment.specimen.file for number in (0, 1, 2, 3)
    }
    assert drawn <= set(values)
    (tmp_path / "none.toml").write_text(text.replace("*.npy", "*.stl"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"files = './maps/\*\.stl': found no such file"):
        load_recipe(tmp_path / "none.toml")


def test_rigs_exposure_noise_and_assemblies_are_drawn() -> None:
    """Expected: each key of the drawn experiment has the distribution of the recipe.

    Tolerances of the rig are normal deviations of poses and lenses; the others are axes.
    """
    tolerances = {"projector.pose.polar_deg": 0.5, "camera.pose.standoff_mm": 0.3}
    tolerances |= {"projector.blur_px": 0.05}
    inputs = {
        key.rpartition(".")[2]: Input(group="optics", key=key, distribution="normal", spread=spread)
        for key, spread in tolerances.items()
    }
    ranges = {"camera.exposure_ms": (5.0, 20.0), "camera.read_noise_e": (2.0, 9.0)}
    axes = [{"path": path, "low": low, "high": high} for path, (low, high) in ranges.items()]
    axes.append({"path": "specimen.seed", "low": 0, "high": 2**32 - 1, "integer": True})
    axes.append({"path": "specimen.count", "values": [3, 4, 5]})
    recipe = recipe_of(*axes, inputs=inputs)
    material = {"kind": "diffuse", "albedo": 0.5}
    base = vary(
        load_experiment("examples/gauges"),
        {"specimen": {"kind": "random_group", "material": material}},
    )
    draws = [draw_sample(recipe, (base,), number) for number in range(60)]
    drawn = [draw.case.experiment for draw in draws]
    for key, spread in tolerances.items():
        law = stats.norm(field_at(base, key), spread)
        assert stats.kstest([field_at(each, key) for each in drawn], law.cdf).pvalue > 0.01, key
    for key, (low, high) in ranges.items():
        law = stats.uniform(low, high - low)
        assert stats.kstest([field_at(each, key) for each in drawn], law.cdf).pvalue > 0.01, key
    rigs = [true_calibration(each).T_world_from_proj for each in drawn[:2]]
    assert not np.allclose(*rigs, rtol=0, atol=1e-3)
    assert {noise_model(each.camera).read_noise_e for each in drawn} == {
        each.camera.read_noise_e for each in drawn
    }
    assert {len(each.specimen.components) for each in drawn} == {3, 4, 5}
    assert len({draw.object_digest for draw in draws}) == len(draws)


def field_at(experiment: object, path: str) -> float:
    for name in path.split("."):
        experiment = getattr(experiment, name)
    return experiment


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "ball"', 'name = "relief"', "found the name relief twice"),
        ("train = 0.0", "train = 0.5", "found 1.5, allowed 1"),
        ("[sample]", '[sample]\nframes = "png"', None),
        ('"frames",', '"frames", "frames",', "found frames twice"),
        ("shard_mb = 0.3", 'format = "hdf5"\nsample.frames = "png"', "allowed 'npy' with format"),
        ("values = [6.0, 1e6]", "values = [6.0]\nlow = 1.0", "takes one of values"),
    ],
)
def test_faults_of_a_recipe(tmp_path, old: str, new: str, message: str | None) -> None:
    file = tmp_path / "recipe.toml"
    text = RECIPE.replace(old, new, 1)
    if "sample.frames" in new:
        text = text.replace('sample.frames = "png"\n', "").replace(
            "[sample]", '[sample]\nframes = "png"'
        )
    file.write_text(text, encoding="utf-8")
    if message is None:
        assert load_recipe(file)[0].sample.frames == "png"
        return
    with pytest.raises(ConfigError, match=message):
        load_recipe(file)
