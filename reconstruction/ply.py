"""Write points as binary PLY files, which most programs for point clouds read."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reconstruction.arrays import at_pixels
from reconstruction.colouring import Deviation, Intensity
from reconstruction.errors import InputError
from reconstruction.triangulation import PointMap
from reconstruction.writing import write_bytes

PLY_TYPES = {
    "uint8": "uchar",
    "float32": "float",
    "float64": "double",
    "uint16": "ushort",
    "int32": "int",
}


def write_ply(
    path: Path | str,
    points_mm: ArrayLike,
    scalars: Mapping[str, NDArray[Any]] | None = None,
    comments: tuple[str, ...] = ("units mm",),
) -> None:
    """Write points, and further values of each point, as a little-endian binary PLY file.

    Parameters
    ----------
    points_mm : (n, 3) float; stored in single precision
    scalars : further vertex properties, each (n,) of uint8, float32, float64, uint16 or int32
    comments : comment lines of the header
    """
    points = np.asarray(points_mm, dtype=np.float32)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points for {path} have shape {points.shape}; give (n, 3)")
    columns: dict[str, NDArray[Any]] = {
        name: points[:, i] for i, name in enumerate(("x", "y", "z"))
    }
    columns.update(scalars or {})
    table = _vertex_table(columns, len(points))
    header = _ply_header(columns, len(points), comments)
    write_bytes(path, header.encode("ascii"), table.tobytes())


def _vertex_table(columns: Mapping[str, NDArray[Any]], count: int) -> NDArray[np.void]:
    for name, values in columns.items():
        if values.shape != (count,) or values.dtype.name not in PLY_TYPES:
            raise InputError(
                f"PLY property {name} is {values.dtype} {values.shape}; "
                f"give ({count},) of {', '.join(PLY_TYPES)}"
            )
    layout = [(name, values.dtype.newbyteorder("<")) for name, values in columns.items()]
    table = np.zeros(count, dtype=layout)
    for name, values in columns.items():
        table[name] = values
    return table


def _ply_header(columns: Mapping[str, NDArray[Any]], count: int, comments: tuple[str, ...]) -> str:
    lines = ["ply", "format binary_little_endian 1.0"]
    lines += [f"comment {comment}" for comment in comments]
    lines += [f"element vertex {count}"]
    lines += [f"property {PLY_TYPES[v.dtype.name]} {name}" for name, v in columns.items()]
    return "\n".join([*lines, "end_header", ""])


def write_point_map_ply(
    path: Path | str,
    point_map: PointMap,
    deviation: Deviation | None = None,
    intensity: Intensity | None = None,
) -> None:
    """Write the valid points, in row-major order of their camera pixels, as a PLY file.

    Each point has its normal (nx, ny, nz), sigma_x_mm, sigma_y_mm, sigma_z_mm and its pixel (row,
    col). With `deviation` it also has deviation_um, with `intensity` intensity_dn. The colour (red,
    green, blue) is that of the deviation, or without it that of the intensity.
    """
    valid = point_map.valid
    row, col = np.divmod(np.flatnonzero(valid), valid.shape[1])
    sigma_mm = at_pixels(point_map.sigma_xyz_mm, valid)
    normals = at_pixels(point_map.normals_world, valid)
    scalars: dict[str, NDArray[Any]] = {f"n{name}": normals[:, i] for i, name in enumerate("xyz")}
    scalars |= {f"sigma_{name}_mm": sigma_mm[:, i] for i, name in enumerate("xyz")}
    scalars |= {
        "row": row.astype(np.uint16),
        "col": col.astype(np.uint16),
    }
    comments = ["frame world, z up", "units mm", "order row-major, valid pixels only"]
    colours = deviation or intensity
    if colours is not None:
        rgb = at_pixels(colours.rgb, valid)
        scalars |= {name: rgb[:, i] for i, name in enumerate(("red", "green", "blue"))}
        comments.append(colours.legend)
    if deviation is not None:
        scalars |= {"deviation_um": at_pixels(deviation.um, valid)}
    if intensity is not None:
        scalars |= {"intensity_dn": at_pixels(intensity.dn, valid)}
    write_ply(path, at_pixels(point_map.points_world_mm, valid), scalars, tuple(comments))
