"""Rays against a sheet that is a grid of heights: marched, and exact against its facets.

A pressed face is z = h(x, y) over a rectangle, two facets to a cell. Such a sheet is searched with
a few look-ups per ray, all lanes side by side, where a tree of boxes has to be built first and is
walked down twenty levels ray by ray. Two questions are answered for most rays at once:

`is_free`: does a ray from a point of the sheet leave it for good? While the ray climbs faster than
the steepest facet of the blocks of cells around the point, it stays above them (as in
`height_grid.shades_itself`). From there it goes on block by block, and is free in each whose
highest vertex, and that of the blocks beside, lies below it; it is out where it is above the whole
sheet or beyond its border.

`first_hit`: where does a ray from above first meet the sheet? Newton's method: the ray meets the
plane of a facet, there lies the next facet, until a facet holds the point where its own plane is
met. That point is on the sheet; it is the first one if the way back is free, the question above.

The others, beside walls and outside the border, are walked from facet to facet (`_walk`), and meet
the sheet where their height above it changes its sign. That height is carried from one facet to the
next, so that no ray slips between the two. The answer is a tree's for every ray, but for rounding.

Positions on the grid are in cells: x along a row of vertices, y along a column.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from reconstruction.arrays import FloatArray
from twin.optics.height_grid import is_even, steepest_by_cell

_BLOCK = 8
"""Cells along the side of a block."""

_TURNS = 12
"""Newton's steps; on a smooth relief two or three are enough."""

# A ray that falls less than this per mm against a facet grazes it: the tree decides.
_GRAZING = 1e-3
# Facets whose planes a ray meets this close together are met at their common edge.
_SAME_MM = 1e-6
# So far above and below the sheet rays are walked: no vertex lies there.
_BESIDE_MM = 0.01
# Slopes and climbs are rounded.
_STEEPER = 1.0 + 1e-4


