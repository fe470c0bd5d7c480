"""Q2/Q1 (Taylor-Hood) elements on brick grids: nodes, integration points, shape functions.

Meshes, elements and quadrature are those of scikit-fem, as for the tetrahedra (`taylor_hood`). This
module sorts them in the order of the grid. Axes are x, y, z; z is along the press, from the touched
face (z = 0) to the far face. Displacement nodes are on the edges of the grid and half way between
them, numbered as by `numpy.ravel_multi_index`. Unknowns are in order of the nodes.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import skfem
from scipy import sparse

from reconstruction.arrays import FloatArray, IntArray

Components = tuple[tuple[int, int], ...]
_ROUNDING = 1e-12


@dataclass(frozen=True)
class ElementGrid:
    """A grid of brick elements, defined by the positions of the elements' edges."""

    #: tensor components (i, j) of the deformation gradient, one for each row of `gradient`
    components: ClassVar[Components] = tuple((i, j) for i in range(3) for j in range(3))
    mesh_of: ClassVar[Any] = skfem.MeshHex
    displacement_element: ClassVar[Any] = skfem.ElementHex2
    pressure_element: ClassVar[Any] = skfem.ElementHex1

    #: one ascending array per axis, mm
    edges_mm: tuple[FloatArray, ...]
    #: integration points per axis and element
    gauss: int = 3

    @property
    def axes(self) -> int:
        """Number of coordinates of a node."""
        return len(self.edges_mm)

    @cached_property
    def lines_mm(self) -> tuple[FloatArray, ...]:
        """Coordinates of the displacement nodes along each axis, mm: edges and midpoints."""
        return tuple(
            np.interp(np.arange(2 * edge.size - 1) / 2, np.arange(edge.size), edge)
            for edge in self.edges_mm
        )

    @cached_property
    def nodes_mm(self) -> FloatArray:
        """(node, axis) coordinates of the displacement nodes."""
        return np.stack(np.meshgrid(*self.lines_mm, indexing="ij"), axis=-1).reshape(-1, self.axes)

    @cached_property
    def element_nodes(self) -> IntArray:
        """(element, 3^axes) numbers of the displacement nodes of each element."""
        return np.asarray(self._node_of_unknown[self._displacement.element_dofs.T])

    @cached_property
    def element_corners(self) -> IntArray:
        """(element, 2^axes) numbers of the pressure nodes, separate from the displacement's."""
        return np.asarray(self._pressure.element_dofs.T, dtype=np.int64)

    @cached_property
    def corner_shapes(self) -> FloatArray:
        """(point, 2^axes) pressure shape functions at the integration points."""
        # Elements of a grid differ only by scale: all have the shape functions of the first one.
        return np.stack([np.asarray(shape[0])[0] for shape in self._pressure.basis], axis=-1)

    @cached_property
    def weights(self) -> FloatArray:
        """(element, point) integration weights, mm^3."""
        return np.asarray(self._displacement.dx)

    @cached_property
    def gradient(self) -> FloatArray:
        """(element, point, component, unknown) matrix from displacements to F - I.

        F is the deformation gradient with the tensor components of `components`.
        """
        return self._slopes(self.components)

    def _slopes(self, components: Components) -> FloatArray:
        """Return the matrix (element, point, component, unknown) from displacements to du_i / dx_j.

        (i, j) are the given components.
        """
        shapes = [shape[0].grad for shape in self._displacement.basis]
        slopes = np.stack([np.moveaxis(shape, 0, -1) for shape in shapes], axis=-2)
        elements, points, nodes, axes = slopes.shape
        operator = np.zeros((elements, points, len(components), nodes, axes))
        for row, (i, j) in enumerate(components):
            operator[:, :, row, :, i] = slopes[..., j]
        return operator.reshape(elements, points, len(components), nodes * axes)

    def surface(self, gauss: int) -> "Surface":
        """Return the touched face (z = 0) with `gauss` integration points per element and axis.

        Points are sorted by facet; facets, and the points of a facet, by x and then by y.
        """
        low = self._mesh.facets_satisfying(lambda at: np.isclose(at[-1], self.edges_mm[-1][0]))
        quadratic = self.displacement_element()
        face = skfem.FacetBasis(self._mesh, quadratic, facets=low, intorder=2 * gauss - 1)
        order, nodes = _in_order(face), self._node_of_unknown[face.element_dofs.T]
        trace = trace_of(face, nodes, self.nodes_mm.shape[0])
        return Surface(sparse.csr_array(trace[order]), face.dx.ravel()[order], self.axes)

    @cached_property
    def _mesh(self) -> Any:
        return self.mesh_of.init_tensor(*self.edges_mm)

    @cached_property
    def _displacement(self) -> Any:
        return skfem.CellBasis(self._mesh, self.displacement_element(), intorder=2 * self.gauss - 1)

    @cached_property
    def _pressure(self) -> Any:
        return self._displacement.with_element(self.pressure_element())

    @cached_property
    def _node_of_unknown(self) -> IntArray:
        """(unknown,) node number in the grid of each displacement unknown of scikit-fem."""
        places = zip(self.lines_mm, self._displacement.doflocs, strict=True)
        halfway = [((line[1:] + line[:-1]) / 2, at) for line, at in places]
        numbers = tuple(np.searchsorted(between, at) for between, at in halfway)
        counts = tuple(line.size for line in self.lines_mm)
        return np.asarray(np.ravel_multi_index(numbers, counts), dtype=np.int64)


