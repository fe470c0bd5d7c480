"""Q2/Q1 (Taylor-Hood) elements on rectangle and brick grids: where they are and what they see.

Axes: r, z in axisymmetry; x, y, z in space; z is the last and runs along the press from the
touched face (z = 0) to the far face. Displacement nodes are the grid lines and their midpoints,
numbered as in `numpy.ravel_multi_index`; unknowns are numbered node by node.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import sparse

from reconstruction.arrays import FloatArray

IntArray = npt.NDArray[np.int64]

# Tensor components (i, j) of the deformation gradient that can differ from the identity.
_AXISYMMETRIC = ((0, 0), (0, 1), (1, 0), (1, 1), (2, 2))
_SPATIAL = tuple((i, j) for i in range(3) for j in range(3))


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
        """The tensor components that an element's `gradient` rows stand for."""
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
        return _connect(tuple(e.size - 1 for e in self.edges_mm), 2)

    @cached_property
    def element_corners(self) -> IntArray:
        """(element, 2^axes) pressure nodes, numbered apart from the displacement's."""
        return _connect(tuple(e.size - 1 for e in self.edges_mm), 1)

    @cached_property
    def corner_shapes(self) -> FloatArray:
        """(point, 2^axes) pressure shape functions at the integration points."""
        return _tensor([_linear(_gauss(self.gauss)[0])] * self.axes)

    @cached_property
    def weights(self) -> FloatArray:
        """(element, point) integration weights, mm^3; 2 pi r included in axisymmetry."""
        sizes = np.stack(np.meshgrid(*map(np.diff, self.edges_mm), indexing="ij"), axis=-1)
        volume = sizes.reshape(-1, self.axes).prod(axis=1)
        unit = _tensor([_gauss(self.gauss)[1][:, None]] * self.axes)[:, 0]
        weights: FloatArray = np.outer(volume, unit)
        return weights * 2 * np.pi * self._points_r if self.axes == 2 else weights

    @cached_property
    def gradient(self) -> FloatArray:
        """(element, point, component, unknown): displacement to deformation gradient less I."""
        slopes = self._slopes
        elements, points, nodes, axes = slopes.shape
        operator = np.zeros((elements, points, len(self.components), nodes, axes))
        for row, (i, j) in enumerate(self.components):
            if i < axes:
                operator[:, :, row, :, i] = slopes[..., j]
            else:
                operator[:, :, row, :, 0] = self._shapes / self._points_r[..., None]
        return operator.reshape(elements, points, len(self.components), nodes * axes)

    def surface(self, gauss: int) -> "Surface":
        """Return the touched face (z = 0) with `gauss` integration points per element and axis."""
        lines = tuple(e.size - 1 for e in self.edges_mm[:-1])
        flat = _connect(lines, 2)
        points, unit = _gauss(gauss)
        shapes = _tensor([_quadratic(points)] * (self.axes - 1))
        # Nodes of the face are those of the plane grid at the first z.
        nodes = flat * self.lines_mm[-1].size
        rows = np.repeat(np.arange(flat.shape[0] * shapes.shape[0]), flat.shape[1])
        columns = np.repeat(nodes[:, None], shapes.shape[0], axis=1).ravel()
        values = np.tile(shapes, (flat.shape[0], 1, 1)).ravel()
        shape = (rows[-1] + 1, self.nodes_mm.shape[0])
        trace = sparse.csr_array((values, (rows, columns)), shape=shape)
        sizes = np.stack(np.meshgrid(*map(np.diff, self.edges_mm[:-1]), indexing="ij"), axis=-1)
        area = sizes.reshape(-1, self.axes - 1).prod(axis=1)
        weight = np.outer(area, _tensor([unit[:, None]] * (self.axes - 1))[:, 0]).ravel()
        if self.axes == 2:
            weight = weight * 2 * np.pi * np.asarray(trace @ self.nodes_mm[:, 0])
        return Surface(trace, weight, self.axes)

    @cached_property
    def _slopes(self) -> FloatArray:
        points = _gauss(self.gauss)[0]
        value, slope = _quadratic(points), _quadratic_slope(points)
        sizes = np.stack(np.meshgrid(*map(np.diff, self.edges_mm), indexing="ij"), axis=-1)
        sizes = sizes.reshape(-1, 1, 1, self.axes)
        unit = np.stack(
            [
                _tensor([slope if axis == j else value for axis in range(self.axes)])
                for j in range(self.axes)
            ],
            axis=-1,
        )
        slopes: FloatArray = np.asarray(unit / sizes, dtype=np.float64)
        return slopes

    @cached_property
    def _shapes(self) -> FloatArray:
        return _tensor([_quadratic(_gauss(self.gauss)[0])] * self.axes)

    @cached_property
    def _points_r(self) -> FloatArray:
        radii: FloatArray = self.nodes_mm[self.element_nodes, 0] @ self._shapes.T
        return radii


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
    """Return count + 1 edges on 0..length whose steps grow by `ratio`."""
    steps = ratio ** np.arange(count)
    edges: FloatArray = np.concatenate(([0.0], np.cumsum(steps)))
    return edges * (length_mm / float(steps.sum()))


def _connect(counts: tuple[int, ...], order: int) -> IntArray:
    """Return (element, (order + 1)^axes) nodes of a grid of `counts` elements."""
    first = np.indices(counts).reshape(len(counts), -1, 1) * order
    local = np.indices((order + 1,) * len(counts)).reshape(len(counts), 1, -1)
    nodes = np.ravel_multi_index(tuple(first + local), tuple(order * n + 1 for n in counts))
    return np.asarray(nodes, dtype=np.int64)


def _gauss(count: int) -> tuple[FloatArray, FloatArray]:
    points, weights = np.polynomial.legendre.leggauss(count)
    return (points + 1) / 2, weights / 2


def _linear(x: FloatArray) -> FloatArray:
    return np.stack((1 - x, x), axis=-1)


def _quadratic(x: FloatArray) -> FloatArray:
    return np.stack(((1 - x) * (1 - 2 * x), 4 * x * (1 - x), x * (2 * x - 1)), axis=-1)


def _quadratic_slope(x: FloatArray) -> FloatArray:
    return np.stack((4 * x - 3, 4 - 8 * x, 4 * x - 1), axis=-1)


def _tensor(factors: list[FloatArray]) -> FloatArray:
    """Return the tensor product of (point, function) tables, the first axis slowest."""
    product: FloatArray = factors[0]
    for factor in factors[1:]:
        product = np.asarray(np.kron(product, factor), dtype=np.float64)
    return product
