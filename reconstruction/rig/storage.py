"""OpenCV's YAML and XML files, read so that nothing in them brings OpenCV's reader down."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import CaptureError, InputError
from reconstruction.reading import read_text

YAML, XML = "%YAML", "<?xml"
# OpenCV's reader goes down one level of C++ per bracket, element or indent, and overflows its
# stack: a calibration has 3 kB in short lines and two levels.
MOST_BYTES, MOST_LINE, MOST_NESTED = 1_000_000, 1000, 32
_MATRIX_KEYS = {"rows", "cols", "dt", "data"}


def open_storage(path: Path, heads: tuple[str, ...] = (YAML,)) -> Any:
    """Return the open cv2.FileStorage of a file that begins with one of some heads.

    Raises
    ------
    CaptureError : no such file, or it is none of OpenCV's, or damaged
    """
    try:
        text = read_text(path)
    except InputError as error:
        raise CaptureError(str(error)) from None
    if not text.startswith(heads):  # checked here: OpenCV prints and aborts the parse otherwise
        raise CaptureError(
            f"{path}: is no OpenCV calibration; the first line must begin with {' or '.join(heads)}"
        )
    _require_plain(path, text)
    try:
        # Not by the constructor: the binding turns an error in it into a SystemError.
        storage = cv2.FileStorage()
        storage.open(text, cv2.FileStorage_READ | cv2.FileStorage_MEMORY)
        return storage
    except cv2.error as error:
        raise damaged(path, error) from error


def _require_plain(path: Path, text: str) -> None:
    """Refuse a text that is no calibration and may bring OpenCV's reader down."""
    longest, nested = max(map(len, text.splitlines())), 0
    for sign in re.findall(r"[][{}]|</|/>|<(?=\w)", text):
        nested = nested + 1 if sign in "[{<" else max(nested - 1, 0)
        if nested > MOST_NESTED:
            raise CaptureError(
                f"{path}: is no calibration: brackets nest deeper than {MOST_NESTED} levels"
            )
    if len(text) > MOST_BYTES or longest > MOST_LINE:
        raise CaptureError(
            f"{path}: is no calibration: found {len(text)} characters in lines of up to "
            f"{longest}, allowed {MOST_BYTES} and {MOST_LINE}"
        )


def damaged(path: Path, error: Any) -> CaptureError:
    """Return what to raise for an error of OpenCV's reader."""
    # In a parse error OpenCV puts line number and cause where the function's name belongs.
    is_parse_error = error.code == cv2.Error.StsParseError
    cause = f"line {error.func}" if is_parse_error else "an entry is incomplete"
    return CaptureError(f"{path}: is damaged: {cause}")


def numbers_in(path: Path) -> dict[str, FloatArray]:
    """Return every number and matrix of a YAML or XML file by its path, `camera/matrix`.

    Raises
    ------
    CaptureError : no such file, or it is none of OpenCV's, or damaged
    """
    storage = open_storage(path, (YAML, XML))
    try:
        return dict(_numbers(storage.root(), ""))
    except cv2.error as error:  # thrown wherever it meets a half-written node
        raise damaged(path, error) from error
    finally:
        storage.release()


def _numbers(node: Any, path: str) -> Iterator[tuple[str, FloatArray]]:
    if node.isMap():
        keys = set(node.keys())
        if keys >= _MATRIX_KEYS:
            matrix = node.mat()
            if matrix is not None:
                yield path, np.asarray(matrix, np.float64)
            return
        for key in sorted(keys):
            yield from _numbers(node.getNode(key), f"{path}/{key}" if path else key)
    elif node.isSeq():
        items = [node.at(number) for number in range(node.size())]
        if items and all(one.isReal() or one.isInt() for one in items):
            yield path, np.array([one.real() for one in items])
    elif node.isReal() or node.isInt():
        yield path, np.array(node.real())
