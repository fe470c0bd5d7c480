"""Pressed faces as grids of heights: detection, slopes, and a test for cast shadows.

A face z = h(x, y) over a rectangle has two facets per cell, as `grid_facets` lists them.
"""

from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray
from twin.specimens.solids import grid_facets

if TYPE_CHECKING:
    import trimesh

# Largest deviation of a grid line from its position on a uniform grid, in cells.
_UNEVEN_CELLS = 1e-3


def height_grid(face: "trimesh.Trimesh") -> FloatArray | None:
    """Return the face's vertices (row, col, xyz), mm, rounded to float32 as by the renderer.

    Returns None if the face is no height grid, that is, no function z(x, y) on a rectangle. In a
    height grid, vertex row * cols + col is at (x[col], y[row]) with increasing x and y, and the
    facets are those of `grid_facets`.
    """
    vertices = np.asarray(face.vertices, np.float32).astype(np.float64)
    cols = int(np.count_nonzero(vertices[:, 1] == vertices[0, 1]))
    rows = len(vertices) // cols
    if min(rows, cols) < 2 or rows * cols != len(vertices):
        return None
    grid = vertices.reshape(rows, cols, 3)
    x_mm, y_mm = grid[0, :, 0], grid[:, 0, 1]
    on_lines = np.all(grid[..., 0] == x_mm) and np.all(grid[..., 1] == y_mm[:, None])
    growing = np.all(np.diff(x_mm) > 0.0) and np.all(np.diff(y_mm) > 0.0)
    regular = on_lines and growing and np.array_equal(face.faces, grid_facets(rows, cols))
    return grid if regular else None


def is_even(grid: FloatArray) -> bool:
    """Return True if the lines of a grid (row, col, xyz) are equidistant along x and along y.

    Only then can rays be marched over the grid, which `MarchedHeights` treats as uniform.
    """
    for lines in (grid[0, :, 0], grid[:, 0, 1]):
        place = (lines - lines[0]) * (len(lines) - 1) / (lines[-1] - lines[0])
        if np.abs(place - np.arange(len(lines))).max() > _UNEVEN_CELLS:
            return False
    return True


def steepest_by_cell(grid: FloatArray) -> FloatArray:
    """Return the slope of the steeper of the two facets of each cell, (row, col).

    A facet's slope, in mm per mm, follows from its two edges along x and along y.
    """
    z_mm = grid[..., 2]
    slope_x = np.diff(z_mm, axis=1) / np.diff(grid[0, :, 0])
    slope_y = np.diff(z_mm, axis=0) / np.diff(grid[:, 0, 1])[:, None]
    # The two facets of a cell: edges (lower row, right column) and (upper row, left column).
    first = slope_x[:-1] ** 2 + slope_y[:, 1:] ** 2
    second = slope_x[1:] ** 2 + slope_y[:, :-1] ** 2
    return np.asarray(np.sqrt(np.maximum(first, second)))


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
    return bool(climb <= steepest_by_cell(grid).max())
