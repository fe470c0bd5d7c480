"""Allowed imports of each package, read from the sources."""

import ast
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[2]
SHIPPED = ("twin", "reconstruction")
ALL = (*SHIPPED, "benchmarks", "tests")


def sources(folders: tuple[str, ...]) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def imported_roots(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            yield node.module.partition(".")[0]


def importers(folders: tuple[str, ...], modules: set[str]) -> list[str]:
    named = re.compile(rf"\b({'|'.join(modules)})\b")  # other files are not parsed
    return [
        path.relative_to(ROOT).as_posix()
        for path in sources(folders)
        if named.search(path.read_text(encoding="utf-8")) and modules & set(imported_roots(path))
    ]


def test_renderer_is_imported_under_optics_only():
    result = importers(SHIPPED, {"mitsuba", "drjit"})
    assert result
    assert [path for path in result if not path.startswith("twin/optics/")] == []


def test_reconstruction_does_not_know_the_twin():
    assert importers(("reconstruction",), {"twin", "trimesh", "skfem", "pytetwild"}) == []


def test_data_folders_are_not_imported():
    assert importers(ALL, {"scenes", "materials"}) == []
    assert "tests/packaging/test_imports.py" in importers(ALL, {"grimp"})


@pytest.mark.parametrize("folder", ["scenes", "materials"])
def test_data_folders_hold_no_code(folder):
    assert list((ROOT / folder).rglob("*.py")) == []


def test_no_modules_import_each_other():
    """Also inside functions; types that only the checker reads do not count."""
    graph = grimp.build_graph(*SHIPPED, exclude_type_checking_imports=True, cache_dir=None)
    imports = {item: graph.find_modules_directly_imported_by(item) for item in graph.modules}
    circle: list[str] = []
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        circle = error.args[1]
    assert circle == [], " <- ".join(circle)
