"""What the rows of one band share: the plan, the result and the lines that are used anew."""

from typing import Any, NamedTuple

import numpy as np

from reconstruction._jit import compiled
from reconstruction.arrays import FloatImage
from reconstruction.decoding._chain import Ladder
from reconstruction.decoding._order import Code
from reconstruction.decoding._sum import Layout, Limits


class Units(NamedTuple):
    """Factors for `pack_row`: BIAS over the unit of each kind of map."""

    level: np.float32
    sigma: np.float32
    chance: np.float32


class Plan(NamedTuple):
    """All that is the same for every row; pairs are (column, row)."""

    layout: Layout
    limits: Limits
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

    sums: Any  # (6, col): total, real, imag, square, high, low
    fit: Any  # (line, col): mean, variance, noise, excess of one set; total variance, residual
    mean: Any  # (axis, col), of the measuring period
    excess: Any  # (axis, col), the largest of all sets
    modulations: Any  # (axis, set, col)
    phases: Any  # (axis, set, col)
    sigmas: Any  # (set, col)
    answers: Any  # (line, col): coordinate and sigma of both axes
    lines: Any  # (line, col): error, and two to pack with
    order: Any
    damaged: Any
    ones: Any
    usable: Any
    word: Any
    nearest: Any


# Lines of `Work.answers`, column and row.
COORDINATE, SIGMA = (0, 1), (2, 3)


@compiled
def make_work(width: int, sets: int) -> Work:
    return Work(
        np.zeros((6, width), np.float32),
        np.zeros((6, width), np.float32),
        np.zeros((2, width), np.float32),
        np.zeros((2, width), np.float32),
        np.zeros((2, sets, width), np.float32),
        np.zeros((2, sets, width), np.float32),
        np.zeros((sets, width), np.float32),
        np.zeros((4, width), np.float32),
        np.zeros((3, width), np.float32),
        np.zeros(width, np.int32),
        np.zeros(width, np.bool_),
        np.ones(width, np.float32),
        np.zeros(width, np.float32),
        np.zeros(width, np.uint32),
        np.zeros(width, np.float32),
    )
