"""Docstrings of the code as Sphinx reads them: names in single backticks, tables with bars."""

import re
from typing import Any

from sphinx.application import Sphinx

_NAME = re.compile(r"(?<![`\w:])`([^`\n]+)`(?![`_])")
_RULE = re.compile(r"\|[-| ]+\|")


def read(_app: Sphinx, _what: str, _name: str, _of: Any, _how: Any, lines: list[str]) -> None:
    """Turn one docstring, in place, into what reStructuredText means."""
    lines[:] = [line for text in lines if not _RULE.fullmatch(text.strip()) for line in row(text)]
    lines[:] = [_NAME.sub(r"``\1``", line).replace("|", r"\|") for line in lines]


def row(line: str) -> list[str]:
    """Turn a row of a table into an item of a list; other lines stay."""
    text = line.strip()
    if not (text.startswith("| ") and text.endswith(" |")):
        return [line]
    first, *rest = (cell.strip() for cell in text.strip("|").split(" | "))
    return [f"- {first}: {'; '.join(rest)}"]


def setup(app: Sphinx) -> dict[str, bool]:
    """Read every docstring before Napoleon does."""
    app.connect("autodoc-process-docstring", read, priority=100)
    return {"parallel_read_safe": True}
