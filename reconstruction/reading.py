"""Files that others wrote: what may be opened at all; text, TOML, JSON, images and arrays.

Whatever is wrong with such a file is an InputError of one line: the file, the place, what was found
and what is allowed. Pipes and devices are refused before they are opened, since reading from them
may never end.
"""

import json
import os
import re
import stat
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reconstruction.errors import InputError, one_line

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_TEXT_BYTES = 16 * 2**20
# Of TOML, which is written by hand: the largest list of frames has some 100 kB.
MOST_TOML_BYTES = 2**20
MOST_DATA_BYTES = 64 * 2**30
MOST_IMAGE_BYTES = 2**30
# Deeper tables are a mistake or an attack; Python's own limit would end in a RecursionError.
MOST_NESTED = 64
# A dotted key of more parts, which the parser would take apart in time quadratic in their number.
_DEEP_KEY = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{MOST_NESTED}}}"""
)
_LONGEST_SHOWN = 120
# Windows has no pipes among its files, and would change the ends of lines.
_READING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_KINDS: Mapping[int, str] = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def is_regular(path: Path) -> bool:
    """Tell whether a file is there; names that no file can have are of none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def regular_file(path: Path | str, most_bytes: int = MOST_DATA_BYTES) -> Path:
    """Return `path` if it is a file that may be opened.

    Raises
    ------
    InputError : it is missing, larger than `most_bytes`, or a folder, a pipe or a device
    """
    path = Path(path)
    try:
        found = path.stat()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or one_line(error)
        raise InputError(f"{shown(path)}: cannot be read: {reason}") from None
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "no file")
        raise InputError(f"{shown(path)}: cannot be read: found {kind}, allowed a file")
    if found.st_size > most_bytes:
        raise InputError(
            f"{shown(path)}: cannot be read: found {found.st_size} bytes, allowed up to "
            f"{most_bytes}"
        )
    return path


def read_bytes(path: Path | str, most_bytes: int = MOST_DATA_BYTES) -> bytes:
    """Return the content of a file.

    Raises
    ------
    InputError : as `regular_file`, or it cannot be read
    """
    path = regular_file(path, most_bytes)
    try:
        # Not waiting for a writer, should a pipe have taken the file's place.
        with os.fdopen(os.open(path, _READING), "rb") as file:
            return file.read()
    except OSError as error:
        raise InputError(f"{shown(path)}: cannot be read: {error.strerror}") from None


def read_text(path: Path | str, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """Return a text file in UTF-8, of at most `most_bytes`.

    Raises
    ------
    InputError : as `read_bytes`, or it is no UTF-8
    """
    content = read_bytes(path, most_bytes)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{shown(path)}: cannot be read: line {line} is no text in UTF-8"
        ) from None


def read_toml(path: Path | str) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    InputError : as `read_text`, or it is no TOML, or nested deeper than any file of ours
    """
    return parse_toml(read_text(path, MOST_TOML_BYTES), shown(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Return a TOML text's content; `where` begins the message.

    Raises
    ------
    InputError : it is no TOML, or nested deeper than any file of ours
    """
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise InputError(
            f"{where}: line {line}: found a key of more than {MOST_NESTED} parts, tables nested "
            f"deeper than {MOST_NESTED} levels; shorten it"
        )
    try:
        found = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        # Integers beyond 4300 digits are a ValueError of Python's own.
        raise InputError(f"{where}: not valid TOML: {_cause(error)}") from None
    _require_shallow(found, where)
    return found


def read_json(path: Path | str) -> dict[str, Any]:
    """Return the object of a JSON file.

    Raises
    ------
    InputError : as `read_text`, or it is no JSON, or no object
    """
    where = shown(path)
    text = read_text(path)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: cannot be read: {_cause(error)}") from None
    if not isinstance(content, dict):
        raise InputError(f"{where}: found {type(content).__name__}, allowed a JSON object")
    _require_shallow(content, where)
    return content


def read_pixels(path: Path | str) -> "NDArray[Any]":
    """Return an image file, PNG, TIFF or BMP, as it is stored, (row, col) or (row, col, channel).

    Raises
    ------
    InputError : as `regular_file`, or it is no complete image
    """
    import imageio.v3 as imageio  # 0.1 s that reading text need not pay

    path = regular_file(path, MOST_IMAGE_BYTES)
    try:
        return _array(imageio.imread(path, plugin="pillow"))
    # Pillow's readers raise each their own: SyntaxError, struct.error, zlib.error, IndexError ...
    except Exception as error:
        raise InputError(f"{shown(path)}: is no complete image ({_of_image(error)})") from None


def _of_image(error: Exception) -> str:
    if isinstance(error, AttributeError):
        return "a part is missing, such as its palette"
    # imageio hides what Pillow said.
    return one_line(error.__cause__ or error) or type(error).__name__


def _array(found: Any) -> "NDArray[Any]":
    import numpy as np

    array = np.asarray(found)
    if array.dtype.kind not in "biuf" or array.ndim not in (2, 3) or not array.size:
        raise ValueError(f"found {array.dtype} of shape {array.shape}")
    return array


def read_arrays(path: Path | str) -> "dict[str, np.ndarray[Any, Any]]":
    """Return the arrays of an npz file by name; none of Python objects.

    Raises
    ------
    InputError : as `regular_file`, or it is no complete npz file
    """
    import numpy as np

    path = regular_file(path)
    try:
        # Opened here: np.load leaves a file open that is no archive.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in file.files}
    # zipfile and numpy raise each their own: BadZipFile, zlib.error, NotImplementedError ...
    except Exception as error:
        reason = one_line(error) or type(error).__name__
        raise InputError(f"{shown(path)}: is no complete npz file ({reason})") from None


def _cause(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return f"brackets nest deeper than {MOST_NESTED} levels"
    text = one_line(error)
    return "a number has more than 4300 digits" if "integer string conversion" in text else text


def _require_shallow(tree: Any, where: str) -> None:
    """Refuse nested content without recursion."""
    level = [tree]
    for _ in range(MOST_NESTED):
        level = [
            child
            for node in level
            for child in (node.values() if isinstance(node, dict) else node)
            if isinstance(child, dict | list)
        ]
        if not level:
            return
    raise InputError(f"{where}: found tables nested deeper than {MOST_NESTED} levels")


def shown(name: Path | str) -> str:
    """Return a name as messages show it: without control characters, not longer than a line."""
    text = repr(str(name))[1:-1]
    return f"{text[:_LONGEST_SHOWN]}..." if len(text) > 2 * _LONGEST_SHOWN else text
