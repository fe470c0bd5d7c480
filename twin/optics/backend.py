"""Choice of the Dr.Jit backend, made in one place and proved in a child process.

Dr.Jit takes the first libLLVM it finds. LLVM older than 17 either does not load or aborts the whole
process at the first maximum of two floats ("Cannot select: fmaximum"), and Debian 12 and Ubuntu
22.04 install LLVM 14 or 15 by default. So each candidate library first has to compile and run the
kinds of kernel the twin needs, in a child process with an empty kernel cache; the first that gives
the right numbers is used. The finding is kept in the user's cache folder.

``TWIN_BACKEND`` (``llvm`` or ``cuda``) restricts the choice, ``DRJIT_LIBLLVM_PATH`` names the
library.
"""

from __future__ import annotations

import argparse
import ctypes
import functools
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
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

LLVM_VARIANT = "llvm_ad_mono"
CUDA_VARIANT = "cuda_ad_mono"
LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
CHOICE_VARIABLE = "TWIN_BACKEND"
ADVICE = "install LLVM 17 or newer (Debian, Ubuntu: apt-get install libllvm19)"

_MISSING_EXIT = 3
_PROBE_TIMEOUT_S = 180.0  # the first OptiX start on a cold machine takes about a minute
_LIBRARY_NAME = re.compile(r"^libLLVM(?:-(?P<dash>\d[\d.]*))?\.so(?:\.(?P<suffix>\d[\d.]*))?$")
_VERSION_LINE = re.compile(r"^backend version (\S+)$", re.MULTILINE)  # among Mitsuba's own output
_LIBRARY_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/llvm*/lib",
)


class MissingBackend(RuntimeError):  # noqa: N818  # it names what is missing
    """No Dr.Jit backend works here; the message says in one line what to install."""


@dataclass(frozen=True)
class Backend:
    """A Dr.Jit backend that ran the probe.

    Parameters
    ----------
    variant : str
        Mitsuba variant.
    library : str or None
        Path of libLLVM; None for CUDA.
    version : str
        Version of LLVM or of the CUDA driver interface.
    """

    variant: str
    library: str | None
    version: str

    def __str__(self) -> str:
        if self.library is None:
            return f"{self.variant}, CUDA {self.version}"
        return f"{self.variant}, LLVM {self.version}, {self.library}"


@dataclass(frozen=True)
class _Refusal:
    """Why a candidate is not used."""

    reason: str


def activate() -> Backend:
    """Make the backend of this machine the current one; any number of calls.

    Returns
    -------
    Backend

    Raises
    ------
    MissingBackend
        If no backend works here.
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
    fresh : bool
        Probe again even if an earlier finding is in the cache.

    Returns
    -------
    Backend

    Raises
    ------
    MissingBackend
        If no backend works here.
    """
    key = _circumstances()
    known = None if fresh else _recall(key)
    if known is not None:
        return known
    backend = _search()
    _remember(key, backend)
    return backend


def _search() -> Backend:
    choice = os.environ.get(CHOICE_VARIABLE, "")
    if choice not in ("", "llvm", "cuda"):
        raise MissingBackend(
            f"{CHOICE_VARIABLE}={choice} is unknown: use llvm or cuda, or unset it"
        )
    if choice != "llvm" and (choice == "cuda" or _has_cuda_driver()):
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


# ---- candidates --------------------------------------------------------------------------------


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


def _has_cuda_driver() -> bool:
    try:
        ctypes.CDLL(os.environ.get("DRJIT_LIBCUDA_PATH", "libcuda.so.1"))
    except OSError:
        return False
    return True


# ---- probe -------------------------------------------------------------------------------------


def probe(
    variant: str, library: str | None = None, timeout_s: float = _PROBE_TIMEOUT_S
) -> Backend | _Refusal:
    """Let a child process compile and run kernels with one candidate.

    Parameters
    ----------
    variant : str
        Mitsuba variant.
    library : str or None
        Path of libLLVM; None for CUDA.
    timeout_s : float
        Patience with the child.

    Returns
    -------
    Backend or _Refusal
        The proved backend, or the reason why it is not used.

    Raises
    ------
    MissingBackend
        If Mitsuba does not even load.
    """
    with tempfile.TemporaryDirectory(prefix="fringe-twin-probe-") as folder:
        try:
            child = subprocess.run(
                [sys.executable, "-P", "-m", "twin.optics.backend", "--probe", variant],
                env=_probe_environment(folder, library),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return _Refusal(f"no answer within {timeout_s:g} s")
    if child.returncode != 0:
        _check_system_libraries(child.stderr)
        return _Refusal(_reason(child))
    version = _VERSION_LINE.search(child.stdout)
    if version is None:
        return _Refusal("the probe ended without an answer")
    return Backend(variant, library, version[1])


def _probe_environment(folder: str, library: str | None) -> dict[str, str]:
    root = str(Path(__file__).parents[2])
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH")))),
        # A kernel cached by another LLVM would pass without being compiled.
        "DRJIT_CACHE_DIR": folder,
        "LC_ALL": "C",  # the refusals are recognised by their English words
    }
    if library is not None:
        environment[LIBRARY_VARIABLE] = library
    return environment


