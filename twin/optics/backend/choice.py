"""Choose the backend of this machine, once per process."""

import functools
import os

from twin.optics.backend.candidates import has_cuda_driver, llvm_candidates
from twin.optics.backend.memory import circumstances, recall, remember
from twin.optics.backend.model import (
    ADVICE,
    CHOICE_VARIABLE,
    CUDA_VARIANT,
    LIBRARY_VARIABLE,
    LLVM_VARIANT,
    Backend,
    MissingBackend,
)
from twin.optics.backend.probe import probe


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
