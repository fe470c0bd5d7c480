"""Organised point clouds: one point per camera pixel, as PCD files of the Point Cloud Library.

The file has the header of version 0.7 of the format and binary data. WIDTH and HEIGHT are those of
the camera's image, and the points are in row-major order, so that neighbouring pixels are
neighbouring points. Coordinates and normals of a pixel without a point are NaN, which the readers
of PCL, Open3D and ROS take for invalid.
"""

from pathlib import Path

import numpy as np

from reconstruction.pipeline import Reconstruction
from reconstruction.writing import write_bytes

FIELDS = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "intensity")
"""Fields of a point: world frame, mm; unit normal towards the camera; mean pixel value, DN."""


def write_organised_pcd(path: Path | str, measured: Reconstruction) -> None:
    """Write the points of all camera pixels as a binary PCD file, each field as float32.

    A normal is also NaN where it is not known, because the pixel has no valid neighbour.
    """
    points, normals = measured.point_map.points_world_mm, measured.point_map.normals_world
    valid = measured.point_map.valid[..., np.newaxis]
    has_normal = np.any(normals != 0.0, axis=-1, keepdims=True)
    columns = (
        np.where(valid, points, np.nan),
        np.where(valid & has_normal, normals, np.nan),
        measured.decoded.intensity_dn[..., np.newaxis],
    )
    values = np.concatenate(columns, axis=-1).astype("<f4")
    write_bytes(path, _header(*values.shape[:2]).encode("ascii"), values.tobytes())


def _header(rows: int, cols: int) -> str:
    count = len(FIELDS)
    lines = (
        "# .PCD v0.7 - world frame, mm; row-major order of the camera pixels",
        "VERSION 0.7",
        f"FIELDS {' '.join(FIELDS)}",
        f"SIZE {' '.join('4' * count)}",
        f"TYPE {' '.join('F' * count)}",
        f"COUNT {' '.join('1' * count)}",
        f"WIDTH {cols}",
        f"HEIGHT {rows}",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {rows * cols}",
        "DATA binary",
    )
    return "\n".join(lines) + "\n"
