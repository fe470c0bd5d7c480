"""OpenCV's YAML and XML read without OpenCV, whose reader corrupts memory on some damaged files.

The part of YAML that `cv2.FileStorage` writes: maps and lists, indented or in brackets, numbers and
texts, and matrices `!!opencv-matrix` of rows, cols, dt and data. In XML the same by elements: a map
has one of each name, items of a list are named `_`, and numbers stand in a row.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError, one_line
from reconstruction.reading import read_text, shown

YAML, XML = "%YAML", "<?xml"
MATRIX = "opencv-matrix"
# A calibration has 3 kB in short lines and two levels.
MOST_BYTES, MOST_LINE, MOST_NESTED = 1_000_000, 1000, 32
_WHOLE_TYPES = ("u", "c", "w", "s", "i")
_ENTRY = re.compile(r'(?P<key>[\w.-]+|"[^"]*")[ ]*:(?:[ ]*!!(?P<tag>[\w-]+))?(?:[ ]+(?P<rest>.*))?')
_TOKEN = re.compile(r'[\[\]{},:]|"[^"]*"|[^\s\[\]{},:"]+')
_WHOLE = re.compile(r"[+-]?\d{1,18}")
_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?")


@dataclass(frozen=True)
class _Line:
    number: int
    indent: int
    text: str

    def wrong(self, told: str) -> InputError:
        return InputError(f"line {self.number}: {told}")


class _Lines:
    """Lines that hold something, and which of them is next."""

    def __init__(self, text: str) -> None:
        self._rest = [
            _Line(number, len(line) - len(line.lstrip(" ")), line.strip())
            for number, line in enumerate(text.split("\n"), 1)
            if line.strip() and line.lstrip()[0] not in "#%" and line.strip() not in ("---", "...")
        ][::-1]

    @property
    def next(self) -> _Line | None:
        return self._rest[-1] if self._rest else None

    def take(self) -> _Line:
        return self._rest.pop()

    def take_inside(self, indent: int) -> _Line | None:
        """Take the next line if it is indented deeper."""
        return self.take() if self.next is not None and self.next.indent > indent else None


def read_storage(path: Path | str, heads: tuple[str, ...] = (YAML,)) -> dict[str, Any]:
    """Return what a file of OpenCV's holds: maps, lists, numbers, texts, and float matrices.

    Parameters
    ----------
    heads : how it may begin

    Raises
    ------
    CaptureError : no such file, it is none of OpenCV's or damaged, or longer or deeper than any
        calibration; with the line
    """
    try:
        text = read_text(path)
    except InputError as error:
        raise CaptureError(str(error)) from None
    try:
        return parse_storage(text, heads)
    except InputError as error:
        raise CaptureError(f"{shown(path)}: {error}") from None


def parse_storage(text: str, heads: tuple[str, ...] = (YAML,)) -> dict[str, Any]:
    """Return what the text of such a file says, as `read_storage`.

    Raises
    ------
    InputError : with the line
    """
    if not text.startswith(heads):
        raise InputError(
            f"is no OpenCV calibration; the first line must begin with {' or '.join(heads)}"
        )
    longest = max(map(len, text.splitlines()))
    if len(text) > MOST_BYTES or longest > MOST_LINE:
        raise InputError(
            f"is no calibration: found {len(text)} characters in lines of up to {longest}, "
            f"allowed {MOST_BYTES} and {MOST_LINE}"
        )
    found = _of_yaml(text) if text.startswith(YAML) else _of_xml(text)
    if not isinstance(found, dict):
        raise InputError("is no calibration: found no key")
    return found


def numbers_in(path: Path) -> dict[str, FloatArray]:
    """Return every number and matrix of a YAML or XML file by its path, `camera/matrix`.

    Raises
    ------
    CaptureError : as `read_storage`
    """
    return dict(_numbers(read_storage(path, (YAML, XML)), ""))


def _numbers(node: Any, path: str) -> Iterator[tuple[str, FloatArray]]:
    if isinstance(node, dict):
        for key, inner in node.items():
            yield from _numbers(inner, f"{path}/{key}" if path else key)
    elif isinstance(node, np.ndarray) or _is_number(node):
        yield path, np.asarray(node, np.float64)
    elif isinstance(node, list) and node and all(map(_is_number, node)):
        yield path, np.array(node, np.float64)


def _of_yaml(text: str) -> Any:
    lines = _Lines(text)
    found = _block(lines, 0)
    if lines.next is not None:
        raise lines.next.wrong("is indented less than what stands above it")
    return found


def _of_xml(text: str) -> Any:
    try:
        return _element(ElementTree.fromstring(text), 0)
    # Expat's own limits end entities that grow without end.
    except ElementTree.ParseError as error:
        raise InputError(f"is damaged XML: {one_line(error)}") from None


def _element(element: "ElementTree.Element", depth: int) -> Any:
    if depth > MOST_NESTED:
        raise InputError(f"elements nest deeper than {MOST_NESTED} levels")
    inner = list(element)
    where = f"element {element.tag}"
    if not inner:
        words = [_plain(word) for word in (element.text or "").split()]
        return words[0] if len(words) == 1 else words
    if all(one.tag == "_" for one in inner):
        return [_element(one, depth + 1) for one in inner]
    found = {one.tag: _element(one, depth + 1) for one in inner}
    if len(found) < len(inner):
        raise InputError(f"{where}: a name stands there twice")
    return _matrix(where, found) if element.get("type_id") == MATRIX else found


def _block(lines: _Lines, depth: int) -> Any:
    """Read a map or a list whose entries stand under each other."""
    first = lines.next
    if first is None:
        return None
    if depth > MOST_NESTED:
        raise first.wrong(f"entries nest deeper than {MOST_NESTED} levels")
    return (_items if first.text.startswith("-") else _entries)(lines, first.indent, depth)


def _entries(lines: _Lines, indent: int, depth: int) -> dict[str, Any]:
    found: dict[str, Any] = {}
    while (line := lines.next) is not None and line.indent == indent:
        entry = _ENTRY.fullmatch(line.text)
        if entry is None:
            raise line.wrong("is no entry KEY: VALUE")
        key = entry["key"].strip('"')
        if key in found:
            raise line.wrong(f"the key {key} stands there twice")
        lines.take()
        value = _value(lines, line, entry["rest"] or "", depth)
        where = f"line {line.number}"
        found[key] = _matrix(where, value) if entry["tag"] == MATRIX else value
    _require_end(lines, indent)
    return found


def _items(lines: _Lines, indent: int, depth: int) -> list[Any]:
    found = []
    while (line := lines.next) is not None and line.indent == indent and line.text[0] == "-":
        lines.take()
        found.append(_value(lines, line, line.text[1:].strip(), depth))
    _require_end(lines, indent)
    return found


def _require_end(lines: _Lines, indent: int) -> None:
    line = lines.next
    if line is not None and line.indent > indent:
        raise line.wrong("is indented more than what stands above it")


def _value(lines: _Lines, line: _Line, rest: str, depth: int) -> Any:
    if not rest:
        deeper = lines.next is not None and lines.next.indent > line.indent
        return _block(lines, depth + 1) if deeper else None
    if rest[0] not in "[{":
        return _plain(rest)
    tokens = _tokens(lines, line, rest)
    found = _in_brackets(next(tokens), tokens, line, depth + 1)
    if next(tokens, None) is not None:
        raise line.wrong("something follows the closing bracket")
    return found


def _tokens(lines: _Lines, line: _Line, rest: str) -> Iterator[str]:
    """Yield the tokens of a value in brackets, which may go on in deeper lines."""
    open_brackets = 0
    while True:
        if _TOKEN.sub("", rest).strip():
            raise line.wrong("a quotation mark is not closed")
        for token in _TOKEN.findall(rest):
            open_brackets += (token in "[{") - (token in "]}")
            yield token
        if open_brackets <= 0:
            return
        more = lines.take_inside(line.indent)
        if more is None:
            raise line.wrong("a bracket is not closed")
        rest = more.text


def _in_brackets(token: str, tokens: Iterator[str], line: _Line, depth: int) -> Any:
    """Read the value that begins with a token."""
    if token not in ("[", "{"):
        if token in ("]", "}", ",", ":"):
            raise line.wrong(f"found {token} in the place of a value")
        return _plain(token)
    if depth > MOST_NESTED:
        raise line.wrong(f"brackets nest deeper than {MOST_NESTED} levels")
    pairs: list[tuple[str, Any]] = []
    closing, is_map = ("}", True) if token == "{" else ("]", False)
    token = next(tokens, "")
    while token != closing:
        key = ""
        if is_map:
            key = token.strip('"')
            if next(tokens, "") != ":":
                raise line.wrong(f"found no colon after {key}")
            token = next(tokens, "")
        pairs.append((key, _in_brackets(token, tokens, line, depth + 1)))
        token = next(tokens, "")
        if token not in (",", closing):
            raise line.wrong("found no comma between two values")
        token = next(tokens, "") if token == "," else token
    return dict(pairs) if is_map else [value for _, value in pairs]


def _plain(text: str) -> int | float | str:
    if _WHOLE.fullmatch(text):
        return int(text)
    return float(text) if _REAL.fullmatch(text) else text.strip('"')


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _matrix(where: str, found: Any) -> FloatArray:
    names = ("rows", "cols", "dt", "data")
    if not isinstance(found, dict) or sorted(found) != sorted(names):
        raise InputError(f"{where}: a matrix needs {', '.join(names)}")
    rows, cols, dt, data = (found[name] for name in names)
    numbers = data if isinstance(data, list) else [data]
    if not all(map(_is_number, numbers)):
        raise InputError(f"{where}: data of a matrix is no list of finite numbers")
    whole = dt in _WHOLE_TYPES and all(isinstance(one, int) for one in numbers)
    if dt not in ("d", "f") and not whole:
        raise InputError(f"{where}: a matrix is of dt: {dt}; write d, its numbers are reals")
    if not (isinstance(rows, int) and isinstance(cols, int) and min(rows, cols) > 0):
        raise InputError(f"{where}: a matrix has {rows} rows and {cols} cols")
    if rows * cols != len(numbers):
        raise InputError(
            f"{where}: a matrix of {rows} rows and {cols} cols holds {len(numbers)} numbers"
        )
    exact = np.array(numbers, np.float32 if dt == "f" else np.float64)
    return np.asarray(exact.reshape(rows, cols), np.float64)
