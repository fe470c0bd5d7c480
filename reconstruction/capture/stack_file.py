"""Write and read the frames of a capture as one netCDF-4 file, stack.nc.

The variable `stack` (frame, row, col) has the DN of a sensor as uint8 or uint16. For a noise-free
rendering it has the expected values as float32. The variable `frame_name` (frame) has the names of
the frames. The file is not compressed; xarray, MATLAB and HDFView can read it.
"""

from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import Stack
from reconstruction.errors import CaptureError, few, one_line
from reconstruction.netcdf import LabelledArrays, read_arrays, write_arrays
from reconstruction.patterns import PatternSet
from reconstruction.reading import is_regular

DIMENSIONS = ("frame", "row", "col")
STACK = "stack"
NAMES = "frame_name"
TYPES = ("uint8", "uint16", "float32")


def write_stack(path: Path, stack: Stack, patterns: PatternSet) -> None:
    """Write a stack (frame, row, col), uint8, uint16 or float32, and the names of its frames."""
    write_arrays(path, stack_arrays(stack, patterns))


def stack_arrays(stack: Stack, patterns: PatternSet) -> LabelledArrays:
    """Return a stack (frame, row, col), DN, and the names of its frames as labelled arrays."""
    attributes = {"units": "DN", "long_name": "camera frames"}
    names = np.array([frame.name for frame in patterns.frames], dtype=object)
    return LabelledArrays({STACK: (DIMENSIONS, stack, attributes), NAMES: ("frame", names, {})})


def read_stack(path: Path, patterns: PatternSet, shape: tuple[int, int]) -> Stack:
    """Return the stack (frame, row, col) of a file that `write_stack` wrote.

    Parameters
    ----------
    patterns : pattern set; the file must have its frames, in order
    shape : expected (rows, cols)

    Raises
    ------
    CaptureError : the file is missing, truncated or damaged, or its variables, type, size or frames
        are not as expected
    """
    if not is_regular(path):
        raise CaptureError(f"{path}: the stack of frames is missing")
    try:
        file = read_arrays(path)
    except OSError as error:
        raise CaptureError(
            f"{path}: is no complete netCDF-4 file ({one_line(error)}); copy or record it again"
        ) from error
    _check(path, file, patterns, shape)
    return file[STACK]


def _check(path: Path, file: LabelledArrays, patterns: PatternSet, shape: tuple[int, int]) -> None:
    if STACK not in file or NAMES not in file:
        raise CaptureError(f"{path}: needs the variables {STACK} and {NAMES}")
    dims, stack, _ = file.variables[STACK]
    if dims != DIMENSIONS or str(stack.dtype) not in TYPES:
        raise CaptureError(
            f"{path}: stack is {stack.dtype} {dims}; it must be {' or '.join(TYPES)} {DIMENSIONS}"
        )
    _check_frames(path, [_text(name) for name in file[NAMES]], patterns)
    expected = (len(patterns.frames), *shape)
    if stack.shape != expected:
        raise CaptureError(
            f"{path}: stack has shape {stack.shape}; capture.toml announces {expected}"
        )


def _check_frames(path: Path, names: list[str], patterns: PatternSet) -> None:
    expected = [frame.name for frame in patterns.frames]
    if names == expected:
        return
    missing = [name for name in expected if name not in names]
    extra = [name for name in names if name not in expected]
    raise CaptureError(
        f"{path}: holds {len(names)} frames, the pattern set has {len(expected)}; "
        f"missing: {few(missing)}; not expected: {few(extra)}; "
        "frames must be in the order of the pattern set"
    )


def _text(name: Any) -> str:
    return name.decode("utf-8") if isinstance(name, bytes) else str(name)
