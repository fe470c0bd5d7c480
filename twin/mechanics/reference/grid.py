"""Q2/Q1 (Taylor-Hood) elements on rectangle and brick grids: nodes, weights and gradients.

Meshes, elements and quadrature are scikit-fem's, as for the tetrahedra (`taylor_hood`); here they
are put in the order of the grid. Axes: r, z in axisymmetry; x, y, z in space; z is the last and
runs along the press from the touched face (z = 0) to the far face. Displacement nodes are the grid
lines and their midpoints, numbered as in `numpy.ravel_multi_index`; unknowns node by node.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import skfem
from scipy import sparse

from reconstruction.arrays import FloatArray, IntArray

# Tensor components (i, j) of the deformation gradient that can differ from the identity.
_AXISYMMETRIC = ((0, 0), (0, 1), (1, 0), (1, 1), (2, 2))
_SPATIAL = tuple((i, j) for i in range(3) for j in range(3))
_ROUNDING = 1e-12


@dataclass(frozen=True)
class ElementGrid:
    """A rectangle grid (axisymmetric) or a brick grid, given by its element edges."""

    #: one ascending array per axis, mm
    edges_mm: tuple[FloatArray, ...]
    #: integration points per axis and element
    gauss: int = 3

    @property
    def axes(self) -> int:
        """2 in axisymmetry, 3 in space."""
        return len(self.edges_mm)

    @property
    def components(self) -> tuple[tuple[int, int], ...]:
        """The tensor components of the rows of an element's `gradient`."""
        return _AXISYMMETRIC if self.axes == 2 else _SPATIAL

    @cached_property
    def lines_mm(self) -> tuple[FloatArray, ...]:
        """Node coordinates per axis: edges and midpoints."""
        return tuple(
            np.interp(np.arange(2 * edge.size - 1) / 2, np.arange(edge.size), edge)
            for edge in self.edges_mm
        )

    @cached_property
    def nodes_mm(self) -> FloatArray:
        """(node, axis) coordinates."""
        return np.stack(np.meshgrid(*self.lines_mm, indexing="ij"), axis=-1).reshape(-1, self.axes)

    @cached_property
    def element_nodes(self) -> IntArray:
        """(element, 3^axes) displacement nodes."""
        return np.asarray(self._node_of_unknown[self._displacement.element_dofs.T])

    @cached_property
    def element_corners(self) -> IntArray:
        """(element, 2^axes) pressure nodes, numbered separately from the displacement's."""
        return np.asarray(self._pressure.element_dofs.T, dtype=np.int64)

    @cached_property
    def corner_shapes(self) -> FloatArray:
        """(point, 2^axes) pressure shape functions at the integration points."""
        # Shape functions of a grid's elements differ only by scale: those of the first do for all.
        return np.stack([np.asarray(shape[0])[0] for shape in self._pressure.basis], axis=-1)

    @cached_property
    def weights(self) -> FloatArray:
        """(element, point) integration weights, mm^3; 2 pi r included in axisymmetry."""
        weights: FloatArray = self._displacement.dx
        return weights * 2 * np.pi * self._points_r if self.axes == 2 else weights

    @cached_property
    def gradient(self) -> FloatArray:
        """(element, point, component, unknown): displacement to deformation gradient less I."""
        shapes = [shape[0] for shape in self._displacement.basis]
        slopes = np.stack([np.moveaxis(shape.grad, 0, -1) for shape in shapes], axis=-2)
        elements, points, nodes, axes = slopes.shape
        operator = np.zeros((elements, points, len(self.components), nodes, axes))
        for row, (i, j) in enumerate(self.components):
            if i < axes:
                operator[:, :, row, :, i] = slopes[..., j]
            else:
                values = np.stack([np.asarray(shape) for shape in shapes], axis=-1)
                operator[:, :, row, :, 0] = values / self._points_r[..., None]
        return operator.reshape(elements, points, len(self.components), nodes * axes)

    def surface(self, gauss: int) -> "Surface":
        """Return the touched face (z = 0) with `gauss` integration points per element and axis.

        Points are in order, facet by facet, ascending in the first axis, then in the second.
        """
        low = self._mesh.facets_satisfying(lambda at: np.isclose(at[-1], self.edges_mm[-1][0]))
        face = skfem.FacetBasis(self._mesh, self._quadratic, facets=low, intorder=2 * gauss - 1)
        order, first = _in_order(face), np.asarray(face.global_coordinates())[0]
        weight = face.dx * 2 * np.pi * first if self.axes == 2 else face.dx
        values = np.stack([np.asarray(shape[0]) for shape in face.basis], axis=-1)
        nodes = self._node_of_unknown[face.element_dofs.T]
        columns = np.repeat(nodes[:, None], weight.shape[1], axis=1).reshape(weight.size, -1)
        count = (weight.size, self.nodes_mm.shape[0])
        rows = np.repeat(np.arange(weight.size), columns.shape[1])
        trace = sparse.csr_array(
            (values.reshape(columns.shape)[order].ravel(), (rows, columns[order].ravel())), count
        )
        # A facet's basis includes the nodes of its whole element: the inner ones have weight 0.
        trace.data[np.abs(trace.data) < _ROUNDING] = 0.0
        trace.eliminate_zeros()
        return Surface(trace, weight.ravel()[order], self.axes)

    @cached_property
    def _mesh(self) -> Any:
        kind = skfem.MeshQuad if self.axes == 2 else skfem.MeshHex
        return kind.init_tensor(*self.edges_mm)

    @property
    def _quadratic(self) -> Any:
        return skfem.ElementQuad2() if self.axes == 2 else skfem.ElementHex2()

    @cached_property
    def _displacement(self) -> Any:
        return skfem.CellBasis(self._mesh, self._quadratic, intorder=2 * self.gauss - 1)

    @cached_property
    def _pressure(self) -> Any:
        linear = skfem.ElementQuad1() if self.axes == 2 else skfem.ElementHex1()
        return self._displacement.with_element(linear)

    @cached_property
    def _node_of_unknown(self) -> IntArray:
        """Number in the grid of scikit-fem's unknowns, by their position."""
        places = zip(self.lines_mm, self._displacement.doflocs, strict=True)
        halfway = [((line[1:] + line[:-1]) / 2, at) for line, at in places]
        numbers = tuple(np.searchsorted(between, at) for between, at in halfway)
        counts = tuple(line.size for line in self.lines_mm)
        return np.asarray(np.ravel_multi_index(numbers, counts), dtype=np.int64)

    @cached_property
    def _points_r(self) -> FloatArray:
        return np.asarray(np.asarray(self._displacement.global_coordinates())[0])


