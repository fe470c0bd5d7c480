"""Choice of the Dr.Jit backend, tested in a child process.

Dr.Jit loads the first libLLVM on its search path. LLVM older than 17 either does not load or aborts
the process at the first maximum of two floats ("Cannot select: fmaximum"); Debian 12 and Ubuntu
22.04 install LLVM 14 or 15 by default. Therefore each candidate library compiles and runs small
kernels like those of the renderer, in a child process with an empty kernel cache. The first library
with correct results is used, and its path is stored in the user's cache folder.

``TWIN_BACKEND`` (``llvm`` or ``cuda``) restricts the choice, ``DRJIT_LIBLLVM_PATH`` names the
library.

`python -m twin.optics.backend [--fresh]` prints the backend; `--fresh` tests the candidates again.
"""

import argparse
import ctypes
import hashlib
import importlib.metadata
import json
import os
import platform
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from reconstruction.errors import InputError
from reconstruction.reading import is_regular, read_json
from reconstruction.writing import write_text
from twin.extras import pip_install

LLVM_VARIANT = "llvm_ad_mono"
CUDA_VARIANT = "cuda_ad_mono"
LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
CHOICE_VARIABLE = "TWIN_BACKEND"
ADVICE = "install LLVM 17 or newer (Debian, Ubuntu: apt-get install libllvm19)"
_PROBE_TIMEOUT_S = 180.0  # the first OptiX start on a cold machine takes about a minute
_VERSION_LINE = re.compile(r"^backend version (\S+)$", re.MULTILINE)  # among Mitsuba's output


class MissingBackend(RuntimeError):  # noqa: N818  # named after the missing part
    """No Dr.Jit backend works on this machine; the message names the package to install."""


@dataclass(frozen=True)
class Backend:
    """A Dr.Jit backend that passed the test of `probe`.

    Parameters
    ----------
    variant : name of the Mitsuba variant
    library : path of libLLVM; None for CUDA
    version : version of LLVM or of the CUDA driver interface
    """

    variant: str
    library: str | None
    version: str

    def __str__(self) -> str:
        if self.library is None:
            return f"{self.variant}, CUDA {self.version}"
        return f"{self.variant}, LLVM {self.version}, {self.library}"


@dataclass(frozen=True)
class Rejection:
    """Reason why a backend candidate failed the test of `probe`."""

    reason: str


def probe(
    variant: str, library: str | None = None, timeout_s: float = _PROBE_TIMEOUT_S
) -> Backend | Rejection:
    """Test one backend candidate: compile and run small kernels in a child process.

    Parameters
    ----------
    variant : name of the Mitsuba variant
    library : path of libLLVM; None for CUDA
    timeout_s : time limit of the child process, s

    Returns
    -------
    The tested backend, or the reason for its rejection

    Raises
    ------
    MissingBackend : Mitsuba does not load
    """
    with tempfile.TemporaryDirectory(prefix="fringe-twin-probe-") as folder:
        try:
            child = subprocess.run(
                [sys.executable, "-P", "-m", "twin.optics.backend_kernels", variant],
                env=_probe_environment(folder, library),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Rejection(f"no answer within {timeout_s:g} s")
    if child.returncode != 0:
        _check_system_libraries(child.stderr)
        return Rejection(_reason(child))
    version = _VERSION_LINE.search(child.stdout)
    if version is None:
        return Rejection("the probe ended without an answer")
    return Backend(variant, library, version[1])


def _probe_environment(folder: str, library: str | None) -> dict[str, str]:
    root = str(Path(__file__).parents[2])
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH")))),
        # A kernel cached by another LLVM would pass without being compiled.
        "DRJIT_CACHE_DIR": folder,
        "LC_ALL": "C",  # error messages are matched in English
    }
    if library is not None:
        environment[LIBRARY_VARIABLE] = library
    return environment


