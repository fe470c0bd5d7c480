"""Docstrings of the code as Sphinx reads them: names in single backticks, tables with bars."""

import re
from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

from sphinx.application import Sphinx

_NAME = re.compile(r"(?<![`\w:])`([^`\n]+)`(?![`_])")
_RULE = re.compile(r"\|[-| ]+\|")
_ERROR = re.compile(r"(\w+) : (.*)")


def read(_app: Sphinx, _what: str, _name: str, _of: Any, _how: Any, lines: list[str]) -> None:
    """Turn one docstring, in place, into what reStructuredText means."""
    lines[:] = [line for text in lines if not _RULE.fullmatch(text.strip()) for line in row(text)]
    lines[:] = list(split_error_lines(lines))
    lines[:] = [_NAME.sub(r"``\1``", line).replace("|", r"\|") for line in lines]


def row(line: str) -> list[str]:
    """Turn a row of a table into an item of a list; other lines stay."""
    text = line.strip()
    if not (text.startswith("| ") and text.endswith(" |")):
        return [line]
    first, *rest = (cell.strip() for cell in text.strip("|").split(" | "))
    return [f"- {first}: {'; '.join(rest)}"]


def split_error_lines(lines: list[str]) -> Iterator[str]:
    """Yield lines; in a section Raises the condition of an error follows on a line of its own.

    Napoleon reads a whole line of this section as the name of an error.
    """
    section = ""
    for line, below in zip_longest(lines, lines[1:], fillvalue=""):
        if line and {*below} == {"-"}:
            section = line
        error = _ERROR.fullmatch(line) if section == "Raises" else None
        yield from (error[1], f"    {error[2]}") if error else (line,)


def setup(app: Sphinx) -> dict[str, bool]:
    """Read every docstring before Napoleon does."""
    app.connect("autodoc-process-docstring", read, priority=100)
    return {"parallel_read_safe": True}
