"""Quadratic B-splines on a graded line: values, derivatives, and interpolation between lines."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from reconstruction.arrays import FloatArray

_GAUSS = 0.5 / np.sqrt(3)
#: change of width over distance
_GROWTH = 0.2
_SAMPLES = 2001
#: widest of the cells that may be wider than the pitch
_WIDEST_PITCHES = 4.0
#: number of widths of the series in each doubling
_RUNGS = 2


@dataclass(frozen=True, eq=False)
class Widths:
    """Largest widths of cells at ascending points along a line."""

    #: (n,)
    places_mm: FloatArray
    widths_mm: FloatArray

    def at(self, places_mm: FloatArray, pitch_mm: float) -> FloatArray:
        """Return the widths at points, from `pitch_mm` up; they increase no faster than allowed.

        Each is rounded down to a width of the series, so that last digits move no cell.
        """
        pitches = np.clip(self.widths_mm / pitch_mm, 1.0, _WIDEST_PITCHES)
        rungs = 2.0 ** (np.floor(_RUNGS * np.log2(pitches) + 1e-9) / _RUNGS)
        away = np.abs(self.places_mm[:, None] - self.places_mm)
        widths = (pitch_mm * rungs + _GROWTH * away).min(axis=1)
        return np.asarray(np.interp(places_mm, self.places_mm, widths), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SplineLine:
    """C1 quadratic B-splines on the cells between `edges`, open at both ends.

    Cell i carries the functions i, i + 1 and i + 2; there are two more functions than cells.
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
        """(function,) points at which the values are the coefficients of a straight line."""
        knots = self._knots
        return (knots[1:-2] + knots[2:-1]) / 2

    @cached_property
    def points(self) -> FloatArray:
        """(cell, 2) Gauss points."""
        steps = np.diff(self.edges)[:, None]
        points: FloatArray = self.edges[:-1, None] + steps * [0.5 - _GAUSS, 0.5 + _GAUSS]
        return points

    @cached_property
    def weights(self) -> FloatArray:
        """(cell, 2) weights of the Gauss points."""
        return np.repeat(np.diff(self.edges)[:, None] / 2, 2, axis=1)

    @cached_property
    def table(self) -> FloatArray:
        """(cell, 2, derivative 0 to 2, 3) the functions of each cell at its Gauss points."""
        return np.ascontiguousarray(self.at(self.points.ravel())[1]).reshape(self.cells, 2, 3, 3)

    def at(self, places: FloatArray) -> tuple[np.ndarray, FloatArray]:
        """Return (n,) cell and (n, derivative 0 to 2, 3) functions of that cell at `places`."""
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
        """Return (n, function) values of all functions at `places`."""
        cell, local = self.at(places)
        full = np.zeros((places.size, self.size))
        np.put_along_axis(full, cell[:, None] + np.arange(3), local[:, derivative], axis=1)
        return full

    def interpolated_from(self, source: "SplineLine") -> FloatArray:
        """Return (function, source function): this line's spline through the values of `source`."""
        passed = np.linalg.solve(self.matrix(self.greville), source.matrix(self.greville))
        return np.asarray(passed, dtype=np.float64)

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
) -> SplineLine:
    """Return cells of about `pitch_mm` within `fine_mm`, wider between it and the ends.

    Within it they are also wider where that is `allowed`.
    At the ends cells are of `rim_mm`: under pressure the sheet bends within less than its thickness
    at a held rim, and an error there moves all of its face.
    """
    low, high = max(fine_mm[0], ends_mm[0]), min(fine_mm[1], ends_mm[1])
    before = low - _between(low - ends_mm[0], pitch_mm, rim_mm, coarse_mm)[::-1]
    after = high + _between(ends_mm[1] - high, pitch_mm, rim_mm, coarse_mm)
    return SplineLine(np.concatenate((before, _fine(low, high, pitch_mm, allowed), after)))


def subdivided(edges: FloatArray, parts: npt.NDArray[np.int64]) -> FloatArray:
    """Return the ends of `parts` (cell,) equal parts of each cell."""
    cells = zip(edges[:-1], edges[1:], parts, strict=True)
    inner = [np.linspace(low, high, count, endpoint=False) for low, high, count in cells]
    return np.concatenate((*inner, edges[-1:]))


def _fine(low: float, high: float, pitch_mm: float, allowed: Widths | None) -> FloatArray:
    """Return the ends of cells of the pitch, or of the allowed width if that is larger."""
    if allowed is not None:
        places = np.linspace(low, high, _SAMPLES)
        widths = allowed.at(places, pitch_mm)
        if widths.max() > pitch_mm:
            return np.append(low, _ends(places, widths))
    count = max(2, int(np.ceil((high - low) / pitch_mm - 1e-9)))
    return np.linspace(low, high, count + 1)


def _between(length_mm: float, pitch_mm: float, rim_mm: float, coarse_mm: float) -> FloatArray:
    """Return the ends of cells from the fine part, at 0, to an end of the line."""
    if length_mm < 1e-9:
        return np.zeros(0)
    places = np.linspace(0.0, length_mm, _SAMPLES)
    width = np.minimum(pitch_mm + _GROWTH * places, rim_mm + _GROWTH * (length_mm - places))
    return _ends(places, np.minimum(width, coarse_mm))


def _ends(places: FloatArray, widths_mm: FloatArray) -> FloatArray:
    """Return the ends of cells but the first, at most as wide as `widths_mm` at even points."""
    density = 1 / widths_mm
    cells = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2)))
    cells *= (places[-1] - places[0]) / (places.size - 1)
    count = max(1, int(np.ceil(cells[-1] - 1e-9)))
    ends = np.linspace(0.0, cells[-1], count + 1)[1:]
    return np.asarray(np.interp(ends, cells, places), dtype=np.float64)