def _check_system_libraries(stderr: str) -> None:
    """Raise MissingBackend if a system library of Mitsuba is missing: all candidates would fail."""
    absent = re.search(r"ImportError: (lib\S+\.so\S*): cannot open shared object file", stderr)
    if absent:
        raise MissingBackend(
            f"Mitsuba does not load, {absent[1]} is missing: install the package that has it "
            "(Debian, Ubuntu: apt-get install libatomic1)"
        )


def _reason(child: subprocess.CompletedProcess[str]) -> str:
    if "backend is inactive" in child.stderr or "hasn't been initialized" in child.stderr:
        return "Dr.Jit cannot start it"
    lines = [line.strip() for line in child.stderr.splitlines() if line.strip()]
    message = next((line for line in lines if "LLVM ERROR" in line), lines[-1] if lines else "")
    message = re.sub(r"Cannot select: \S+ [^=]*= (\w+).*", r"Cannot select \1", message)[:120]
    if child.returncode > 0:
        return message or f"exit status {child.returncode}"
    return f"{signal.Signals(-child.returncode).name} {message}".strip()


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
    """Return the paths of all LLVM libraries of this machine, newest version first."""
    files = {path.resolve() for path in _library_paths() if _LIBRARY_NAME.match(path.name)}
    return sorted((path for path in files if path.is_file()), key=_version_key, reverse=True)


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
    """Return True if the CUDA driver library loads."""
    try:
        ctypes.CDLL(os.environ.get("DRJIT_LIBCUDA_PATH", "libcuda.so.1"))
    except OSError:
        return False
    return True


def find_backend(*, fresh: bool = False) -> Backend:
    """Return a working backend: CUDA if it works, else the newest LLVM library that works.

    Parameters
    ----------
    fresh : test the candidates again, even if the cache has an earlier result

    Raises
    ------
    MissingBackend : no backend works on this machine
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
    rejected = []
    for library in llvm_candidates():
        outcome = probe(LLVM_VARIANT, str(library))
        if isinstance(outcome, Backend):
            return outcome
        rejected.append(f"{library.name}: {outcome.reason}")
    tried = "; ".join(rejected) or "no libLLVM found"
    raise MissingBackend(f"no usable renderer backend ({tried}): {ADVICE}")


def cache_file() -> Path:
    """Return the path of the JSON file that caches the backends found by `find_backend`."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(base) / "fringe-twin" / "backend.json"


def circumstances() -> str:
    """Return a digest of everything that a `probe` depends on, except the content of libLLVM."""
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
        command = pip_install("mitsuba", "drjit")
        raise MissingBackend(f"{package} is not installed: {command}") from None


def _cpu_flags() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


def recall(key: str) -> Backend | None:
    """Return the cached backend for a digest of `circumstances`.

    Returns None if the cache has no backend for this digest, or if its library has changed.
    """
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
        return read_json(cache_file())
    except InputError:
        return {}


def remember(key: str, backend: Backend) -> None:
    """Store a backend in the cache under a digest of `circumstances`.

    A cache that cannot be written is ignored; the next process then tests the candidates again.
    """
    path = cache_file()
    entries = _remembered() | {
        key: {"backend": asdict(backend), "modified_ns": _modified_ns(backend)}
    }
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        if not is_regular(path):  # a write to a pipe would block
            path.unlink(missing_ok=True)
        write_text(path, json.dumps(entries, indent=1))


def _modified_ns(backend: Backend) -> int:
    return 0 if backend.library is None else Path(backend.library).stat().st_mtime_ns


_MISSING_EXIT = 3


def main() -> int:
    """Print the backend of this machine, or the reason why none works.

    Returns
    -------
    Exit status: 0, or 3 without a backend
    """
    parser = argparse.ArgumentParser(prog="python -m twin.optics.backend", description=main.__doc__)
    parser.add_argument("--fresh", action="store_true", help="probe again")
    arguments = parser.parse_args()
    try:
        sys.stdout.write(f"{find_backend(fresh=arguments.fresh)}\n")
    except MissingBackend as error:
        sys.stderr.write(f"{error}\n")
        return _MISSING_EXIT
    return 0


if __name__ == "__main__":
    sys.exit(main())
