"""Reads a netCDF-4 file whole, in a process that it may take down; see `sealing`.

Called with a limit in seconds of processor time and the file; imports nothing of this package, so
that it starts fast. Prints what is wrong in one line and exits with 1.
"""

import contextlib
import os
import signal
import sys
from typing import Any

# No filter packs more numbers into a byte, but for arrays that nobody wrote.
_MOST_NUMBERS_PER_BYTE, _ALWAYS_ALLOWED_BYTES = 2000, 2**28


def main(limit_s: str, path: str) -> int:
    """Read every attribute and array."""
    signal.setitimer(signal.ITIMER_PROF, float(limit_s))
    import h5netcdf
    import h5py

    def visit(name: str, node: Any) -> None:
        dict(node.attrs)
        if isinstance(node, h5py.Dataset):
            stored = node.id.get_storage_size()
            if node.nbytes > max(_ALWAYS_ALLOWED_BYTES, _MOST_NUMBERS_PER_BYTE * stored):
                raise ValueError(f"{name} claims {node.nbytes} bytes, the file holds {stored}")
            node[()]

    try:
        with h5py.File(path, "r") as file:
            dict(file.attrs)
            file.visititems(visit)
        with h5netcdf.File(path, "r") as file:
            _walk(file)
    except Exception as error:
        sys.stdout.write(" ".join(f"{error or type(error).__name__}".split()))
        return 1
    return 0


def _walk(group: Any) -> None:
    dict(group.attrs)
    for variable in group.variables.values():
        dict(variable.attrs)
        _ = variable.dimensions, variable.shape, variable.dtype
    for inner in group.groups.values():
        _walk(inner)


if __name__ == "__main__":
    code = main(*sys.argv[1:])
    # h5netcdf prints a traceback when what it half opened is collected.
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(code)
