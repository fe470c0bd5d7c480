"""Linear elasticity on tetrahedra: P2 displacement and P1 pressure (Taylor-Hood), no locking.

At unit Young's modulus: [[A, B^T], [B, -M / K]] with A = int 2 mu (eps:eps - div div / 3),
B = int q div u, M = int q q. The matrix is factorised once; each load then takes one
substitution. Nodes are the vertices followed by the edges' midpoints.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import skfem
from scipy import sparse
from skfem.helpers import ddot, div, sym_grad

from reconstruction.arrays import FloatArray, IntArray
from twin.mechanics.errors import PressError
from twin.mechanics.reference.mixed import moduli, symmetric_lu
from twin.mechanics.reference.pad import Hold, Selector
from twin.mechanics.reference.tetrahedra import Tetrahedra

_FACET_ORDER = 4


@dataclass(frozen=True)
class Facets:
    """A part of the surface with integration points; (facet, ...) and (point, ...) arrays."""

    #: (facet, 6) nodes: three vertices, then the midpoints opposite to them in turn 01, 12, 20
    nodes: IntArray
    #: (point, xyz) mm
    points_mm: FloatArray
    #: (point,) area and area in plan, mm^2
    weight_mm2: FloatArray
    plan_mm2: FloatArray
    #: (point, node) sparse: nodal values to values at the points
    trace: sparse.csr_array

    @property
    def size_mm(self) -> float:
        """Edge length of the smallest facets (fifth percentile)."""
        areas = self.weight_mm2.reshape(self.nodes.shape[0], -1).sum(axis=1)
        return float(np.sqrt(4 / np.sqrt(3) * np.quantile(areas, 0.05)))


@dataclass(frozen=True)
class ElasticBody:
    """A held body of tetrahedra."""

    mesh: Tetrahedra
    poisson_ratio: float
    holds: tuple[Hold, ...]

    @cached_property
    def nodes_mm(self) -> FloatArray:
        """(node, xyz) vertices and midpoints."""
        vertices, edges = self._mesh.p.T, self._mesh.edges
        return np.concatenate((vertices, vertices[edges].mean(axis=0)))

    def facets(self, where: Selector) -> Facets:
        """Return the chosen part of the surface.

        Raises
        ------
        PressError : the selector chooses no facet
        """
        corners, centres, normals = self._boundary
        chosen = where(centres, normals)
        if not chosen.any():
            raise PressError("pad: a selector chooses no facet of the surface")
        return self._with_points(corners[chosen], normals[chosen])

    def solve(self, force: FloatArray) -> FloatArray:
        """Return the displacement (node, xyz), mm, under nodal forces (node, xyz) over E."""
        right = np.zeros(self._free.size)
        displaced = np.zeros(self._size)
        displaced[self._unknowns] = force
        right[:] = displaced[self._free]
        solution = np.zeros(self._size)
        solution[self._free] = self._factor.solve(right)
        return np.asarray(solution[self._unknowns])

    def residual(self, moved_mm: FloatArray, pressure: FloatArray) -> FloatArray:
        """Return the nodal forces (node, xyz) over E of a displacement and vertex pressures."""
        state = np.zeros(self._size)
        state[self._unknowns] = moved_mm
        state[self._size - pressure.size :] = pressure
        return np.asarray((self._matrix @ state)[self._unknowns])

    @cached_property
    def _mesh(self) -> Any:
        return skfem.MeshTet(
            np.ascontiguousarray(self.mesh.points_mm.T), np.ascontiguousarray(self.mesh.cells.T)
        )

    @cached_property
    def _basis(self) -> Any:
        return skfem.CellBasis(self._mesh, skfem.ElementVector(skfem.ElementTetP2()), intorder=2)

    @property
    def _size(self) -> int:
        return int(self._basis.N + self._mesh.p.shape[1])

    @cached_property
    def _unknowns(self) -> IntArray:
        """(node, xyz) numbers of the displacement unknowns."""
        numbers = np.concatenate((self._basis.nodal_dofs, self._basis.edge_dofs), axis=1)
        return np.asarray(numbers.T, dtype=np.int64)

    @cached_property
    def _matrix(self) -> sparse.csc_array:
        material = moduli(self.poisson_ratio)
        pressure = self._basis.with_element(skfem.ElementTetP1())

        def shear(u: Any, v: Any, _: Any) -> Any:
            strains = ddot(sym_grad(u), sym_grad(v)) - div(u) * div(v) / 3
            return 2 * material.shear * strains

        def volume(u: Any, q: Any, _: Any) -> Any:
            return div(u) * q

        def compression(p: Any, q: Any, _: Any) -> Any:
            return p * q / material.bulk

        across = skfem.BilinearForm(volume).assemble(self._basis, pressure)
        blocks = [
            [skfem.BilinearForm(shear).assemble(self._basis), across.T],
            [across, -skfem.BilinearForm(compression).assemble(pressure)],
        ]
        return sparse.csc_array(sparse.block_array(blocks))

    @cached_property
    def _free(self) -> IntArray:
        corners, centres, normals = self._boundary
        held = np.zeros((self.nodes_mm.shape[0], 3), dtype=bool)
        for hold in self.holds:
            chosen = hold.where(centres, normals)
            if not chosen.any():
                raise PressError("pad: a hold chooses no facet of the surface")
            nodes = np.unique(self._six_nodes(corners[chosen]))
            for direction in hold.directions:
                held[nodes, "xyz".index(direction)] = True
        return np.asarray(np.setdiff1d(np.arange(self._size), self._unknowns[held]))

    @cached_property
    def _factor(self) -> Any:
        matrix = sparse.csc_array(self._matrix[self._free][:, self._free])
        # Quasi-definite: any symmetric ordering is stable; three times less fill than COLAMD.
        return symmetric_lu(matrix)

    @cached_property
    def _boundary(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return vertices (facet, 3), centres and outward normals of the surface."""
        numbers = self._mesh.boundary_facets()
        corners = np.asarray(self._mesh.facets[:, numbers].T, dtype=np.int64)
        at = self._mesh.p.T[corners]
        normals = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        cells = self._mesh.t[:, self._mesh.f2t[0, numbers]].T
        centres = at.mean(axis=1)
        inwards = self._mesh.p.T[cells].mean(axis=1) - centres
        normals *= -np.sign(np.sum(normals * inwards, axis=1, keepdims=True))
        return corners, centres, normals

    def _six_nodes(self, corners: IntArray) -> IntArray:
        """Return vertices and midpoints (facet, 6)."""
        count, edges = self._mesh.p.shape[1], np.sort(self._mesh.edges, axis=0)
        keys = edges[0].astype(np.int64) * count + edges[1]
        order = np.argsort(keys)
        pairs = np.sort(corners[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
        edge_keys = pairs[..., 0] * count + pairs[..., 1]
        midpoints = order[np.searchsorted(keys, edge_keys, sorter=order)] + count
        return np.concatenate((corners, midpoints), axis=1)

    def _with_points(self, corners: IntArray, normals: FloatArray) -> Facets:
        nodes = self._six_nodes(corners)
        local, unit = skfem.quadrature.get_quadrature(
            skfem.element.ElementTriP2.refdom, _FACET_ORDER
        )
        share = np.stack((1 - local.sum(axis=0), *local), axis=1)
        at = self._mesh.p.T[corners]
        double = np.linalg.norm(np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]), axis=1)
        weight = np.outer(double, unit)
        shapes = np.concatenate(
            (share * (2 * share - 1), 4 * share * np.roll(share, -1, axis=1)), axis=1
        )
        rows = np.repeat(np.arange(weight.size), 6)
        columns = np.repeat(nodes, unit.size, axis=0).ravel()
        values = np.tile(shapes, (nodes.shape[0], 1)).ravel()
        return Facets(
            nodes=nodes,
            points_mm=np.einsum("qc,fcx->fqx", share, at).reshape(-1, 3),
            weight_mm2=weight.ravel(),
            plan_mm2=(weight * np.abs(normals[:, 2:])).ravel(),
            trace=sparse.csr_array(
                (values, (rows, columns)), shape=(weight.size, self.nodes_mm.shape[0])
            ),
        )
