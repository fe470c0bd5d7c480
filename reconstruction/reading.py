"""Read files of other programs: text, TOML, JSON, images and arrays, after a check of the file.

Every fault of such a file raises an InputError. Its one line names the file, the position in the
file, the value that was read and the allowed values. Pipes and devices are rejected before they are
opened, because reading them may never end.
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
# Limit for TOML, which is written by hand: the largest list of frames has some 100 kB.
MOST_TOML_BYTES = 2**20
MOST_DATA_BYTES = 64 * 2**30
MOST_IMAGE_BYTES = 2**30
# Largest depth of nested tables. Deeper ones are a mistake or an attack, and would exceed Python's
# recursion limit (RecursionError).
MOST_NESTED = 64
# Matches a dotted key of more than MOST_NESTED parts. The time in which the parser would split such
# a key is quadratic in the number of parts.
_DEEP_KEY = re.compile(
    rf"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{MOST_NESTED}}}"""
)
_LONGEST_SHOWN = 120
# Windows has no pipes among its files, and would translate line ends.
_READING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_KINDS: Mapping[int, str] = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def is_regular(path: Path) -> bool:
    """Return True if the path is a regular file; False also if the path is not a valid name."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def regular_file(path: Path | str, most_bytes: int = MOST_DATA_BYTES) -> Path:
    """Return `path` if it is a regular file of at most `most_bytes` bytes.

    Raises
    ------
    InputError : the file is missing or larger, or the path is a folder, a pipe or a device
    """
    path = Path(path)
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or one_line(error)
        raise InputError(f"{shown(path)}: cannot be read: {reason}") from None
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "no file")
        raise InputError(f"{shown(path)}: cannot be read: found {kind}, allowed a file")
    if status.st_size > most_bytes:
        raise InputError(
            f"{shown(path)}: cannot be read: found {status.st_size} bytes, allowed up to "
            f"{most_bytes}"
        )
    return path


def read_bytes(path: Path | str, most_bytes: int = MOST_DATA_BYTES) -> bytes:
    """Return the content of a regular file of at most `most_bytes` bytes.

    Raises
    ------
    InputError : the file cannot be read, is not a regular file or is larger
    """
    path = regular_file(path, most_bytes)
    try:
        # Non-blocking, in case a pipe has replaced the file: no wait for its writer.
        with os.fdopen(os.open(path, _READING), "rb") as file:
            return file.read()
    except OSError as error:
        raise InputError(f"{shown(path)}: cannot be read: {error.strerror}") from None


def read_text(path: Path | str, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """Return the text of a UTF-8 file of at most `most_bytes` bytes.

    Raises
    ------
    InputError : as `read_bytes`, or the file is not UTF-8
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
    """Return the top-level table of a TOML file.

    Raises
    ------
    InputError : as `read_text`, or the text is not TOML, or its tables are nested too deeply
    """
    return parse_toml(read_text(path, MOST_TOML_BYTES), shown(path))


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Return the top-level table of a text in TOML; error messages start with `where`.

    Raises
    ------
    InputError : the text is not TOML, or its tables are nested too deeply
    """
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise InputError(
            f"{where}: line {line}: found a key of more than {MOST_NESTED} parts, tables nested "
            f"deeper than {MOST_NESTED} levels; shorten it"
        )
    try:
        content = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        # Integers beyond 4300 digits raise Python's own ValueError.
        raise InputError(f"{where}: not valid TOML: {_cause(error)}") from None
    _require_shallow(content, where)
    return content


def read_json(path: Path | str) -> dict[str, Any]:
    """Return the object that a JSON file contains.

    Raises
    ------
    InputError : as `read_text`, or the text is not JSON, is no object, or is nested too deeply
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
    """Return the pixels of a PNG, TIFF or BMP file as stored: (row, col) or (row, col, channel).

    Raises
    ------
    InputError : as `regular_file`, or the file is not a complete image
    """
    import imageio.v3 as imageio  # 0.1 s that are not needed for text

    path = regular_file(path, MOST_IMAGE_BYTES)
    try:
        return _array(imageio.imread(path, plugin="pillow"))
    # Pillow's readers raise many classes: SyntaxError, struct.error, zlib.error, IndexError ...
    except Exception as error:
        raise InputError(f"{shown(path)}: is no complete image ({_of_image(error)})") from None


def _of_image(error: Exception) -> str:
    if isinstance(error, AttributeError):
        return "a part is missing, such as its palette"
    # imageio hides the message of Pillow.
    return one_line(error.__cause__ or error) or type(error).__name__


def _array(decoded: Any) -> "NDArray[Any]":
    import numpy as np

    array = np.asarray(decoded)
    if array.dtype.kind not in "biuf" or array.ndim not in (2, 3) or not array.size:
        raise ValueError(f"found {array.dtype} of shape {array.shape}")
    return array


def read_arrays(path: Path | str) -> "dict[str, np.ndarray[Any, Any]]":
    """Return the arrays of an npz file by name.

    Raises
    ------
    InputError : as `regular_file`, the npz file is incomplete, or an array has Python objects
    """
    import numpy as np

    path = regular_file(path)
    try:
        # Opened here: np.load does not close a file that is not an archive.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            return {name: np.asarray(file[name]) for name in file.files}
    # zipfile and numpy raise different classes: BadZipFile, zlib.error, NotImplementedError ...
    except Exception as error:
        reason = one_line(error) or type(error).__name__
        raise InputError(f"{shown(path)}: is no complete npz file ({reason})") from None


def _cause(error: Exception) -> str:
    if isinstance(error, RecursionError):
        return f"brackets nest deeper than {MOST_NESTED} levels"
    text = one_line(error)
    return "a number has more than 4300 digits" if "integer string conversion" in text else text


def _require_shallow(tree: Any, where: str) -> None:
    """Raise InputError if `tree` is nested deeper than MOST_NESTED levels; without recursion."""
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
    """Return a name as text for a message: control characters escaped, a long name shortened."""
    text = repr(str(name))[1:-1]
    return f"{text[:_LONGEST_SHOWN]}..." if len(text) > 2 * _LONGEST_SHOWN else text
