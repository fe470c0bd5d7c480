"""The measured points as a triangle mesh: neighbours in the image are joined, jumps are cut."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatImage
from reconstruction.errors import InputError
from reconstruction.triangulation.triangulate import PointMap

Triangles = NDArray[np.int32]

CUT_OVER_TYPICAL = 5.0
"""An edge this many times longer than the typical one bridges a jump: 79 degrees of slope."""


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """Triangles over the valid points.

    Attributes
    ----------
    vertices_mm : (vertex, xyz) float32
        World frame.
    triangles : (triangle, 3) int32
        Anticlockwise seen from the camera.
    """

    vertices_mm: FloatImage
    triangles: Triangles


def surface_mesh(points: PointMap, longest_mm: float | None = None) -> SurfaceMesh:
    """Join valid points that are neighbours in the image.

    Parameters
    ----------
    points : PointMap
    longest_mm : float, optional
        Triangles with a longer edge are left out; five times the typical edge by default.

    Raises
    ------
    InputError : no three neighbouring points
    """
    number = np.cumsum(points.valid.ravel()).reshape(points.valid.shape) - 1
    # Rows run down and the camera looks along the rays: (a, c, b) is anticlockwise from the camera.
    a, b = number[:-1, :-1], number[:-1, 1:]
    c, d = number[1:, :-1], number[1:, 1:]
    v = points.valid
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
    vertices = points.points_world_mm[v].astype(np.float32)
    corners = vertices[triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    limit = longest_mm or CUT_OVER_TYPICAL * float(np.median(edges))
    kept = triangles[edges.max(axis=1) <= limit].astype(np.int32)
    return SurfaceMesh(vertices, kept)


def write_mesh_ply(path: Path, mesh: SurfaceMesh) -> None:
    """Write as little-endian binary PLY, mm."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment units mm\n"
        f"element vertex {len(mesh.vertices_mm)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.zeros(len(mesh.triangles), [("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, mesh.triangles
    vertices = mesh.vertices_mm.astype("<f4")
    path.write_bytes(header.encode("ascii") + vertices.tobytes() + faces.tobytes())


def write_mesh_stl(path: Path, mesh: SurfaceMesh) -> None:
    """Write as binary STL, mm."""
    corners = mesh.vertices_mm[mesh.triangles].astype("<f4")
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    facets = np.zeros(len(corners), [("n", "<f4", 3), ("v", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["n"], facets["v"] = normals, corners
    head = b"fringe-twin surface, mm".ljust(80) + np.uint32(len(corners)).tobytes()
    path.write_bytes(head + facets.tobytes())
