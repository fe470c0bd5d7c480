"""Read image files of uncompressed numbers: NumPy arrays (NPY) and grey maps (PGM)."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import InputError, one_line
from reconstruction.reading import MOST_IMAGE_BYTES, read_bytes, regular_file

# The header has width, height and largest value, with comments between them, and one blank before
# the pixels. P5: bytes, P2: numbers as text.
_HEADER = re.compile(rb"P([25])" + rb"(?:\s|#[^\n]*\n)+(\d{1,9})" * 3 + rb"\s")


def read_npy(path: Path) -> NDArray[Any]:
    """Return the array of an NPY file.

    Raises
    ------
    InputError : the file is missing, the array is incomplete or empty, or has Python objects
    """
    regular_file(path, MOST_IMAGE_BYTES)
    try:
        content = np.load(path, allow_pickle=False)
    # numpy raises ValueError, EOFError, OSError ...
    except Exception as error:
        raise InputError(f"{path}: is no complete image ({one_line(error)})") from error
    image = np.asarray(content)
    if not image.size:
        raise InputError(f"{path}: is no complete image (an array of shape {image.shape})")
    return image


def read_pgm(path: Path) -> NDArray[Any]:
    """Return the values of a PGM file, binary or text, as stored, (row, col) uint8 or uint16.

    The values are not scaled. Other readers multiply them such that the largest value in the
    header, for example 4095, becomes 65535.

    Raises
    ------
    InputError : the file is missing, is no PGM, or has fewer pixels than the header states
    """
    content = read_bytes(path, MOST_IMAGE_BYTES)
    header = _HEADER.match(content)
    if header is None:
        raise InputError(f"{path}: is no complete image (no header of a PGM, P5 or P2)")
    cols, rows, largest = (int(number) for number in header.groups()[1:])
    if header[1] == b"2":
        return _text_values(path, content[header.end() :], (rows, cols), largest)
    kind = np.dtype(">u2" if largest > 255 else "u1")
    end = header.end() + rows * cols * kind.itemsize
    if not 0 < largest < 2**16 or rows * cols == 0 or len(content) < end:
        raise InputError(
            f"{path}: is no complete image ({len(content)} bytes, {cols} x {rows} px with values "
            f"up to {largest} need {end})"
        )
    values = np.frombuffer(content[header.end() : end], kind).reshape(rows, cols)
    return values.astype(kind.newbyteorder("="))


def _text_values(path: Path, text: bytes, shape: tuple[int, int], largest: int) -> NDArray[Any]:
    """Return the values of a PGM file of type P2, (row, col) uint8 or uint16."""
    numbers = re.sub(rb"#[^\n]*", b" ", text).split()
    try:
        values = np.array([int(number) for number in numbers[: shape[0] * shape[1]]], np.int64)
    except ValueError as error:
        raise InputError(f"{path}: is no complete image ({one_line(error)})") from error
    if not 0 < largest < 2**16 or len(values) < max(shape[0] * shape[1], 1):
        raise InputError(
            f"{path}: is no complete image ({len(values)} numbers, {shape[1]} x {shape[0]} px with "
            f"values up to {largest} need {shape[0] * shape[1]})"
        )
    if values.min() < 0 or values.max() > largest:
        raise InputError(f"{path}: is no complete image (a value is not within 0 to {largest})")
    return values.reshape(shape).astype(np.uint16 if largest > 255 else np.uint8)
