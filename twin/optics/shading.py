"""Where on a face light may be blocked: proven, so that shadow rays are traced there alone.

Two proofs, for a sheet z = h(x, y) over a rectangle and a light at a point q above it.

That a gentle relief cannot shade itself at all: where facets climb at most s per mm, the sheet
rises at most s d over a horizontal distance d (mean value theorem along the line between the two
points, facet by facet). A ray that climbs m > s per mm from a point of the sheet stays above it for
ever after. Towards q, m is smallest at the highest point and in the corner furthest from it:

    m >= (q_z - max z) / max |q_xy - corner|

Where a steep one can: seen from q, the sheet is a map onto the plane,
(X, Y) = (p_xy - q_xy) / (q_z - p_z). Where the sheet's border goes round an area there just once,
each place inside it is covered once more by facets that face the light than by facets that face
away, and outside it equally often (degree of a map). Light reaches the first of those that lie
behind one another: a point is in shadow only where its place is covered twice or more, and so by a
facet that faces away. Elsewhere no ray need be traced.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from twin.specimens.solids import grid_facets

if TYPE_CHECKING:
    import trimesh

_CELLS = 1024
# Of the area of a facet of the level sheet, seen from the light: less counts as facing away.
_GRAZING = 1e-4


@dataclass(frozen=True, eq=False)
class ShadedPlaces:
    """Places, seen from the light, that a facet facing away covers; on the device.

    Attributes
    ----------
    marked : cells of a square grid, row by row
    low, per_unit : of the grid: first corner, and cells per unit of X and Y
    """

    source_mm: tuple[float, float, float]
    marked: Any
    low: tuple[Any, Any]
    per_unit: tuple[Any, Any]

    @classmethod
    def of_cells(
        cls, marked: BoolArray, source_mm: FloatArray, low: FloatArray, per_unit: FloatArray
    ) -> "ShadedPlaces":
        """Take cells, (row, col) bool, to the device."""
        q = tuple(source_mm.tolist())
        # Opaque: numbers of a face, which must not be part of the kernel's code.
        corner, scale = (
            tuple(dr.opaque(mi.Float, float(one)) for one in pair) for pair in (low, per_unit)
        )
        cells = mi.UInt32(marked.ravel().astype(np.uint32))
        return cls((q[0], q[1], q[2]), cells, (corner[0], corner[1]), (scale[0], scale[1]))

    def may_be_dark(self, point_mm: Any) -> Any:
        """Tell of which points, `mi.Point3f`, a shadow ray has to be asked, `mi.Bool`."""
        x, y, z = self.source_mm
        below = dr.rcp(z - point_mm.z)
        col = ((point_mm.x - x) * below - self.low[0]) * self.per_unit[0]
        row = ((point_mm.y - y) * below - self.low[1]) * self.per_unit[1]
        last = float(_CELLS - 1)
        place = dr.fma(
            mi.UInt32(dr.clip(row, 0.0, last)), _CELLS, mi.UInt32(dr.clip(col, 0.0, last))
        )
        return dr.gather(mi.UInt32, self.marked, place) > 0


class SelfShading(NamedTuple):
    """Whether a face can shade itself at all, and where; `places` None: anywhere."""

    possible: bool
    places: ShadedPlaces | None = None


def shading_of(face: "trimesh.Trimesh", source_mm: FloatArray) -> SelfShading:
    """Tell where light from a point may be blocked by a face before it reaches the face.

    Parameters
    ----------
    face : world frame, mm
    source_mm : (3,) float; world position of the light, mm

    Returns
    -------
    What is proven; anywhere for every mesh that is not a grid of heights as `face_mesh` builds it,
    and for a source below the highest point
    """
    grid = _height_grid(face)
    if grid is None:
        return SelfShading(possible=True)
    if not _is_steep(grid, source_mm):
        return SelfShading(possible=False)
    return SelfShading(possible=True, places=_places(grid, source_mm))


def _places(grid: FloatArray, source_mm: FloatArray) -> ShadedPlaces | None:
    """Return where light may be blocked; None where the border does not allow to tell."""
    height_mm = source_mm[2] - grid[..., 2]
    if height_mm.min() <= 0.0:
        return None
    x_mm, y_mm = grid[0, :, 0], grid[:, 0, 1]
    seen = (x_mm - source_mm[0]) / height_mm, (y_mm - source_mm[1])[:, None] / height_mm
    if not _goes_round_once(seen):
        return None
    low = np.array([one.min() for one in seen])
    per_unit = _CELLS / (np.array([one.max() for one in seen]) - low)
    marked = _covered(seen, _facing_away(seen, x_mm, y_mm), low, per_unit)
    return ShadedPlaces.of_cells(marked, source_mm, low, per_unit)


_Seen = tuple[FloatArray, FloatArray]
"""X and Y of every vertex, (row, col) each."""


def _goes_round_once(seen: _Seen) -> bool:
    """Tell whether the sheet's border, seen from the light, goes round an area just once.

    Each side runs ahead faster than aside, so that two sides which share a corner meet there alone,
    and opposite sides lie apart.
    """
    x, y = seen
    along_x = ((x[row], y[row]) for row in (0, -1))
    along_y = ((y[:, col], x[:, col]) for col in (0, -1))
    straight = all(
        np.all(np.abs(np.diff(aside)) < np.diff(ahead)) for ahead, aside in (*along_x, *along_y)
    )
    apart = x[:, 0].max() < x[:, -1].min() and y[0].max() < y[-1].min()
    return bool(straight and apart)


def _facing_away(seen: _Seen, x_mm: FloatArray, y_mm: FloatArray) -> BoolArray:
    """Tell which cells (row, col) have a facet that does not face the light."""
    x, y = seen
    x_by_col, y_by_col = np.diff(x, axis=1), np.diff(y, axis=1)
    x_by_row, y_by_row = np.diff(x, axis=0), np.diff(y, axis=0)
    # The two facets of a cell: edges (lower row, right column) and (upper row, left column).
    first = x_by_col[:-1] * y_by_row[:, 1:] - y_by_col[:-1] * x_by_row[:, 1:]
    second = x_by_col[1:] * y_by_row[:, :-1] - y_by_col[1:] * x_by_row[:, :-1]
    level = np.ptp(x) / np.ptp(x_mm) * np.ptp(y) / np.ptp(y_mm)
    least = _GRAZING * level * np.outer(np.diff(y_mm), np.diff(x_mm))
    return np.asarray(np.minimum(first, second) <= least)


def _covered(seen: _Seen, away: BoolArray, low: FloatArray, per_unit: FloatArray) -> BoolArray:
    """Mark the grid's cells under the boxes round facets that face away, and those beside."""
    first, last = [], []
    for one, least, scale in zip(seen, low, per_unit, strict=True):
        corners = np.stack(
            [part[away] for part in (one[:-1, :-1], one[:-1, 1:], one[1:, :-1], one[1:, 1:])]
        )
        cells = np.floor((corners - least) * scale).astype(int)
        first.append(np.clip(cells.min(axis=0) - 1, 0, _CELLS - 1))
        last.append(np.clip(cells.max(axis=0) + 1, 0, _CELLS - 1) + 1)
    # Sums along both axes of +1 and -1 at the corners of each box count the boxes over a cell.
    count = np.zeros((_CELLS + 1, _CELLS + 1), np.int32)
    np.add.at(count, (first[1], first[0]), 1)
    np.add.at(count, (last[1], last[0]), 1)
    np.add.at(count, (first[1], last[0]), -1)
    np.add.at(count, (last[1], first[0]), -1)
    return np.asarray(count.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0)


