"""The notebooks: their cells run in order, and they are kept without outputs.

The cells are plain Python, so no kernel is needed: `jupyter` would bring thirty packages.
"""

import ast
import json
from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))


def code_cells(notebook: Path) -> list[dict[str, Any]]:
    read = json.loads(notebook.read_text(encoding="utf-8"))
    assert (read["nbformat"], read["nbformat_minor"]) == (4, 5)
    return [cell for cell in read["cells"] if cell["cell_type"] == "code"]


def run_cell(source: str, variables: dict[str, Any]) -> Any:
    """Run one cell and return the value of the expression on its last line, if it is one."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "cell", "exec"), variables)
    if not isinstance(last, ast.Expr):
        return None
    return eval(compile(ast.Expression(last.value), "cell", "eval"), variables)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(mi, monkeypatch, notebook):
    """The last value of a cell is displayed: as a picture with a table, or as a short text."""
    monkeypatch.chdir(notebook.parent)
    variables: dict[str, Any] = {}
    shown = [run_cell("".join(cell["source"]), variables) for cell in code_cells(notebook)]
    results = [
        item for item in shown if type(item).__module__.startswith(("twin", "reconstruction"))
    ]
    assert results
    for item in results:
        assert "data:image/png;base64," in item._repr_html_()
        assert len(repr(item)) < 200


def test_notebooks_are_kept_without_outputs():
    assert len(NOTEBOOKS) == 2
    for notebook in NOTEBOOKS:
        for cell in code_cells(notebook):
            assert cell["outputs"] == []
            assert cell["execution_count"] is None
