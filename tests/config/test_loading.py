"""Experiment files: resolving, units, provenance, and one clear line for every mistake."""

import tomllib

import pytest

from twin.assets import asset_path, list_assets
from twin.config import ConfigError, digest, load_experiment, to_toml, validate_experiment, vary
from twin.config.quantities import split_quantities


@pytest.fixture(scope="module")
def experiment():
    return load_experiment("examples/slab_balls")


def test_resolved_experiment_loads_back_to_itself(experiment, tmp_path):
    file = tmp_path / "experiment.toml"
    file.write_text(to_toml(experiment), encoding="utf-8")
    assert load_experiment(file) == experiment
    assert digest(load_experiment(file)) == digest(experiment)


def test_digest_names_content_not_words(experiment):
    renamed = vary(experiment, {"name": "other", "description": "words"})
    deeper = vary(experiment, {"press.depth_mm": 0.7})
    assert digest(renamed) == digest(experiment) != digest(deeper)


def test_digest_of_a_mesh_is_its_content(experiment, tmp_path):
    (tmp_path / "a.stl").write_bytes(b"one")
    (tmp_path / "b.stl").write_bytes(b"one")
    (tmp_path / "c.stl").write_bytes(b"two")
    tree = experiment.model_dump(mode="json")
    a, b, c = (
        digest(validate_experiment(tree | {"specimen": {"kind": "mesh", "file": str(file)}}))
        for file in (tmp_path / "a.stl", tmp_path / "b.stl", tmp_path / "c.stl")
    )
    assert a == b != c


def test_length_with_its_own_unit(experiment):
    assert vary(experiment, {"elastomer.thickness_mm": "2500 um"}).elastomer.thickness_mm == 2.5


def test_provenance_travels_and_says_when_a_value_was_set(experiment):
    assert experiment.provenance["elastomer.thickness_mm"].source.startswith("assumed")
    changed = load_experiment("examples/slab_balls", {"elastomer.thickness_mm": 2.0})
    assert changed.provenance["elastomer.thickness_mm"].source == (
        "set in the experiment; range: " + experiment.provenance["elastomer.thickness_mm"].source
    )
    assert changed.provenance["elastomer.thickness_mm"].range == (1.0, 5.0)


MISTAKES = [
    ({"elastomer.thicknes_mm": 2}, "unknown key 'thicknes_mm' in [elastomer]", "thickness_mm"),
    ({"elastomer.thickness_mm": 1e-5}, "found 1e-05", "allowed >= 0.0001"),
    ({"elastomer.thickness_mm": "3 kg"}, "found unit 'kg'", "allowed for a length"),
    ({"elastomer.poisson_ratio": 0.5}, "elastomer.poisson_ratio: found 0.5", "less than 0.5"),
    ({"press.force_n": 1.0}, "press", "does not take force_n"),
    ({"press.control": "force"}, "press", "needs force_n"),
    ({"specimen.kind": "cube"}, "specimen.kind: found 'cube'", "allowed: 'ball', 'bar'"),
    ({"specimen.kind": "two_bals"}, "specimen.kind: found 'two_bals'", "did you mean 'two_balls'?"),
    ({"specimen.radius_mm": 4.0}, "unknown key 'radius_mm' in [specimen]", ""),
    ({"camera.pose.polar_deg": 95}, "camera.pose.polar_deg: found 95", "less than 90"),
    ({"seed": -1}, "seed: found -1", "greater than or equal to 0"),
    ({"seed": True}, "seed: found true", "valid integer"),
    ({"press.depth_mm": True}, "press.depth_mm: found true", "valid number"),
    ({"camera.binning": True}, "camera.binning: found true", "1, 2 or 4"),
    ({"camera.distortion": [0, 0, False, 0, 0]}, "distortion.2: found false", "valid number"),
    ({"schema_version": True}, "schema_version: found true", "should be 1"),
    ({"name": True}, "name: found true", "valid string"),
    ({".".join("a" * 3000): 1}, "found a path of 3000 keys", "up to 64"),
    ({"render.engine": "magic"}, "render.engine: found 'magic'", "'one_trace' or 'stock'"),
    ({"projector.blur_px": float("nan")}, "projector.blur_px: found nan", "finite number"),
    ({"render.samples": {"x": 3}}, "render.samples: found {'x': 3}", "1, 4, 9"),
]