@dataclass(frozen=True)
class Surface:
    """Integration points on the touched face."""

    #: (point, node) sparse matrix: interpolates nodal values at the points
    trace: sparse.csr_array
    #: (point,) undeformed area, mm^2
    weight_mm2: FloatArray
    axes: int

    @cached_property
    def vector_trace(self) -> sparse.csr_array:
        """(axes * point, axes * node) sparse matrix: interpolates nodal vectors at the points."""
        return sparse.csr_array(sparse.kron(self.trace, sparse.eye_array(self.axes)))


def trace_of(face: Any, nodes: IntArray, count: int) -> sparse.csr_array:
    """Return the sparse matrix (point, node) that interpolates nodal values at a face's points.

    Parameters
    ----------
    face : facet basis of scikit-fem; points are in the order of its facets
    nodes : (facet, shape) numbers of the nodes of the element behind each facet
    count : number of all nodes
    """
    values = np.stack([np.asarray(shape[0]) for shape in face.basis], axis=-1)
    columns = np.broadcast_to(nodes[:, None], values.shape).ravel()
    rows = np.repeat(np.arange(face.dx.size), nodes.shape[1])
    trace = sparse.csr_array((values.ravel(), (rows, columns)), (face.dx.size, count))
    # Shape functions of an element's nodes that are not on the facet are zero there.
    trace.data[np.abs(trace.data) < _ROUNDING] = 0.0
    trace.eliminate_zeros()
    return trace


def graded(length_mm: float, count: int, ratio: float) -> FloatArray:
    """Return count + 1 edges from 0 to `length_mm`; each step is `ratio` times the previous one."""
    steps = ratio ** np.arange(count)
    edges: FloatArray = np.concatenate(([0.0], np.cumsum(steps)))
    return edges * (length_mm / float(steps.sum()))


def _in_order(face: Any) -> IntArray:
    """Return the indices (point,) that sort a face's points by facet centre, then by position."""
    at = np.asarray(face.global_coordinates())[-2::-1]
    centres = np.broadcast_to(at.mean(axis=2, keepdims=True), at.shape)
    # `lexsort` sorts by the last key first. Keys are rounded, because the coordinates of points on
    # one line differ in their last digits.
    keys = np.round(np.concatenate((at, centres)), 9).reshape(2 * len(at), -1)
    return np.asarray(np.lexsort(keys), dtype=np.int64)
