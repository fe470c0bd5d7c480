"""Quadratic B-splines on a line with cells of different widths; interpolation between lines.

A function is one B-spline of a line. Positions along a line are parameters of the sheet, mm.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_banded

from reconstruction.arrays import FloatArray

_GAUSS = 0.5 / np.sqrt(3)
GROWTH = 0.2
"""Change of the cells' width over distance, unless another is given."""
_SAMPLES = 2001
#: widest of the cells that may be wider than the pitch
_WIDEST_PITCHES = 4.0
#: number of widths of the series in each doubling
_RUNGS = 2


@dataclass(frozen=True, eq=False)
class Widths:
    """Largest allowed widths of cells, mm, at ascending points along a line."""

    #: (n,)
    places_mm: FloatArray
    widths_mm: FloatArray

    def at(self, places_mm: FloatArray, pitch_mm: float) -> FloatArray:
        """Return the allowed widths of cells, mm, at points `places_mm` along the line.

        Widths are 1 to 4 x `pitch_mm`, and increase along the line by at most 0.2 mm per mm. Before
        this limit they are rounded down to a geometric series with two widths per doubling, so that
        rounding errors do not move cells.
        """
        pitches = np.clip(self.widths_mm / pitch_mm, 1.0, _WIDEST_PITCHES)
        rungs = 2.0 ** (np.floor(_RUNGS * np.log2(pitches) + 1e-9) / _RUNGS)
        away = np.abs(self.places_mm[:, None] - self.places_mm)
        widths = (pitch_mm * rungs + GROWTH * away).min(axis=1)
        return np.asarray(np.interp(places_mm, self.places_mm, widths), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SplineLine:
    """C1 quadratic B-splines on the cells between `edges`, with triple knots at both ends.

    In cell i the functions i, i + 1 and i + 2 are not zero. There are two more functions than
    cells.
    """

    #: (cell + 1,) ascending
    edges: FloatArray

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.edges.size - 1

    @property
    def size(self) -> int:
        """Number of functions."""
        return self.cells + 2

    @cached_property
    def greville(self) -> FloatArray:
        """(function,) Greville points: a straight line has its values there as coefficients."""
        knots = self._knots
        return (knots[1:-2] + knots[2:-1]) / 2

    @cached_property
    def points(self) -> FloatArray:
        """(cell, 2) positions of the two Gauss points of each cell."""
        steps = np.diff(self.edges)[:, None]
        points: FloatArray = self.edges[:-1, None] + steps * [0.5 - _GAUSS, 0.5 + _GAUSS]
        return points

    @cached_property
    def weights(self) -> FloatArray:
        """(cell, 2) integration weights of the Gauss points, mm: half the width of the cell."""
        return np.repeat(np.diff(self.edges)[:, None] / 2, 2, axis=1)

    @cached_property
    def table(self) -> FloatArray:
        """(cell, 2, derivative 0 to 2, 3) the three functions of each cell at its Gauss points."""
        return np.ascontiguousarray(self.at(self.points.ravel())[1]).reshape(self.cells, 2, 3, 3)

    def at(self, places: FloatArray) -> tuple[np.ndarray, FloatArray]:
        """Return the cell (n,) of each of n points, and the cell's three functions there.

        The functions are (n, derivative 0 to 2, 3).
        """
        last = self.cells - 1
        cell = np.clip(np.searchsorted(self.edges, places, side="right") - 1, 0, last)
        t0, t1, t2, t3 = (self._knots[cell + k] for k in range(1, 5))
        ab, bb, bc = t2 - t0, t2 - t1, t3 - t1
        x0, a, b, c = places - t0, t2 - places, places - t1, t3 - places
        rows = (
            (a * a / (ab * bb), x0 * a / (ab * bb) + c * b / (bc * bb), b * b / (bc * bb)),
            (-2 * a / (ab * bb), (a - x0) / (ab * bb) + (c - b) / (bc * bb), 2 * b / (bc * bb)),
            (2 / (ab * bb), -2 / (ab * bb) - 2 / (bc * bb), 2 / (bc * bb)),
        )
        return cell, np.moveaxis(np.array(rows), -1, 0)

    def matrix(self, places: FloatArray, derivative: int = 0) -> FloatArray:
        """Return the values (n, function) of all functions, or of a derivative, at n points."""
        cell, local = self.at(places)
        full = np.zeros((places.size, self.size))
        np.put_along_axis(full, cell[:, None] + np.arange(3), local[:, derivative], axis=1)
        return full

    def interpolated_from(self, source: "SplineLine") -> FloatArray:
        """Return the matrix (function, source function) from coefficients of `source` to this line.

        The resulting spline interpolates that of `source` at the Greville points of this line.
        """
        # Each Greville point is the middle of a cell, so three functions are not zero there.
        matrix, band = self.matrix(self.greville), np.zeros((3, self.size))
        for row, offset in enumerate((1, 0, -1)):
            diagonal = matrix.diagonal(offset)
            band[row, max(offset, 0) : max(offset, 0) + diagonal.size] = diagonal
        return np.asarray(solve_banded((1, 1), band, source.matrix(self.greville)), np.float64)

    @property
    def _knots(self) -> FloatArray:
        first, last = self.edges[:1], self.edges[-1:]
        return np.concatenate((first, first, self.edges, last, last))


def graded_line(
    ends_mm: tuple[float, float],
    fine_mm: tuple[float, float],
    pitch_mm: float,
    rim_mm: float,
    coarse_mm: float,
    *,
    allowed: Widths | None = None,
    growth: float = GROWTH,
) -> SplineLine:
    """Return a line with cells of about `pitch_mm` in a fine part, and wider cells outside it.

    At both ends of the line cells have the width `rim_mm`: under pressure the sheet bends at a
    fixed rim over a length below its thickness, and an error there moves its whole face.

    Parameters
    ----------
    ends_mm : (low, high) ends of the line
    fine_mm : (low, high) ends of the fine part
    coarse_mm : largest width of cells outside the fine part
    allowed : widths of cells in the fine part, if larger than the pitch; None: the pitch
    growth : change of the width over distance outside the fine part
    """
    widths = pitch_mm, rim_mm, coarse_mm
    low, high = max(fine_mm[0], ends_mm[0]), min(fine_mm[1], ends_mm[1])
    before = low - _between(low - ends_mm[0], widths, growth)[::-1]
    after = high + _between(ends_mm[1] - high, widths, growth)
    return SplineLine(np.concatenate((before, _fine(low, high, pitch_mm, allowed), after)))


def subdivided(edges: FloatArray, parts: npt.NDArray[np.int64]) -> FloatArray:
    """Return the ends (n,) of all parts of a line; cell i is divided into parts[i] equal parts."""
    cells = zip(edges[:-1], edges[1:], parts, strict=True)
    inner = [np.linspace(low, high, count, endpoint=False) for low, high, count in cells]
    return np.concatenate((*inner, edges[-1:]))


def _fine(low: float, high: float, pitch_mm: float, allowed: Widths | None) -> FloatArray:
    """Return the edges of the cells from `low` to `high`: of the pitch, or wider if allowed."""
    if allowed is not None:
        places = np.linspace(low, high, _SAMPLES)
        widths = allowed.at(places, pitch_mm)
        if widths.max() > pitch_mm:
            return np.append(low, _ends(places, widths))
    count = max(2, int(np.ceil((high - low) / pitch_mm - 1e-9)))
    return np.linspace(low, high, count + 1)


def _between(length_mm: float, widths_mm: tuple[float, float, float], growth: float) -> FloatArray:
    """Return the edges of the cells between the fine part and an end of the line.

    Edges are distances from the fine part, in (0, `length_mm`]. `widths_mm` are those of cells in
    the fine part and at the end, and the largest one.
    """
    pitch_mm, rim_mm, coarse_mm = widths_mm
    if length_mm < 1e-9:
        return np.zeros(0)
    places = np.linspace(0.0, length_mm, _SAMPLES)
    width = np.minimum(pitch_mm + growth * places, rim_mm + growth * (length_mm - places))
    return _ends(places, np.minimum(width, coarse_mm))


def _ends(places: FloatArray, widths_mm: FloatArray) -> FloatArray:
    """Return the edges of cells, without the first, for widths given at equally spaced points.

    Cells are at most `widths_mm` (n,) wide; `places` (n,) are the points.
    """
    density = 1 / widths_mm
    cells = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2)))
    cells *= (places[-1] - places[0]) / (places.size - 1)
    count = max(1, int(np.ceil(cells[-1] - 1e-9)))
    ends = np.linspace(0.0, cells[-1], count + 1)[1:]
    return np.asarray(np.interp(ends, cells, places), dtype=np.float64)
