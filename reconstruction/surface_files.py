"""The measured surface in the formats that other programs take, in one call."""

from pathlib import Path

from reconstruction.evaluate.height_map import (
    height_map,
    write_height_exr,
    write_height_netcdf,
    write_height_png,
)
from reconstruction.evaluate.surface_mesh import surface_mesh, write_mesh_ply
from reconstruction.outputs import write_point_map_ply
from reconstruction.triangulation.triangulate import PointMap


def write_surface(folder: Path, points: PointMap) -> None:
    """Write points.ply, and where there are neighbouring points the height map and the mesh.

    height_map.nc, height_map.png with height_map.png.json, height_map.exr, surface.ply.
    """
    write_point_map_ply(folder / "points.ply", points)
    if not (points.valid[1:, 1:] & points.valid[:-1, 1:] & points.valid[1:, :-1]).any():
        return
    heights = height_map(points)
    write_height_netcdf(folder / "height_map.nc", heights)
    write_height_png(folder / "height_map.png", heights)
    write_height_exr(folder / "height_map.exr", heights)
    write_mesh_ply(folder / "surface.ply", surface_mesh(points))
