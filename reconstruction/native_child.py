"""Program that reads one file by native code, in a process of its own that may crash; see `native`.

Its arguments are the kind of file, the limit in seconds of processor time, and the path. The module
does not import this package, so that it starts fast. An error is printed in one line, with exit
status 1. For a MATLAB file the numeric arrays are printed as the bytes of an npz file.
"""

import contextlib
import io
import os
import signal
import sys
from collections.abc import Iterator
from typing import Any

# No compressed array has more numbers per stored byte, except an array that was never written.
_MOST_NUMBERS_PER_BYTE, _ALWAYS_ALLOWED_BYTES = 2000, 2**28


def read_hdf5(path: str) -> bytes:
    """Read every attribute and array of a netCDF-4 file; return no bytes."""
    import h5netcdf
    import h5py

    def visit(name: str, node: Any) -> None:
        dict(node.attrs)
        if isinstance(node, h5py.Dataset):
            stored = node.id.get_storage_size()
            if node.nbytes > max(_ALWAYS_ALLOWED_BYTES, _MOST_NUMBERS_PER_BYTE * stored):
                raise ValueError(f"{name} claims {node.nbytes} bytes, the file holds {stored}")
            node[()]

    with h5py.File(path, "r") as file:
        dict(file.attrs)
        file.visititems(visit)
    with h5netcdf.File(path, "r") as file:
        _walk(file)
    return b""


def _walk(group: Any) -> None:
    dict(group.attrs)
    for variable in group.variables.values():
        dict(variable.attrs)
        _ = variable.dimensions, variable.shape, variable.dtype
    for inner in group.groups.values():
        _walk(inner)


def read_matlab(path: str) -> bytes:
    """Return the numeric arrays of a MATLAB file as the bytes of an npz file.

    An array is named by its path in the structures of the file: `outer/inner`.
    """
    import numpy as np
    from scipy.io import loadmat

    try:
        tree = loadmat(path, appendmat=False, simplify_cells=True)
    except NotImplementedError:
        raise ValueError("it is of MATLAB's version 7.3; save it again with -v7") from None
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **dict(_numbers(tree, "")))
    return content.getvalue()


def _numbers(tree: dict[str, Any], path: str) -> Iterator[tuple[str, Any]]:
    import numpy as np

    for key, value in tree.items():
        name = f"{path}/{key}" if path else str(key)
        if isinstance(value, dict):
            yield from _numbers(value, name)
        elif not str(key).startswith("__") and np.asarray(value).dtype.kind in "fiu":
            yield name, np.asarray(value, np.float64)


def main(kind: str, limit_s: str, path: str) -> int:
    """Read a file of the kind HDF5 or MATLAB, print the result or the error, return the status."""
    if hasattr(signal, "setitimer"):  # on other systems the parent limits the time
        signal.setitimer(signal.ITIMER_PROF, float(limit_s))
    readers = {"HDF5": read_hdf5, "MATLAB": read_matlab}
    try:
        output, code = readers[kind](path), 0
    except Exception as error:
        output, code = " ".join(f"{error or type(error).__name__}".split()).encode(), 1
    sys.stdout.buffer.write(output)
    return code


if __name__ == "__main__":
    code = main(*sys.argv[1:])
    # h5netcdf prints a traceback when a file that it failed to open is garbage-collected.
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(code)
