"""Meshes of a pressed elastomer: coated face with smooth normals, and slab as a closed body."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from reconstruction.arrays import FloatArray, FloatImage, IntArray
from reconstruction.compiling import Function, compile_and_keep, digest_of_sources
from twin.config.models import Elastomer
from twin.mechanics.layouts import mirrored, touched_at_nodes, widened
from twin.mechanics.press import PressedElastomer
from twin.specimens.solids import grid_facets

_SOURCE_DIGEST = digest_of_sources(Path(__file__).parent, ("relief.py",))
# Without fused multiply-add, the normals are those of array arithmetic to the last digit.
_OPTIONS: dict[str, Any] = {"nogil": True, "_nrt": False, "error_model": "numpy"}


def _compiled(function: Function) -> Function:
    return compile_and_keep(function, _OPTIONS, _SOURCE_DIGEST)


MATERIAL_MM = "material_mm"
"""Attribute of a face's vertices, (vertex, 2) float64: material coordinates X and Y, mm."""


@dataclass(frozen=True, eq=False)
class FaceGrid:
    """Coated face for the renderer: the arrays of `face_mesh`, in single precision.

    It is made in a quarter of the time of `face_mesh`. It has no reference cycles, so that the last
    reference releases its memory.

    Attributes
    ----------
    shape : number of rows and of columns of the vertices
    vertices, vertex_normals : (vertex, xyz) float32, row by row; world, mm
    vertex_attributes : further values of the vertices by name
    """

    shape: tuple[int, int]
    vertices: FloatImage
    vertex_normals: FloatImage
    vertex_attributes: dict[str, FloatArray] = field(default_factory=dict)

    @property
    def faces(self) -> IntArray:
        """Facets (facet, 3), indices of vertices."""
        return grid_facets(*self.shape)

    @cached_property
    def grid(self) -> FloatArray:
        """Vertices (row, col, xyz) as float64."""
        return self.vertices.astype(np.float64).reshape(*self.shape, 3)


def face_grid(pressed: PressedElastomer) -> FaceGrid:
    """Return the coated face with normals that point to +z, world frame, mm, for the renderer."""
    rows, cols = pressed.face_z_mm.shape
    vertices, normals = (np.zeros((rows, cols, 3), np.float32) for _ in range(2))
    _fill_vertices(pressed, pressed.face_z_mm, vertices)
    _fill_normals(pressed, normals)
    return FaceGrid((rows, cols), vertices.reshape(-1, 3), normals.reshape(-1, 3))


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
    normals = np.zeros((*pressed.face_z_mm.shape, 3))
    _fill_normals(pressed, normals)
    return normals


def _vertices(pressed: PressedElastomer, z_mm: FloatArray) -> FloatArray:
    vertices = np.zeros((*z_mm.shape, 3))
    _fill_vertices(pressed, z_mm, vertices)
    return vertices.reshape(-1, 3)


def _fill_vertices(pressed: PressedElastomer, z_mm: FloatArray, vertices: Any) -> None:
    vertices[..., 0] = pressed.face_x_mm
    vertices[..., 1] = pressed.face_y_mm[:, None]
    vertices[..., 2] = z_mm


def _fill_normals(pressed: PressedElastomer, normals: Any) -> None:
    """Fill the normals (row, col, xyz) of the coated face; slopes are fourth-order accurate.

    With a lower order the grid is visible in the shading. Beyond the rim z is extended as an odd
    function: this is exact for a simply supported slab, and continues the slope at a pad's side.
    """
    wide = np.pad(pressed.face_z_mm, 2, mode="reflect", reflect_type="odd")
    nodes = pressed.face_x_mm, pressed.face_y_mm
    step_x, step_y = (float(of[-1] - of[0]) / (of.size - 1) for of in nodes)
    _normals(wide, 12 * step_x, 12 * step_y, normals)


@_compiled
def _normals(wide: Any, over_x: Any, over_y: Any, normals: Any) -> None:
    """Fill unit normals from heights `wide`, which have two more nodes on each side.

    Parameters
    ----------
    over_x, over_y : 12 steps of the grid, mm
    """
    rows, cols = normals.shape[0], normals.shape[1]
    for row in range(rows):
        below, under = wide[row], wide[row + 1]
        here = wide[row + 2]
        above, over = wide[row + 3], wide[row + 4]
        for col in range(cols):
            x, c = 8 * (here[col + 3] - here[col + 1]), col + 2
            slope_x = (x - (here[col + 4] - here[col])) / over_x
            slope_y = (8 * (above[c] - under[c]) - (over[c] - below[c])) / over_y
            upright = 1 / np.sqrt(1 + slope_x * slope_x + slope_y * slope_y)
            normals[row, col, 0] = -slope_x * upright
            normals[row, col, 1] = -slope_y * upright
            normals[row, col, 2] = upright
