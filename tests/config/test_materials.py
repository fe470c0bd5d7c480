"""Material files: all load, state the sources of their numbers, and enforce their ranges."""

import tomllib

import numpy as np
import pytest

from twin.assets import AssetError, asset_path, list_assets
from twin.config import ConfigError, load_experiment
from twin.config.quantities import outside_sources, split_quantities
from twin.mechanics.choice import check_press, select_model
from twin.mechanics.models import PressInput

SOLIDS = [
    name
    for name in list_assets("materials")
    if name.split("/")[0] in ("metals", "plastics", "glasses") or name == "diffuse/gray_print"
]
SCENES = [
    "ball", "bars", "bars_a", "bars_b", "bars_c", "bear", "brick", "fingerprint", "nut", "rods",
    "rods_a", "rods_b", "rods_c", "t_bolt",
]  # fmt: skip


def ball_of(name, tmp_path, extra=""):
    """Write the ball's scene with another material, and with keys that override it."""
    text = asset_path("scenes", "examples/slab_ball").read_text(encoding="utf-8")
    text = text.replace("metals/steel", name).replace("[press]", f"{extra}\n\n[press]")
    file = tmp_path / "experiment.toml"
    file.write_text(text, encoding="utf-8")
    return file


def quantities(name):
    tree = tomllib.loads(asset_path("materials", name).read_text(encoding="utf-8"))
    return split_quantities(tree)


def test_there_is_what_the_paper_needs():
    assert {
        "metals/steel",
        "metals/chromium",
        "metals/aluminium",
        "metals/brass",
        "plastics/pmma",
        "plastics/polycarbonate",
        "plastics/abs_clear",
        "glasses/glass",
        "glasses/silicone",
        "diffuse/gray_print",
    } <= set(SOLIDS)


@pytest.mark.parametrize("name", [*SOLIDS, "diffuse/stage"])
def test_every_number_has_source_and_range(name):
    values, provenance = quantities(name)
    numbers = {key for key, value in values.items() if isinstance(value, float)}
    assert numbers == provenance.keys()
    assert all(origin.range and origin.source for origin in provenance.values())


@pytest.mark.parametrize("name", SOLIDS)
def test_every_material_serves_a_specimen(name, tmp_path):
    experiment = load_experiment(ball_of(name, tmp_path))
    values, _ = quantities(name)
    dumped = experiment.specimen.material.model_dump()
    assert {key: dumped[key] for key in dumped.keys() & values.keys()} == {
        key: value for key, value in values.items() if key != "description"
    }


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("metals/steel", "ior", 1.2),
        ("metals/aluminium", "extinction", 2.0),
        ("plastics/pmma", "ior", 1.6),
        ("plastics/abs_clear", "absorption_per_mm", 0.2),
        ("diffuse/gray_print", "albedo", 0.95),
    ],
)
def test_value_outside_the_files_range_is_a_warning_that_names_the_source(
    name, key, value, tmp_path
):
    origin = quantities(name)[1][key]
    low, high = origin.range
    (message,) = outside_sources(load_experiment(ball_of(name, tmp_path, f"{key} = {value}")))
    assert f"specimen.material.{key} = {value:g} is outside {low:g} to {high:g}" in message
    assert f"the range of its source ({origin.source})" in message
    assert "\n" not in message
    assert outside_sources(load_experiment(ball_of(name, tmp_path))) == ()


@pytest.mark.parametrize(
    ("name", "reflectance"),
    [
        ("steel", 0.51),
        ("stainless_steel", 0.63),
        ("chromium", 0.557),
        ("aluminium", 0.917),
        ("brass", 0.734),
    ],
)
def test_complex_index_gives_the_metals_known_reflectance(name, reflectance):
    """Normal incidence, ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2): detects a swapped or misread index.
    Expected: the mean of the two table rows on either side of 525 nm in each source."""
    values, _ = quantities(f"metals/{name}")
    index = values["ior"] + 1j * values["extinction"]
    assert np.abs((index - 1) / (index + 1)) ** 2 == pytest.approx(reflectance, abs=0.004)


