"""Convert measured points to a height map on a grid and a triangle mesh, and write files of both.

The height of a cell is the mean world z of the valid points in the cell. A cell without a point has
no height: heights are not interpolated.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Levels, at_pixels
from reconstruction.cells import SquareCells
from reconstruction.colouring import Deviation, Intensity
from reconstruction.errors import InputError
from reconstruction.machine import run_side_by_side
from reconstruction.netcdf import LabelledArrays, write_arrays
from reconstruction.ply import write_point_map_ply
from reconstruction.triangulation import PointMap
from reconstruction.writing import write_bytes, write_exr_channels, write_png, write_text

_PNG_LEVELS = 65534
"""Number of steps: PNG levels 1 to 65535 are heights, level 0 is a cell without a height."""
Triangles = NDArray[np.int32]
_VERTEX: list[tuple[str, str, int]] = [("xyz", "<f4", 3)]
_RGB = ("rgb", "u1", 3)

CUT_OVER_TYPICAL = 5.0
"""Ratio of an edge's length to the median one above which a triangle is left out, because it joins
the two sides of a jump in height; corresponds to a slope of 79 degrees."""


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """Mean height of the measured points in each cell of a square grid.

    Attributes
    ----------
    x_mm : (col,) float
        World x of the cells' centres, increasing.
    y_mm : (row,) float
        World y of the cells' centres, decreasing: row 0 is the top of a picture.
    z_mm : (row, col) float32
        Mean world z of the points in the cell; 0 in a cell without a point.
    valid : (row, col) bool
        True for cells with a point.
    pitch_mm : float
        Edge length of a cell.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    z_mm: FloatImage
    valid: BoolImage
    pitch_mm: float


def height_map(points: PointMap, pitch_mm: float | None = None) -> HeightGrid:
    """Return the height map of the valid points, averaged over square cells.

    Parameters
    ----------
    points : PointMap
    pitch_mm : float, optional
        Edge length of a cell; by default 1.5 x the median distance of neighbouring points, so that
        nearly every cell on the surface contains a point.

    Raises
    ------
    InputError : there is no valid point, or the pitch makes more than 10^8 cells
    """
    world = at_pixels(points.points_world_mm, points.valid).astype(np.float64)
    if not len(world):
        raise InputError("height map: no valid point; look at the mask's reasons")
    return grid_heights(world, pitch_mm or 1.5 * typical_distance_mm(points))


def grid_heights(points_mm: FloatArray, pitch_mm: float) -> HeightGrid:
    """Return the height map of points (point, xyz), averaged over square cells of `pitch_mm`."""
    cells = SquareCells.of(points_mm, pitch_mm).means(points_mm[:, 2])
    return HeightGrid(
        cells.x_mm, cells.y_mm, cells.mean.astype(np.float32), cells.valid, cells.pitch_mm
    )


def typical_distance_mm(points: PointMap) -> float:
    """Return the median x-y distance, mm, of valid points at adjacent pixels of an image row."""
    world, both = points.points_world_mm, points.valid[:, 1:] & points.valid[:, :-1]
    if not both.any():
        raise InputError("height map: no two neighbouring points; give the pitch")
    difference = (world[:, 1:, :2] - world[:, :-1, :2])[both]
    return float(np.median(np.hypot(difference[:, 0], difference[:, 1])))


def write_height_netcdf(path: Path, heights: HeightGrid) -> None:
    """Write a height map as a netCDF-4 file with the coordinates x and y, mm."""
    height = {"units": "mm", "long_name": "mean world z of the points in the cell"}
    valid = {"units": "1", "long_name": "1 where there is a height"}
    arrays = LabelledArrays(
        {
            "z_mm": (("y", "x"), heights.z_mm, height),
            "valid": (("y", "x"), heights.valid.astype(np.uint8), valid),
        },
        coords={
            "x": ("x", heights.x_mm, {"units": "mm", "long_name": "world x of the cell"}),
            "y": ("y", heights.y_mm, {"units": "mm", "long_name": "world y of the cell"}),
        },
        attrs={"Conventions": "CF-1.8"},
    )
    write_arrays(path, arrays)


def write_height_png(path: Path, heights: HeightGrid) -> None:
    """Write a height map as a 16-bit PNG, and its scale as PATH.json.

    The heights are z = first_z_mm + step_z_mm (level - 1); level 0 is a cell without a height.
    """
    z = heights.z_mm[heights.valid].astype(np.float64)
    first, step = float(z.min()), max(float(np.ptp(z)) / (_PNG_LEVELS - 1), 1e-9)
    level = np.rint((heights.z_mm - first) / step) + 1
    write_png(path, np.where(heights.valid, level, 0).astype(np.uint16))
    scale = {
        "first_z_mm": first,
        "step_z_mm": step,
        "no_height_level": 0,
        "first_height_level": 1,
        "pitch_mm": heights.pitch_mm,
        "first_x_mm": float(heights.x_mm[0]),
        "first_y_mm": float(heights.y_mm[0]),
        "y_per_row": -heights.pitch_mm,
    }
    write_text(path.with_name(path.name + ".json"), json.dumps(scale, indent=2))