def _check_system_libraries(stderr: str) -> None:
    """Raise if Mitsuba itself does not load: no other candidate will do better."""
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
    told = next((line for line in lines if "LLVM ERROR" in line), lines[-1] if lines else "")
    told = re.sub(r"Cannot select: \S+ [^=]*= (\w+).*", r"Cannot select \1", told)[:120]
    if child.returncode > 0:
        return told or f"exit status {child.returncode}"
    return f"{signal.Signals(-child.returncode).name} {told}".strip()


def _run_probe(variant: str) -> int:
    """Compile and run the twin's kinds of kernel; in the child process only."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    import drjit as dr
    import mitsuba as mi

    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    _check_arithmetic(dr, mi)
    _check_rendering(dr, mi)
    sys.stdout.write(f"\nbackend version {_version(variant, dr)}\n")
    return 0


def _check_arithmetic(dr: Any, mi: Any) -> None:
    index = dr.arange(mi.UInt32, 64)
    table = dr.arange(mi.Float, 64)
    dr.make_opaque(index, table)
    picked = dr.minimum(dr.maximum(dr.gather(mi.Float, table, 63 - index), 10), 20)
    precise = dr.maximum(mi.Float64(picked), 12) + dr.abs(dr.minimum(mi.Float64(picked), 11))
    sums = dr.zeros(mi.Float, 2)
    dr.scatter_add(sums, picked, index & 1)
    wave = dr.square(dr.sin(table)) + dr.square(dr.cos(table))
    dr.eval(picked, precise, sums, wave)
    expected = [float(min(max(number, 10), 20)) for number in range(64)]
    good = (
        sum(picked.numpy()) == sum(expected)
        and sum(precise.numpy()) == sum(max(x, 12) + min(x, 11) for x in expected)
        and sum(sums.numpy()) == sum(expected)
        and max(abs(wave.numpy() - 1)) < 1e-5
    )
    if not good:
        raise ArithmeticError("a kernel gave wrong numbers")


def _check_rendering(dr: Any, mi: Any) -> None:
    coat = {"type": "roughconductor", "alpha": 0.3}
    scene = mi.load_dict(
        {
            "type": "scene",
            "ball": {
                "type": "sphere",
                "bsdf": {"type": "blendbsdf", "weight": 0.3, "a": {"type": "diffuse"}, "b": coat},
            },
            "floor": {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, -3, 0])},
            "lamp": {"type": "point", "position": [2.0, 3.0, 5.0], "intensity": 10.0},
            "sensor": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8},
            },
            "integrator": {"type": "direct"},
        }
    )
    column = dr.arange(mi.Float, 16) / 4 - 2
    ray = mi.Ray3f(mi.Point3f(column, 0, 5), mi.Vector3f(0, 0, -1))
    hit = scene.ray_intersect(ray)
    depth = dr.select(hit.is_valid(), hit.t, 0)
    brightness = dr.sum(mi.render(scene, spp=4).array)
    # The ball of radius 1 is met at 5 - sqrt(1 - x^2).
    good = abs(depth.numpy()[8] - 4) < 1e-5 and depth.numpy()[0] == 0 and brightness.numpy() > 0
    if not good:
        raise ArithmeticError("a render gave wrong numbers")


def _version(variant: str, dr: Any) -> str:
    if variant == LLVM_VARIANT:
        return ".".join(str(part) for part in dr.detail.llvm_version())
    number = ctypes.c_int(0)
    ctypes.CDLL(os.environ.get("DRJIT_LIBCUDA_PATH", "libcuda.so.1")).cuDriverGetVersion(
        ctypes.byref(number)
    )
    return f"{number.value // 1000}.{number.value % 1000 // 10}"


# ---- memory of earlier findings ----------------------------------------------------------------


def cache_file() -> Path:
    """Tell where findings are kept.

    Returns
    -------
    Path
    """
    base = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(base) / "fringe-twin" / "backend.json"


def _circumstances() -> str:
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


def _recall(key: str) -> Backend | None:
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


def _remember(key: str, backend: Backend) -> None:
    """Store a finding; a cache that cannot be written only costs the next probe."""
    path = cache_file()
    entries = _remembered() | {
        key: {"backend": asdict(backend), "modified_ns": _modified_ns(backend)}
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as file:
            json.dump(entries, file, indent=1)
        Path(file.name).replace(path)
    except OSError:
        return


def _modified_ns(backend: Backend) -> int:
    return 0 if backend.library is None else Path(backend.library).stat().st_mtime_ns


def main() -> int:
    """Print the backend of this machine, or why there is none.

    Returns
    -------
    int
        Exit status: 0, or 3 without a backend.
    """
    parser = argparse.ArgumentParser(prog="python -m twin.optics.backend", description=main.__doc__)
    parser.add_argument("--fresh", action="store_true", help="probe again")
    parser.add_argument("--probe", metavar="VARIANT", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.probe:
        return _run_probe(arguments.probe)
    try:
        sys.stdout.write(f"{find_backend(fresh=arguments.fresh)}\n")
    except MissingBackend as error:
        sys.stderr.write(f"{error}\n")
        return _MISSING_EXIT
    return 0


if __name__ == "__main__":
    sys.exit(main())
