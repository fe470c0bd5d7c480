"""Read OpenCV's YAML and XML files without OpenCV, whose reader corrupts memory on damaged files.

Only the part of YAML is read that `cv2.FileStorage` writes: maps and lists, indented or in
brackets; numbers and texts; matrices `!!opencv-matrix` with the keys rows, cols, dt and data. In
XML each of these is an element. The elements of a map have different names, the items of a list are
named `_`, and numbers are separated by blanks.

PyYAML splits YAML into events, ElementTree splits XML into elements. Both limit the resources that
a file can use. Neither converts a text to a number; this module does.
"""

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError, one_line
from reconstruction.reading import read_text, shown

YAML, XML = "%YAML", "<?xml"
MATRIX = "opencv-matrix"
# Limits far above a calibration file, which has 3 kB, short lines and two levels.
MOST_BYTES, MOST_LINE, MOST_NESTED = 1_000_000, 1000, 32
_WHOLE_TYPES = ("u", "c", "w", "s", "i")
_TAG = f"tag:yaml.org,2002:{MATRIX}"
_NO_BLANK = re.compile(r':(?=[\[{]|"[^,\]}\s])')
_SEVERAL = re.compile(r'"?([2-9])([a-z])"?')
_WHOLE = re.compile(r"[+-]?\d{1,18}")
_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,4})?")
# Without the C library of PyYAML the same events take 10 x the time.
_LOADER = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


def read_storage(path: Path | str, heads: tuple[str, ...] = (YAML,)) -> dict[str, Any]:
    """Return the content of an OpenCV file: maps, lists, numbers, texts, and float64 matrices.

    Parameters
    ----------
    heads : the file must start with one of these texts

    Raises
    ------
    CaptureError : the file is missing, is not of OpenCV, is damaged, or is longer or more deeply
        nested than allowed; for a fault in YAML the message has the line number
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
    """Return the content of an OpenCV file, as `read_storage`, from the text of the file.

    Raises
    ------
    InputError : for the reasons of the CaptureError of `read_storage`, except a missing file
    """
    if not text.startswith(heads):
        raise InputError(
            f"is no OpenCV calibration; the first line must begin with {' or '.join(heads)}"
        )
    _require_small(text)
    content = _of_yaml(text) if text.startswith(YAML) else _of_xml(text)
    if not isinstance(content, dict):
        raise InputError("is no calibration: found no key")
    return content


def _require_small(text: str) -> None:
    longest = max(map(len, text.splitlines()), default=0)
    if len(text) > MOST_BYTES or longest > MOST_LINE:
        raise InputError(
            f"is no calibration: found {len(text)} characters in lines of up to {longest}, "
            f"allowed {MOST_BYTES} and {MOST_LINE}"
        )


def numbers_in(path: Path) -> dict[str, FloatArray]:
    """Return every number and matrix of an OpenCV file by its path in it, e.g. `camera/matrix`.

    Raises
    ------
    CaptureError : as `read_storage`
    """
    return numbers_of_tree(read_storage(path, (YAML, XML)))


def read_yaml(path: Path, is_first: bool = False) -> dict[str, Any]:
    """Return the content of a YAML file without OpenCV's first line: maps, lists, numbers, texts.

    Parameters
    ----------
    is_first : read only the first document of several, as a recorded ROS topic has them

    Raises
    ------
    CaptureError : the file is missing, is no YAML map, or is longer or more deeply nested than
        allowed; for a fault in YAML the message has the line number
    """
    try:
        text = read_text(path)
        if is_first:
            text = re.split(r"(?m)^---[ \t]*$", text.removeprefix("---"), maxsplit=1)[0]
    except InputError as error:
        raise CaptureError(str(error)) from None
    try:
        _require_small(text)
        content = _yaml_tree(text)
        if not isinstance(content, dict):
            raise InputError("is no calibration: found no key")
        return content
    except InputError as error:
        raise CaptureError(f"{shown(path)}: {error}") from None


def numbers_of_tree(tree: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Return every number, matrix and list of numbers in nested maps by its path, e.g. `a/b`.

    A map with the keys rows, cols and data is a matrix; so are lists of equally long lists.
    """
    return dict(_numbers(tree, ""))


def _numbers(node: Any, path: str) -> Iterator[tuple[str, FloatArray]]:
    matrix = _stored_matrix(node)
    if matrix is not None:
        yield path, matrix
    elif isinstance(node, dict):
        for key, inner in node.items():
            yield from _numbers(inner, f"{path}/{key}" if path else key)
    elif isinstance(node, np.ndarray) or _is_number(node):
        yield path, np.asarray(node, np.float64)
    elif isinstance(node, list) and node and all(map(_is_number, node)):
        yield path, np.array(node, np.float64)


def _stored_matrix(node: Any) -> FloatArray | None:
    """Return the matrix of a map with rows, cols and data, or of a list of rows; else None.

    A map with sizes and data is a vector or an array of more axes (OpenCV 5, `opencv-nd-matrix`).
    """
    if isinstance(node, dict) and {"sizes", "data"} <= node.keys():
        sizes = node["sizes"] if isinstance(node["sizes"], list) else [node["sizes"]]
        node = {"rows": math.prod(sizes) if all(isinstance(n, int) for n in sizes) else 0} | node
        node["cols"] = 1
    if isinstance(node, dict) and {"rows", "cols", "data"} <= node.keys():
        data, shape = node["data"], (node["rows"], node["cols"])
        is_list = isinstance(data, list) and all(map(_is_number, data))
        whole = all(isinstance(length, int) for length in shape)
        if is_list and whole and shape[0] * shape[1] == len(data):
            return np.array(data, np.float64).reshape(shape)
    is_rows = isinstance(node, list) and node and all(isinstance(row, list) for row in node)
    if is_rows and len({len(row) for row in node}) == 1:
        numbers = [number for row in node for number in row]
        if numbers and all(map(_is_number, numbers)):
            return np.array(node, np.float64)
    return None


