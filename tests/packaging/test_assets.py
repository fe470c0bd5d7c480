"""Scenes and materials are found by name, in a fixed order."""

import pytest

from reconstruction.errors import InputError
from twin.assets import AssetError, asset_path, list_assets

MATERIAL = "elastomers/silicone_c"


@pytest.fixture(autouse=True)
def no_own_folder(monkeypatch):
    monkeypatch.delenv("TWIN_ASSETS", raising=False)


@pytest.fixture
def own_folder(monkeypatch, tmp_path):
    folder = tmp_path / "materials" / "elastomers"
    folder.mkdir(parents=True)
    monkeypatch.setenv("TWIN_ASSETS", str(tmp_path))
    return folder


def test_suffix_may_be_left_out():
    assert asset_path("materials", MATERIAL) == asset_path("materials", f"{MATERIAL}.toml")


def test_own_folder_comes_first(own_folder):
    (own_folder / "silicone_c.toml").write_text("")
    assert asset_path("materials", MATERIAL) == own_folder / "silicone_c.toml"


def test_own_folder_adds_to_the_others(own_folder):
    (own_folder / "gel_0.5mm.toml").write_text("")
    assert {MATERIAL, "elastomers/gel_0.5mm"} <= set(list_assets("materials"))
    assert asset_path("materials", "elastomers/gel_0.5mm").is_file()
    assert asset_path("materials", MATERIAL).is_file()


def test_existing_path_is_taken_as_it_is(tmp_path, monkeypatch):
    file = tmp_path / "mine.toml"
    file.write_text("")
    monkeypatch.chdir(tmp_path)
    assert asset_path("scenes", str(file)) == file
    assert asset_path("scenes", "./mine").resolve() == file.resolve()


@pytest.mark.parametrize("collection", ["scenes", "materials"])
def test_every_listed_asset_is_found(collection):
    names = list_assets(collection)
    assert names
    assert all(asset_path(collection, name).is_file() for name in names)


@pytest.mark.parametrize("name", ["../pyproject", "elastomers/../../x", "..", "", "./../x"])
def test_names_do_not_leave_the_collection(name):
    with pytest.raises(AssetError, match="not a name in materials"):
        asset_path("materials", name)


@pytest.mark.parametrize("name", ["elastomers/silicon_c", "silicone_c"])
def test_misspelt_name_gets_a_suggestion(name):
    with pytest.raises(AssetError, match="did you mean materials/elastomers/silicone_c") as caught:
        asset_path("materials", name)
    assert "\n" not in str(caught.value)


def test_missing_asset_is_bad_input():
    with pytest.raises(InputError, match=r"/absent/x\.toml: no such file"):
        asset_path("scenes", "/absent/x.toml")


def test_unknown_collection_is_refused():
    with pytest.raises(AssetError, match="no such collection"):
        asset_path("benchmarks", "x")
