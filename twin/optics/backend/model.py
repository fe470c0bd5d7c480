"""A Dr.Jit backend, and why there may be none."""

from dataclasses import dataclass

LLVM_VARIANT = "llvm_ad_mono"
CUDA_VARIANT = "cuda_ad_mono"
LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
CHOICE_VARIABLE = "TWIN_BACKEND"
ADVICE = "install LLVM 17 or newer (Debian, Ubuntu: apt-get install libllvm19)"


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
class Refusal:
    """Why a candidate is not used."""

    reason: str
