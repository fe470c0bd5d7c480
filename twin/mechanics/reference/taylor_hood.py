"""Linear elasticity on tetrahedra: P2 displacement and P1 pressure (Taylor-Hood), no locking.

The matrix is [[A, B^T], [B, -M / K]] with A = int 2 mu (eps:eps - div div / 3), B = int q div u,
M = int q q, shear modulus mu and bulk modulus K, all over Young's modulus. It is factorised once;
each load then takes one substitution. Nodes are the vertices, followed by the edges' midpoints.
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
from twin.mechanics.reference.grid import trace_of
from twin.mechanics.reference.mixed import moduli, symmetric_lu
from twin.mechanics.reference.pad import Hold, Selector
from twin.mechanics.reference.tetrahedra import Tetrahedra

_FACET_ORDER = 4


@dataclass(frozen=True)
class Facets:
    """Selected facets of a body's surface, with their integration points."""

    #: (facet, 6) node numbers: three vertices, then the edges' midpoints
    nodes: IntArray
    #: (point, xyz) integration points, sorted by facet, mm
    points_mm: FloatArray
    #: (point,) area and area in plan, mm^2
    weight_mm2: FloatArray
    plan_mm2: FloatArray
    #: (point, node) sparse matrix: interpolates nodal values at the points
    trace: sparse.csr_array

    @property
    def size_mm(self) -> float:
        """Edge length of the smallest facets (fifth percentile)."""
        areas = self.weight_mm2.reshape(self.nodes.shape[0], -1).sum(axis=1)
        return float(np.sqrt(4 / np.sqrt(3) * np.quantile(areas, 0.05)))


@dataclass(frozen=True)
class ElasticBody:
    """A linear elastic body of tetrahedra with its supports."""

    mesh: Tetrahedra
    poisson_ratio: float
    holds: tuple[Hold, ...]

    @cached_property
    def nodes_mm(self) -> FloatArray:
        """(node, xyz) positions of vertices and midpoints of edges."""
        vertices, edges = self._mesh.p.T, self._mesh.edges
        return np.concatenate((vertices, vertices[edges].mean(axis=0)))

    def facets(self, where: Selector) -> Facets:
        """Return the facets of the surface that a selector selects.

        Raises
        ------
        PressError : the selector selects no facet
        """
        chosen = self._chosen(where)
        if not chosen.size:
            raise PressError("pad: a selector chooses no facet of the surface")
        quadratic = skfem.ElementTetP2()
        face = skfem.FacetBasis(self._mesh, quadratic, facets=chosen, intorder=_FACET_ORDER)
        return Facets(
            nodes=self._nodes_on(chosen),
            points_mm=np.asarray(face.global_coordinates()).reshape(3, -1).T,
            weight_mm2=face.dx.ravel(),
            plan_mm2=(face.dx * np.abs(face.normals[2])).ravel(),
            # The unknowns of the scalar element have the numbers of the nodes.
            trace=trace_of(face, face.element_dofs.T, self.nodes_mm.shape[0]),
        )

    def solve(self, force: FloatArray) -> FloatArray:
        """Return the displacement (node, xyz), mm, under nodal forces (node, xyz) over E."""
        load, solution = np.zeros((2, self._size))
        load[self._unknowns] = force
        solution[self._free] = self._factor.solve(load[self._free])
        return np.asarray(solution[self._unknowns])

    def residual(self, moved_mm: FloatArray, pressure: FloatArray) -> FloatArray:
        """Return the nodal forces over E (node, xyz) of displacements and vertex pressures.

        `moved_mm` is (node, xyz), `pressure` (vertex,) over E.
        """
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
        held = np.zeros((self.nodes_mm.shape[0], 3), dtype=bool)
        for hold in self.holds:
            nodes = self._nodes_on(self._chosen(hold.where))
            if not nodes.size:
                raise PressError("pad: a hold chooses no facet of the surface")
            for direction in hold.directions:
                held[nodes, "xyz".index(direction)] = True
        return np.asarray(np.setdiff1d(np.arange(self._size), self._unknowns[held]))

    @cached_property
    def _factor(self) -> Any:
        matrix = sparse.csc_array(self._matrix[self._free][:, self._free])
        # The matrix is quasi-definite, so that any symmetric ordering is stable. This one has 1/3
        # of the fill of COLAMD.
        return symmetric_lu(matrix)

    @cached_property
    def _surface(self) -> Any:
        """Facet basis of the whole surface, with one integration point at each facet's centre."""
        return skfem.FacetBasis(self._mesh, skfem.ElementTetP1(), intorder=1)

    def _chosen(self, where: Selector) -> IntArray:
        """Return the numbers (n,) of the surface's facets that a selector selects."""
        centres = np.asarray(self._surface.global_coordinates())[..., 0].T
        normals = np.asarray(self._surface.normals)[..., 0].T
        return np.asarray(self._surface.find[where(centres, normals)])

    def _nodes_on(self, facets: IntArray) -> IntArray:
        """Return the node numbers of facets (facet, 6): vertices, then the edges' midpoints."""
        midpoints = self._mesh.f2e[:, facets] + self._mesh.p.shape[1]
        return np.concatenate((self._mesh.facets[:, facets], midpoints)).T.astype(np.int64)
