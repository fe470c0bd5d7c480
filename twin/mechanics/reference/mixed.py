"""Residual and tangent of a mixed displacement-pressure body, whatever its elements and material.

Unknowns: displacements node by node, then pressures. Residuals are forces and volumes at unit
Young's modulus.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from reconstruction.arrays import FloatArray
from twin.mechanics.reference.grid import Grid, IntArray
from twin.mechanics.reference.material import Material, Moduli


@dataclass(frozen=True)
class Body:
    """A grid filled with a material."""

    grid: Grid
    material: Material
    moduli: Moduli

    @property
    def displacements(self) -> int:
        """Number of displacement unknowns."""
        return self.grid.nodes_mm.size

    @property
    def unknowns(self) -> int:
        """Number of all unknowns."""
        return self.displacements + int(self.grid.element_corners.max()) + 1

    def displacement_mm(self, state: FloatArray) -> FloatArray:
        """Return the (node, axis) displacements of a state vector."""
        return state[: self.displacements].reshape(-1, self.grid.axes)

    def is_admissible(self, state: FloatArray) -> bool:
        """Tell whether no integration point is turned inside out."""
        return bool((np.linalg.det(self._deformation(state)) > 0).all())

    def assemble(self, state: FloatArray) -> tuple[FloatArray, sparse.csc_array]:
        """Return the residual (unknown,) and the tangent (unknown, unknown)."""
        grid, weights = self.grid, self.grid.weights
        pressure = state[self._pressure_unknowns] @ grid.corner_shapes.T
        answer = self.material(self._deformation(state), pressure, self.moduli)
        i, j = np.transpose(grid.components)
        stress, coupling = answer.stress[..., i, j], answer.coupling[..., i, j]
        tangent = answer.tangent[..., i[:, None], j[:, None], i, j]
        residual = np.zeros(self.unknowns)
        forces = _contract(grid.gradient, stress * weights[..., None])
        volumes = (answer.volume * weights) @ grid.corner_shapes
        np.add.at(residual, self._element_unknowns, np.concatenate((forces, volumes), axis=1))
        blocks = self._blocks(tangent * weights[..., None, None], coupling * weights[..., None])
        rows, columns = self._pattern
        shape = (self.unknowns, self.unknowns)
        return residual, sparse.csc_array((blocks.ravel(), (rows, columns)), shape=shape)

    def _deformation(self, state: FloatArray) -> FloatArray:
        """Return F (element, point, 3, 3)."""
        grid = self.grid
        local = state[self._displacement_unknowns]
        moved = np.matmul(grid.gradient, local[:, None, :, None])[..., 0]
        deformation = np.zeros((*moved.shape[:2], 3, 3)) + np.eye(3)
        i, j = np.transpose(grid.components)
        deformation[..., i, j] += moved
        return deformation

    def _blocks(self, tangent: FloatArray, coupling: FloatArray) -> FloatArray:
        """Return the element matrices (element, n, n) with displacement and pressure blocks."""
        grid = self.grid
        operator, shapes = grid.gradient, grid.corner_shapes
        elements, points, rows, width = operator.shape
        flat = operator.reshape(elements, points * rows, width)
        stiffness = np.matmul(np.swapaxes(flat, 1, 2), (tangent @ operator).reshape(flat.shape))
        drive = coupling[..., None] * shapes[:, None, :]
        drive = drive.reshape(elements, points * rows, shapes.shape[1])
        across = np.matmul(np.swapaxes(flat, 1, 2), drive)
        mass = np.matmul(shapes.T, grid.weights[..., None] * shapes) / self.moduli.bulk
        upper = np.concatenate((stiffness, across), axis=2)
        lower = np.concatenate((np.swapaxes(across, 1, 2), -mass), axis=2)
        return np.concatenate((upper, lower), axis=1)

    @cached_property
    def _displacement_unknowns(self) -> IntArray:
        axes = self.grid.axes
        nodes = self.grid.element_nodes
        wide = nodes[:, :, None] * axes + np.arange(axes)
        return wide.reshape(nodes.shape[0], -1)

    @cached_property
    def _pressure_unknowns(self) -> IntArray:
        return self.grid.element_corners + self.displacements

    @cached_property
    def _element_unknowns(self) -> IntArray:
        return np.concatenate((self._displacement_unknowns, self._pressure_unknowns), axis=1)

    @cached_property
    def _pattern(self) -> tuple[IntArray, IntArray]:
        """Return row and column of every entry of the element matrices."""
        unknowns = self._element_unknowns
        width = unknowns.shape[1]
        return np.repeat(unknowns, width, axis=1).ravel(), np.tile(unknowns, width).ravel()


def _contract(operator: FloatArray, stress: FloatArray) -> FloatArray:
    """Return int B^T stress per element."""
    elements, points, rows, width = operator.shape
    flat = operator.reshape(elements, points * rows, width)
    forces: FloatArray = np.matmul(stress.reshape(elements, 1, points * rows), flat)[:, 0]
    return forces
