"""A layer's transfer over a whole grid of wavenumbers, through a table in log q."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from reconstruction.arrays import FloatArray
from twin.mechanics.errors import PressError
from twin.mechanics.film import CoatFilm, LoadedBase, solve_coated
from twin.mechanics.transfer import SMALLEST_Q, Base, Transfer, solve_transfer

Column = Literal["normal_t", "normal_b", "tangential_t", "tangential_b"]
_COLUMNS: tuple[Column, ...] = ("normal_t", "normal_b", "tangential_t", "tangential_b")
# Above, both faces are half-spaces to 1e-15.
_LARGEST_Q = 45.0
_TABLE_SIZE = 2000


@dataclass(frozen=True, eq=False)
class TransferTable:
    """Phi over log q, from `lowest_q` up; beyond `highest_q` it no longer changes."""

    lowest_q: float
    highest_q: float
    splines: dict[Column, CubicSpline]

    def __call__(self, q: FloatArray, column: Column) -> FloatArray:
        """Return one column of `Transfer` on a wavenumber grid (...), q >= lowest_q."""
        inside = np.minimum(q, self.highest_q)
        found: FloatArray = self.splines[column](np.log(inside))
        found /= _bounded(inside)
        return found


def tabulate(
    lowest_q: float, poisson_ratio: float, base: LoadedBase, film: CoatFilm | None = None
) -> TransferTable:
    """Tabulate a layer's transfer from `lowest_q` to where both faces are half-spaces.

    Raises
    ------
    PressError
        The layer is too thin for its span.
    """
    if lowest_q < SMALLEST_Q:
        raise PressError(
            "elastomer.thickness_mm: the span is more than 300 times the thickness; "
            "a slab cannot be solved as a film: make it thicker or shorter"
        )
    highest_q = max(_LARGEST_Q, 2 * lowest_q)
    if film is not None and base != "free":
        highest_q /= film.share  # the loaded film is a half-space to much shorter waves only
    q = np.geomspace(lowest_q, highest_q, _TABLE_SIZE)
    solved = _solve(q, poisson_ratio, base, film)
    splines = {
        column: CubicSpline(np.log(q), getattr(solved, column) * _bounded(q)) for column in _COLUMNS
    }
    return TransferTable(lowest_q, highest_q, splines)


def normal_transfer(
    q: FloatArray, poisson_ratio: float, base: Base
) -> tuple[FloatArray, FloatArray]:
    """Return Phi of faces t and b on a whole wavenumber grid, q >= SMALLEST_Q, by a table.

    Raises
    ------
    PressError
        The layer is too thin for its span.
    """
    table = tabulate(float(q.min()), poisson_ratio, base)
    return table(q, "normal_t"), table(q, "normal_b")


def _solve(
    q: FloatArray, poisson_ratio: float, base: LoadedBase, film: CoatFilm | None
) -> Transfer:
    if film is not None:
        return solve_coated(q, poisson_ratio, base, film)
    return solve_transfer(q, poisson_ratio, "bonded" if base == "bonded" else "free")


def _bounded(q: FloatArray) -> FloatArray:
    """Long waves of the free layer grow as q^-3 (plate): times this, the spline sees none."""
    cubed = q * q * q
    bounded: FloatArray = cubed / (1 + cubed)
    return bounded
