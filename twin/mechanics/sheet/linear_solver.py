"""Solve positive definite sparse systems: small by a band, others by PARDISO or own factors."""

import ctypes
import importlib.metadata
import os
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.linalg import lapack
from scipy.sparse.linalg import LinearOperator, cg

from reconstruction.arrays import FloatArray
from reconstruction.machine import (
    environment_variable,
    one_blas_thread,
    threads,
    warnings_ignored,
)
from twin.mechanics.sheet.multifrontal import Multifrontal, Values

IntArray = npt.NDArray[np.int32]
_LIBRARY_VARIABLE = "PYPARDISO_MKL_RT"
_REAL_POSITIVE_DEFINITE = 2
_MKL_CBWR_AUTO = 2
_ANALYSE, _FACTORISE, _SOLVE = 11, 22, 33
_OWN_SETTINGS, _ORDERING, _NESTED_DISSECTION, _SINGLE_PRECISION = 1, 2, 3, 28
_UNUSED = np.zeros(1)
ACCURACY = 1e-10
"""Residual of a solution over the right-hand side, unless less is requested."""
_MOST_ITERATIONS = 50
# For factors of another matrix: 8 iterations take the time of a factorisation. An inexact step of
# Newton's method with this residual leaves the number of its steps nearly the same.
_KEPT_ACCURACY, _KEPT_ITERATIONS = 0.05, 8
# Factor of all matrices. Factors decrease with the distance of two unknowns; below 1e-38 arithmetic
# in single precision is slow (3.3 s for 0.35 s with the largest viscosity), and this is farther
# away in a scaled matrix.
_SCALE = 2.0**60
# Conditional numerical reproducibility: sums as for this number of threads, for any number of them.
_REPRODUCIBLE, _THREADS = 34, 4
# Fewer unknowns are solved and evaluated by one thread: for these, several threads take longer next
# to another busy process, and 1.7 times the processor time.
_LARGE = 20_000
# Unknowns times the square of the width of the band: of 5,600 unknowns on a square grid. With less,
# the factors of the band need at most the time of PARDISO, and no symbolic factorisation.
_BANDED = 4e8


def threads_for(unknowns: int) -> int:
    """Return the number of threads for a system with this number of unknowns."""
    return threads() if unknowns >= _LARGE else 1


@dataclass(frozen=True, eq=False)
class Approximation:
    """Approximate solution of a linear system, and how far conjugate gradients have converged."""

    solution: FloatArray
    #: norm of the residual over that of the right-hand side, both in the metric of the
    #: preconditioner; infinite: the matrix is not positive definite
    residual: float

    @property
    def is_accurate(self) -> bool:
        """Whether the iteration has converged."""
        return self.residual <= _KEPT_ACCURACY


class LinearSolver(Protocol):
    """Solver of symmetric linear systems that have one sparsity pattern."""

    #: whether a factorisation takes so long that factors are used for further matrices
    keeps_factors: bool

    def factorise(self, values: FloatArray) -> bool:
        """Factorise the upper triangle's values; return True if they are positive definite."""
        ...

    def solve(self, right: FloatArray, accuracy: float = ACCURACY) -> FloatArray:
        """Solve for the right-hand side `right` with the latest factorisation.

        The residual is at most `accuracy` of the right-hand side, both as Euclidean norms. It may
        be larger for a matrix so ill-conditioned that 50 iterations do not reach it.
        """
        ...

    def approximate(self, values: FloatArray, right: FloatArray) -> Approximation:
        """Solve for other `values` of the upper triangle, without their factorisation.

        The latest factors are the preconditioner of at most 8 iterations of conjugate gradients.
        """
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