@dataclass(frozen=True, eq=False)
class MarchedHeights:
    """A sheet on the device.

    Attributes
    ----------
    corner_mm, cells_per_mm : x and y of vertex (0, 0), and the grid's density
    cols, last : vertices in a row; position of the last vertex along x and y
    z_mm : of all vertices, row by row
    lowest_mm, middle_mm, highest_mm : height of the lowest vertex, halfway, and of the highest
    steepest, tops : by block, row by row: steepest facet and highest vertex of it and of the eight
        blocks around it
    block_cols : blocks in a row
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
        """Take vertices (row, col, xyz) to the device; None where the grid is not even."""
        if not is_even(grid):
            return None
        rows, cols = grid.shape[:2]
        x_mm, y_mm, z_mm = grid[0, :, 0], grid[:, 0, 1], grid[..., 2]
        density = [(len(one) - 1) / (one[-1] - one[0]) for one in (x_mm, y_mm)]
        cells = np.stack([z_mm[:-1, :-1], z_mm[:-1, 1:], z_mm[1:, :-1], z_mm[1:, 1:]]).max(axis=0)
        tops = _around(cells)
        return cls(
            corner_mm=(_number(x_mm[0]), _number(y_mm[0])),
            cells_per_mm=(_number(density[0]), _number(density[1])),
            cols=dr.opaque(mi.UInt32, cols),
            last=(_number(cols - 1), _number(rows - 1)),
            z_mm=mi.Float(z_mm.astype(np.float32).ravel()),
            lowest_mm=_number(z_mm.min()),
            middle_mm=_number((z_mm.min() + z_mm.max()) / 2.0),
            highest_mm=_number(z_mm.max()),
            steepest=mi.Float(_around(steepest_by_cell(grid)).astype(np.float32).ravel()),
            tops=mi.Float(tops.astype(np.float32).ravel()),
            block_cols=dr.opaque(mi.UInt32, tops.shape[1]),
        )

    def is_free(self, point_mm: Any, direction: Any, active: Any) -> Any:
        """Tell of which points of the sheet it is sure that nothing of it lies ahead, `mi.Bool`.

        Parameters
        ----------
        point_mm : `mi.Point3f` on the sheet
        direction : `mi.Vector3f`, unit; upward, or nothing is sure
        active : which are asked
        """
        track = self._track(point_mm, direction)
        level = dr.sqrt(direction.x * direction.x + direction.y * direction.y)
        steepest = dr.gather(mi.Float, self.steepest, self._block(track.at(0.0)), active)
        # So far along either axis that the block that it begins in, and those beside, hold it.
        stride_mm = _BLOCK / dr.maximum(dr.maximum(dr.abs(track.dx), dr.abs(track.dy)), 1e-6)

        def height_mm(way_mm: Any) -> Any:
            return dr.fma(way_mm, direction.z, point_mm.z)

        def ahead(way_mm: Any, free: Any) -> Any:
            return free & self._inside(track.at(way_mm)) & (height_mm(way_mm) <= self.highest_mm)

        def stride(way_mm: Any, free: Any) -> tuple[Any, Any]:
            top_mm = dr.gather(mi.Float, self.tops, self._block(track.at(way_mm)))
            return way_mm + stride_mm, free & (height_mm(way_mm) > top_mm)

        start = stride_mm, active & (direction.z > steepest * level * _STEEPER)
        return dr.while_loop(start, ahead, stride)[1]

    def first_hit(self, shape: Any, ray: Any) -> Any:
        """Return what rays first meet, `mi.PreliminaryIntersection3f`.

        Parameters
        ----------
        shape : `mi.ShapePtr`, the sheet
        """
        met, sure = self.met_at_once(ray)
        walked = self._met_on_the_way(ray, ~sure)
        found = dr.select(sure, met, walked)
        found.shape = dr.select(found.valid, shape, dr.zeros(mi.ShapePtr))
        return found

    def met_at_once(self, ray: Any) -> tuple[Any, Any]:
        """Return where rays from above meet the sheet, without its shape, and which are sure."""
        met = self._meet(ray)
        return met, self.is_free(ray(met.t), -ray.d, met.valid & (met.t < ray.maxt))

    def is_crossed(self, ray: Any, active: Any) -> Any:
        """Tell which rays meet the sheet before their end, from whichever side, `mi.Bool`."""
        ends = mi.Float(0.0), ray.maxt
        return self._walk(self._track(ray.o, ray.d), (ray.o.z, ray.d.z), ends, active)[2]

    def _met_on_the_way(self, ray: Any, active: Any) -> Any:
        """Return where rays meet the sheet, facet by facet; not valid where they do not."""
        base_mm, height_mm = self._base(ray)
        track = self._track(ray(base_mm), ray.d)
        ends = -base_mm, ray.maxt - base_mm
        way_mm, facet, crosses = self._walk(track, (height_mm, ray.d.z), ends, active)
        met = dr.zeros(mi.PreliminaryIntersection3f)
        met.t = dr.select(crosses, base_mm + way_mm, dr.inf)
        met.prim_index, met.prim_uv = self._on_mesh(facet, track.at(way_mm))
        met.valid = crosses
        return met

    def _walk(
        self, track: "_Track", height: tuple[Any, Any], ends_mm: tuple[Any, Any], active: Any
    ) -> tuple[Any, "_Facet", Any]:
        """Go from facet to facet; return the way to the first that is met, it, and which are.

        Parameters
        ----------
        height : world z at way 0, mm, and its change per mm of the way
        ends_mm : of the way that is searched
        """
        high_mm, climb = height
        over = (self.lowest_mm - _BESIDE_MM, self.highest_mm + _BESIDE_MM)
        spans = (
            _within(track.x, track.dx, (0.0, self.last[0])),
            _within(track.y, track.dy, (0.0, self.last[1])),
            _within(high_mm, climb, over),
        )
        start_mm, end_mm = ends_mm
        for first, last in spans:
            start_mm, end_mm = dr.maximum(start_mm, first), dr.minimum(end_mm, last)

        def gap_mm(facet: "_Facet", way_mm: Any) -> Any:
            return dr.fma(way_mm, climb, high_mm) - self._plane(facet, track.at(way_mm))[0]

        def step(way_mm: Any, gap: Any, facet: Any, _going: Any, _met: Any) -> tuple[Any, ...]:
            end, beyond = track.leaves(facet)
            next_mm = dr.maximum(way_mm, dr.minimum(end, end_mm))
            next_gap = gap_mm(facet, next_mm)
            met = (next_gap > 0.0) != (gap > 0.0)
            share = dr.select(met, gap / (gap - next_gap), 1.0)
            goes_on = ~met & (end < end_mm) & self._has(beyond)
            facet = tuple(
                dr.select(goes_on, one, other) for one, other in zip(beyond, facet, strict=True)
            )
            return dr.fma(share, next_mm - way_mm, way_mm), next_gap, facet, goes_on, met

        going = active & (start_mm < end_mm)
        start_mm = dr.select(going, start_mm, 0.0)
        facet = self._facet(track.at(start_mm))
        state = start_mm, gap_mm(facet, start_mm), facet, going, mi.Bool(False)
        way_mm, _, facet, _, met = dr.while_loop(
            state, lambda _way, _gap, _facet, going, _met: going, step
        )
        return way_mm, facet, met

    def _base(self, ray: Any) -> tuple[Any, Any]:
        """Return the way of rays from above to the plane at middle height, and their height there.

        From there on all ways are short and well resolved. Of other rays, their start.
        """
        falls = self._falls(ray)
        base_mm = dr.select(falls, (self.middle_mm - ray.o.z) / ray.d.z, 0.0)
        return base_mm, dr.select(falls, self.middle_mm, ray.o.z)

    def _falls(self, ray: Any) -> Any:
        return (ray.o.z > self.highest_mm) & (ray.d.z < -_GRAZING)

    def _has(self, facet: "_Facet") -> Any:
        """Tell whether the sheet has cells of such a column and row."""
        col, row, _ = facet
        return (col >= 0.0) & (col < self.last[0]) & (row >= 0.0) & (row < self.last[1])

    def _meet(self, ray: Any) -> Any:
        """Return where rays from above meet the sheet; not valid where that is not found."""
        falls = self._falls(ray)
        to_middle_mm, _ = self._base(ray)
        track = self._track(ray(to_middle_mm), ray.d)

        def step(turn: Any, way_mm: Any, facet: Any, _going: Any, _good: Any) -> tuple[Any, ...]:
            z_mm, slope_x, slope_y = self._plane(facet, track.at(way_mm))
            closing = slope_x * track.dx + slope_y * track.dy - ray.d.z
            good = closing > _GRAZING
            gap_mm = dr.fma(way_mm, ray.d.z, self.middle_mm) - z_mm
            further_mm = dr.select(good, gap_mm / closing, 0.0)
            here = self._facet(track.at(way_mm + further_mm))
            same = _equal(here, facet) | (dr.abs(further_mm) < _SAME_MM)
            return turn + 1, way_mm + further_mm, here, good & ~same, good & same

        start = mi.UInt32(0), mi.Float(0.0), self._facet(track.at(0.0)), falls, mi.Bool(False)
        _, way_mm, facet, _, good = dr.while_loop(
            start, lambda turn, _way, _facet, going, _good: going & (turn < _TURNS), step
        )
        place = track.at(way_mm)
        met = dr.zeros(mi.PreliminaryIntersection3f)
        met.t = to_middle_mm + way_mm
        met.prim_index, met.prim_uv = self._on_mesh(facet, place)
        met.valid = good & self._inside(place)
        return met

    def _track(self, start_mm: Any, direction: Any) -> "_Track":
        """Return the vertical view of a ray."""
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
        """Index of the block at a place, or of the nearest one."""
        col, row = self._cell(place)
        return dr.fma(mi.UInt32(row) // _BLOCK, self.block_cols, mi.UInt32(col) // _BLOCK)

    def _cell(self, place: "_Place") -> "_Place":
        """Column and row of the cell at a place, or of the nearest one, whole numbers."""
        # Half a cell before the last vertex is in the last cell, the vertex itself is not.
        col, row = (
            dr.floor(dr.clip(one, 0.0, end - 0.5))
            for one, end in zip(place, self.last, strict=True)
        )
        return col, row

    def _facet(self, place: "_Place") -> "_Facet":
        col, row = self._cell(place)
        return col, row, place[1] - row > place[0] - col

    def _plane(self, facet: "_Facet", place: "_Place") -> tuple[Any, Any, Any]:
        """Height of a facet's plane at a place, and its slopes, mm per cell."""
        col, row, second = facet
        vertex = dr.fma(mi.UInt32(row), self.cols, mi.UInt32(col))
        beside = vertex + dr.select(second, self.cols, 1)
        corners = vertex, beside, vertex + self.cols + 1
        first_mm, beside_mm, last_mm = (dr.gather(mi.Float, self.z_mm, at) for at in corners)
        one, other = beside_mm - first_mm, last_mm - beside_mm
        slope_x, slope_y = dr.select(second, other, one), dr.select(second, one, other)
        x, y = place
        return dr.fma(x - col, slope_x, dr.fma(y - row, slope_y, first_mm)), slope_x, slope_y

    def _on_mesh(self, facet: "_Facet", place: "_Place") -> tuple[Any, Any]:
        """Return the number of a facet, as `grid_facets` counts, and its coordinates of a place."""
        col, row, second = facet
        number = 2 * dr.fma(mi.UInt32(row), self.cols - 1, mi.UInt32(col))
        x, y = (
            dr.clip(one - begin, 0.0, 1.0) for one, begin in zip(place, (col, row), strict=True)
        )
        u, v = dr.select(second, x, x - y), dr.select(second, y - x, y)
        return number + dr.select(second, 1, 0), mi.Point2f(dr.maximum(u, 0.0), dr.maximum(v, 0.0))