def _is_steep(grid: FloatArray, source_mm: FloatArray) -> bool:
    """Tell whether the first proof fails."""
    corners_mm = grid[:: len(grid) - 1, :: grid.shape[1] - 1, :2].reshape(-1, 2)
    furthest_mm = np.linalg.norm(corners_mm - source_mm[:2], axis=-1).max()
    climb = float(source_mm[2] - grid[..., 2].max()) / furthest_mm
    return bool(climb <= _steepest_facet(grid))


def _height_grid(face: "trimesh.Trimesh") -> FloatArray | None:
    """Vertices (row, col, xyz) as the renderer rounds them; None if not a height grid.

    Vertex row * cols + col lies at (x[col], y[row]) with x and y growing, the facets are those of
    `grid_facets`: a graph over a rectangle.
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


def _steepest_facet(grid: FloatArray) -> float:
    """Largest slope of any facet: each has one edge along x and one along y."""
    z_mm = grid[..., 2]
    slope_x = np.diff(z_mm, axis=1) / np.diff(grid[0, :, 0])
    slope_y = np.diff(z_mm, axis=0) / np.diff(grid[:, 0, 1])[:, None]
    # The two facets of a cell: edges (lower row, right column) and (upper row, left column).
    first = slope_x[:-1] ** 2 + slope_y[:, 1:] ** 2
    second = slope_x[1:] ** 2 + slope_y[:, :-1] ** 2
    return float(np.sqrt(max(first.max(), second.max())))