@pytest.mark.parametrize(("changes", "value", "allowed"), MISTAKES)
def test_every_mistake_is_one_line(changes, value, allowed):
    with pytest.raises(ConfigError) as caught:
        load_experiment("examples/slab_balls", changes)
    message = str(caught.value)
    assert value in message
    assert allowed in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("specimen", "line"),
    [
        ({"kind": "rod", "diamter_mm": 3}, "unknown key 'diamter_mm' in [specimen]; did you mean"),
        ({"kind": "rod", "diameter_mm": -3}, "specimen.diameter_mm: found -3"),
        (
            {"kind": "group", "parts": {"ball": {"kind": "ball", "diametr_mm": 1}}},
            "unknown key 'diametr_mm' in [specimen.parts.ball]; did you mean 'diameter_mm'?",
        ),
    ],
)
def test_paths_are_those_of_the_file(experiment, specimen, line):
    """Paths have no union tag; a part's name that equals a kind remains in the path."""
    tree = experiment.model_dump(mode="json") | {"specimen": specimen}
    with pytest.raises(ConfigError) as caught:
        validate_experiment(tree)
    assert line in str(caught.value)


def test_a_flag_is_a_flag(experiment):
    assert vary(experiment, {"camera.noise": False}).camera.noise is False


def test_more_mistakes_than_anybody_reads_are_counted(tmp_path):
    (tmp_path / "many.toml").write_text("".join(f"k{i} = 1\n" for i in range(500)))
    with pytest.raises(ConfigError) as caught:
        load_experiment(tmp_path / "many.toml")
    lines = str(caught.value).split("\n")
    assert len(lines) == 21
    assert lines[-1].endswith("more problems")


def test_all_mistakes_are_reported_at_once():
    with pytest.raises(ConfigError) as caught:
        load_experiment("examples/slab_balls", {"seed": -1, "press.depth_mm": -2, "colour": "red"})
    assert len(str(caught.value).splitlines()) == 3


def test_not_toml_and_missing_file(tmp_path):
    file = tmp_path / "broken.toml"
    file.write_text("name = [", encoding="utf-8")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_experiment(file)
    with pytest.raises(ValueError, match="two_balls"):
        load_experiment("paper/two_bals")


def test_files_that_use_each_other_in_a_circle(tmp_path, monkeypatch):
    folder = tmp_path / "scenes"
    folder.mkdir()
    (folder / "a.toml").write_text('use = "scenes/b"', encoding="utf-8")
    (folder / "b.toml").write_text('use = "scenes/a"', encoding="utf-8")
    monkeypatch.setenv("TWIN_ASSETS", str(tmp_path))
    with pytest.raises(ConfigError, match="is cyclic"):
        load_experiment("a")


def quantities_of(name, collection):
    tree = tomllib.loads(asset_path(collection, name).read_text(encoding="utf-8"))
    return split_quantities(tree)


DATA = [("materials", name) for name in list_assets("materials")] + [
    ("scenes", name)
    for name in list_assets("scenes")
    if name.split("/")[0] in ("rigs", "cameras", "lenses", "projectors")
]


@pytest.mark.parametrize(("collection", "name"), DATA)
def test_every_number_in_a_data_file_has_a_source(collection, name):
    """Expected: value, source and, for an assumed value, its plausible range."""
    values, origins = quantities_of(name, collection)
    # A link needs no source.
    flat = {path: value for path, value in leaves(values) if not str(value).startswith("= ")}
    words = {"description", "use", "kind"}
    assert {path for path in flat if path.rsplit(".", 1)[-1] not in words} == set(origins)
    for path, origin in origins.items():
        assert len(origin.source) > 4
        if origin.source.startswith("assumed") and isinstance(flat[path], float):
            assert origin.range is not None, path


def leaves(tree, prefix=""):
    for key, node in tree.items():
        if isinstance(node, dict):
            yield from leaves(node, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", node


EXPERIMENTS = [
    name
    for name in list_assets("scenes")
    if name.split("/")[0] in ("examples", "paper", "templates")
    and name
    not in (
        "templates/study",
        "paper/identified",
        "paper/identify",
        "paper/identify_next",
        "paper/targets",
        "paper/trials",
    )
]


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_shipped_experiment_is_valid(name):
    assert load_experiment(name).name


def test_a_quantity_without_a_source_is_refused():
    with pytest.raises(ConfigError, match="needs a source"):
        validate_experiment({"press": {"depth_mm": {"value": 1.0}}})


def test_the_changes_of_the_caller_remain_as_they_are():
    """A dotted path may set a key of a table that is also given."""
    changes = {"specimen": {"kind": "bar"}, "specimen.z_mm": 0.5}
    experiment = load_experiment("examples/slab_ball", changes)
    assert experiment.specimen.z_mm == 0.5
    assert changes == {"specimen": {"kind": "bar"}, "specimen.z_mm": 0.5}
    vary(experiment, changes)
    assert changes["specimen"] == {"kind": "bar"}
