"""Intersection of rays with a sheet given as a grid of heights, exact for the facets of the grid.

A pressed face is z = h(x, y) over a rectangle, with two facets per cell. A few look-ups per ray
find an intersection. A tree of bounding boxes would have to be built first and has twenty levels.
Two methods are fast for most rays:

`is_free` returns whether a ray from a point of the sheet does not meet the sheet again. If the ray
is steeper than the steepest facet of the blocks of cells around the point, it is above them (as in
`height_grid.shades_itself`). Further along the ray, each block is compared: the ray does not meet
the sheet in a block if it is above the highest vertex of the block and of its neighbours. The
comparison ends if the ray is above the whole sheet or outside its border.

`first_hit` returns the first intersection of a ray from above with the sheet, by Newton's method.
The intersection with the plane of a facet determines the next facet, until the facet contains the
intersection with its own plane. This point is on the sheet. It is the first intersection if
`is_free` returns True for the reversed ray from the point.

All remaining rays, near steep walls and outside the border, are marched from facet to facet
(`_walk`). They meet the sheet where their height above the sheet changes sign. The height at the
common edge of two facets is computed once, so that no ray passes between the two facets. Results
equal those of a tree except for rounding.

Positions on the grid are in cells: x along a row of vertices, y along a column.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from reconstruction.arrays import FloatArray
from twin.optics.height_grid import BLOCK, blocks_of, is_even

_TURNS = 12
"""Largest number of Newton steps; a smooth relief needs two or three."""

# Rays that approach a facet by less than this per mm are grazing: they are marched.
_GRAZING = 1e-3
# Two intersections closer than this are the same: on the common edge of two facets.
_SAME_MM = 1e-6
# Margin of marching above and below the sheet, outside the heights of all vertices.
_MARGIN_MM = 0.01
# Margin for the rounding of slopes.
_STEEPER = 1.0 + 1e-4


@dataclass(frozen=True, eq=False)
class MarchedHeights:
    """Height grid of a sheet on the computing device, with the intersections of rays with it.

    Attributes
    ----------
    corner_mm, cells_per_mm : position of vertex (0, 0), and cells per mm; each along x and y
    cols, last : number of vertices in a row; position of the last vertex along x and y, in cells
    z_mm : height of every vertex, row by row
    lowest_mm, highest_mm, middle_mm : lowest and highest height of all vertices, and their mean
    steepest, tops : for each block, row by row: slope of the steepest facet and height (mm) of the
        highest vertex, in the block and in the eight blocks around it
    block_cols : number of blocks in a row
    """

    corner_mm: tuple[Any, Any]
    cells_per_mm: tuple[Any, Any]
    cols: Any
    last: tuple[Any, Any]
    z_mm: Any
    lowest_mm: Any
    middle_mm: Any
    highest_mm: Any
    steepest: Any
    tops: Any
    block_cols: Any

    @classmethod
    def of_grid(cls, grid: FloatArray) -> "MarchedHeights | None":
        """Return the sheet with vertices (row, col, xyz), mm; None if the grid is not uniform."""
        if not is_even(grid):
            return None
        rows, cols = grid.shape[:2]
        x_mm, y_mm, z_mm = grid[0, :, 0], grid[:, 0, 1], grid[..., 2]
        density = [(len(axis) - 1) / (axis[-1] - axis[0]) for axis in (x_mm, y_mm)]
        blocks = blocks_of(grid)
        tops = _around(blocks.tops_mm)
        return cls(
            corner_mm=(_number(x_mm[0]), _number(y_mm[0])),
            cells_per_mm=(_number(density[0]), _number(density[1])),
            cols=dr.opaque(mi.UInt32, cols),
            last=(_number(cols - 1), _number(rows - 1)),
            z_mm=mi.Float(z_mm.astype(np.float32).ravel()),
            lowest_mm=_number(z_mm.min()),
            middle_mm=_number((z_mm.min() + z_mm.max()) / 2.0),
            highest_mm=_number(z_mm.max()),
            steepest=mi.Float(_around(blocks.steepest).astype(np.float32).ravel()),
            tops=mi.Float(tops.astype(np.float32).ravel()),
            block_cols=dr.opaque(mi.UInt32, tops.shape[1]),
        )

    def is_free(self, point_mm: Any, direction: Any, active: Any) -> Any:
        """Return True where a ray from the sheet certainly does not meet it again, `mi.Bool`.

        Parameters
        ----------
        point_mm : `mi.Point3f`; start of the ray on the sheet
        direction : `mi.Vector3f`, unit; if it is not upward, the result is False
        active : lanes to be tested; in all other lanes the result is False
        """
        track = self._track(point_mm, direction)
        level = dr.sqrt(direction.x * direction.x + direction.y * direction.y)
        steepest = dr.gather(mi.Float, self.steepest, self._block(track.at(0.0)), active)
        # At most a block along each axis: the ray remains in the block or in its neighbours.
        stride_mm = BLOCK / dr.maximum(dr.maximum(dr.abs(track.dx), dr.abs(track.dy)), 1e-6)

        def height_mm(distance_mm: Any) -> Any:
            return dr.fma(distance_mm, direction.z, point_mm.z)

        def ahead(distance_mm: Any, free: Any) -> Any:
            return (
                free
                & self._inside(track.at(distance_mm))
                & (height_mm(distance_mm) <= self.highest_mm)
            )

        def stride(distance_mm: Any, free: Any) -> tuple[Any, Any]:
            top_mm = dr.gather(mi.Float, self.tops, self._block(track.at(distance_mm)))
            return distance_mm + stride_mm, free & (height_mm(distance_mm) > top_mm)

        start = stride_mm, active & (direction.z > steepest * level * _STEEPER)
        return dr.while_loop(start, ahead, stride)[1]

    def first_hit(self, shape: Any, ray: Any) -> Any:
        """Return the first intersection of rays with the sheet, `mi.PreliminaryIntersection3f`.

        Parameters
        ----------
        shape : `mi.ShapePtr`, the sheet
        """
        newton, sure = self.newton_hit(ray)
        met = dr.select(sure, newton, self._marched_hit(ray, ~sure))
        met.shape = dr.select(met.valid, shape, dr.zeros(mi.ShapePtr))
        return met

    def newton_hit(self, ray: Any) -> tuple[Any, Any]:
        """Return hits of rays from above, by Newton's method, and whether each is the ray's first.

        The second value is True only if that is certain. The field `shape` of the hits is not set.
        """
        met = self._meet(ray)
        return met, self.is_free(ray(met.t), -ray.d, met.valid & (met.t < ray.maxt))

    def is_crossed(self, ray: Any, active: Any) -> Any:
        """Return True for rays that meet the sheet before `ray.maxt`, from above or below."""
        ends = mi.Float(0.0), ray.maxt
        return self._walk(self._track(ray.o, ray.d), (ray.o.z, ray.d.z), ends, active)[2]

    def _marched_hit(self, ray: Any, active: Any) -> Any:
        """Return the intersections of rays, marched facet by facet; not valid if there is none."""
        base_mm, height_mm = self._base(ray)
        track = self._track(ray(base_mm), ray.d)
        ends = -base_mm, ray.maxt - base_mm
        distance_mm, facet, crosses = self._walk(track, (height_mm, ray.d.z), ends, active)
        met = dr.zeros(mi.PreliminaryIntersection3f)
        met.t = dr.select(crosses, base_mm + distance_mm, dr.inf)
        met.prim_index, met.prim_uv = self._on_mesh(facet, track.at(distance_mm))
        met.valid = crosses
        return met

    def _walk(
        self, track: "_Track", height: tuple[Any, Any], ends_mm: tuple[Any, Any], active: Any
    ) -> tuple[Any, "_Facet", Any]:
        """March rays from facet to facet; return distance, facet and existence of the first hit.

        Parameters
        ----------
        track : projection of the ray onto the grid
        height : world z of the ray at distance 0, mm, and its change per mm of distance
        ends_mm : range of distances along the ray that is searched
        active : lanes to be marched
        """
        high_mm, climb = height
        over = (self.lowest_mm - _MARGIN_MM, self.highest_mm + _MARGIN_MM)
        spans = (
            _within(track.x, track.dx, (0.0, self.last[0])),
            _within(track.y, track.dy, (0.0, self.last[1])),
            _within(high_mm, climb, over),
        )
        start_mm, end_mm = ends_mm
        for first, last in spans:
            start_mm, end_mm = dr.maximum(start_mm, first), dr.minimum(end_mm, last)

        def gap_mm(facet: "_Facet", distance_mm: Any) -> Any:
            return (
                dr.fma(distance_mm, climb, high_mm) - self._plane(facet, track.at(distance_mm))[0]
            )

        def step(distance_mm: Any, gap: Any, facet: Any, _going: Any, _met: Any) -> tuple[Any, ...]:
            end, beyond = track.exit_from(facet)
            next_mm = dr.maximum(distance_mm, dr.minimum(end, end_mm))
            next_gap = gap_mm(facet, next_mm)
            met = (next_gap > 0.0) != (gap > 0.0)
            share = dr.select(met, gap / (gap - next_gap), 1.0)
            goes_on = ~met & (end < end_mm) & self._has(beyond)
            facet = tuple(
                dr.select(goes_on, new, old) for new, old in zip(beyond, facet, strict=True)
            )
            return dr.fma(share, next_mm - distance_mm, distance_mm), next_gap, facet, goes_on, met

        going = active & (start_mm < end_mm)
        start_mm = dr.select(going, start_mm, 0.0)
        facet = self._facet(track.at(start_mm))
        state = start_mm, gap_mm(facet, start_mm), facet, going, mi.Bool(False)
        distance_mm, _, facet, _, met = dr.while_loop(
            state, lambda _way, _gap, _facet, going, _met: going, step
        )
        return distance_mm, facet, met

    def _base(self, ray: Any) -> tuple[Any, Any]:
        """Return the distance of rays from above to the plane at middle height, and their z there.

        Distances from this plane are short and therefore well resolved in single precision. For
        rays that do not come from above the sheet, returns 0 and the z of their origin.
        """
        from_above = self._comes_from_above(ray)
        base_mm = dr.select(from_above, (self.middle_mm - ray.o.z) / ray.d.z, 0.0)
        return base_mm, dr.select(from_above, self.middle_mm, ray.o.z)

    def _comes_from_above(self, ray: Any) -> Any:
        return (ray.o.z > self.highest_mm) & (ray.d.z < -_GRAZING)

    def _has(self, facet: "_Facet") -> Any:
        """Return True if the column and row of a facet's cell are on the sheet."""
        col, row, _ = facet
        return (col >= 0.0) & (col < self.last[0]) & (row >= 0.0) & (row < self.last[1])

    def _meet(self, ray: Any) -> Any:
        """Return hits of rays from above by Newton's method; not valid without convergence."""
        from_above = self._comes_from_above(ray)
        to_middle_mm, _ = self._base(ray)
        track = self._track(ray(to_middle_mm), ray.d)

        def step(
            turn: Any, distance_mm: Any, facet: Any, _going: Any, _good: Any
        ) -> tuple[Any, ...]:
            z_mm, slope_x, slope_y = self._plane(facet, track.at(distance_mm))
            closing = slope_x * track.dx + slope_y * track.dy - ray.d.z
            good = closing > _GRAZING
            gap_mm = dr.fma(distance_mm, ray.d.z, self.middle_mm) - z_mm
            further_mm = dr.select(good, gap_mm / closing, 0.0)
            here = self._facet(track.at(distance_mm + further_mm))
            same = _equal(here, facet) | (dr.abs(further_mm) < _SAME_MM)
            return turn + 1, distance_mm + further_mm, here, good & ~same, good & same

        start = mi.UInt32(0), mi.Float(0.0), self._facet(track.at(0.0)), from_above, mi.Bool(False)
        _, distance_mm, facet, _, good = dr.while_loop(
            start, lambda turn, _way, _facet, going, _good: going & (turn < _TURNS), step
        )
        place = track.at(distance_mm)
        met = dr.zeros(mi.PreliminaryIntersection3f)
        met.t = to_middle_mm + distance_mm
        met.prim_index, met.prim_uv = self._on_mesh(facet, place)
        met.valid = good & self._inside(place)
        return met

    def _track(self, start_mm: Any, direction: Any) -> "_Track":
        """Return the projection of a ray onto the grid."""
        return _Track(
            (start_mm.x - self.corner_mm[0]) * self.cells_per_mm[0],
            (start_mm.y - self.corner_mm[1]) * self.cells_per_mm[1],
            direction.x * self.cells_per_mm[0],
            direction.y * self.cells_per_mm[1],
        )

    def _inside(self, place: "_Place") -> Any:
        x, y = place
        return (x >= 0.0) & (x <= self.last[0]) & (y >= 0.0) & (y <= self.last[1])

    def _block(self, place: "_Place") -> Any:
        """Return the index of the block that contains a position, or of the nearest block."""
        col, row = self._cell(place)
        return dr.fma(mi.UInt32(row) // BLOCK, self.block_cols, mi.UInt32(col) // BLOCK)

    def _cell(self, place: "_Place") -> "_Place":
        """Return column and row (whole numbers) of the cell at a position, or of the nearest."""
        # Half a cell before the last vertex is in the last cell, the vertex itself is not.
        col, row = (
            dr.floor(dr.clip(value, 0.0, end - 0.5))
            for value, end in zip(place, self.last, strict=True)
        )
        return col, row

    def _facet(self, place: "_Place") -> "_Facet":
        col, row = self._cell(place)
        return col, row, place[1] - row > place[0] - col

    def _plane(self, facet: "_Facet", place: "_Place") -> tuple[Any, Any, Any]:
        """Return the height (mm) of a facet's plane at a position, and its slopes, mm per cell."""
        col, row, second = facet
        vertex = dr.fma(mi.UInt32(row), self.cols, mi.UInt32(col))
        corner = vertex + dr.select(second, self.cols, 1)
        corners = vertex, corner, vertex + self.cols + 1
        first_mm, corner_mm, last_mm = (dr.gather(mi.Float, self.z_mm, at) for at in corners)
        rise, next_rise = corner_mm - first_mm, last_mm - corner_mm
        slope_x, slope_y = dr.select(second, next_rise, rise), dr.select(second, rise, next_rise)
        x, y = place
        return dr.fma(x - col, slope_x, dr.fma(y - row, slope_y, first_mm)), slope_x, slope_y

    def _on_mesh(self, facet: "_Facet", place: "_Place") -> tuple[Any, Any]:
        """Return a facet's index in `grid_facets`, and barycentric u, v of a position on it."""
        col, row, second = facet
        number = 2 * dr.fma(mi.UInt32(row), self.cols - 1, mi.UInt32(col))
        x, y = (
            dr.clip(value - begin, 0.0, 1.0) for value, begin in zip(place, (col, row), strict=True)
        )
        u, v = dr.select(second, x, x - y), dr.select(second, y - x, y)
        return number + dr.select(second, 1, 0), mi.Point2f(dr.maximum(u, 0.0), dr.maximum(v, 0.0))


_Place = tuple[Any, Any]
_Facet = tuple[Any, Any, Any]
"""Facet: column and row of its cell (whole numbers), and True for the second facet of the cell."""


class _Track(NamedTuple):
    """Projection of a ray onto the grid: start (x, y), cells, and (dx, dy), cells per mm of ray."""

    x: Any
    y: Any
    dx: Any
    dy: Any

    def at(self, distance_mm: Any) -> _Place:
        return dr.fma(distance_mm, self.dx, self.x), dr.fma(distance_mm, self.dy, self.y)

    def exit_from(self, facet: _Facet) -> tuple[Any, _Facet]:
        """Return the distance (mm) at which a ray exits a facet, and the facet that follows."""
        col, row, second = facet
        to_x, to_y = _to_line(self.x - col, self.dx), _to_line(self.y - row, self.dy)
        # The diagonal, on which both coordinates within the cell are equal.
        offset, closing = (self.y - row) - (self.x - col), self.dx - self.dy
        towards = dr.select(second, closing > 0.0, closing < 0.0)
        to_diagonal = dr.select(towards, offset / closing, dr.inf)
        end_mm = dr.minimum(dr.minimum(to_x, to_y), to_diagonal)
        inner, along_x = to_diagonal <= end_mm, to_x <= to_y
        right, up = self.dx > 0.0, self.dy > 0.0
        beyond_col = col + dr.select(~inner & along_x, dr.select(right, 1.0, -1.0), 0.0)
        beyond_row = row + dr.select(~inner & ~along_x, dr.select(up, 1.0, -1.0), 0.0)
        # A ray enters a cell in the second facet from the left, in the first facet from below.
        beyond = dr.select(inner, ~second, dr.select(along_x, right, ~up))
        return end_mm, (beyond_col, beyond_row, beyond)


def _to_line(within: Any, speed: Any) -> Any:
    """Return the distance (mm) at which a ray reaches a side of its cell; infinite if parallel.

    Parameters
    ----------
    within : coordinate of the ray's start in the cell, in cells
    speed : cells per mm of distance along the ray
    """
    side = dr.select(speed > 0.0, 1.0, 0.0)
    return dr.select(speed == 0.0, dr.inf, (side - within) / speed)


def _within(start: Any, speed: Any, ends: tuple[Any, Any]) -> tuple[Any, Any]:
    """Return the range of distances in which a coordinate is between `ends`.

    If there is no such distance, the first returned value is larger than the second.

    Parameters
    ----------
    start : coordinate at distance 0
    speed : change of the coordinate per mm of distance
    """
    first, last = ((end - start) / speed for end in ends)
    still, inside = speed == 0.0, (start >= ends[0]) & (start <= ends[1])
    enters = dr.select(still, dr.select(inside, -dr.inf, dr.inf), dr.minimum(first, last))
    leaves = dr.select(still, dr.select(inside, dr.inf, -dr.inf), dr.maximum(first, last))
    return enters, leaves


def _number(value: float) -> Any:
    """Return a number as an opaque variable, so that it is no literal of the kernel's code."""
    return dr.opaque(mi.Float, float(value))


def _equal(a: _Facet, b: _Facet) -> Any:
    return (a[0] == b[0]) & (a[1] == b[1]) & (a[2] == b[2])


def _around(blocks: FloatArray) -> FloatArray:
    """Return the largest value in each block and the eight blocks around it."""
    wide = np.pad(blocks, 1, constant_values=-np.inf)
    return np.asarray(sliding_window_view(wide, (3, 3)).max(axis=(2, 3)))
