"""Pressed faces as grids of heights: detection, slopes, and a test for cast shadows.

A face z = h(x, y) over a rectangle has two facets per cell, as `grid_facets` lists them.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compiling import Function, compile_and_keep, digest_of_sources
from twin.mechanics.relief import FaceGrid
from twin.specimens.solids import grid_facets

if TYPE_CHECKING:
    import trimesh

BLOCK = 8
"""Number of cells along each side of a block."""

_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, ("height_grid.py",))
# Without fused multiply-add, slopes are those of array arithmetic to the last digit.
_OPTIONS: dict[str, Any] = {"nogil": True, "_nrt": False, "error_model": "numpy"}


def _compiled(function: Function) -> Function:
    return compile_and_keep(function, _OPTIONS, _SOURCE_DIGEST)


# Largest deviation of a grid line from its position on a uniform grid, in cells.
_UNEVEN_CELLS = 1e-3


def height_grid(face: "trimesh.Trimesh | FaceGrid") -> FloatArray | None:
    """Return the face's vertices (row, col, xyz), mm, rounded to float32 as by the renderer.

    Returns None if the face is no height grid, that is, no function z(x, y) on a rectangle. In a
    height grid, vertex row * cols + col is at (x[col], y[row]) with increasing x and y, and the
    facets are those of `grid_facets`.
    """
    if isinstance(face, FaceGrid):
        return face.grid if _is_growing(face.grid) else None
    vertices = np.asarray(face.vertices, np.float32).astype(np.float64)
    cols = int(np.count_nonzero(vertices[:, 1] == vertices[0, 1]))
    rows = len(vertices) // cols
    if min(rows, cols) < 2 or rows * cols != len(vertices):
        return None
    grid = vertices.reshape(rows, cols, 3)
    x_mm, y_mm = grid[0, :, 0], grid[:, 0, 1]
    on_lines = np.all(grid[..., 0] == x_mm) and np.all(grid[..., 1] == y_mm[:, None])
    regular = on_lines and np.array_equal(face.faces, grid_facets(rows, cols))
    return grid if regular and _is_growing(grid) else None


def _is_growing(grid: FloatArray) -> bool:
    """Return True if x increases along the rows of a grid (row, col, xyz), and y along columns."""
    lines = grid[0, :, 0], grid[:, 0, 1]
    return all(bool(np.all(np.diff(of) > 0.0)) for of in lines)


def is_even(grid: FloatArray) -> bool:
    """Return True if the lines of a grid (row, col, xyz) are equidistant along x and along y.

    Only then can rays be marched over the grid, which `MarchedHeights` treats as uniform.
    """
    for lines in (grid[0, :, 0], grid[:, 0, 1]):
        place = (lines - lines[0]) * (len(lines) - 1) / (lines[-1] - lines[0])
        if np.abs(place - np.arange(len(lines))).max() > _UNEVEN_CELLS:
            return False
    return True


class BlockExtremes(NamedTuple):
    """Extremes of a height grid in blocks of `BLOCK` x `BLOCK` cells, (row, col) of the block.

    Attributes
    ----------
    tops_mm : height of the highest vertex
    steepest : slope of the steepest facet, mm per mm
    """

    tops_mm: FloatArray
    steepest: FloatArray


def blocks_of(grid: FloatArray) -> BlockExtremes:
    """Return the extremes of a grid (row, col, xyz), mm, in its blocks of cells."""
    size = tuple(-(-(length - 1) // BLOCK) for length in grid.shape[:2])
    tops_mm, square = np.full(size, -np.inf), np.zeros(size)
    widths = np.diff(grid[0, :, 0]), np.diff(grid[:, 0, 1])
    _fill_blocks(np.ascontiguousarray(grid[..., 2]), *widths, tops_mm, square)
    return BlockExtremes(tops_mm, np.sqrt(square))


@_compiled
def _fill_blocks(z_mm: Any, wide_mm: Any, high_mm: Any, tops_mm: Any, square: Any) -> None:
    """Fill the highest height of each block of cells, and the largest square of a facet's slope.

    A facet's slope, in mm per mm, follows from its two edges along x and along y. The two facets of
    a cell have the edges (lower row, right column) and (upper row, left column).

    Parameters
    ----------
    wide_mm, high_mm : widths of the columns of cells, and heights of the rows
    """
    for row in range(high_mm.size):
        lower, upper, tall = z_mm[row], z_mm[row + 1], high_mm[row]
        for col in range(wide_mm.size):
            a, b, c, d = lower[col], lower[col + 1], upper[col], upper[col + 1]
            along_lower, along_upper = (b - a) / wide_mm[col], (d - c) / wide_mm[col]
            up_left, up_right = (c - a) / tall, (d - b) / tall
            first = along_lower * along_lower + up_right * up_right
            second = along_upper * along_upper + up_left * up_left
            at = row // BLOCK, col // BLOCK
            square[at] = max(square[at], first, second)
            tops_mm[at] = max(tops_mm[at], a, b, c, d)


def shades_itself(grid: FloatArray, source_mm: FloatArray) -> bool:
    """Return False if a sheet provably casts no shadow on itself in light from a point.

    Where facets climb at most s per mm, the sheet rises at most s d over a horizontal distance d,
    by the mean value theorem along the line between two points, facet by facet. A ray that climbs
    m > s per mm from a point of the sheet is above the sheet everywhere. Towards the light at q,
    m is smallest for a point at the largest height and in the corner furthest from the light:

        m >= (q_z - max z) / max |q_xy - corner|

    Parameters
    ----------
    grid : vertices (row, col, xyz), mm
    source_mm : (3,) float; world position of the light, mm
    """
    corners_mm = grid[:: len(grid) - 1, :: grid.shape[1] - 1, :2].reshape(-1, 2)
    furthest_mm = np.linalg.norm(corners_mm - source_mm[:2], axis=-1).max()
    climb = float(source_mm[2] - grid[..., 2].max()) / furthest_mm
    return bool(climb <= blocks_of(grid).steepest.max())
