"""Flakes of a coat in material coordinates: random places, diameters and tilts.

The places are a Poisson process of constant density. Diameters are log-normal, cut at 3 standard
deviations. The slopes of the flakes have the distribution of GGX facets, so that the mean of their
reflection is that of a rough conductor. The density follows from the share of the area: flakes may
overlap, and the areas of all flakes are summed.

The plane is divided into square cells. Each cell has its own stream of random numbers, computed
from the seed and the cell's indices by SplitMix64 (Steele, Lea, Flood, OOPSLA 2014). A flake
therefore does not depend on the region that is evaluated or on the number of threads.
"""

import math
from dataclasses import dataclass
from math import erf, exp, floor, log, pi, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.compiling import NESTED, Function, compile_and_keep, digest_of_sources
from twin.config.coatings import DiscreteFacets
from twin.config.digest import keyed_sequence

# No fused multiply-add: the same bytes on every CPU type.
_OPTIONS: dict[str, Any] = {"nogil": True, "_nrt": False, "error_model": "numpy"}
_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, ("flakes.py", "glints.py"))

_PER_CELL = 2.0
"""Mean number of flakes in a cell."""
_CUT = 3.0
"""Largest deviation of ln(diameter), in standard deviations."""

_STRIDE = np.uint64(0x9E3779B97F4A7C15)
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_S12, _S27, _S30, _S31 = (np.uint64(bits) for bits in (12, 27, 30, 31))


def compiled(function: Function) -> Function:
    """Return a kernel that is compiled at its first call and cached on disk."""
    return compile_and_keep(function, _OPTIONS, _SOURCE_DIGEST)


def nested(function: Function) -> Function:
    """Return a compiled function that other kernels can call, but not Python."""
    return compile_and_keep(function, _OPTIONS | NESTED, _SOURCE_DIGEST)


class FlakeList(NamedTuple):
    """Flakes of a rectangle of cells, sorted by cell.

    Attributes
    ----------
    flakes : (flake, 5); X, Y and radius, mm, and the slopes of the surface along X and Y
    first : (cell + 1,); index of the first flake of each cell, row by row
    low : indices of the first cell along X and Y
    cols : number of cells along X
    cell_mm : edge length of a cell
    largest_mm : largest possible radius of a flake
    """

    flakes: FloatArray
    first: IntArray
    low: tuple[int, int]
    cols: int
    cell_mm: float
    largest_mm: float


@dataclass(frozen=True)
class FlakeProcess:
    """Random flakes of one coat.

    Attributes
    ----------
    density_per_mm2 : mean number of flakes per area of the coat
    median_mm, spread : median radius by number; standard deviation of ln(radius)
    alpha : GGX alpha of the flakes' normals
    key : number that determines all random numbers
    """

    density_per_mm2: float
    median_mm: float
    spread: float
    alpha: float
    key: int

    @classmethod
    def of(cls, facets: DiscreteFacets, seed: int) -> "FlakeProcess":
        """Return the flakes of a coat; the same seed gives the same flakes.

        Notes
        -----
        The median by number is smaller than the median by area by the factor exp(-2 spread^2). This
        is that of the distribution before the cut, which lowers the median by area by 1 % at a
        spread of 0.45, and by 8 % at 0.8.
        """
        spread = facets.glints.diameter_spread
        median_mm = 0.5e-3 * facets.glints.diameter_um * exp(-2.0 * spread**2)
        density = facets.share / (pi * median_mm**2 * _square_moment(spread))
        key = int(keyed_sequence(seed, "glints").generate_state(1, np.uint64)[0])
        return cls(density, median_mm, spread, facets.alpha, key)

    @property
    def largest_mm(self) -> float:
        """Largest possible radius of a flake."""
        return self.median_mm * exp(_CUT * self.spread)

    def within(self, extent_mm: tuple[float, float, float, float]) -> FlakeList:
        """Return all flakes that reach into a rectangle.

        Parameters
        ----------
        extent_mm : (X_low, X_high, Y_low, Y_high), material coordinates
        """
        cell_mm = sqrt(_PER_CELL / self.density_per_mm2)
        # One more cell on each side: rounding can move a position across the border of a cell.
        lows = [floor((low - self.largest_mm) / cell_mm) - 1 for low in extent_mm[::2]]
        highs = [floor((high + self.largest_mm) / cell_mm) + 1 for high in extent_mm[1::2]]
        cols, rows = (high - low + 1 for low, high in zip(lows, highs, strict=True))
        first = np.zeros(rows * cols + 1, np.int64)
        cells, key = (lows[0], lows[1], cols), np.uint64(self.key)
        _count(first, cells, key)
        np.cumsum(first, out=first)
        flakes = np.zeros((int(first[-1]), 5))
        numbers = (cell_mm, log(self.median_mm), self.spread, self.alpha)
        _fill(flakes, first, cells, key, numbers)
        return FlakeList(flakes, first, cells[:2], cells[2], cell_mm, self.largest_mm)


