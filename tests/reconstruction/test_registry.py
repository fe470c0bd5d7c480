"""Registries: kinds from modules of a package, from installed packages and from plug-in files."""

import os
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from reconstruction.errors import InputError
from reconstruction.registry import PLUGINS_VARIABLE, PluginError, Registry, load_plugin

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def no_plugins(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No plug-in is inherited, and none is left to the tests after this one."""
    monkeypatch.setenv(PLUGINS_VARIABLE, "")
    yield
    for name in [name for name in sys.modules if name.startswith("fringe_twin_plugin_")]:
        del sys.modules[name]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the name of a new package without modules."""
    name = f"home_{uuid.uuid4().hex}"
    (tmp_path / name).mkdir()
    (tmp_path / name / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    return name


def colours(home: str) -> Registry[type]:
    return Registry("colours", home, lambda kind: kind.__name__.lower())


def module_of(home: str, tmp_path: Path, registry: Registry[type], name: str) -> None:
    """Write a module of the home package that registers one kind."""
    sys.modules[f"{home}_registry"] = registry  # type: ignore[assignment]
    code = f"import sys\n\n@sys.modules['{home}_registry'].register\nclass {name}: ...\n"
    (tmp_path / home / f"{name.lower()}.py").write_text(code)


def test_a_module_of_the_home_package_is_a_kind(home: str, tmp_path: Path) -> None:
    registry = colours(home)
    for name in ("Red", "Blue"):
        module_of(home, tmp_path, registry, name)
    assert registry.names() == ("blue", "red")
    assert registry["red"].__name__ == "Red"
    assert "red" in registry
    assert "green" not in registry
    assert [kind.__name__ for kind in registry] == ["Blue", "Red"]


def test_an_unknown_kind_gets_a_suggestion(home: str) -> None:
    registry = colours(home)
    registry.register(type("Blue", (), {}))
    with pytest.raises(InputError, match=r"^colours: found 'blu', allowed: blue; did you mean"):
        registry["blu"]


def test_two_kinds_of_one_name_are_an_error_that_names_both_places(home: str) -> None:
    registry = colours(home)
    first = type("Blue", (), {"__module__": "package_a"})
    registry.register(first)
    assert registry.register(first) is first
    with pytest.raises(PluginError, match=r"'blue' twice, in package_a and in package_b; rename"):
        registry.register(type("Blue", (), {"__module__": "package_b"}))


def test_listeners_are_called_for_kinds_after_the_built_in_ones(home: str) -> None:
    registry, calls = colours(home), []
    registry.on_change(lambda: calls.append(registry.names()))
    registry.register(type("Blue", (), {}))
    assert not calls
    assert registry.names() == ("blue",)
    registry.register(type("Red", (), {}))
    assert calls == [("blue", "red")]


def test_a_package_adds_a_kind_by_an_entry_point(
    home: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder with the metadata of an installed distribution; no other file names the package."""
    package = f"other_{uuid.uuid4().hex}"
    (tmp_path / f"{package}.py").write_text("class Green: ...\n")
    entry_point(tmp_path, package, "green", f"{package}:Green")
    assert colours(home).names() == ("green",)


def test_an_entry_point_that_fails_names_the_package(home: str, tmp_path: Path) -> None:
    entry_point(tmp_path, "paints", "green", "module_that_is_missing:Green")
    registry = colours(home)
    with pytest.raises(PluginError, match=r"^paints: entry point fringe_twin\.colours: green = "):
        registry.names()
    with pytest.raises(PluginError, match=r"ModuleNotFoundError: .*mend or uninstall"):
        registry.names()


def entry_point(folder: Path, package: str, name: str, target: str) -> None:
    metadata = folder / f"{package}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[fringe_twin.colours]\n{name} = {target}\n")


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("x = 1\ny = x / 0\n", r"mine\.py:2: ZeroDivisionError"),
        ("x = 1\n\ndef broken(:\n", r"mine\.py:3: SyntaxError"),
        ("import module_that_is_missing\n", r"mine\.py:1: ModuleNotFoundError"),
    ],
)
def test_a_broken_plug_in_is_one_line_with_file_and_line(
    tmp_path: Path, code: str, message: str
) -> None:
    file = tmp_path / "mine.py"
    file.write_text(code)
    with pytest.raises(PluginError, match=message) as caught:
        load_plugin(file)
    assert "\n" not in str(caught.value)
    assert not os.environ[PLUGINS_VARIABLE]


def test_a_plug_in_that_is_missing_or_no_python_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=r"mine\.py: found no file there"):
        load_plugin(tmp_path / "mine.py")
    (tmp_path / "mine.toml").write_text("a = 1\n")
    with pytest.raises(PluginError, match=r"mine\.toml: found no Python file"):
        load_plugin(tmp_path / "mine.toml")


def test_a_plug_in_runs_once_in_this_process_and_in_its_children(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs, file = tmp_path / "runs.txt", tmp_path / "mine.py"
    file.write_text(f"with open({str(runs)!r}, 'a') as runs:\n    runs.write('run\\n')\n")
    monkeypatch.chdir(tmp_path)
    load_plugin("mine.py")
    load_plugin(file)
    assert runs.read_text() == "run\n"
    child = "from reconstruction.registry import load_inherited_plugins as load; load(); load()"
    subprocess.run([sys.executable, "-c", child], check=True, cwd=ROOT)
    assert runs.read_text() == "run\nrun\n"
