"""The frames of a capture as netCDF-4 (HDF5): uncompressed, readable by xarray, MATLAB, HDFView."""

from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import numpy as np

from reconstruction.arrays import Stack
from reconstruction.disk import writing_netcdf
from reconstruction.errors import CaptureError
from reconstruction.patterns import PatternSet

DIMENSIONS = ("frame", "row", "col")
STACK = "stack"
NAMES = "frame_name"
# Digital numbers of a sensor, or the expected values of a noise-free rendering.
TYPES = ("uint8", "uint16", "float32")


def write_stack(path: Path, stack: Stack, patterns: PatternSet) -> None:
    """Write a (frame, row, col) uint8, uint16 or float32 stack and the names of its frames."""
    with writing_netcdf(path) as file:
        file.dimensions = dict(zip(DIMENSIONS, stack.shape, strict=True))
        variable = file.create_variable(STACK, DIMENSIONS, data=stack)
        variable.attrs["units"] = "DN"
        variable.attrs["long_name"] = "camera frames"
        names = file.create_variable(NAMES, ("frame",), dtype=h5py.string_dtype())
        names[...] = np.array([frame.name for frame in patterns.frames], dtype=object)


def read_stack(path: Path, patterns: PatternSet, shape: tuple[int, int]) -> Stack:
    """Read the stack that `patterns` and the image `shape` (rows, cols) announce.

    Raises
    ------
    CaptureError : missing, truncated or damaged file, wrong variable, type, size or frames
    """
    if not path.is_file():
        raise CaptureError(f"{path}: the stack of frames is missing")
    try:
        with h5netcdf.File(path, "r") as file:
            _check(path, file, patterns, shape)
            return np.asarray(file.variables[STACK][...])
    except OSError as error:
        raise CaptureError(
            f"{path}: is no complete netCDF-4 file ({_one_line(error)}); copy or record it again"
        ) from error


def _check(path: Path, file: Any, patterns: PatternSet, shape: tuple[int, int]) -> None:
    if STACK not in file.variables or NAMES not in file.variables:
        raise CaptureError(f"{path}: needs the variables {STACK} and {NAMES}")
    variable = file.variables[STACK]
    if tuple(variable.dimensions) != DIMENSIONS or str(variable.dtype) not in TYPES:
        raise CaptureError(
            f"{path}: stack is {variable.dtype} {tuple(variable.dimensions)}; "
            f"it must be {' or '.join(TYPES)} {DIMENSIONS}"
        )
    _check_frames(path, [_text(name) for name in file.variables[NAMES][...]], patterns)
    expected = (len(patterns.frames), *shape)
    if tuple(variable.shape) != expected:
        raise CaptureError(
            f"{path}: stack has shape {tuple(variable.shape)}; capture.toml announces {expected}"
        )


def _check_frames(path: Path, found: list[str], patterns: PatternSet) -> None:
    expected = [frame.name for frame in patterns.frames]
    if found == expected:
        return
    missing = [name for name in expected if name not in found]
    extra = [name for name in found if name not in expected]
    raise CaptureError(
        f"{path}: holds {len(found)} frames, the pattern set has {len(expected)}; "
        f"missing: {_few(missing)}; not expected: {_few(extra)}; "
        "frames must be in the order of the pattern set"
    )


def _text(name: Any) -> str:
    return name.decode("utf-8") if isinstance(name, bytes) else str(name)


def _few(names: list[str]) -> str:
    return (
        ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "") or "none"
    )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
