"""Meshes of a pressed elastomer: coated face with smooth normals, and slab as a closed body."""

from dataclasses import replace

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray, IntArray
from twin.config.models import Elastomer
from twin.mechanics.layouts import mirrored, touched_at_nodes, widened
from twin.mechanics.press import PressedElastomer
from twin.specimens.solids import grid_facets


def face_mesh(pressed: PressedElastomer) -> trimesh.Trimesh:
    """Return the coated face as a mesh of triangles, world frame, mm.

    Vertices are in row order: vertex row * cols + col is at (face_x_mm[col], face_y_mm[row]).
    Facet and vertex normals point to +z. The mesh is an open surface that includes the rim.
    """
    mesh = trimesh.Trimesh(
        vertices=_vertices(pressed, pressed.face_z_mm),
        faces=grid_facets(*pressed.face_z_mm.shape),
        vertex_normals=face_normals(pressed).reshape(-1, 3),
        process=False,
        validate=False,
    )
    mesh.metadata["name"] = "coated_face"
    return mesh


def slab_mesh(pressed: PressedElastomer, elastomer: Elastomer) -> trimesh.Trimesh:
    """Return the pressed slab as one watertight body, world frame, mm.

    Its vertices are those of `face_mesh`, then those of the second face in the same order: the
    touched face of the opposite-face layout, or the window of the contact-face layout. Straight
    sides join both faces. The touched face of a thin sheet is the coated face shifted along its
    normal by the local thickness.
    """
    rows, cols = pressed.face_z_mm.shape
    coated, opposite = _vertices(pressed, pressed.face_z_mm), _opposite_vertices(pressed, elastomer)
    coated_above = coated[:, 2].mean() > opposite[:, 2].mean()
    rim = _rim(rows, cols)
    after = np.roll(rim, -1)
    # Facets of the sides if the coated face is above the second face; otherwise reversed.
    walls = np.concatenate(
        (
            np.stack((rim, rim + rows * cols, after + rows * cols), axis=-1),
            np.stack((rim, after + rows * cols, after), axis=-1),
        )
    )
    grid = grid_facets(rows, cols)
    closed = np.concatenate((grid, grid[:, ::-1] + rows * cols, walls))
    body = trimesh.Trimesh(
        vertices=np.concatenate((coated, opposite)),
        faces=closed if coated_above else closed[:, ::-1],
        process=False,
        validate=False,
    )
    body.metadata["name"] = "slab"
    return body


def _opposite_vertices(pressed: PressedElastomer, elastomer: Elastomer) -> FloatArray:
    if pressed.sheet is None:
        return _vertices(pressed, _opposite_face(pressed, elastomer))
    texture = 0.0 if pressed.texture_mm is None else pressed.texture_mm
    smooth = replace(pressed, face_z_mm=pressed.face_z_mm - texture)
    behind = pressed.sheet.thickness_mm[..., None] * face_normals(smooth)
    return _vertices(smooth, smooth.face_z_mm) - behind.reshape(-1, 3)


def _opposite_face(pressed: PressedElastomer, elastomer: Elastomer) -> FloatArray:
    if elastomer.layout == "contact_face":
        return np.full_like(pressed.face_z_mm, elastomer.thickness_mm)
    # The slab's deflection is odd about its rim, where it is 0.
    plane = elastomer.touched_plane_mm
    odd = mirrored(pressed.touched_face_mm - plane)
    cells = widened(pressed.y_mm), widened(pressed.x_mm)
    nodes = pressed.face_y_mm, pressed.face_x_mm
    free = np.full_like(pressed.face_z_mm, -np.inf)
    return plane + touched_at_nodes(odd, cells, nodes, free)


def _rim(rows: int, cols: int) -> IntArray:
    """Return the vertex numbers on the grid's outline (n,), counter-clockwise seen from +z."""
    index = np.arange(rows * cols).reshape(rows, cols)
    return np.concatenate((index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]))


def face_normals(pressed: PressedElastomer) -> FloatArray:
    """Return (row, col, xyz) unit normals of the coated face, pointing to +z."""
    slope_x = _derivative(pressed.face_z_mm, pressed.face_x_mm, axis=1)
    slope_y = _derivative(pressed.face_z_mm, pressed.face_y_mm, axis=0)
    upright = 1 / np.sqrt(1 + slope_x**2 + slope_y**2)
    return np.asarray(np.stack((-slope_x * upright, -slope_y * upright, upright), axis=-1))


def _vertices(pressed: PressedElastomer, z_mm: FloatArray) -> FloatArray:
    vertices = np.zeros((*z_mm.shape, 3))
    vertices[..., 0] = pressed.face_x_mm
    vertices[..., 1] = pressed.face_y_mm[:, None]
    vertices[..., 2] = z_mm
    return vertices.reshape(-1, 3)


def _derivative(z: FloatArray, nodes_mm: FloatArray, axis: int) -> FloatArray:
    """Return dz/dy (axis 0) or dz/dx (axis 1) at the nodes (row, col), fourth-order accurate.

    With a lower order the grid is visible in the shading. Beyond the rim z is extended as an odd
    function: this is exact for a simply supported slab, and continues the slope at a pad's side.
    """
    step = float(nodes_mm[-1] - nodes_mm[0]) / (nodes_mm.size - 1)
    margin = tuple((2, 2) if direction == axis else (0, 0) for direction in range(2))
    wide = np.pad(z, margin, mode="reflect", reflect_type="odd")

    def shifted(cells: int) -> FloatArray:
        window = [slice(None), slice(None)]
        window[axis] = slice(2 + cells, wide.shape[axis] - 2 + cells)
        return wide[tuple(window)]

    return np.asarray((8 * (shifted(1) - shifted(-1)) - (shifted(2) - shifted(-2))) / (12 * step))
