"""A function is one thought: none is longer than a screen."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_LINES = 60


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield those that may have a function in them; no expression, which are most of the nodes."""
    for block in ("body", "orelse", "handlers", "finalbody", "cases"):
        inner = getattr(node, block, ())
        for item in inner if isinstance(inner, list) else ():
            yield item
            yield from statements(item)


def test_no_function_has_more_than_60_lines():
    result = {
        f"{file.relative_to(ROOT)}:{node.lineno} {node.name}": node.end_lineno - node.lineno + 1
        for package in ("twin", "reconstruction")
        for file in (ROOT / package).rglob("*.py")
        for node in statements(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    assert len(result) > 5000
    assert {name: lines for name, lines in result.items() if lines > MOST_LINES} == {}
