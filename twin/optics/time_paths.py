"""Projector coordinate and weight of camera rays as polynomials of time.

The rays are traced at the moments, the extremes of a Chebyshev polynomial over the sequence:
3, 5 or 9, of which each set contains the one before. The polynomial through the moments is a sum of
Chebyshev polynomials; the coefficient of the highest one bounds the error, because the
coefficients of a smooth function decrease. Of a ray that crosses an edge they do not decrease.
Times are relative: -1 at the start of the sequence, 1 at its end.
"""

import functools
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, FloatImage
from twin.optics.connection import Connection, FrameLight
from twin.optics.exposures import ExposureNodes

Values = TypeVar("Values", bound=Any)

MOMENTS = (3, 5, 9)
"""Numbers of moments, from which the renderer chooses."""

COORDINATE_PX = 0.05
"""Largest last coefficient of a projector coordinate, px; that of a further moment is smaller.

With limits of 0.01 to 0.1 px the errors of moving balls and planes are the same (`bench motion`).
"""

_WEIGHTS = ("on_columns", "on_rows")
WEIGHT_SHARE = 0.005
"""Largest last coefficient of a weight, relative to the mean weight of all lit rays."""


def moment_places(count: int) -> FloatArray:
    """Return the relative times of so many moments: -1, ..., 1."""
    return np.asarray(-np.cos(np.pi * np.arange(count) / (count - 1)))


def coefficients(values: Sequence[Values]) -> list[Values]:
    """Return the Chebyshev coefficients, by order, of values at all moments.

    Parameters
    ----------
    values : by moment; an array of numpy or of Dr.Jit each
    """
    middle = values[len(values) // 2]
    # Differences have smaller rounding errors than the values, and the same other coefficients.
    changes = [value - middle for value in values]
    matrix = np.asarray(np.linalg.inv(_chebyshev_at(moment_places(len(values)))), np.float64)
    constant, *others = _products(matrix, changes)
    return [constant + middle, *others]


def polynomial_at(values: FloatImage, places: FloatArray) -> FloatArray:
    """Return the polynomial through values (moment, lane) at relative times, (place, lane)."""
    from_chebyshev = chebyshev.chebvander(places, len(values) - 1)
    return np.asarray(from_chebyshev @ np.array(coefficients(list(values))))


def _chebyshev_at(places: FloatArray) -> FloatArray:
    return np.asarray(chebyshev.chebvander(places, len(places) - 1))


def _products(matrix: FloatArray, values: Sequence[Values]) -> list[Values]:
    """Return the product of a matrix with a column of arrays."""
    rows = (zip(row.tolist(), values, strict=True) for row in matrix)
    return [functools.reduce(operator.add, (factor * of for factor, of in row)) for row in rows]


@dataclass(frozen=True, eq=False)
class LitMoment:
    """Lanes at one moment; the light ends at the outline of the projector's image.

    Attributes
    ----------
    path : projector coordinate and weight
    on_columns, on_rows : weight times the image's outline across the frames along columns, and
        across those along rows
    """

    path: Connection
    on_columns: Any
    on_rows: Any

    @classmethod
    def of(cls, path: Connection, light: FrameLight) -> "LitMoment":
        """Return lanes in the light of the projector."""
        return cls(path, *(path.weight * outline for outline in light.outlines(path)))

    def quantity(self, name: str) -> Any:
        """Return a quantity by its name in this class or in `Connection`."""
        return getattr(self if name.startswith("on_") else self.path, name)


@dataclass(frozen=True, eq=False)
class TimePaths:
    """Lanes whose projector coordinate and weight are polynomials of the relative time.

    Attributes
    ----------
    powers : by quantity of a `LitMoment`, the coefficients of all powers of time, each (lane,)
    row : row of the image of each lane
    """

    powers: dict[str, list[Any]]
    row: Any

    @classmethod
    def through(cls, moments: Sequence[LitMoment], lit: Any, rows: NDArray[Any]) -> "TimePaths":
        """Return the polynomials through lanes at all moments.

        Parameters
        ----------
        lit : `mi.Bool`; lanes that have light, the others are dark
        rows : row of the image of each lane
        """
        to_powers = _powers_of_chebyshev(len(moments))
        powers = {
            name: _products(to_powers, coefficients([m.quantity(name) for m in moments]))
            for name in ("column_px", "row_px", "axial_mm", *_WEIGHTS)
        }
        for name in _WEIGHTS:
            powers[name] = [dr.select(lit, power, 0.0) for power in powers[name]]
        dr.eval(powers)
        return cls(powers, mi.Float(np.asarray(rows, np.float32)))

    def light(
        self, light: FrameLight, frame: int, nodes: ExposureNodes, row_delay: float
    ) -> FloatImage:
        """Return the radiance (lane,) of one frame, integrated over its exposure.

        Parameters
        ----------
        frame : number of the frame in the sequence
        nodes : relative times of the exposure in row 0
        row_delay : relative time from one row to the next
        """
        weight = _WEIGHTS[0 if light.is_along_columns(np.array([frame]))[0] else 1]
        delay, total = dr.opaque(mi.Float, row_delay), mi.Float(0.0)
        for place, share in zip(nodes.places, nodes.shares, strict=True):
            start = dr.opaque(mi.Float, float(place))
            path = self._at(dr.fma(self.row, delay, start), weight)
            value = path.weight * light.relative(path, frame)
            total = dr.fma(value, float(share), total)
        return np.array(total, np.float32)

    def _at(self, place: Any, weight: str) -> Connection:
        """Return the connections at a relative time of each lane, with one of the weights."""
        column, row, axial, lit = (
            _polynomial(self.powers[name], place)
            for name in ("column_px", "row_px", "axial_mm", weight)
        )
        return Connection(column, row, lit, lit > 0.0, axial)


def _powers_of_chebyshev(count: int) -> FloatArray:
    """Return the matrix (power, order) from Chebyshev coefficients to those of the powers."""
    matrix = np.zeros((count, count))
    for order in range(count):
        powers = chebyshev.cheb2poly(np.eye(count)[order])
        matrix[: len(powers), order] = powers
    return matrix


def _polynomial(powers: list[Any], place: Any) -> Any:
    *lower, value = powers
    for power in reversed(lower):
        value = dr.fma(value, place, power)
    return value
