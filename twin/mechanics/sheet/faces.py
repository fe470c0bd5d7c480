"""Compute both faces of the deformed sheet as height maps over x and y; z is in the solver's frame.

The sheet is sampled at points of its own surface, which are projected along z. Where it overhangs,
the highest of the points above (x, y) is used.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compiling import Function, compile_and_keep, digest_of_sources
from twin.mechanics.sheet.energy import Sheet, SheetState
from twin.mechanics.sheet.grid import SheetGrid
from twin.mechanics.sheet.splines import subdivided
from twin.mechanics.sheet.surface import faces_of

# As of `specimens.distance`: the same bytes on any type of CPU.
_OPTIONS = {"nogil": True, "_nrt": False, "error_model": "numpy"}
_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, ("faces.py",))
_FEWEST_PARTS, _MOST_PARTS = 2, 12
_DEGENERATE_MM2 = 1e-14
# Of the opening: material that an edge has drawn in is drawn up to this.
_UNDER_THE_FRAME = 1.001
#: of a step between nodes, and of a triangle's side: a point this near to an edge is on it
_ON = 1e-9


@dataclass(frozen=True, eq=False)
class Sampled:
    """The deformed sheet at a grid of its material points, in the solver's frame, mm."""

    #: (row, col, xy) positions on the mounted sheet
    material_mm: FloatArray
    #: (row, col, xyz) surface midway between the faces, and the faces
    middle_mm: FloatArray
    upper_mm: FloatArray
    lower_mm: FloatArray
    thickness_mm: FloatArray
    #: (row, col, 2) principal stretches, larger first
    stretch: FloatArray


def sample(sheet: Sheet, state: SheetState, pitch_mm: float) -> Sampled:
    """Sample the sheet at intervals of about `pitch_mm` or less.

    A cell is divided into 2 to 12 parts along each axis, so that intervals are longer in wide
    cells.
    """
    grid = sheet.grid
    x, y = _places(grid, pitch_mm)
    surface = grid.evaluate(state.control_mm, x, y)
    material_mm = grid.evaluate(grid.mounted_mm, x, y)[..., 0, :2]
    faces = faces_of(surface, sheet.laws.thickness_mm + grid.deviation_mm(material_mm))
    sampled = Sampled(
        material_mm=material_mm,
        middle_mm=surface[..., 0, :],
        **faces._asdict(),
    )
    return _with_margin(sampled) if grid.frame.rim_compliance_mm2_per_n else sampled


def _with_margin(sampled: Sampled) -> Sampled:
    """Return the samples with a margin of samples that continue the sheet to the frame.

    The edge of a sheet on a compliant rim has moved inwards. The margin has the fields of the edge.
    """
    parts = {name: _padded(values) for name, values in vars(sampled).items()}
    for name in ("middle_mm", "upper_mm", "lower_mm"):
        place = _UNDER_THE_FRAME * parts["material_mm"]
        place[1:-1, 1:-1] = parts[name][1:-1, 1:-1, :2]
        parts[name][..., :2] = place
    return Sampled(**parts)


def _padded(values: FloatArray) -> FloatArray:
    return np.pad(values, ((1, 1), (1, 1), *((0, 0),) * (values.ndim - 2)), mode="edge")


def height_map(
    surface_mm: FloatArray,
    values: FloatArray,
    x_mm: FloatArray,
    y_mm: FloatArray,
    below: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the heights of a sampled surface, and values on it, at the nodes of a grid in plan.

    Parameters
    ----------
    surface_mm : (i, j, xyz) points of the surface
    values : (i, j, k) values at these points, which are interpolated linearly
    x_mm, y_mm : (col,) and (row,) equally spaced nodes
    below : (1 + k,) height and values at nodes without a sheet above or below them

    Returns
    -------
    heights (row, col), mm, and values (row, col, k); the highest where the sheet overhangs
    """
    shape = y_mm.size, x_mm.size
    height = np.full(shape, -np.inf)
    interpolated = np.zeros((*shape, values.shape[2]))
    grid = np.array([x_mm[0], y_mm[0], x_mm[1] - x_mm[0], y_mm[1] - y_mm[0]])
    _raster(
        np.ascontiguousarray(surface_mm), np.ascontiguousarray(values), grid, height, interpolated
    )
    absent = np.isinf(height)
    height[absent] = below[0]
    interpolated[absent] = below[1:]
    return height, interpolated


def _places(grid: SheetGrid, pitch_mm: float) -> tuple[FloatArray, FloatArray]:
    parts = [
        np.clip(np.ceil(np.diff(line.edges) / pitch_mm), _FEWEST_PARTS, _MOST_PARTS).astype(int)
        for line in (grid.x, grid.y)
    ]
    return subdivided(grid.x.edges, parts[0]), subdivided(grid.y.edges, parts[1])


def _compiled(function: Function) -> Function:
    return compile_and_keep(function, _OPTIONS, _SOURCE_DIGEST)


@_compiled
def _raster(surface: Any, values: Any, grid: Any, height: Any, interpolated: Any) -> None:
    """Interpolate the two triangles of each quad at the nodes in plan that they cover.

    `grid` is x0, y0, dx, dy of the nodes. A node keeps the largest height.
    """
    x0, y0, dx, dy = grid
    rows, cols = height.shape
    for j in range(surface.shape[0] - 1):
        for i in range(surface.shape[1] - 1):
            for half in range(2):
                ja, ia = (j, i + 1) if half == 0 else (j + 1, i)
                a, b, c = surface[j, i], surface[j + 1, i + 1], surface[ja, ia]
                area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
                if abs(area) < _DEGENERATE_MM2:
                    continue
                # A node on the rim is on the sheet, for any last digit.
                left = max(int(np.ceil((min(a[0], b[0], c[0]) - x0) / dx - _ON)), 0)
                right = min(int(np.floor((max(a[0], b[0], c[0]) - x0) / dx + _ON)), cols - 1)
                low = max(int(np.ceil((min(a[1], b[1], c[1]) - y0) / dy - _ON)), 0)
                high = min(int(np.floor((max(a[1], b[1], c[1]) - y0) / dy + _ON)), rows - 1)
                for row in range(low, high + 1):
                    for col in range(left, right + 1):
                        x, y = x0 + col * dx - a[0], y0 + row * dy - a[1]
                        u = (x * (c[1] - a[1]) - y * (c[0] - a[0])) / area
                        v = ((b[0] - a[0]) * y - (b[1] - a[1]) * x) / area
                        if u < -_ON or v < -_ON or u + v > 1 + _ON:
                            continue
                        z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
                        if z > height[row, col]:
                            height[row, col] = z
                            for k in range(values.shape[2]):
                                va, vb, vc = (
                                    values[j, i, k],
                                    values[j + 1, i + 1, k],
                                    values[ja, ia, k],
                                )
                                interpolated[row, col, k] = va + u * (vb - va) + v * (vc - va)
