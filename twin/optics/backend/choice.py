"""Choose the backend of this machine, once per process, among what is installed here.

A finding is remembered in the user's cache folder: a probe takes seconds.
"""

import ctypes
import functools
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from twin.optics.backend.probe import (
    ADVICE,
    CHOICE_VARIABLE,
    CUDA_VARIANT,
    LIBRARY_VARIABLE,
    LLVM_VARIANT,
    Backend,
    MissingBackend,
    probe,
)
from twin.output import replacing

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
    """List the LLVM libraries of this machine, newest first, each once."""
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


def activate() -> Backend:
    """Make the backend of this machine the current one; any number of calls.

    Raises
    ------
    MissingBackend : if no backend works here
    """
    backend = _backend_of_this_process()
    if backend.library is not None:
        os.environ[LIBRARY_VARIABLE] = backend.library
    import mitsuba as mi  # reads the variable above when it is imported

    if mi.variant() != backend.variant:
        mi.set_variant(backend.variant)
    return backend


@functools.cache
def _backend_of_this_process() -> Backend:
    return find_backend()


def find_backend(*, fresh: bool = False) -> Backend:
    """Find a backend that works: CUDA where there is a device, else the newest usable LLVM.

    Parameters
    ----------
    fresh : probe again even if an earlier finding is in the cache

    Raises
    ------
    MissingBackend : if no backend works here
    """
    key = circumstances()
    known = None if fresh else recall(key)
    if known is not None:
        return known
    backend = _search()
    remember(key, backend)
    return backend


def _search() -> Backend:
    choice = os.environ.get(CHOICE_VARIABLE, "")
    if choice not in ("", "llvm", "cuda"):
        raise MissingBackend(
            f"{CHOICE_VARIABLE}={choice} is unknown: use llvm or cuda, or unset it"
        )
    if choice != "llvm" and (choice == "cuda" or has_cuda_driver()):
        outcome = probe(CUDA_VARIANT)
        if isinstance(outcome, Backend):
            return outcome
        if choice == "cuda":
            raise MissingBackend(
                f"{CHOICE_VARIABLE}=cuda, but CUDA does not work here ({outcome.reason}): "
                f"unset {CHOICE_VARIABLE} to compute on the CPU"
            )
    return _search_llvm()


def _search_llvm() -> Backend:
    explicit = os.environ.get(LIBRARY_VARIABLE)
    if explicit:
        outcome = probe(LLVM_VARIANT, explicit)
        if isinstance(outcome, Backend):
            return outcome
        raise MissingBackend(
            f"{LIBRARY_VARIABLE}={explicit} does not work ({outcome.reason}): unset it, or {ADVICE}"
        )
    refused = []
    for library in llvm_candidates():
        outcome = probe(LLVM_VARIANT, str(library))
        if isinstance(outcome, Backend):
            return outcome
        refused.append(f"{library.name}: {outcome.reason}")
    tried = "; ".join(refused) or "no libLLVM found"
    raise MissingBackend(f"no usable renderer backend ({tried}): {ADVICE}")


def use_threads(count: int) -> None:
    """Let Dr.Jit use `count` threads in this process.

    Raises
    ------
    MissingBackend : no usable Dr.Jit backend
    """
    activate()
    import drjit as dr

    dr.set_thread_count(count)


def cache_file() -> Path:
    """Tell where findings are kept."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(base) / "fringe-twin" / "backend.json"


def circumstances() -> str:
    """Digest of everything that a finding depends on, besides the library itself."""
    facts = [
        _installed_version("mitsuba"),
        _installed_version("drjit"),
        platform.machine(),
        _cpu_flags(),
        *(os.environ.get(name, "") for name in (CHOICE_VARIABLE, LIBRARY_VARIABLE)),
        *(os.environ.get(name, "") for name in ("CUDA_VISIBLE_DEVICES", "DRJIT_LIBCUDA_PATH")),
        *sorted(path.name for path in Path("/dev").glob("nvidia*")),
    ]
    return hashlib.blake2b(json.dumps(facts).encode(), digest_size=16).hexdigest()


def _installed_version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        raise MissingBackend(f"{package} is not installed: pip install mitsuba drjit") from None


def _cpu_flags() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


def recall(key: str) -> Backend | None:
    """Return an earlier finding under the same circumstances, unless its library changed."""
    entry = _remembered().get(key)
    if not isinstance(entry, dict):
        return None
    try:
        backend = Backend(**entry["backend"])
        return backend if entry["modified_ns"] == _modified_ns(backend) else None
    except (TypeError, KeyError, OSError):
        return None


def _remembered() -> dict[str, Any]:
    try:
        entries = json.loads(cache_file().read_text())
    except (OSError, ValueError):
        return {}
    return entries if isinstance(entries, dict) else {}


def remember(key: str, backend: Backend) -> None:
    """Store a finding; a cache that cannot be written only costs the next probe."""
    path = cache_file()
    entries = _remembered() | {
        key: {"backend": asdict(backend), "modified_ns": _modified_ns(backend)}
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as part:
            part.write_text(json.dumps(entries, indent=1))
    except (OSError, InputError):
        return


def _modified_ns(backend: Backend) -> int:
    return 0 if backend.library is None else Path(backend.library).stat().st_mtime_ns
