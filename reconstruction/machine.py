"""What the machine gives: cores to share, and a disk that may be full.

Programs that share a machine agree on how many threads may run side by side (`VARIABLE`).

Files are written through HDF5 and OpenEXR so that a full disk is an ordinary error. HDF5 must not
be told that a write failed: its file can then be closed no more, and the process ends in a
segmentation fault. So the bytes go to the disk through Python; after the first failure the rest is
dropped, and the failure is raised once HDF5 has let go of the file. OpenEXR tells the reason in
words only. Which files HDF5 is given to read is decided in `sealing`.
"""

import errno
import io
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reconstruction.errors import InputError, one_line
from reconstruction.reading import regular_file
from reconstruction.sealing import require_readable, seal

if TYPE_CHECKING:
    import numpy as np
    import xarray
    from numpy.typing import NDArray


PIXELS = ("row", "col")
"""Dimensions of maps in camera pixels."""

VARIABLE = "NUMBA_NUM_THREADS"
"""Environment variable that limits the threads of this process, as it limits Numba's."""


def threads() -> int:
    """Return the number of cores that this process may use, or less where VARIABLE says so."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    told = os.environ.get(VARIABLE, "")
    return max(1, min(cores or 1, int(told) if told.isdecimal() else cores or 1))


def run_side_by_side(jobs: Sequence[Callable[[], object]]) -> None:
    """Run jobs on the cores of this process; raises the failure of the first that failed.

    For what spends its time outside of Python: array arithmetic, compression, files.
    """
    with ThreadPoolExecutor(threads()) as pool:
        for job in [pool.submit(job) for job in jobs]:
            job.result()


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def is_disk_full(error: BaseException) -> bool:
    """Tell whether an error means that there is no room: full disk, quota, or limit of a file."""
    return isinstance(error, OSError) and error.errno in _FULL


def unwritable(
    path: Path | str, error: OSError, kind: type[InputError] = InputError
) -> OSError | InputError:
    """Return what to raise for a file that cannot be written.

    A full disk stays an OSError, for nothing that was asked for is wrong; it names the file.
    Anything else (no permission, a file in the place of a folder) is bad input.
    """
    if is_disk_full(error):
        return OSError(error.errno, error.strerror, str(path))
    return kind(f"{path}: cannot be written ({error.strerror or error})")


def write_dataset(path: Path | str, dataset: "xarray.Dataset") -> None:
    """Write a data set as netCDF-4; an existing file is replaced.

    Maps of whole numbers are compressed: masks, reasons, orders. Maps of measured numbers are not:
    noise leaves a third of their size, and takes longer to compress than all else. An `encoding`
    of a variable's own goes before.

    Raises
    ------
    OSError : it cannot be written: the first failure. What was written until then stays there.
    """
    # Nothing here is NaN: a fill value would only say that something may be.
    plain: dict[str, Any] = {"_FillValue": None}
    packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    kinds = {
        name: plain | (one.encoding or (packed if one.ndim == 2 and one.dtype.kind in "iu" else {}))
        for name, one in dataset.variables.items()
    }
    with _patient(path) as target:
        dataset.to_netcdf(target, engine="h5netcdf", encoding=kinds)
        if target.failure is None:
            seal(target)


def pixel_coordinates(rows: int, cols: int) -> dict[str, Any]:
    """Return the coordinates of camera pixels: (0, 0) is the first, row 0 the top."""
    import numpy as np

    told = {"row": "camera row, from the top", "col": "camera column, from the left"}
    return {
        name: (name, np.arange(count, dtype=np.int32), {"units": "1", "long_name": told[name]})
        for name, count in zip(PIXELS, (rows, cols), strict=True)
    }


def read_dataset(path: Path | str, group: str | None = None) -> "xarray.Dataset":
    """Read a netCDF-4 file, or a group of it, as it was written, whole.

    Raises
    ------
    InputError : it is no file
    OSError : it is missing, damaged or something else; or a number in it is not finite
    """
    import xarray

    # Before a library opens it: reading from a pipe or a device may never end.
    if (path := Path(path)).exists():
        require_readable(regular_file(path))
    try:
        # Nothing is decoded: a unit such as ms does not make durations.
        with xarray.open_dataset(path, engine="h5netcdf", group=group, decode_cf=False) as found:
            _require_finite(found.load())
            return found
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise OSError(f"{path}: is damaged ({one_line(error)})") from error


def _require_finite(dataset: "xarray.Dataset") -> None:
    """Refuse NaN and infinity, which no file of ours holds: masks say what has no value."""
    import numpy as np

    with np.errstate(all="ignore"):
        for name, one in dataset.variables.items():
            # A sum is finite when all its parts are, and takes no memory.
            if one.dtype.kind == "f" and not math.isfinite(one.values.sum(dtype=np.float64)):
                raise ValueError(f"{name} holds numbers that are not finite")


@contextmanager
def _patient(path: Path | str) -> Iterator["_PatientFile"]:
    with _PatientFile(path) as target:
        try:
            yield target
        except Exception:
            if target.failure is None:
                raise
        if target.failure is not None:
            raise target.failure


def write_exr_channels(path: Path | str, channels: Mapping[str, "NDArray[np.float32]"]) -> None:
    """Write (row, col) float32 images as the channels of one EXR file.

    Raises
    ------
    OSError : the disk is full
    """
    import numpy as np
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    pixels = {name: np.ascontiguousarray(image, np.float32) for name, image in channels.items()}
    try:
        with OpenEXR.File(header, pixels) as file:
            file.write(str(path))
    except RuntimeError as error:
        for code in _FULL:
            if os.strerror(code) in str(error):
                raise OSError(code, os.strerror(code), str(path)) from None
        raise


class _PatientFile(io.FileIO):
    """A file that takes everything, and keeps its first failure."""

    failure: OSError | None = None

    def __init__(self, path: Path | str) -> None:
        super().__init__(path, "w+b")

    def write(self, data: Any, /) -> int:
        left = memoryview(data).cast("B")
        size = left.nbytes
        while left and self.failure is None:
            try:
                left = left[super().write(left) :]
            except OSError as error:
                self._fail(error)
        return size

    def truncate(self, size: int | None = None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self._fail(error)
            return size or 0

    def _fail(self, error: OSError) -> None:
        self.failure = self.failure or OSError(error.errno, error.strerror, os.fspath(self.name))
