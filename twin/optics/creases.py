"""Split a mesh along its creases, so that its vertex normals are smooth on each side of a crease.

Two adjacent facets are on the same side if the angle between their normals is below `CREASE_DEG`. A
plane part of the surface that is larger than a tenth of it is a side of its own. The result is that
of `trimesh.graph.smooth_shade`, with the same order of facets and vertices, in a third of the
time for the face of a random relief.
"""

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from reconstruction.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    import trimesh

CREASE_DEG = 20.0
"""Adjacent facets with a smaller angle between their normals are one smooth surface."""

LARGE_PLANE = 10.0
"""A plane part larger than the surface divided by this number is a side of its own."""

PLANE_SINE = 0.5 / np.sqrt(5000.0)
"""Adjacent facets are in one plane if the sine of the angle between them is smaller.

Trimesh compares the square of radius / span with 5000, where radius = span / (2 sine)."""


def split_at_creases(mesh: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """Return a mesh with the vertices on creases repeated for each side; facets are reordered."""
    import trimesh

    adjacent = adjacent_facets(mesh.faces)
    normals = mesh.face_normals
    angles = trimesh.geometry.vector_angle(normals[adjacent])
    planes = _large_planes(mesh, adjacent[np.abs(np.sin(angles)) < PLANE_SINE])
    order, side = _by_side(adjacent[angles < np.deg2rad(CREASE_DEG)], planes, len(mesh.faces))
    if not len(order):
        return mesh.copy()
    single = np.setdiff1d(np.arange(len(mesh.faces)), order, assume_unique=True)
    order = np.concatenate([order, single])
    side = np.concatenate([side, side[-1] + 1 + np.arange(len(single))])
    # One vertex for each pair of side and old vertex.
    count = len(mesh.vertices)
    corners = side[:, None] * count + mesh.faces[order]
    # Sorted: a table of hashes, which NumPy uses without inverse, takes longer.
    pairs, facets = np.unique(corners.ravel(), return_inverse=True)
    return trimesh.Trimesh(
        mesh.vertices[pairs % count],
        facets.reshape(-1, 3),
        face_normals=normals[order],
        process=False,
    )


def adjacent_facets(facets: IntArray) -> IntArray:
    """Return the pairs (m, 2) of facets that share an edge which no third facet has.

    Parameters
    ----------
    facets : (n, 3) numbers of vertices
    """
    first, second = facets, np.roll(facets, -1, axis=1)
    count = np.int64(facets.max(initial=0) + 1)
    edges = (np.minimum(first, second) * count + np.maximum(first, second)).ravel()
    order = np.argsort(edges)
    edges = edges[order]
    starts = np.flatnonzero(np.concatenate([[True], edges[1:] != edges[:-1]]))
    of_two = starts[np.diff(starts, append=len(edges)) == 2]
    pairs = np.column_stack([order[of_two], order[of_two + 1]]) // 3
    return np.asarray(pairs[pairs[:, 0] != pairs[:, 1]])


def _by_side(joined: IntArray, planes: list[IntArray], count: int) -> tuple[IntArray, IntArray]:
    """Return the facets of all sides of at least two facets, side by side, and their sides.

    Smooth sides come first, then large planes; other facets are left out.
    """
    smooth = np.ones(count, bool)
    for plane in planes:
        smooth[plane] = False
    joined = joined[smooth[joined].all(axis=1)]
    within = np.zeros(count, bool)
    within[joined] = True
    nodes = np.flatnonzero(within)
    label = _connected(joined, count)[nodes]
    order = _sorted_like_trimesh(label)
    label = label[order]
    side = np.cumsum(np.concatenate([[0], label[1:] != label[:-1]])[: len(label)])
    first = side[-1] + 1 if len(side) else 0
    sides = [np.full(len(plane), first + number) for number, plane in enumerate(planes)]
    return np.concatenate([nodes[order], *planes]), np.concatenate([side, *sides])


def _large_planes(mesh: "trimesh.Trimesh", parallel: IntArray) -> list[IntArray]:
    """Return the facets of each plane part that is larger than a tenth of the surface.

    Parameters
    ----------
    parallel : (m, 2) adjacent facets in one plane
    """
    area, least = mesh.area_faces, mesh.area / LARGE_PLANE
    label = _connected(parallel, len(mesh.faces))
    sizes = np.bincount(label)
    ends = np.cumsum(sizes)
    order = _sorted_like_trimesh(label)
    # Most of the 15 000 planes of a relief have too few facets: their area is not computed.
    may_be_large = np.flatnonzero((sizes > 1) & (sizes * float(area.max()) > least))
    planes = [order[ends[number] - sizes[number] : ends[number]] for number in may_be_large]
    return [plane for plane in planes if area[plane].sum() > least]


def _connected(pairs: IntArray, count: int) -> IntArray:
    """Return the number of the connected part of each of `count` facets."""
    ones: FloatArray = np.ones(len(pairs))
    graph = sparse.csr_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1])


def _sorted_like_trimesh(label: IntArray) -> IntArray:
    """Return the order of facets by label; facets of one label are in NumPy's, not a stable order.

    Trimesh sorts so. The order decides the last digits of vertex normals, and hence the bytes of
    rendered frames.
    """
    return np.argsort(label)
