"""Closed bodies for specimens: prisms, bodies of revolution, and boolean operations.

All lengths are in mm. trimesh and manifold3d are imported in functions: reading an experiment
imports this module, and their import would take longer than all other steps of reading.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np

from reconstruction.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    import manifold3d
    import trimesh

#: Number of facets per turn, 2 degrees each: chord errors are at most 0.6 um at a radius of 4 mm.
SECTIONS = 180
# Shorter edges are removed after a boolean operation; 0.1 x the elastomer's finest relief pitch.
_TOLERANCE_MM = 1e-4


def box(
    low_mm: tuple[float, float, float], high_mm: tuple[float, float, float]
) -> "trimesh.Trimesh":
    """Return the block between two opposite corners (xyz)."""
    import trimesh

    return trimesh.creation.box(bounds=np.array([low_mm, high_mm]))


def rounded_box(
    low_mm: tuple[float, float, float], high_mm: tuple[float, float, float], edge_radius_mm: float
) -> "trimesh.Trimesh":
    """Return the block between two opposite corners (xyz), edges rounded with facets of 6 deg."""
    if edge_radius_mm == 0:
        return box(low_mm, high_mm)
    import manifold3d

    quarter = np.deg2rad(np.linspace(0, 90, 16))
    up, round_ = (angle.ravel() for angle in np.meshgrid(quarter[:-1], quarter, indexing="ij"))
    eighth = np.stack((np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)))
    pole = np.array([[0.0], [0.0], [1.0]])
    corner_mm = edge_radius_mm * np.concatenate((eighth, pole), axis=1).T
    half = (np.array(high_mm) - low_mm) / 2
    signs = np.array(list(product((-1, 1), repeat=3)))
    points = signs[:, None] * (half - edge_radius_mm + corner_mm)
    middle = (np.array(high_mm) + low_mm) / 2
    return _from_manifold(manifold3d.Manifold.hull_points(points.reshape(-1, 3) + middle))


def prism(outline_mm: FloatArray, low_mm: float, high_mm: float) -> "trimesh.Trimesh":
    """Return a counter-clockwise outline (n, xy) extruded along z from `low_mm` to `high_mm`."""
    import manifold3d

    section = manifold3d.CrossSection([np.ascontiguousarray(outline_mm)])
    return _from_manifold(section.extrude(high_mm - low_mm).translate((0.0, 0.0, low_mm)))


def turned(profile_mm: Sequence[tuple[float, float]]) -> "trimesh.Trimesh":
    """Return the body of revolution about z of a profile of points (radius, z).

    The profile starts at its lower end and stops at its upper end, both on the axis.
    """
    import trimesh

    return trimesh.creation.revolve(np.array(profile_mm), sections=SECTIONS)


def along_axis(
    body: "trimesh.Trimesh", x: FloatArray, y: FloatArray, z: FloatArray
) -> "trimesh.Trimesh":
    """Return the body rotated: its x, y and z axes become three unit vectors (right-handed)."""
    turned_body = body.copy()
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack((x, y, z), axis=-1)
    turned_body.apply_transform(matrix)
    return turned_body


def moved(
    body: "trimesh.Trimesh", x_mm: float, y_mm: float, z_mm: float = 0.0
) -> "trimesh.Trimesh":
    """Return the body shifted along x, y and z."""
    shifted = body.copy()
    shifted.apply_translation((x_mm, y_mm, z_mm))
    return shifted


def united(bodies: Sequence["trimesh.Trimesh"]) -> "trimesh.Trimesh":
    """Return the union of bodies; unlike `union` it does not remove short edges."""
    import trimesh

    return bodies[0] if len(bodies) == 1 else trimesh.boolean.union(bodies, engine="manifold")


def union(bodies: Sequence["trimesh.Trimesh"]) -> "trimesh.Trimesh":
    """Return the union of bodies, without edges shorter than 0.1 um."""
    return _combined(bodies, "Add")


def without(body: "trimesh.Trimesh", *holes: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """Return a body from which the bodies `holes` are subtracted."""
    return _combined((body, *holes), "Subtract")


def common(bodies: Sequence["trimesh.Trimesh"]) -> "trimesh.Trimesh":
    """Return the intersection of all bodies."""
    return _combined(bodies, "Intersect")


def _combined(
    bodies: Sequence["trimesh.Trimesh"], operation: Literal["Add", "Subtract", "Intersect"]
) -> "trimesh.Trimesh":
    """Return a boolean operation on bodies, in double precision.

    In single precision, nearly coincident facets result in needle-like triangles.
    """
    import manifold3d

    manifolds = [
        manifold3d.Manifold(
            manifold3d.Mesh64(
                np.asarray(body.vertices, np.float64), np.asarray(body.faces, np.uint64)
            )
        )
        for body in bodies
    ]
    result = manifold3d.Manifold.batch_boolean(manifolds, getattr(manifold3d.OpType, operation))
    return _from_manifold(result.simplify(_TOLERANCE_MM))


def level_set(
    level_mm: Callable[[float, float, float], float],
    box_mm: tuple[float, float, float, float, float, float],
    edge_mm: float,
    refined: int,
) -> "trimesh.Trimesh":
    """Return a mesh of the zero set of a function of (x, y, z), with each edge split.

    Parameters
    ----------
    level_mm : function of x, y, z, mm; negative inside the body
    box_mm : (x, y, z of the low corner, then of the high corner), mm; box that contains the body
    edge_mm : length of the edges before they are split
    refined : number of pieces of each edge; the new vertices are on the flat facets
    """
    import manifold3d

    negated = manifold3d.Manifold.level_set(lambda *at: -level_mm(*at), box_mm, edge_mm)
    return _from_manifold(negated.refine(refined))


def _from_manifold(body: "manifold3d.Manifold") -> "trimesh.Trimesh":
    """Return a manifold as a triangle mesh, with vertices in double precision."""
    mesh = body.to_mesh64()
    return closed_mesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int64))


def closed_mesh(vertices_mm: FloatArray, facets: IntArray) -> "trimesh.Trimesh":
    """Return a body from vertices (n, xyz) and facets (m, 3), counter-clockwise seen from outside.

    Vertices are neither merged nor removed.
    """
    import trimesh

    return trimesh.Trimesh(vertices_mm, facets, process=False)


def height_grid_body(
    x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray, base_z_mm: float
) -> "trimesh.Trimesh":
    """Return the body of a height map, closed by vertical walls and a flat base.

    Parameters
    ----------
    x_mm, y_mm : (col,) and (row,) float, mm; ascending
    z_mm : (row, col) float, mm; heights at the grid's nodes
    base_z_mm : z of the base, below all heights
    """
    grid_x, grid_y = np.meshgrid(x_mm, y_mm)
    top = np.stack((grid_x, grid_y, z_mm), axis=-1).reshape(-1, 3)
    index = np.arange(z_mm.size).reshape(z_mm.shape)
    rim = np.concatenate((index[0], index[1:, -1], index[-1, -2::-1], index[-2:0:-1, 0]))
    base = top[rim] * [1, 1, 0] + [0, 0, base_z_mm]
    below, middle = z_mm.size + np.arange(rim.size), base.mean(axis=0)
    # The base's facets face down.
    fan = (np.roll(below, -1), below, np.full_like(below, z_mm.size + rim.size))
    facets = (grid_facets(*z_mm.shape), _wall(rim, below), np.stack(fan, axis=-1))
    return closed_mesh(np.concatenate((top, base, middle[None])), np.concatenate(facets))


def _wall(rim: IntArray, below: IntArray) -> IntArray:
    """Return the facets (n, 3) of the wall between the vertices of the rim and those of the base.

    `rim` is counter-clockwise seen from above.
    """
    after, below_after = np.roll(rim, -1), np.roll(below, -1)
    return np.stack((rim, below, below_after, rim, below_after, after), axis=-1).reshape(-1, 3)


@lru_cache(maxsize=1)  # consecutive calls have the same grid
def grid_facets(rows: int, cols: int) -> IntArray:
    """Return the triangles of a grid of vertices: (2 (rows-1) (cols-1), 3) vertex numbers.

    They are counter-clockwise seen from +z. The array is read-only.
    """
    corner = np.arange(rows * cols).reshape(rows, cols)[:-1, :-1, None]
    two_triangles = np.array([0, 1, cols + 1, 0, cols + 1, cols])
    facets = np.asarray((corner + two_triangles).reshape(-1, 3))
    facets.flags.writeable = False
    return facets


def arc(
    centre_mm: tuple[float, float],
    radius_mm: float,
    first_deg: float,
    last_deg: float,
    step_deg: float = 360 / SECTIONS,
) -> list[tuple[float, float]]:
    """Return points (x, y) on an arc in steps of at most `step_deg`; for radius 0 the centre.

    Angles are measured from the x axis towards the y axis.
    """
    if radius_mm == 0:
        return [centre_mm]
    steps = int(np.ceil(abs(last_deg - first_deg) / step_deg - 1e-9)) + 1
    turn = np.deg2rad(np.linspace(first_deg, last_deg, steps))
    x, y = centre_mm[0] + radius_mm * np.cos(turn), centre_mm[1] + radius_mm * np.sin(turn)
    return list(zip(x.tolist(), y.tolist(), strict=True))