def _of_yaml(text: str) -> Any:
    # Forms of OpenCV that no YAML parser reads: the first line %YAML:1.0, and in brackets no blank
    # between a colon and a bracket or a text.
    return _yaml_tree(_NO_BLANK.sub(": ", "\n".join(["", *text.split("\n")[1:]])))


def _yaml_tree(text: str) -> Any:
    try:
        return _Nodes(yaml.parse(text, Loader=_LOADER)).document()
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise InputError(f"line {line}: is no YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise InputError(f"is no YAML: {one_line(error)}") from None


class _Nodes:
    """Parser that makes maps, lists, numbers, texts and matrices from the events of PyYAML."""

    def __init__(self, events: Iterator[Any]) -> None:
        self._events = (event for event in events if not isinstance(event, yaml.StreamStartEvent))

    def document(self) -> Any:
        """Return the content of the only document; None if there is none."""
        if isinstance(next(self._events), yaml.StreamEndEvent):
            return None
        content = self._value(next(self._events), 0)
        next(self._events)
        last = next(self._events)
        _require(isinstance(last, yaml.StreamEndEvent), last, "found a second document")
        return content

    def _value(self, event: Any, depth: int) -> Any:
        _require(depth <= MOST_NESTED, event, f"nests deeper than {MOST_NESTED} levels")
        _require(not isinstance(event, yaml.AliasEvent), event, "has an alias; write the value")
        value: Any
        if isinstance(event, yaml.SequenceStartEvent):
            value = [self._value(item, depth + 1) for item in self._until(yaml.SequenceEndEvent)]
        elif isinstance(event, yaml.MappingStartEvent):
            value = self._map(depth + 1)
        else:
            value = event.value if event.style else _plain(event.value) if event.value else None
        return _matrix(f"line {_line(event)}", value) if event.tag == _TAG else value

    def _map(self, depth: int) -> dict[str, Any]:
        entries: dict[str, Any] = {}
        for event in self._until(yaml.MappingEndEvent):
            _require(isinstance(event, yaml.ScalarEvent), event, "is no entry KEY: VALUE")
            key, value = event.value, self._value(next(self._events), depth)
            # In brackets OpenCV writes no blank after a colon.
            if value is None and not event.style and ":" in key:
                key, _, rest = key.partition(":")
                value = _plain(rest)
            _require(key not in entries, event, f"the key {key} is there twice")
            entries[key] = value
        return entries

    def _until(self, end: type) -> Iterator[Any]:
        while not isinstance(event := next(self._events), end):
            yield event


def _line(event: Any) -> int:
    return int(event.start_mark.line) + 1


def _require(holds: bool, event: Any, message: str) -> None:
    if not holds:
        raise InputError(f"line {_line(event)}: {message}")


def _of_xml(text: str) -> Any:
    try:
        return _element(ElementTree.fromstring(text), 0)
    # Expat's own limits stop the expansion of recursive entities.
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
    if all(child.tag == "_" for child in inner):
        return [_element(child, depth + 1) for child in inner]
    content = {child.tag: _element(child, depth + 1) for child in inner}
    if len(content) < len(inner):
        raise InputError(f"{where}: a name is there twice")
    return _matrix(where, content) if element.get("type_id") == MATRIX else content


def _plain(text: str) -> int | float | str:
    if _WHOLE.fullmatch(text):
        return int(text)
    return float(text) if _REAL.fullmatch(text) else text


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value)


def _matrix(where: str, entries: Any) -> FloatArray:
    names = ("rows", "cols", "dt", "data")
    if not isinstance(entries, dict) or sorted(entries) != sorted(names):
        raise InputError(f"{where}: a matrix needs {', '.join(names)}")
    rows, cols, dt, data = (entries[name] for name in names)
    numbers = data if isinstance(data, list) else [data]
    if not all(map(_is_number, numbers)):
        raise InputError(f"{where}: data of a matrix is no list of finite numbers")
    channels, kind = _channels(dt)
    whole = kind in _WHOLE_TYPES and all(isinstance(number, int) for number in numbers)
    if kind not in ("d", "f") and not whole:
        raise InputError(f"{where}: a matrix is of dt: {dt}; write d, its numbers are reals")
    if not (isinstance(rows, int) and isinstance(cols, int) and min(rows, cols) > 0):
        raise InputError(f"{where}: a matrix has {rows} rows and {cols} cols")
    if rows * cols * channels != len(numbers):
        raise InputError(
            f"{where}: a matrix of {rows} rows and {cols} cols{f' of dt {dt}' * (channels > 1)} "
            f"holds {len(numbers)} numbers"
        )
    exact = np.array(numbers, np.float32 if kind == "f" else np.float64)
    shape = (rows, cols) if channels == 1 else (rows, cols, channels)
    return np.asarray(exact.reshape(shape), np.float64)


def _channels(dt: Any) -> tuple[int, Any]:
    """Return the numbers per element and the type of a matrix: (2, "f") for "2f", as of points."""
    match = _SEVERAL.fullmatch(dt) if isinstance(dt, str) else None
    return (int(match[1]), match[2]) if match else (1, dt)
