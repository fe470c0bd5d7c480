"""Where an LLVM or a CUDA driver may be found on this machine."""

import ctypes
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

_LIBRARY_NAME = re.compile(r"^libLLVM(?:-(?P<dash>\d[\d.]*))?\.so(?:\.(?P<suffix>\d[\d.]*))?$")
_LIBRARY_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/llvm*/lib",
)


def llvm_candidates() -> list[Path]:
    """List the LLVM libraries of this machine, newest first, each once.

    Returns
    -------
    list of Path
    """
    found = {path.resolve() for path in _library_paths() if _LIBRARY_NAME.match(path.name)}
    return sorted((path for path in found if path.is_file()), key=_version_key, reverse=True)


def _library_paths() -> Iterator[Path]:
    for folder in (*_LIBRARY_FOLDERS, f"{sys.prefix}/lib"):
        yield from Path("/").glob(f"{folder.lstrip('/')}/libLLVM*.so*")
    yield from _linker_cache()


def _linker_cache() -> Iterator[Path]:
    for ldconfig in ("/sbin/ldconfig", "ldconfig"):
        try:
            listing = subprocess.run(
                [ldconfig, "-p"], capture_output=True, text=True, timeout=10, check=False
            )
        except (OSError, subprocess.TimeoutExpired):
            continue
        for line in listing.stdout.splitlines():
            if "libLLVM" in line and " => " in line:
                yield Path(line.rpartition(" => ")[2])
        return


def _version_key(library: Path) -> tuple[tuple[int, ...], str]:
    match = _LIBRARY_NAME.match(library.name)
    text = (match["dash"] or match["suffix"] or "") if match else ""
    return tuple(int(part) for part in text.split(".") if part), str(library)


def has_cuda_driver() -> bool:
    """Tell whether the CUDA driver library loads."""
    try:
        ctypes.CDLL(os.environ.get("DRJIT_LIBCUDA_PATH", "libcuda.so.1"))
    except OSError:
        return False
    return True
