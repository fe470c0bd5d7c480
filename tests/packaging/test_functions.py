"""A function is one thought: none is longer than a screen."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_LINES = 60


def test_no_function_has_more_than_60_lines():
    result = {
        f"{file.relative_to(ROOT)}:{node.lineno} {node.name}": node.end_lineno - node.lineno + 1
        for package in ("twin", "reconstruction")
        for file in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    assert {name: lines for name, lines in result.items() if lines > MOST_LINES} == {}