class _Refined:
    """Factors of large systems in single precision, with refinement in double precision.

    Single precision takes 60 % of the time of double precision. A solution by such factors has a
    relative error of 1e-5 and more; conjugate gradients in double precision, with these factors as
    preconditioner, reduce it to that of double factors.
    """

    keeps_factors = True

    def __init__(self, start: IntArray, columns: IntArray) -> None:
        size = start.size - 1
        self._single = size >= _LARGE
        self._dtype = np.float32 if self._single else np.float64
        self._upper = sparse.csr_matrix((np.ones(columns.size), columns, start), shape=(size, size))

    def factorise(self, values: FloatArray) -> bool:
        """Factorise the upper triangle's values; return True if they are positive definite."""
        self._upper.data = values
        scaled = np.zeros(values.size, self._dtype)
        return self._factorise(np.multiply(values, _SCALE, out=scaled, casting="same_kind"))

    def solve(self, right: FloatArray, accuracy: float = ACCURACY) -> FloatArray:
        """Solve for the right-hand side `right` with the latest factorisation."""
        if not self._single or not right.any():
            return self._by_factors(right)
        size = right.size
        matrix = LinearOperator((size, size), self._times, dtype=np.float64)
        factors = LinearOperator((size, size), self._by_factors, dtype=np.float64)
        with one_blas_thread():  # sums by several threads have other last digits
            solution, _ = cg(matrix, right, rtol=accuracy, maxiter=_MOST_ITERATIONS, M=factors)
        return np.asarray(solution)

    def approximate(self, values: FloatArray, right: FloatArray) -> Approximation:
        """Solve for other `values` of the upper triangle, without their factorisation."""
        upper = sparse.csr_matrix(
            (values, self._upper.indices, self._upper.indptr), shape=self._upper.shape
        )
        with one_blas_thread():
            return _conjugate_gradients(partial(_product, upper), self._by_factors, right)

    def _by_factors(self, right: FloatArray) -> FloatArray:
        """Return the solution by the factors in their precision."""
        # In single precision small residuals would be 0.
        scale = float(np.abs(right).max()) or 1.0
        scaled = (right * (_SCALE / scale)).astype(self._dtype)
        return np.asarray(scale * self._solve(scaled).astype(np.float64))

    def _times(self, vector: FloatArray) -> FloatArray:
        """Return the product of the symmetric matrix with a vector."""
        return _product(self._upper, vector)

    def _factorise(self, values: Values) -> bool:
        """Factorise scaled values in the precision of the factors."""
        raise NotImplementedError

    def _solve(self, right: Values) -> Values:
        """Return the solution for a right-hand side in the precision of the factors."""
        raise NotImplementedError


def _product(upper: sparse.csr_matrix, vector: FloatArray) -> FloatArray:
    """Return the product of a symmetric matrix, given by its upper triangle, with a vector."""
    # The diagonal is the first element of each row.
    diagonal = upper.data[upper.indptr[:-1]]
    return np.asarray(upper @ vector + upper.T @ vector - diagonal * vector)


def _conjugate_gradients(
    times: Callable[[FloatArray], FloatArray],
    precondition: Callable[[FloatArray], FloatArray],
    right: FloatArray,
) -> Approximation:
    """Solve as `LinearSolver.approximate`.

    SciPy's `cg` does not detect a matrix that is not positive definite.
    """
    solution, residual = np.zeros_like(right), right.copy()
    ahead = precondition(residual)
    direction, first = ahead, float(residual @ ahead)
    norm, left = first, 1.0
    for _ in range(_KEPT_ITERATIONS):
        product = times(direction)
        curvature = float(direction @ product)
        if curvature <= 0:
            return Approximation(solution, np.inf)
        solution += norm / curvature * direction
        residual -= norm / curvature * product
        ahead = precondition(residual)
        before, norm = norm, float(residual @ ahead)
        left = float(np.sqrt(norm / first))
        if left <= _KEPT_ACCURACY:
            break
        direction = ahead + norm / before * direction
    return Approximation(solution, left)


