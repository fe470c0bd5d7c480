"""Solve positive definite sparse systems by PARDISO (pypardiso) or else by SciPy's SuperLU."""

import ctypes
import importlib.metadata
import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import splu

from reconstruction.arrays import FloatArray
from reconstruction.machine import environment_variable, threads, warnings_ignored

IntArray = npt.NDArray[np.int32]
_LIBRARY_VARIABLE = "PYPARDISO_MKL_RT"
_REAL_POSITIVE_DEFINITE = 2
_MKL_CBWR_AUTO = 2
_ANALYSE, _FACTORISE, _SOLVE = 11, 22, 33
_OWN_SETTINGS, _ORDERING, _NESTED_DISSECTION = 1, 2, 3
# Conditional numerical reproducibility: sums as for this number of threads, for any number of them.
_REPRODUCIBLE, _THREADS = 34, 4


class LinearSolver(Protocol):
    """Solver of symmetric linear systems that have one sparsity pattern."""

    def factorise(self, values: FloatArray) -> bool:
        """Factorise the upper triangle's values; return True if they are positive definite."""
        ...

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for the right-hand side `right` with the latest factorisation."""
        ...


@contextmanager
def _named_library() -> Iterator[None]:
    """Set the path of MKL for pypardiso, which would search all packages for it per solver."""
    given = os.environ.get(_LIBRARY_VARIABLE)
    with environment_variable(_LIBRARY_VARIABLE, given or _library()):
        yield


@cache
def _library() -> str | None:
    try:
        files = importlib.metadata.files("mkl") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    places = [str(file.locate()) for file in files if "mkl_rt" in file.name]
    return os.path.realpath(min(places, key=len)) if places else None


class Pardiso:
    """MKL's PARDISO: one symbolic factorisation for all systems of the pattern."""

    def __init__(self, start: IntArray, columns: IntArray) -> None:
        with _named_library():  # the import searches for it already
            from pypardiso import PyPardisoSolver
            from pypardiso.pardiso_wrapper import PyPardisoError

            self._refusal: type[Exception] = PyPardisoError
            self._solver: Any = PyPardisoSolver(mtype=_REAL_POSITIVE_DEFINITE)
        # Newton's next step refines more than the refinement of a solution, 2/3 of its time.
        self._solver.set_iparm(_OWN_SETTINGS, 1)
        self._solver.set_iparm(_ORDERING, _NESTED_DISSECTION)
        size = start.size - 1
        # One order of sums: the same bytes in every run, with any number of cores.
        self._solver.set_iparm(_REPRODUCIBLE, _THREADS)
        self._solver.libmkl.MKL_CBWR_Set(ctypes.c_int(_MKL_CBWR_AUTO))
        self._matrix = sparse.csr_matrix(
            (np.ones(columns.size), columns, start), shape=(size, size)
        )
        self._zero = np.zeros((size, 1))
        self._run(_ANALYSE, self._zero)
        # The library allocates the factors; at the end of the process they are freed with it.
        weakref.finalize(self, self._solver.free_memory, everything=True).atexit = False

    def factorise(self, values: FloatArray) -> bool:
        """Factorise the upper triangle's values; return True if they are positive definite."""
        self._matrix.data = values
        try:
            self._run(_FACTORISE, self._zero)
        except self._refusal:
            return False
        return True

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for the right-hand side `right` with the latest factorisation."""
        solution: FloatArray = self._run(_SOLVE, right.reshape(-1, 1)).ravel()
        return solution

    def _run(self, phase: int, right: FloatArray) -> FloatArray:
        self._solver.set_phase(phase)
        # For this thread and call: the process' own number belongs to the caller, and NumPy uses it
        set_threads = self._solver.libmkl.MKL_Set_Num_Threads_Local
        before = set_threads(ctypes.c_int(min(threads(), _THREADS)))
        try:
            solution: FloatArray = self._solver._call_pardiso(self._matrix, right)
        finally:
            set_threads(ctypes.c_int(before))
        return solution


class SuperLU:
    """SciPy's LU without pivoting, so that its diagonal has the signs of the eigenvalues."""

    def __init__(self, start: IntArray, columns: IntArray) -> None:
        size = start.size - 1
        self._upper = sparse.csr_matrix((np.ones(columns.size), columns, start), shape=(size, size))

    def factorise(self, values: FloatArray) -> bool:
        """Factorise the upper triangle's values; return True if they are positive definite."""
        self._upper.data = values
        above = sparse.triu(self._upper, 1)
        whole = (self._upper + above.T).tocsc()
        try:
            self._factors = splu(
                whole,
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError:  # exactly singular
            return False
        return bool((self._factors.U.diagonal() > 0).all())

    def solve(self, right: FloatArray) -> FloatArray:
        """Solve for the right-hand side `right` with the latest factorisation."""
        solution: FloatArray = self._factors.solve(right)
        return solution


def linear_solver(start: IntArray, columns: IntArray) -> LinearSolver:
    """Return the fastest solver that is installed, for the upper triangle of a CSR pattern."""
    return Pardiso(start, columns) if has_pardiso() else SuperLU(start, columns)


@cache
def has_pardiso() -> bool:
    """Return True if pypardiso and its library are installed."""
    try:
        with warnings_ignored(), _named_library():
            import pypardiso  # noqa: F401  # importing loads the library
    except ImportError:
        return False
    return True