@pytest.mark.parametrize(
    ("name", "sellmeier"),
    [
        ("plastics/pmma", [(1.1819, 0.011313)]),
        ("plastics/polycarbonate", [(1.4182, 0.021304)]),
        (
            "glasses/glass",
            [(1.03961212, 0.00600069867), (0.231792344, 0.0200179144), (1.01046945, 103.560653)],
        ),
    ],
)
def test_index_is_the_sources_dispersion_formula_at_525_nm(name, sellmeier):
    square = 0.525**2
    index = np.sqrt(1 + sum(b * square / (square - c) for b, c in sellmeier))
    assert quantities(name)[0]["ior"] == pytest.approx(index, abs=6e-4)


@pytest.mark.parametrize("name", SCENES)
def test_scenes_of_the_paper_load_with_material_and_stage(name):
    experiment = load_experiment(f"paper/{name}")
    assert experiment.name == name
    assert experiment.specimen.material is not None
    assert experiment.provenance["press.depth_mm"].source.startswith("identified")
    assert experiment.provenance["stage.albedo"].range == (0.02, 0.9)
    metal = name in ("ball", "nut", "t_bolt")
    assert experiment.specimen.material.kind == ("conductor" if metal else "dielectric")


def test_two_balls_are_steel():
    material = load_experiment("examples/slab_balls").specimen.material
    assert material == load_experiment("examples/slab_ball").specimen.material


@pytest.mark.parametrize("name", ["nut", "balls", "bars", "brick", "fingerprint", "group"])
def test_wrapped_scenes_are_thin_sheets_that_may_be_thick(name):
    """Both limits of the range are allowed; its source gives the reason; the model is a sheet."""
    scene = load_experiment(f"examples/wrapped_{name}")
    data = scene.mechanics, scene.specimen, scene.elastomer, scene.press
    assert select_model(PressInput(*data)).wraps
    check_press(*data)
    for thickness_mm, outside in ((0.05, 0), (3.0, 0), (4.0, 1)):
        key = "elastomer.thickness_mm"
        warned = outside_sources(load_experiment(f"examples/wrapped_{name}", {key: thickness_mm}))
        assert [text.partition(",")[0] for text in warned] == outside * [
            f"{key} = {thickness_mm:g} is outside 0.05 to 3"
        ]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"specimen.material": "steel"}, 'material = { use = "materials/metals/steel" }?'),
        ({"specimen.material": {"kind": "steel"}}, '{ use = "materials/metals/steel" }?'),
        ({"specimen.material": {"use": "steel"}}, '{ use = "materials/metals/steel" }?'),
        ({"specimen.material": "Stainless Steel"}, '"materials/metals/stainless_steel" }?'),
        ({"specimen.material": "aluminum"}, '"materials/metals/aluminium" }?'),
        ({"specimen.material": "acrylic"}, '"materials/plastics/pmma" }?'),
        ({"coating": "airbrushed"}, 'coating = { use = "materials/coatings/airbrushed" }?'),
        ({"elastomer": "silicone_a"}, '{ use = "materials/elastomers/silicone_a" }?'),
        ({"specimen.material": "cheese"}, "found 'cheese', allowed a table"),
    ],
)
def test_a_material_by_its_plain_name_is_suggested(changes, message):
    """The suggestion is of the table's own folder, and is a line of TOML that can be pasted."""
    with pytest.raises(ConfigError) as caught:
        load_experiment("examples/wrapped_nut", changes)
    (line,) = str(caught.value).splitlines()
    assert line.endswith(message)


def test_a_material_that_does_not_exist_is_suggested_by_its_description(tmp_path):
    """Iron is a word of the comment of steel."""
    file = tmp_path / "iron.toml"
    file.write_text(
        'use = "scenes/examples/wrapped_nut"\n'
        '[specimen]\nmaterial = { use = "materials/metals/iron" }\n',
        encoding="utf-8",
    )
    with pytest.raises(AssetError, match="did you mean materials/metals/steel"):
        load_experiment(file)
