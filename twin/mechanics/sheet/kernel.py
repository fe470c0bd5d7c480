"""Compiled sums of energy, forces and tangent of the thin sheet over its spline cells.

Arrays are (row, col, Gauss point) with rows and columns of cells. Module `point` computes the terms
at one Gauss point.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.sheet.laws import Grip, Rest, inlined, kernel, local_laws
from twin.mechanics.sheet.point import (
    At,
    ContactState,
    EvaluationOptions,
    Point,
    dot,
    point_scratch,
    potentials,
)
from twin.mechanics.sheet.surface import normal_times_area
from twin.mechanics.sheet.tangent import fill_tangent

#: Offsets (row, col) of the upper half of the tangent's stencil, in the order of its slots.
SLOTS = (
    *((0, col) for col in range(3)),
    *((row, col) for row in (1, 2) for col in range(-2, 3)),
)


class Cell(NamedTuple):
    """Work arrays for one cell, which are overwritten for each cell."""

    #: (9, 6) functions and derivatives at a point, and (5,) those of one along the grid
    functions: FloatArray
    plain: FloatArray
    #: (54,) and (6, 81) a point's tangent with its second side mapped to the functions
    side: FloatArray
    half: FloatArray
    #: (9, 81) tangent between functions, [i, 9 j + 3 k + l] for j not below i
    blocks: FloatArray


class Scratch(NamedTuple):
    """Work arrays of one call of `assemble_rows`, because compiled code allocates no arrays."""

    point: Point
    cell: Cell


class Assembled(NamedTuple):
    """Sums to which `assemble_rows` adds: energy, uJ; forces, mN; tangent, mN/mm."""

    #: (row,) of each row of cells
    energy: FloatArray
    #: (row + 2, col + 2, 3)
    forces: FloatArray
    #: (row + 2, col + 2, 13 * 9) by stencil slot
    tangent: FloatArray


def scratch() -> Scratch:
    """Return new work arrays for one call of `assemble_rows`."""
    cell = Cell(np.zeros((9, 6)), np.zeros(5), np.zeros(54), np.zeros((6, 81)), np.zeros((9, 81)))
    return Scratch(point_scratch(), cell)


def assemble_rows(
    rows: tuple[int, int],
    c: FloatArray,
    rest: Rest,
    state: ContactState,
    options: EvaluationOptions,
    work: Scratch,
    sums: Assembled,
) -> None:
    """Add the energy, the forces and, if requested, the tangent of some rows of cells to `sums`.

    Parameters
    ----------
    rows : index of the first row of cells, and of the row after the last one
    c : (row + 2, col + 2, 3) control points, mm
    rest : undeformed sheet
    state : constants of the potentials, distances of the bodies, and anchors
    options : whether the tangent is computed, and in which form
    work : work arrays, see `scratch`
    """
    plain = state._replace(grip=Grip(*map(np.ascontiguousarray, state.grip)))
    _assemble_rows(rows, np.ascontiguousarray(c), _contiguous(rest), plain, options, work, sums)


def _contiguous(rest: Rest) -> Rest:
    """Return `rest` with contiguous arrays: Numba would compile the kernel again for views."""
    return Rest(*map(np.ascontiguousarray, rest))


@kernel
def _assemble_rows(
    rows: tuple[int, int],
    c: FloatArray,
    rest: Rest,
    state: ContactState,
    options: EvaluationOptions,
    work: Scratch,
    sums: Assembled,
) -> None:
    point, cell = work.point, work.cell
    energy, F, S = sums.energy, sums.forces, sums.tangent
    N, plain = cell.functions, cell.plain
    for j_row in range(rows[0], rows[1]):
        total = 0.0
        for i_col in range(rest.area_mm2.shape[1]):
            cell.blocks[:] = 0.0
            for q in range(4):
                weight = rest.area_mm2[j_row, i_col, q]
                _functions((j_row, i_col, q), rest, N, plain)
                _place(N, c, j_row, i_col, point.v)
                laws = state.laws
                if rest.deviation_mm.shape[0] > 0:
                    laws = local_laws(laws, rest.deviation_mm[j_row, i_col, q])
                here = ContactState(laws, state.touch, state.grip)
                total += weight * potentials((j_row, i_col, q), here, options, point)
                for j in range(9):
                    for k in range(3):
                        x = 0.0
                        for m in range(6):
                            x += N[j, m] * point.force[m, k]
                        F[j_row + j // 3, i_col + j % 3, k] += weight * x
                if options.tangent:
                    fill_tangent(state.laws, options.convex, point)
                    _gather(N, weight, point.tangent.reshape(6, 54), cell)
            if options.tangent:
                for i in range(9):
                    own = S[j_row + i // 3, i_col + i % 3]
                    for j in range(i, 9):
                        slot = 9 * ((j // 3 - i // 3) * 5 + j % 3 - i % 3)
                        for k in range(9):
                            own[slot + k] += cell.blocks[i, 9 * j + k]
        energy[j_row] = total


def surface_rows(
    first: int,
    end: int,
    c: FloatArray,
    rest: Rest,
    N: FloatArray,
    plain: FloatArray,
    out: FloatArray,
) -> None:
    """Write r, r_1 and r_2 at the Gauss points of some rows of cells to `out` (row, col, 4, 3, 3).

    Symbols: see `point`.

    Parameters
    ----------
    first, end : index of the first row of cells, and of the row after the last one
    c : (row + 2, col + 2, 3) control points, mm
    rest : undeformed sheet
    N, plain : (9, 3) and (5,) work arrays
    """
    _surface_rows(first, end, np.ascontiguousarray(c), _contiguous(rest), N, plain, out)


@kernel
def _surface_rows(
    first: int,
    end: int,
    c: FloatArray,
    rest: Rest,
    N: FloatArray,
    plain: FloatArray,
    out: FloatArray,
) -> None:
    for j_row in range(first, end):
        for i_col in range(rest.area_mm2.shape[1]):
            for q in range(4):
                _functions((j_row, i_col, q), rest, N, plain)
                _place(N, c, j_row, i_col, out[j_row, i_col, q])


def curvature_squared(c: FloatArray, rest: Rest) -> FloatArray:
    """Return the mean of the two squared principal curvatures at the Gauss points, 1/mm^2.

    The shape is (row, col, 4). `c` are the control points (row + 2, col + 2, xyz), mm.
    """
    square = np.zeros(rest.area_mm2.shape)
    N, v, across = np.zeros((9, 6)), np.zeros((6, 3)), np.zeros(3)
    plain = np.zeros(5)
    _curvature_squared(np.ascontiguousarray(c), _contiguous(rest), N, plain, v, across, square)
    return square


@kernel
def _curvature_squared(
    c: FloatArray,
    rest: Rest,
    N: FloatArray,
    plain: FloatArray,
    v: FloatArray,
    across: FloatArray,
    out: FloatArray,
) -> None:
    for j_row in range(rest.area_mm2.shape[0]):
        for i_col in range(rest.area_mm2.shape[1]):
            for q in range(4):
                _functions((j_row, i_col, q), rest, N, plain)
                _place(N, c, j_row, i_col, v)
                a11, a22, a12 = dot(v[1], v[1]), dot(v[2], v[2]), dot(v[1], v[2])
                det = normal_times_area(v, across)
                # Second fundamental form times the area stretch.
                b11, b22, b12 = dot(v[3], across), dot(v[4], across), dot(v[5], across)
                trace = (a22 * b11 + a11 * b22 - 2 * a12 * b12) / det
                out[j_row, i_col, q] = (0.5 * trace * trace - (b11 * b22 - b12 * b12) / det) / det


@inlined
def _functions(at: At, rest: Rest, N: FloatArray, plain: FloatArray) -> None:
    """Write a cell's nine functions, and derivatives of them along the sheet, to N (9, m).

    m is 3 (value and first derivatives) or 6 (second derivatives as well).
    """
    row, col, q = at
    x, y = rest.along_x[col, q % 2], rest.along_y[row, q // 2]
    count = N.shape[1]
    for b in range(3):
        for a in range(3):
            n = N[3 * b + a]
            n[0] = x[0, a] * y[0, b]
            n[1] = x[1, a] * y[0, b]
            n[2] = x[0, a] * y[1, b]
            if count == 6:
                n[3] = x[2, a] * y[0, b]
                n[4] = x[0, a] * y[2, b]
                n[5] = x[1, a] * y[1, b]
    if rest.turned.shape[0] == 0:
        return
    turned = rest.turned[row, col, q]
    for j in range(9):
        for t in range(count - 1):
            plain[t] = N[j, 1 + t]
        for s in range(count - 1):
            total = 0.0
            for t in range(count - 1):
                total += turned[s, t] * plain[t]
            N[j, 1 + s] = total


@inlined
def _place(functions: FloatArray, c: FloatArray, row: int, col: int, v: FloatArray) -> None:
    """Write position and derivatives of the surface at a Gauss point to v (m, 3), m = 3 or 6."""
    v[:] = 0.0
    for b in range(3):
        for a in range(3):
            for m in range(v.shape[0]):
                N = functions[3 * b + a, m]
                for k in range(3):
                    v[m, k] += N * c[row + b, col + a, k]


@inlined
def _gather(N: FloatArray, weight: float, K: FloatArray, cell: Cell) -> None:
    """Add the tangent of a Gauss point to `cell.blocks`, in long loops that can be vectorised."""
    half, side, blocks = cell.half, cell.side, cell.blocks
    for j in range(9):
        n0, n1, n2 = weight * N[j, 0], weight * N[j, 1], weight * N[j, 2]
        n3, n4, n5 = weight * N[j, 3], weight * N[j, 4], weight * N[j, 5]
        for k in range(54):
            side[k] = (
                n0 * K[0, k] + n1 * K[1, k] + n2 * K[2, k]
                + n3 * K[3, k] + n4 * K[4, k] + n5 * K[5, k]
            )  # fmt: skip
        for s in range(6):
            for k in range(9):
                half[s, 9 * j + k] = side[9 * s + k]
    for i in range(9):
        n0, n1, n2, n3, n4, n5 = N[i, 0], N[i, 1], N[i, 2], N[i, 3], N[i, 4], N[i, 5]
        for k in range(9 * i, 81):
            blocks[i, k] += (
                n0 * half[0, k] + n1 * half[1, k] + n2 * half[2, k]
                + n3 * half[3, k] + n4 * half[4, k] + n5 * half[5, k]
            )  # fmt: skip
