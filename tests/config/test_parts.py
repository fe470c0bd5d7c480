"""User files: paths relative to the file that names them, links between keys, removed keys."""

import pytest

from twin.assets import AssetError, asset_path
from twin.config import ConfigError, digest, load_experiment, to_toml, vary
from twin.config.loading import by_method
from twin.config.quantities import outside_sources

GEL = """
name = "mine"
use = "scenes/examples/gel_on_window"
[elastomer]
thickness_mm = 3.0
[layers.gel]
thickness_mm = "= elastomer.thickness_mm"
[layers.window]
bottom_mm = "= elastomer.thickness_mm"
"""


@pytest.fixture
def gel(tmp_path):
    file = tmp_path / "gel.toml"
    file.write_text(GEL, encoding="utf-8")
    return load_experiment(file)


def test_a_link_takes_the_value_and_states_it_as_source(gel):
    assert gel.layers["gel"].thickness_mm == gel.layers["window"].bottom_mm == 3.0
    assert gel.provenance["layers.gel.thickness_mm"].source == "as elastomer.thickness_mm"


def test_a_link_holds_when_the_other_key_is_varied(gel, tmp_path):
    thicker = vary(gel, {"elastomer": {"thickness_mm": 3.5}})
    assert thicker.layers["gel"].thickness_mm == thicker.layers["window"].bottom_mm == 3.5
    file = tmp_path / "resolved.toml"
    file.write_text(to_toml(gel), encoding="utf-8")
    again = load_experiment(file, {"elastomer.thickness_mm": 2.5})
    assert again.layers["gel"].thickness_mm == 2.5


def test_setting_a_linked_key_ends_its_link(gel):
    own = vary(gel, {"layers.window.bottom_mm": 3.2})
    assert (own.layers["window"].bottom_mm, own.layers["gel"].thickness_mm) == (3.2, 3.0)
    assert list(own.links) == ["layers.gel.thickness_mm"]
    nested = vary(gel, {"layers": {"window": {"bottom_mm": 3.2}}})
    assert nested.layers == own.layers


def test_a_table_that_is_taken_away_takes_its_links_along(gel):
    bare = vary(gel, by_method("direct_fpp"))
    assert not bare.layers
    assert not bare.links
    assert gel.links
    assert by_method("contact_fpp") == {"modality": "contact_fpp"}


def test_links_are_no_content(gel):
    plain = vary(gel, {"layers.window.bottom_mm": 3.0, "layers.gel.thickness_mm": 3.0})
    assert not plain.links
    assert digest(plain) == digest(gel)


def test_a_link_may_name_a_linked_key(gel):
    chained = vary(gel, {"layers.window.bottom_mm": "= layers.gel.thickness_mm"})
    thicker = vary(chained, {"elastomer.thickness_mm": 2.0})
    assert thicker.layers["window"].bottom_mm == 2.0


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("elastomer.thicknes_mm", "found no value there"),
        ("elastomer", "found a table there"),
        ("layers.gel.thickness_mm", "found a cycle of links"),
    ],
)
def test_a_link_to_nowhere_is_one_line(gel, target, message):
    with pytest.raises(ConfigError, match=message) as caught:
        vary(gel, {"layers.gel.thickness_mm": f"= {target}"})
    assert "\n" not in str(caught.value)


def test_paths_of_user_files_are_relative_to_the_file_that_names_them(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/coat.toml").write_text("base_albedo = 0.31\n", encoding="utf-8")
    (tmp_path / "parts/more.toml").write_text('[coating]\nuse = "./coat.toml"\n', encoding="utf-8")
    mine = tmp_path / "mine.toml"
    text = 'name = "mine"\nuse = "scenes/paper/two_balls"\n'
    text += '[specimen]\nkind = "mesh"\nfile = "./parts/a.stl"\n'
    mine.write_text(text, encoding="utf-8")
    assert load_experiment(mine).specimen.file == str(tmp_path / "parts/a.stl")
    text = 'name = "mine"\nuse = "scenes/paper/two_balls"\n[coating]\nuse = "./parts/coat.toml"\n'
    mine.write_text(text, encoding="utf-8")
    assert load_experiment(mine).coating.base_albedo == 0.31
    (tmp_path / "mine.toml").write_text('use = "./parts/more.toml"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match="missing"):  # found, but no whole experiment
        load_experiment(mine)


def test_a_missing_own_file_names_its_neighbour(tmp_path):
    (tmp_path / "mycoat.toml").touch()
    (tmp_path / "mine.toml").write_text('[coating]\nuse = "./mycoats.toml"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"did you mean mycoat.toml\?"):
        load_experiment(tmp_path / "mine.toml")


def test_cyclic_user_files_are_one_line_however_spelt(tmp_path):
    (tmp_path / "inner").mkdir()
    mine = tmp_path / "inner/mine.toml"
    mine.write_text('name = "mine"\nuse = "../inner/mine.toml"\n', encoding="utf-8")
    with pytest.raises(ConfigError, match="is cyclic"):
        load_experiment(mine)


def test_files_that_use_two_files_each_are_counted(tmp_path):
    """Without a limit: 2^30 tables."""
    for i in range(30):
        used = f'use = "./{i + 1}.toml"\n'
        (tmp_path / f"{i}.toml").write_text(f"[left]\n{used}[right]\n{used}")
    (tmp_path / "30.toml").write_text("a = 1\n")
    with pytest.raises(ConfigError, match=r"0\.toml: use: found more than 200 files") as caught:
        load_experiment(tmp_path / "0.toml")
    assert "\n" not in str(caught.value)


def test_a_long_chain_of_files_is_counted(tmp_path):
    for i in range(1000):
        (tmp_path / f"{i}.toml").write_text(f'use = "./{i + 1}.toml"\n')
    with pytest.raises(ConfigError, match=r"0\.toml: use: found more than 200 files"):
        load_experiment(tmp_path / "0.toml")


def test_absent_takes_a_key_away():
    experiment = load_experiment("paper/two_balls", {"decode.filter_taps": "absent"})
    assert experiment.decode.filter_taps == type(experiment.decode)().filter_taps
    with pytest.raises(ConfigError, match=r"camera.f_number: missing"):
        load_experiment("paper/two_balls", {"camera.f_number": "absent"})


def test_a_range_warning_states_the_line_that_widens_it(tmp_path):
    (warning,) = outside_sources(
        load_experiment("examples/slab_balls", {"elastomer.thickness_mm": 9.0})
    )
    line = 'thickness_mm = { value = 9, range = [1, 9], source = "reason" }'
    assert line in warning
    mine = tmp_path / "mine.toml"
    text = f'name = "mine"\nuse = "scenes/examples/slab_balls"\n[elastomer]\n{line}\n'
    mine.write_text(text, encoding="utf-8")
    assert load_experiment(mine).elastomer.thickness_mm == 9.0
    assert outside_sources(load_experiment(mine)) == ()


def test_a_missing_scene_names_the_nearest_ones():
    with pytest.raises(AssetError) as caught:
        asset_path("scenes", "paper/two_ball")
    assert "did you mean paper/two_balls" in str(caught.value)
    with pytest.raises(AssetError) as caught:
        asset_path("scenes", "qqqq")
    assert len(str(caught.value)) < 120
