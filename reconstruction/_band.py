"""What the rows of one band share: the plan, the result and the lines that are used anew.

The phasors and the fits of the last image rows, as many as the filter is high, lie in rings, see
`_filter_kernels`.
"""

from typing import Any, NamedTuple

import numpy as np

from reconstruction._chain_kernels import Ladder
from reconstruction._filter_kernels import Smoothing
from reconstruction._jit import compiled, merged
from reconstruction._order_kernels import Code
from reconstruction._sum_kernels import Layout, Limits
from reconstruction.arrays import FloatImage


class Units(NamedTuple):
    """Factors for `pack_row`: BIAS over the unit of each kind of map."""

    level: np.float32
    sigma: np.float32
    chance: np.float32


class Plan(NamedTuple):
    """All that is the same for every row; pairs are (column, row)."""

    layout: Layout
    limits: Limits
    smoothing: Smoothing
    codes: tuple[Code, Code]
    units: Units
    ladders: tuple[Ladder, Ladder]
    is_chain: bool
    scale: FloatImage  # (row, col), by which each pixel was multiplied; (0, 0): by 1


class Maps(NamedTuple):
    """The result, (axis, row, col) unless stated, zeroed by the caller; see `compact`."""

    coordinate_px: Any  # float32
    turns: Any  # uint16, as all that follow
    mean: Any
    modulation: Any
    sigma: Any
    residual: Any
    order_error: Any
    reason: Any  # (row, col) uint8


class Work(NamedTuple):
    """Lines that live as long as a band."""

    sums: Any  # (4, col): total, square, high, low
    fit: Any  # (line, col): mean, modulation, variance, noise, excess, total variance, residual
    fits: (
        Any  # (row, line, col): mean, modulation of both axes, a ring up to the row to be filtered
    )
    answers: Any  # (line, col): coordinate and sigma of both axes
    lines: Any  # (line, col): modulation, error, and one to pack with
    order: Any
    spare_reason: Any
    damaged: Any
    ones: Any
    ring: Any
    excess_ring: Any
    damaged_rows: Any  # (tap)
    lane: Any
    smooth: Any
    excess_lane: Any
    excess: Any
    phases: Any  # (set, col)
    sigmas: Any
    word: Any
    nearest: Any


# Lines of `Work.fits`, column and row.
MEAN, MODULATION = (0, 1), (2, 3)
# Lines of `Work.answers`, column and row.
COORDINATE, SIGMA = (0, 1), (2, 3)


@compiled
def make_work(width: int, taps: int, sets: int) -> Work:
    half = taps // 2
    length, excess_length = half + (4 * sets + 1) * (width + half), half + 2 * (width + half)
    return Work(
        np.zeros((4, width), np.float32),
        np.zeros((7, width), np.float32),
        np.zeros((half + 1, 4, width), np.float32),
        np.zeros((4, width), np.float32),
        np.zeros((3, width), np.float32),
        np.zeros(width, np.int32),
        np.zeros(width, np.uint8),
        np.zeros(width, np.bool_),
        np.ones(width, np.float32),
        np.zeros((taps, length), np.float32),
        np.zeros((taps, excess_length), np.float32),
        np.zeros(taps, np.int64),
        np.zeros(length, np.float32),
        np.zeros(length, np.float32),
        np.zeros(excess_length, np.float32),
        np.zeros(excess_length, np.float32),
        np.zeros((sets, width), np.float32),
        np.zeros((sets, width), np.float32),
        np.zeros(width, np.uint32),
        np.zeros(width, np.float32),
    )


@merged
def plane(line: Any, index: int, width: int, gap: int) -> Any:
    start = gap + index * (width + gap)
    return line[start : start + width]