@dataclass(frozen=True)
class Surface:
    """Integration points on the touched face."""

    #: (point, node) sparse: nodal values to values at the points
    trace: sparse.csr_array
    #: (point,) undeformed area, mm^2
    weight_mm2: FloatArray
    axes: int

    @cached_property
    def vector_trace(self) -> sparse.csr_array:
        """(axes * point, axes * node) sparse: the same for vectors, point by point."""
        return sparse.csr_array(sparse.kron(self.trace, sparse.eye_array(self.axes)))


def graded(length_mm: float, count: int, ratio: float) -> FloatArray:
    """Return count + 1 edges on 0..length with steps that increase by the factor `ratio`."""
    steps = ratio ** np.arange(count)
    edges: FloatArray = np.concatenate(([0.0], np.cumsum(steps)))
    return edges * (length_mm / float(steps.sum()))


def _in_order(face: Any) -> IntArray:
    """Return the order of a face's points: facets by their centres, then points by position."""
    at = np.asarray(face.global_coordinates())[-2::-1]
    centres = np.broadcast_to(at.mean(axis=2, keepdims=True), at.shape)
    # The last key counts first; rounded, as points of one line differ in their last digits.
    keys = np.round(np.concatenate((at, centres)), 9).reshape(2 * len(at), -1)
    return np.asarray(np.lexsort(keys), dtype=np.int64)