def write_height_exr(path: Path, heights: HeightGrid) -> None:
    """Write a height map as an EXR file with channels Z, mm, and A, 1 in cells with a height."""
    write_exr_channels(path, {"Z": heights.z_mm, "A": heights.valid.astype(np.float32)})


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """Triangle mesh of the valid points.

    Attributes
    ----------
    vertices_mm : (vertex, xyz) float32
        Valid points, world frame.
    triangles : (triangle, 3) int32
        Vertex numbers, anticlockwise as seen from the camera.
    """

    vertices_mm: FloatImage
    triangles: Triangles


def surface_mesh(points: PointMap, longest_mm: float | None = None) -> SurfaceMesh:
    """Return a triangle mesh that joins valid points at neighbouring pixels.

    Parameters
    ----------
    points : PointMap
    longest_mm : float, optional
        Triangles with a longer edge are left out; five times the median edge length by default.

    Raises
    ------
    InputError : there are no three valid points at neighbouring pixels
    """
    v = points.valid
    number = (np.cumsum(v.ravel(), dtype=np.int32) - 1).reshape(v.shape)
    # Rows run down and the camera looks along the rays: (a, c, b) is anticlockwise from the camera.
    a, b = number[:-1, :-1], number[:-1, 1:]
    c, d = number[1:, :-1], number[1:, 1:]
    upper = v[:-1, :-1] & v[:-1, 1:] & v[1:, :-1]
    lower = v[:-1, 1:] & v[1:, :-1] & v[1:, 1:]
    triangles = np.concatenate(
        [
            np.stack([a[upper], c[upper], b[upper]], axis=-1),
            np.stack([b[lower], c[lower], d[lower]], axis=-1),
        ]
    )
    if not len(triangles):
        raise InputError("surface mesh: no three neighbouring points; look at the mask's reasons")
    world = points.points_world_mm.astype(np.float32)
    edges, longest = _edges_mm(world, upper, lower)
    limit = longest_mm or CUT_OVER_TYPICAL * float(np.median(edges))
    return SurfaceMesh(at_pixels(world, v), triangles[longest <= limit])


def _edges_mm(
    world_mm: FloatImage, upper: BoolImage, lower: BoolImage
) -> tuple[FloatImage, FloatImage]:
    """Return the lengths, mm, of all edges (3 triangles,), and of each triangle's longest edge.

    Distances of neighbouring pixels are computed once, though two triangles share an edge.

    Parameters
    ----------
    upper, lower : (row - 1, col - 1) bool, which of the two triangles of four pixels exist
    """
    x, y, z = np.ascontiguousarray(np.moveaxis(world_mm, -1, 0))

    def distance(first: Any, second: Any) -> FloatImage:
        squares = ((values[first] - values[second]) ** 2 for values in (x, y, z))
        return np.asarray(np.sqrt(sum(squares, start=np.float32(0.0))))

    down, right = distance(np.s_[1:], np.s_[:-1]), distance(np.s_[:, 1:], np.s_[:, :-1])
    across = distance(np.s_[1:, :-1], np.s_[:-1, 1:])
    sides = [
        ((down[:, :-1], across, right[:-1]), upper),
        ((down[:, 1:], across, right[1:]), lower),
    ]
    edges = [side[which] for all_three, which in sides for side in all_three]
    longest = [np.maximum(np.maximum(a, b), c)[which] for (a, b, c), which in sides]
    return np.concatenate(edges), np.concatenate(longest)


def write_mesh_ply(path: Path, mesh: SurfaceMesh, rgb: Levels | None = None) -> None:
    """Write a mesh as a little-endian binary PLY file, mm.

    Parameters
    ----------
    rgb : (vertex, 3) uint8, colours of the vertices; None: no colours
    """
    coloured = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment units mm\n"
        f"element vertex {len(mesh.vertices_mm)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"{'' if rgb is None else coloured}"
        f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(mesh.triangles), [("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, mesh.triangles
    vertices = np.zeros(len(mesh.vertices_mm), _VERTEX if rgb is None else [*_VERTEX, _RGB])
    vertices["xyz"] = mesh.vertices_mm
    if rgb is not None:
        vertices["rgb"] = rgb
    write_bytes(path, header.encode("ascii"), vertices.tobytes(), faces.tobytes())


def write_surface(
    folder: Path,
    points: PointMap,
    deviation: Deviation | None = None,
    intensity: Intensity | None = None,
) -> None:
    """Write the files of a measured surface to a folder: points, height map and mesh.

    The files are points.ply, and if there are three valid neighbouring pixels also height_map.nc,
    height_map.png with height_map.png.json, height_map.exr and surface.ply.

    Parameters
    ----------
    deviation : gives points and mesh their colours; None: those of the intensity
    intensity : is written for each point; None: it is not known
    """
    colours = deviation or intensity
    jobs = [lambda: write_point_map_ply(folder / "points.ply", points, deviation, intensity)]
    if (points.valid[1:, 1:] & points.valid[:-1, 1:] & points.valid[1:, :-1]).any():
        rgb = None if colours is None else at_pixels(colours.rgb, points.valid)
        jobs += [
            lambda: write_mesh_ply(folder / "surface.ply", surface_mesh(points), rgb),
            lambda: write_heights(folder, height_map(points)),
        ]
    run_side_by_side(jobs)


def write_heights(folder: Path, heights: HeightGrid) -> None:
    """Write height_map.nc, height_map.png with height_map.png.json, and height_map.exr."""
    write_height_netcdf(folder / "height_map.nc", heights)
    write_height_png(folder / "height_map.png", heights)
    write_height_exr(folder / "height_map.exr", heights)
