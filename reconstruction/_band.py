"""What the rows of one band share: the plan, the result and the lines that are used anew.

The phasors of the last image rows, as many as the filter is high, lie in a ring, see
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


class Plan(NamedTuple):
    """All that is the same for every row; pairs are (column, row)."""

    layout: Layout
    limits: Limits
    smoothing: Smoothing
    codes: tuple[Code, Code]
    ladders: tuple[Ladder, Ladder]
    is_chain: bool
    scale: FloatImage  # (row, col), by which each pixel was multiplied; (0, 0): by 1


class Maps(NamedTuple):
    """The result, (axis, row, col) unless stated, zeroed by the caller."""

    coordinate_px: Any
    phase_rad: Any
    order: Any
    mean_dn: Any
    modulation_dn: Any
    sigma_px: Any
    residual_dn: Any
    order_error: Any
    reason: Any  # (row, col)


class Work(NamedTuple):
    """Lines that live as long as a band."""

    sums: Any  # (6, col)
    fit: Any  # (line, col): mean, modulation, variance, noise, excess of one fringe set
    spare: Any  # (line, col): mean, modulation, residual of rows outside the band, per axis
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
    near: Any


@compiled
def make_work(width: int, taps: int, sets: int) -> Work:
    half = taps // 2
    length, excess_length = half + (4 * sets + 1) * (width + half), half + 2 * (width + half)
    return Work(
        np.zeros((6, width), np.float32),
        np.zeros((5, width), np.float32),
        np.zeros((6, width), np.float32),
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
        np.zeros(width, np.uint32),
    )


@merged
def plane(line: Any, index: int, width: int, gap: int) -> Any:
    start = gap + index * (width + gap)
    return line[start : start + width]