def _square_moment(spread: float) -> float:
    """Return the mean of the squared diameter over the squared median diameter."""
    shifted = erf((_CUT - 2 * spread) / sqrt(2)) + erf((_CUT + 2 * spread) / sqrt(2))
    return exp(2 * spread**2) * shifted / (2 * erf(_CUT / sqrt(2)))


@nested
def _scrambled(state: Any) -> Any:
    state = (state ^ (state >> _S30)) * _FIRST
    state = (state ^ (state >> _S27)) * _SECOND
    return state ^ (state >> _S31)


@nested
def _uniform(state: Any) -> Any:
    """Return the random number of a state, between 0 and 1, without both ends."""
    return (float(_scrambled(state) >> _S12) + 0.5) * 2.0**-52


@nested
def _stream(cells: Any, cell: Any, key: Any) -> Any:
    """Return the first state of a cell's random numbers."""
    x, y = cells[0] + cell % cells[2], cells[1] + cell // cells[2]
    state = _scrambled(key + _STRIDE * np.uint64(x))
    return _scrambled(state + _STRIDE * np.uint64(y))


@nested
def _number_in(state: Any) -> Any:
    """Draw the number of flakes in a cell (Knuth's method); return it and the next state."""
    count, product = -1, 1.0
    while product > math.exp(-_PER_CELL):
        state += _STRIDE
        product *= _uniform(state)
        count += 1
    return count, state


@compiled
def _count(first: Any, cells: Any, key: Any) -> None:
    """Fill the number of flakes of each cell, at the index of the next cell."""
    for cell in range(first.size - 1):
        first[cell + 1] = _number_in(_stream(cells, cell, key))[0]


@nested
def _deviation(state: Any) -> Any:
    """Draw a standard normal number of at most `_CUT`; return it and the next state."""
    value = 2.0 * _CUT
    while abs(value) > _CUT:
        radius = math.sqrt(-2.0 * math.log(_uniform(state + _STRIDE)))
        state += _STRIDE + _STRIDE
        value = radius * math.cos(2.0 * math.pi * _uniform(state))
    return value, state


@compiled
def _fill(flakes: Any, first: Any, cells: Any, key: Any, numbers: Any) -> None:
    """Fill place, radius and slopes of all flakes.

    Parameters
    ----------
    numbers : edge of a cell, mm; logarithm of the median radius; its spread; GGX alpha
    """
    cell_mm, log_median, spread, alpha = numbers
    for cell in range(first.size - 1):
        x, y = cells[0] + cell % cells[2], cells[1] + cell // cells[2]
        state = _number_in(_stream(cells, cell, key))[1]
        for k in range(first[cell], first[cell + 1]):
            deviation, state = _deviation(state)
            state += _STRIDE
            flakes[k, 0] = (x + _uniform(state)) * cell_mm
            state += _STRIDE
            flakes[k, 1] = (y + _uniform(state)) * cell_mm
            flakes[k, 2] = math.exp(log_median + spread * deviation)
            state += _STRIDE
            share = _uniform(state)
            slope = alpha * math.sqrt(share / (1.0 - share))
            state += _STRIDE
            azimuth = 2.0 * math.pi * _uniform(state)
            flakes[k, 3], flakes[k, 4] = slope * math.cos(azimuth), slope * math.sin(azimuth)