_Place = tuple[Any, Any]
_Facet = tuple[Any, Any, Any]
"""Column and row of its cell, whole numbers, and whether it is the second one there."""


class _Track(NamedTuple):
    """A ray seen from above: where it starts, and how far it goes per mm of the ray."""

    x: Any
    y: Any
    dx: Any
    dy: Any

    def at(self, way_mm: Any) -> _Place:
        return dr.fma(way_mm, self.dx, self.x), dr.fma(way_mm, self.dy, self.y)

    def leaves(self, facet: _Facet) -> tuple[Any, _Facet]:
        """Return the way to where it leaves a facet, and the facet behind that edge."""
        col, row, second = facet
        to_x, to_y = _to_line(self.x - col, self.dx), _to_line(self.y - row, self.dy)
        # The diagonal, where both coordinates within the cell are the same.
        apart, closing = (self.y - row) - (self.x - col), self.dx - self.dy
        towards = dr.select(second, closing > 0.0, closing < 0.0)
        to_diagonal = dr.select(towards, apart / closing, dr.inf)
        end_mm = dr.minimum(dr.minimum(to_x, to_y), to_diagonal)
        inner, along_x = to_diagonal <= end_mm, to_x <= to_y
        right, up = self.dx > 0.0, self.dy > 0.0
        beyond_col = col + dr.select(~inner & along_x, dr.select(right, 1.0, -1.0), 0.0)
        beyond_row = row + dr.select(~inner & ~along_x, dr.select(up, 1.0, -1.0), 0.0)
        # Through its left side a cell is entered in the second facet, from below in the first.
        beyond = dr.select(inner, ~second, dr.select(along_x, right, ~up))
        return end_mm, (beyond_col, beyond_row, beyond)


