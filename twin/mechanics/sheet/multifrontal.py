"""Cholesky factors of sparse positive definite matrices by dense factors of fronts.

Fronts are eliminated in the order of a nested dissection. Each is a small dense matrix: BLAS and
LAPACK need 15 % of the time of SuperLU, which works on few columns at a time.

Duff, I. S., Reid, J. K. (1983): The multifrontal solution of indefinite sparse symmetric linear
equations. ACM Trans. Math. Software 9, 302-325.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import get_blas_funcs, get_lapack_funcs

from reconstruction.compiling import OPTIONS, compile_and_keep, digest_of_sources
from reconstruction.machine import one_blas_thread
from twin.mechanics.sheet.dissection import Front, dissected

_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, ("multifrontal.py",))
Values = npt.NDArray[Any]


class Multifrontal:
    """Factors of all matrices of one pattern, in single or double precision.

    Parameters
    ----------
    start, columns : CSR pattern of the upper triangle, columns sorted
    dtype : np.float32 or np.float64
    """

    def __init__(
        self, start: npt.NDArray[np.int32], columns: npt.NDArray[np.int32], dtype: Any
    ) -> None:
        elimination = dissected(start, columns)
        self._rank, self._fronts = elimination.rank, elimination.fronts
        self._dtype = np.dtype(dtype)
        self._taken, self._targets, self._parts = _scatter(start, columns, self._rank, self._fronts)
        self._places = [_places(self._fronts, number) for number in range(len(self._fronts))]
        self._factors: list[tuple[Front, Values, Values]] = []

    def factorise(self, values: Values) -> bool:
        """Factorise the upper triangle's values; return True if they are positive definite."""
        values = values.astype(self._dtype, copy=False)[self._taken]
        with one_blas_thread():
            return self._eliminate(values)

    def _eliminate(self, values: Values) -> bool:
        (factor,) = get_lapack_funcs(("potrf",), dtype=self._dtype)
        divide, update = get_blas_funcs(("trsm", "syrk"), dtype=self._dtype)
        self._factors = []
        remainders: dict[int, Values] = {}
        for number, front in enumerate(self._fronts):
            own, border = front.end - front.first, front.border.size
            both = np.zeros(own * (own + border), self._dtype)
            part = self._parts[number]
            both[self._targets[part]] = values[part]
            square = both[: own * own].reshape(own, own, order="F")
            below = both[own * own :].reshape(border, own, order="F")
            rest = np.zeros((border, border), self._dtype, order="F")
            for child, places in zip(front.children, self._places[number], strict=True):
                _add_remainder(remainders.pop(child), places, own, square, below, rest)
            if own:  # else it only joins parts that are not coupled
                square, failed = factor(square, lower=1, clean=0, overwrite_a=1)
                if failed:
                    return False
            if own and border:
                below = divide(1.0, square, below, side=1, lower=1, trans_a=1, overwrite_b=1)
                rest = update(-1.0, below, beta=1.0, c=rest, lower=1, overwrite_c=1)
            remainders[number] = rest
            if own:
                self._factors.append((front, square, below))
        return True

    def solve(self, right: Values) -> Values:
        """Return the solution for a right-hand side in the precision of the factors."""
        (divide,) = get_blas_funcs(("trsv",), dtype=self._dtype)
        x = np.zeros(right.size, self._dtype)
        x[self._rank] = right
        with one_blas_thread():
            for front, square, below in self._factors:
                own = slice(front.first, front.end)
                x[own] = divide(square, x[own], lower=1)
                x[front.border] -= below @ x[own]
            for front, square, below in reversed(self._factors):
                own = slice(front.first, front.end)
                x[own] -= x[front.border] @ below
                x[own] = divide(square, x[own], lower=1, trans=1)
        return x[self._rank]


def _scatter(
    start: npt.NDArray[np.int32],
    columns: npt.NDArray[np.int32],
    rank: npt.NDArray[np.int64],
    fronts: tuple[Front, ...],
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], list[slice]]:
    """Return the elements in the order of the fronts, their targets, and the part of each front.

    A target is an index into the columns of the front's own unknowns: first the square of their
    rows, then the rows of the border.
    """
    row = rank[np.repeat(np.arange(start.size - 1), np.diff(start))]
    low, high = np.minimum(row, rank[columns]), np.maximum(row, rank[columns])
    ends = np.array([front.end for front in fronts])
    number = np.searchsorted(ends, np.arange(rank.size), side="right")[low]
    taken = np.argsort(number.astype(np.uint16 if ends.size < 2**16 else np.int64), kind="stable")
    bounds = np.concatenate(([0], np.cumsum(np.bincount(number, minlength=ends.size))))
    parts = [slice(*pair) for pair in pairwise(bounds)]
    targets = np.zeros(columns.size, np.int64)
    low, high = low[taken], high[taken]
    for front, part in zip(fronts, parts, strict=True):
        own, border = front.end - front.first, front.border.size
        col, place = low[part] - front.first, high[part]
        inside = place < front.end
        below = own * own + col * border + np.searchsorted(front.border, place)
        targets[part] = np.where(inside, col * own + place - front.first, below)
    return taken, targets, parts


def _places(fronts: tuple[Front, ...], number: int) -> list[npt.NDArray[np.int64]]:
    """Return, for each child of a front, the places of the child's border in the front."""
    front = fronts[number]
    own = front.end - front.first
    places = []
    for child in front.children:
        border = fronts[child].border
        place = own + np.searchsorted(front.border, border)
        places.append(np.where(border < front.end, border - front.first, place))
    return places


def _add_remainder_to(  # noqa: PLR0917 - compiled functions cannot take keyword-only arguments
    remainder: Values,
    places: npt.NDArray[np.int64],
    own: int,
    square: Values,
    below: Values,
    rest: Values,
) -> None:
    """Add the lower triangle of a child's remainder at ascending places of a front."""
    size = places.size
    for j in range(size):
        col = places[j]
        for i in range(j, size):
            row = places[i]
            if row < own:
                square[row, col] += remainder[i, j]
            elif col < own:
                below[row - own, col] += remainder[i, j]
            else:
                rest[row - own, col - own] += remainder[i, j]


_add_remainder = compile_and_keep(_add_remainder_to, OPTIONS, _SOURCE_DIGEST)
