"""Read image files of uncompressed numbers: NumPy arrays (NPY) and binary grey maps (PGM)."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import InputError, one_line
from reconstruction.reading import MOST_IMAGE_BYTES, read_bytes, regular_file

# The header has width, height and largest value, with comments between them, and one blank before
# the pixels.
_HEADER = re.compile(rb"P5" + rb"(?:\s|#[^\n]*\n)+(\d{1,9})" * 3 + rb"\s")


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
    """Return the values of a binary PGM file as they are stored, (row, col) uint8 or uint16.

    The values are not scaled. Other readers multiply them such that the largest value in the
    header, for example 4095, becomes 65535.

    Raises
    ------
    InputError : the file is missing, is no binary PGM, or has fewer bytes than the header states
    """
    content = read_bytes(path, MOST_IMAGE_BYTES)
    header = _HEADER.match(content)
    if header is None:
        raise InputError(f"{path}: is no complete image (no header of a binary PGM, P5)")
    cols, rows, largest = (int(number) for number in header.groups())
    kind = np.dtype(">u2" if largest > 255 else "u1")
    end = header.end() + rows * cols * kind.itemsize
    if not 0 < largest < 2**16 or rows * cols == 0 or len(content) < end:
        raise InputError(
            f"{path}: is no complete image ({len(content)} bytes, {cols} x {rows} px with values "
            f"up to {largest} need {end})"
        )
    values = np.frombuffer(content[header.end() : end], kind).reshape(rows, cols)
    return values.astype(kind.newbyteorder("="))
