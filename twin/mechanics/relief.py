"""The coated face as a triangle mesh with smooth normals, for the renderer."""

import numpy as np
import numpy.typing as npt
import trimesh

from twin.mechanics.press import PressedElastomer
from twin.mechanics.transfer import FloatArray


def face_mesh(pressed: PressedElastomer) -> trimesh.Trimesh:
    """Return the coated face as a grid of triangles, world frame, mm.

    Vertices run row by row: vertex row * cols + col lies at (face_x_mm[col], face_y_mm[row]).
    Facets and vertex normals point to +z. The mesh is an open sheet, rim included.
    """
    mesh = trimesh.Trimesh(
        vertices=_vertices(pressed),
        faces=grid_facets(*pressed.face_z_mm.shape),
        vertex_normals=face_normals(pressed).reshape(-1, 3),
        process=False,
        validate=False,
    )
    mesh.metadata["name"] = "coated_face"
    return mesh


def face_normals(pressed: PressedElastomer) -> FloatArray:
    """Return (row, col, xyz) unit normals of the coated face, pointing to +z."""
    slope_x = _derivative(pressed.face_z_mm, pressed.face_x_mm, axis=1)
    slope_y = _derivative(pressed.face_z_mm, pressed.face_y_mm, axis=0)
    upright = 1 / np.sqrt(1 + slope_x**2 + slope_y**2)
    normals: FloatArray = np.stack((-slope_x * upright, -slope_y * upright, upright), axis=-1)
    return normals


def grid_facets(rows: int, cols: int) -> npt.NDArray[np.int64]:
    """Return (2 (rows-1) (cols-1), 3) vertex indices, counter-clockwise seen from +z."""
    corner = np.arange(rows * cols).reshape(rows, cols)[:-1, :-1, None]
    two_triangles = np.array([0, 1, cols + 1, 0, cols + 1, cols])
    facets: npt.NDArray[np.int64] = (corner + two_triangles).reshape(-1, 3)
    return facets


def _vertices(pressed: PressedElastomer) -> FloatArray:
    vertices = np.zeros((*pressed.face_z_mm.shape, 3))
    vertices[..., 0] = pressed.face_x_mm
    vertices[..., 1] = pressed.face_y_mm[:, None]
    vertices[..., 2] = pressed.face_z_mm
    return vertices.reshape(-1, 3)


def _derivative(z: FloatArray, nodes_mm: FloatArray, axis: int) -> FloatArray:
    """Return dz along `axis`: fourth order, which shows no grid in the shading.

    The slab's deflection is odd about its simply supported rim: the odd extension is exact.
    """
    step = float(nodes_mm[-1] - nodes_mm[0]) / (nodes_mm.size - 1)
    margin = tuple((2, 2) if direction == axis else (0, 0) for direction in range(2))
    wide = np.pad(z, margin, mode="reflect", reflect_type="odd")

    def shifted(cells: int) -> FloatArray:
        window = [slice(None), slice(None)]
        window[axis] = slice(2 + cells, wide.shape[axis] - 2 + cells)
        return wide[tuple(window)]

    slope: FloatArray = (8 * (shifted(1) - shifted(-1)) - (shifted(2) - shifted(-2))) / (12 * step)
    return slope
