"""Memory of earlier findings in the user's cache folder: a probe takes seconds."""

import hashlib
import importlib.metadata
import json
import os
import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from twin.optics.backend.probe import CHOICE_VARIABLE, LIBRARY_VARIABLE, Backend, MissingBackend
from twin.output import replacing


def cache_file() -> Path:
    """Tell where findings are kept.

    Returns
    -------
    Path
    """
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