def _to_line(within: Any, speed: Any) -> Any:
    """Return the way to a cell's side from a coordinate within it, infinite along the side."""
    side = dr.select(speed > 0.0, 1.0, 0.0)
    return dr.select(speed == 0.0, dr.inf, (side - within) / speed)


def _within(start: Any, speed: Any, ends: tuple[Any, Any]) -> tuple[Any, Any]:
    """Return the ways between which a coordinate lies between two ends; crossed where never."""
    first, last = ((end - start) / speed for end in ends)
    still, inside = speed == 0.0, (start >= ends[0]) & (start <= ends[1])
    enters = dr.select(still, dr.select(inside, -dr.inf, dr.inf), dr.minimum(first, last))
    leaves = dr.select(still, dr.select(inside, dr.inf, -dr.inf), dr.maximum(first, last))
    return enters, leaves


def _number(value: float) -> Any:
    """Return a number of a face: opaque, as it must not be part of the kernel's code."""
    return dr.opaque(mi.Float, float(value))


def _equal(one: _Facet, other: _Facet) -> Any:
    return (one[0] == other[0]) & (one[1] == other[1]) & (one[2] == other[2])


def _around(cells: FloatArray) -> FloatArray:
    """Return the largest value by block of cells and the eight blocks around it."""
    rows, cols = (-(-size // _BLOCK) * _BLOCK for size in cells.shape)
    padded = np.full((rows, cols), -np.inf)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    blocks = padded.reshape(rows // _BLOCK, _BLOCK, -1, _BLOCK).max(axis=(1, 3))
    wide = np.pad(blocks, 1, constant_values=-np.inf)
    return np.asarray(sliding_window_view(wide, (3, 3)).max(axis=(2, 3)))
