"""A Dr.Jit backend, proved in a child process: a bad one aborts the child, not us."""

import os
import re
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

LLVM_VARIANT = "llvm_ad_mono"
CUDA_VARIANT = "cuda_ad_mono"
LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
CHOICE_VARIABLE = "TWIN_BACKEND"
ADVICE = "install LLVM 17 or newer (Debian, Ubuntu: apt-get install libllvm19)"
_PROBE_TIMEOUT_S = 180.0  # the first OptiX start on a cold machine takes about a minute
_VERSION_LINE = re.compile(r"^backend version (\S+)$", re.MULTILINE)  # among Mitsuba's own output


class MissingBackend(RuntimeError):  # noqa: N818  # it names what is missing
    """No Dr.Jit backend works here; the message says in one line what to install."""


@dataclass(frozen=True)
class Backend:
    """A Dr.Jit backend that ran the probe.

    Parameters
    ----------
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
class Refusal:
    """Why a candidate is not used."""

    reason: str


def probe(
    variant: str, library: str | None = None, timeout_s: float = _PROBE_TIMEOUT_S
) -> Backend | Refusal:
    """Let a child process compile and run kernels with one candidate.

    Parameters
    ----------
    library : path of libLLVM; None for CUDA

    Returns
    -------
    The proved backend, or the reason why it is not used

    Raises
    ------
    MissingBackend : if Mitsuba does not even load
    """
    with tempfile.TemporaryDirectory(prefix="fringe-twin-probe-") as folder:
        try:
            child = subprocess.run(
                [sys.executable, "-P", "-m", "twin.optics.backend.kernels", variant],
                env=_probe_environment(folder, library),
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Refusal(f"no answer within {timeout_s:g} s")
    if child.returncode != 0:
        _check_system_libraries(child.stderr)
        return Refusal(_reason(child))
    version = _VERSION_LINE.search(child.stdout)
    if version is None:
        return Refusal("the probe ended without an answer")
    return Backend(variant, library, version[1])


def _probe_environment(folder: str, library: str | None) -> dict[str, str]:
    root = str(Path(__file__).parents[3])
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