class Pardiso(_Refined):
    """PARDISO of MKL: one symbolic factorisation for all systems of the pattern."""

    def __init__(self, start: IntArray, columns: IntArray) -> None:
        super().__init__(start, columns)
        with _named_library():  # the import searches for it already
            from pypardiso import PyPardisoSolver

            self._solver: Any = PyPardisoSolver(mtype=_REAL_POSITIVE_DEFINITE)
        self._solver.set_iparm(_OWN_SETTINGS, 1)
        self._solver.set_iparm(_ORDERING, _NESTED_DISSECTION)
        self._solver.set_iparm(_SINGLE_PRECISION, int(self._single))
        # One order of sums: the same bytes in every run, with any number of cores.
        self._solver.set_iparm(_REPRODUCIBLE, _THREADS)
        self._solver.libmkl.MKL_CBWR_Set(ctypes.c_int(_MKL_CBWR_AUTO))
        self._threads = min(threads_for(start.size - 1), _THREADS)
        self._values: Values = np.ones(columns.size, self._dtype)
        # PARDISO counts rows and columns from 1.
        self._pattern = (start + 1).astype(np.int32), (columns + 1).astype(np.int32)
        if self._run(_ANALYSE):
            raise MemoryError("PARDISO: no memory for the symbolic factorisation")
        # The library allocates the factors; at the end of the process they are freed with it.
        weakref.finalize(self, self._solver.free_memory, everything=True).atexit = False

    def _factorise(self, values: Values) -> bool:
        self._values = values
        return self._run(_FACTORISE) == 0

    def _solve(self, right: Values) -> Values:
        solution = np.zeros_like(right)
        self._run(_SOLVE, right, solution)
        return solution

    def _run(
        self,
        phase: int,
        right: Values = _UNUSED,
        solution: Values = _UNUSED,
    ) -> int:
        """Run a phase of PARDISO; return its error code, 0 without an error."""
        solver, (start, columns) = self._solver, self._pattern
        one, size, error = ctypes.c_int32(1), ctypes.c_int32(start.size - 1), ctypes.c_int32(0)
        integers, numbers = ctypes.POINTER(ctypes.c_int32), ctypes.c_void_p
        # For this thread and call: the process' own number belongs to the caller, and NumPy uses it
        set_threads = solver.libmkl.MKL_Set_Num_Threads_Local
        before = set_threads(ctypes.c_int(self._threads))
        try:
            solver.libmkl.pardiso(
                solver.pt.ctypes.data_as(solver.libmkl.pardiso.argtypes[0]),
                one, one, ctypes.c_int32(solver.mtype), ctypes.c_int32(phase), size,
                self._values.ctypes.data_as(numbers),
                start.ctypes.data_as(integers), columns.ctypes.data_as(integers),
                solver.perm.ctypes.data_as(integers), one, solver.iparm.ctypes.data_as(integers),
                ctypes.c_int32(0),
                right.ctypes.data_as(numbers), solution.ctypes.data_as(numbers), error,
            )  # fmt: skip
        finally:
            set_threads(ctypes.c_int(before))
        return error.value


class NestedDissection(_Refined):
    """Multifrontal factors by SciPy's BLAS and LAPACK, for machines without PARDISO."""

    def __init__(self, start: IntArray, columns: IntArray) -> None:
        super().__init__(start, columns)
        self._factors = Multifrontal(start, columns, self._dtype)

    def _factorise(self, values: Values) -> bool:
        return self._factors.factorise(values)

    def _solve(self, right: Values) -> Values:
        return self._factors.solve(right)


class Banded:
    """LAPACK's factors of a banded matrix: for small systems they need the least time."""

    keeps_factors = False

    def __init__(self, start: IntArray, columns: IntArray) -> None:
        self._size = start.size - 1
        self._width = band_width(start, columns) + 1
        row = np.repeat(np.arange(self._size), np.diff(start))
        self._targets = row * self._width + columns - row
        self._factors = np.zeros((self._width, self._size), order="F")

    def factorise(self, values: FloatArray) -> bool:
        """Factorise the upper triangle's values; return True if they are positive definite."""
        band = np.zeros((self._size, self._width))
        band.ravel()[self._targets] = values  # column by column, as LAPACK stores it
        with one_blas_thread():
            self._factors, failed = lapack.dpbtrf(band.T, lower=1, overwrite_ab=1)
        return not failed

    def solve(self, right: FloatArray, accuracy: float = ACCURACY) -> FloatArray:
        """Solve for the right-hand side `right` with the latest factorisation."""
        with one_blas_thread():
            solution, _ = lapack.dpbtrs(self._factors, right, lower=1)
        return np.asarray(solution)

    def approximate(self, values: FloatArray, right: FloatArray) -> Approximation:
        """Solve for other `values` of the upper triangle, by factors: they take less time."""
        if not self.factorise(values):
            return Approximation(np.zeros_like(right), np.inf)
        return Approximation(self.solve(right), 0.0)


def band_width(start: IntArray, columns: IntArray) -> int:
    """Return the largest distance of an element from the diagonal."""
    return int((columns[start[1:] - 1] - np.arange(start.size - 1)).max())


def linear_solver(start: IntArray, columns: IntArray) -> LinearSolver:
    """Return the fastest solver that is installed, for the upper triangle of a CSR pattern.

    The columns of each row are sorted, and begin with the diagonal.
    """
    if (start.size - 1) * band_width(start, columns) ** 2 < _BANDED:
        return Banded(start, columns)
    return Pardiso(start, columns) if has_pardiso() else NestedDissection(start, columns)


@cache
def has_pardiso() -> bool:
    """Return True if pypardiso and its library are installed."""
    try:
        with warnings_ignored(), _named_library():
            import pypardiso  # noqa: F401  # importing loads the library
    except ImportError:
        return False
    return True
