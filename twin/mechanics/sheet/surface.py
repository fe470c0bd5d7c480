"""Compiled positions and derivatives of the sheet at any grid of its points, and its two faces."""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from twin.mechanics.sheet.laws import inlined, kernel
from twin.mechanics.sheet.splines import SplineLine


class Points(NamedTuple):
    """Points along a line of splines, ascending."""

    #: (n,) cell that contains the point
    cell: IntArray
    #: (n, derivative 0 to 2, 3) the cell's functions there
    functions: FloatArray


class PointWork(NamedTuple):
    """Work arrays of a call, because compiled code allocates no arrays."""

    #: (2, col + 2, xyz) sums of a row, and (3, xyz) position and derivatives of a point
    row: FloatArray
    point: FloatArray
    across: FloatArray


def work_for(control_mm: FloatArray) -> PointWork:
    """Return work arrays for control points (row + 2, col + 2, xyz)."""
    return PointWork(np.zeros((2, control_mm.shape[1], 3)), np.zeros((3, 3)), np.zeros(3))


def points_on(line: SplineLine, places_mm: FloatArray) -> Points:
    """Return the points at positions `places_mm` (n,) along a line."""
    cell, functions = line.at(places_mm)
    return Points(cell.astype(np.intp), np.ascontiguousarray(functions))


def surface_at(control_mm: FloatArray, x: Points, y: Points, cut: FloatArray) -> FloatArray:
    """Return position and first derivatives along the undeformed sheet, (y, x, 3, xyz).

    Parameters
    ----------
    control_mm : (row + 2, col + 2, xyz)
    cut : (5, y, x) X_u, Y_u, X_v, Y_v and their determinant; (5, 0, 0) where x = u and y = v
    """
    out = np.zeros((y.cell.size, x.cell.size, 3, 3))
    control = np.ascontiguousarray(control_mm)
    _surface_at(control, x, y, cut, work_for(control), out)
    return out


@kernel
def _surface_at(
    c: FloatArray, x: Points, y: Points, cut: FloatArray, work: PointWork, out: FloatArray
) -> None:
    for j in range(y.cell.size):
        along_row(c, y, j, work.row)
        for i in range(x.cell.size):
            point_in_row(work.row, x, i, out[j, i])
            if cut.shape[1] > 0:
                turn(cut, j, i, out[j, i])


@inlined
def along_row(c: FloatArray, y: Points, j: int, sums: FloatArray) -> None:
    """Write a row's sums over the rows of control points to `sums` (2, col + 2, xyz).

    They are sums with the functions and with their first derivatives.
    """
    cell, functions = y.cell[j], y.functions[j]
    for n in range(2):
        for col in range(c.shape[1]):
            for k in range(3):
                total = 0.0
                for b in range(3):
                    total += functions[n, b] * c[cell + b, col, k]
                sums[n, col, k] = total


@inlined
def point_in_row(sums: FloatArray, x: Points, i: int, v: FloatArray) -> None:
    """Write position and derivatives along the grid to v (3, xyz), from a row's sums."""
    cell, functions = x.cell[i], x.functions[i]
    for k in range(3):
        place, by_x, by_y = 0.0, 0.0, 0.0
        for a in range(3):
            place += functions[0, a] * sums[0, cell + a, k]
            by_x += functions[1, a] * sums[0, cell + a, k]
            by_y += functions[0, a] * sums[1, cell + a, k]
        v[0, k], v[1, k], v[2, k] = place, by_x, by_y


@inlined
def turn(cut: FloatArray, j: int, i: int, v: FloatArray) -> None:
    """Replace derivatives by the parameters with those along the undeformed sheet."""
    for k in range(3):
        by_u, by_v = v[1, k], v[2, k]
        v[1, k] = (by_u * cut[3, j, i] - by_v * cut[1, j, i]) / cut[4, j, i]
        v[2, k] = (by_v * cut[0, j, i] - by_u * cut[2, j, i]) / cut[4, j, i]


class Faces(NamedTuple):
    """Both faces of the sheet at a grid of its points."""

    #: (row, col, xyz) mm
    upper_mm: FloatArray
    lower_mm: FloatArray
    #: (row, col)
    thickness_mm: FloatArray
    #: (row, col, 2) principal stretches, larger first
    stretch: FloatArray


def faces_of(surface: FloatArray, thickness_mm: FloatArray | float) -> Faces:
    """Return the faces of a sheet from `surface` (row, col, 3, xyz), see `surface_at`.

    `thickness_mm` (row, col), or one number, is the undeformed thickness.
    """
    rows, cols = surface.shape[:2]
    shapes = ((rows, cols, 3), (rows, cols, 3), (rows, cols), (rows, cols, 2))
    faces = Faces(*(np.zeros(shape) for shape in shapes))
    undeformed_mm = np.full((rows, cols), thickness_mm)
    _faces_of(surface, undeformed_mm, np.zeros(3), faces)
    return faces


@kernel
def _faces_of(
    surface: FloatArray, undeformed_mm: FloatArray, across: FloatArray, faces: Faces
) -> None:
    for j in range(surface.shape[0]):
        for i in range(surface.shape[1]):
            v, thickness_mm = surface[j, i], undeformed_mm[j, i]
            area2 = normal_times_area(v, across)
            trace = 0.0
            for k in range(3):
                offset = 0.5 * thickness_mm * across[k] / area2
                faces.upper_mm[j, i, k] = v[0, k] + offset
                faces.lower_mm[j, i, k] = v[0, k] - offset
                trace += v[1, k] * v[1, k] + v[2, k] * v[2, k]
            larger = 0.5 * trace + np.sqrt(max(0.25 * trace * trace - area2, 0.0))
            faces.thickness_mm[j, i] = thickness_mm / np.sqrt(area2)
            faces.stretch[j, i, 0] = np.sqrt(larger)
            faces.stretch[j, i, 1] = np.sqrt(area2 / larger)


@inlined
def normal_times_area(v: FloatArray, across: FloatArray) -> float:
    """Write the normal times the area stretch to `across`; return the squared area stretch."""
    across[0] = v[1, 1] * v[2, 2] - v[1, 2] * v[2, 1]
    across[1] = v[1, 2] * v[2, 0] - v[1, 0] * v[2, 2]
    across[2] = v[1, 0] * v[2, 1] - v[1, 1] * v[2, 0]
    area2: float = across[0] * across[0] + across[1] * across[1] + across[2] * across[2]
    return area2
