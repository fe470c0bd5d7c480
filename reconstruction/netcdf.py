"""Write and read netCDF-4 files of arrays with named dimensions, units and long names.

HDF5 encodes a file in memory, and `writing` copies the bytes to the disk. HDF5 does not write to
the disk itself, for two reasons. A failed write may end the process in a segmentation fault, and
so may a read of fewer bytes than HDF5 wrote. In memory neither happens. `sealing` decides which
files HDF5 may read.

This module does not import xarray, which takes 1 s to load.
"""

import io
import math
import mmap
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import one_line
from reconstruction.reading import regular_file
from reconstruction.sealing import require_readable, seal
from reconstruction.writing import write_bytes

if TYPE_CHECKING:
    import xarray

PIXELS = ("row", "col")
"""Names of the dimensions of a map over camera pixels."""

_OF_HDF5_BYTES = 2**24
_encoding = threading.Lock()

Labelled = tuple[str | tuple[str, ...], NDArray[Any], Mapping[str, Any]]
"""Tuple of dimension names (one name, or one per axis), array, and attributes such as units."""


@dataclass(frozen=True, eq=False)
class LabelledArrays:
    """Content of one netCDF-4 file.

    Attributes
    ----------
    variables : arrays by name, of any type except bool
    coords : coordinate arrays by name, of any type except bool. Each is one-dimensional, along the
        dimension of the same name
    attrs : attributes of the file
    """

    variables: Mapping[str, Labelled]
    coords: Mapping[str, Labelled] = field(default_factory=dict)
    attrs: Mapping[str, Any] = field(default_factory=dict)

    def __contains__(self, name: str) -> bool:
        return name in self.variables or name in self.coords

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the array of this name, or raise KeyError."""
        return (self.variables[name] if name in self.variables else self.coords[name])[1]

    def to_xarray(self) -> "xarray.Dataset":
        """Return the content as an xarray dataset."""
        import xarray

        return xarray.Dataset(self.variables, self.coords, self.attrs)


def write_arrays(path: Path | str, arrays: LabelledArrays) -> None:
    """Write arrays as a netCDF-4 file and replace an existing file.

    Maps of whole numbers (masks, reasons, orders) are compressed. Maps of measured numbers are not
    compressed: because of their noise they only shrink to 33 %, and their compression takes longer
    than that of all other arrays. Frames are stored contiguously, because writing one chunk per
    frame takes 10 times as long.

    Encoding needs as much memory as the file is large. Only one thread encodes at a time.

    Raises
    ------
    MemoryError : there is not enough memory for the file
    OSError : the file cannot be written; an existing file is unchanged
    """
    with _encoding:
        memory = _encoded(arrays)
        write_bytes(path, memory.getbuffer())


def _encoded(arrays: LabelledArrays) -> io.BytesIO:
    import h5netcdf

    labelled = {**arrays.variables, **arrays.coords}
    _require_memory(sum(values.nbytes for _, values, _ in labelled.values()))
    # No class of this package: a signal in its methods would reach HDF5 as a failed write.
    memory = io.BytesIO()
    with h5netcdf.File(memory, "w") as file:
        file.attrs.update(arrays.attrs)
        for name, labelled_array in labelled.items():
            _write_array(file, name, *labelled_array)
    seal(memory)
    return memory


def _require_memory(size_bytes: int) -> None:
    """Raise MemoryError unless a file of `size_bytes` can be encoded; HDF5 itself would crash."""
    try:
        # The memory is reserved, not used: a growing buffer needs its old and its new size, and
        # HDF5 needs some memory for itself.
        size = 2 * size_bytes + _OF_HDF5_BYTES
        private = hasattr(mmap, "MAP_PRIVATE")  # not on Windows, where anonymous memory is private
        (mmap.mmap(-1, size, mmap.MAP_PRIVATE) if private else mmap.mmap(-1, size)).close()
    except OSError as error:
        raise MemoryError(f"no {size_bytes / 1e6:.0f} MB of memory to encode a file") from error


def _write_array(
    file: Any,
    name: str,
    dims: str | tuple[str, ...],
    values: NDArray[Any],
    attrs: Mapping[str, Any],
) -> None:
    import h5py

    names = (dims,) if isinstance(dims, str) else dims
    for dim, size in zip(names, values.shape, strict=True):
        if dim not in file.dimensions:
            file.dimensions[dim] = size
    is_map_of_numbers = values.ndim == 2 and values.dtype.kind in "iu"
    packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    made = file.create_variable(
        name,
        names,
        dtype=h5py.string_dtype() if values.dtype == object else values.dtype,
        **(packed if is_map_of_numbers else {}),
    )
    made[...] = values
    made.attrs.update(attrs)


def pixel_coordinates(rows: int, cols: int) -> dict[str, Labelled]:
    """Return the coordinate arrays of a camera image: row and column numbers, row 0 at the top."""
    texts = {"row": "camera row, from the top", "col": "camera column, from the left"}
    return {
        name: (name, np.arange(count, dtype=np.int32), {"units": "1", "long_name": texts[name]})
        for name, count in zip(PIXELS, (rows, cols), strict=True)
    }


def read_arrays(path: Path | str, group: str | None = None) -> LabelledArrays:
    """Read all arrays and attributes of a netCDF-4 file, or of one group in the file.

    Raises
    ------
    InputError : the path is not a regular file
    OSError : the file is missing, damaged or of another format; or a number in it is not finite
    """
    import h5netcdf

    # Before a library opens it: reading from a pipe or a device may never end.
    if (path := Path(path)).exists():
        require_readable(regular_file(path))
    try:
        with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
            node = file if group is None else file[group]
            labelled = {
                name: (variable.dimensions, np.asarray(variable[...]), dict(variable.attrs))
                for name, variable in node.variables.items()
            }
            attrs = dict(node.attrs)
        _require_finite(labelled)
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise OSError(f"{path}: is damaged ({one_line(error)})") from error
    coords = {name: array for name, array in labelled.items() if array[0] == (name,)}
    variables = {name: array for name, array in labelled.items() if name not in coords}
    return LabelledArrays(variables, coords, attrs)


def _require_finite(labelled: Mapping[str, Labelled]) -> None:
    """Raise ValueError if a float array has NaN or infinity; masks mark missing values instead."""
    with np.errstate(all="ignore"):
        for name, (_, values, _) in labelled.items():
            # A sum is finite if all its terms are, and needs no temporary array.
            if values.dtype.kind == "f" and not math.isfinite(values.sum(dtype=np.float64)):
                raise ValueError(f"{name} holds numbers that are not finite")
