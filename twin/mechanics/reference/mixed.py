"""Nearly incompressible rubber in mixed form: materials, residual and tangent of a body.

All stresses are divided by Young's modulus; residuals are forces and volumes. Unknowns are the
displacements in order of the nodes, then the pressures. Symbols: F deformation gradient,
J = det F, mu shear modulus, K bulk modulus, p hydrostatic stress (an unknown; tension is positive),
P first Piola-Kirchhoff stress, cof = J F^-T = dJ/dF.

    neo-Hookean: P = mu J^(-2/3) (F - tr(F^T F) / 3 F^-T) + p cof,   J - 1 - p / K = 0
    linear:      P = 2 mu dev eps + p I,                             tr eps - p / K = 0

The mixed form has no locking as nu -> 0.5. Tensors are arrays (..., 3, 3).

The tangent is assembled by batched matrix products. A form of scikit-fem, which is evaluated for
each pair of an element's 81 displacements, would take 55 times as long (200 bricks, one core: 21 s
instead of 0.39 s).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from reconstruction.arrays import FloatArray, IntArray
from twin.mechanics.reference.grid import ElementGrid


@dataclass(frozen=True)
class Response:
    """Stress and volume residual of material points, over Young's modulus, with derivatives."""

    #: (..., 3, 3) first Piola-Kirchhoff stress
    stress: FloatArray
    #: (..., 3, 3, 3, 3) derivative of the stress by F at constant p
    tangent: FloatArray
    #: (...) residual of the volume equation
    volume: FloatArray
    #: (..., 3, 3) derivative of the volume residual by F; equal to that of the stress by p
    coupling: FloatArray


@dataclass(frozen=True)
class Moduli:
    """Shear and bulk modulus divided by Young's modulus."""

    shear: float
    bulk: float


Material = Callable[[FloatArray, FloatArray, Moduli], Response]


def moduli(poisson_ratio: float) -> Moduli:
    """Return shear and bulk modulus over Young's modulus, for 0 < Poisson's ratio < 0.5."""
    return Moduli(1 / (2 * (1 + poisson_ratio)), 1 / (3 * (1 - 2 * poisson_ratio)))


def neo_hookean(gradient: FloatArray, pressure: FloatArray, material: Moduli) -> Response:
    """Return the response of a neo-Hookean rubber.

    Parameters
    ----------
    gradient : (..., 3, 3) float; deformation gradient F with det F > 0
    pressure : (...) float; p over Young's modulus
    material : shear and bulk modulus over Young's modulus
    """
    J = np.linalg.det(gradient)
    inverse = np.swapaxes(np.linalg.inv(gradient), -1, -2)
    cofactor = J[..., None, None] * inverse
    squares = np.sum(gradient**2, axis=(-1, -2))
    shear = material.shear * np.cbrt(J) ** -2
    stress = shear[..., None, None] * (gradient - squares[..., None, None] / 3 * inverse)
    stress += pressure[..., None, None] * cofactor
    return Response(
        stress,
        _neo_hookean_tangent(gradient, inverse, shear, squares, pressure * J),
        J - 1 - pressure / material.bulk,
        cofactor,
    )


def linear(gradient: FloatArray, pressure: FloatArray, material: Moduli) -> Response:
    """Return the response of a linear elastic rubber; arguments as for `neo_hookean`."""
    identity = np.eye(3)
    raised = gradient - identity
    strain = (raised + np.swapaxes(raised, -1, -2)) / 2
    trace = np.trace(strain, axis1=-2, axis2=-1)
    hydrostatic = pressure - 2 * material.shear * trace / 3
    unit = np.einsum("ik,jl->ijkl", identity, identity)
    tangent = material.shear * (unit + np.swapaxes(unit, 2, 3))
    tangent = tangent - 2 * material.shear / 3 * np.einsum("ij,kl->ijkl", identity, identity)
    return Response(
        2 * material.shear * strain + hydrostatic[..., None, None] * identity,
        np.broadcast_to(tangent, (*trace.shape, 3, 3, 3, 3)),
        trace - pressure / material.bulk,
        np.broadcast_to(identity, gradient.shape),
    )


def _neo_hookean_tangent(
    F: FloatArray, inverse: FloatArray, shear: FloatArray, squares: FloatArray, pJ: FloatArray
) -> FloatArray:
    """Return dP/dF (..., 3, 3, 3, 3) of the neo-Hookean material; `inverse` is F^-T."""
    mixed = np.einsum("...ij,...kl->...ijkl", F, inverse)
    mixed = mixed + np.einsum("...ij,...kl->...ijkl", inverse, F)
    square = np.einsum("...ij,...kl->...ijkl", inverse, inverse)
    # dF^-T_ij / dF_kl = -F^-T_il F^-T_kj
    turned = np.einsum("...il,...kj->...ijkl", inverse, inverse)
    wide = shear[..., None, None, None, None]
    I1, pJ = squares[..., None, None, None, None], pJ[..., None, None, None, None]
    tangent: FloatArray = (wide * I1 / 3 - pJ) * turned
    tangent += (wide * I1 * (2 / 9) + pJ) * square
    tangent -= wide * (2 / 3) * mixed
    tangent += wide * np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))
    return tangent


@dataclass(frozen=True)
class MixedBody:
    """A body of one material on a grid of elements."""

    grid: ElementGrid
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
        """Return the displacements (node, axis), mm, that the state vector (unknown,) contains."""
        return state[: self.displacements].reshape(-1, self.grid.axes)

    def is_admissible(self, state: FloatArray) -> bool:
        """Return True if det F > 0 at every integration point: no element is inverted."""
        return bool((np.linalg.det(self._deformation(state)) > 0).all())

    def assemble(self, state: FloatArray) -> tuple[FloatArray, sparse.csc_array]:
        """Return the residual (unknown,) and the tangent (unknown, unknown) at a state."""
        grid, weights = self.grid, self.grid.weights
        pressure = state[self._pressure_unknowns] @ grid.corner_shapes.T
        response = self.material(self._deformation(state), pressure, self.moduli)
        i, j = np.transpose(grid.components)
        stress, coupling = response.stress[..., i, j], response.coupling[..., i, j]
        tangent = response.tangent[..., i[:, None], j[:, None], i, j]
        residual = np.zeros(self.unknowns)
        forces = _contract(grid.gradient, stress * weights[..., None])
        volumes = (response.volume * weights) @ grid.corner_shapes
        np.add.at(residual, self._element_unknowns, np.concatenate((forces, volumes), axis=1))
        blocks = self._blocks(tangent * weights[..., None, None], coupling * weights[..., None])
        rows, columns = self._pattern
        shape = (self.unknowns, self.unknowns)
        return residual, sparse.csc_array((blocks.ravel(), (rows, columns)), shape=shape)

    def _deformation(self, state: FloatArray) -> FloatArray:
        """Return the deformation gradient F (element, point, 3, 3)."""
        grid = self.grid
        local = state[self._displacement_unknowns]
        moved = np.matmul(grid.gradient, local[:, None, :, None])[..., 0]
        deformation = np.zeros((*moved.shape[:2], 3, 3)) + np.eye(3)
        i, j = np.transpose(grid.components)
        deformation[..., i, j] += moved
        return deformation

    def _blocks(self, tangent: FloatArray, coupling: FloatArray) -> FloatArray:
        """Return the element matrices (element, n, n): displacement unknowns first, then pressure.

        `tangent` and `coupling` are those of `Response`, times the integration weights.
        """
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
        """Row and column in the tangent of every entry of the element matrices, both flattened."""
        unknowns = self._element_unknowns
        width = unknowns.shape[1]
        return np.repeat(unknowns, width, axis=1).ravel(), np.tile(unknowns, width).ravel()


def symmetric_lu(matrix: sparse.csc_array) -> SuperLU:
    """Return an LU factorisation with a symmetric ordering and without pivoting.

    For meshes in three dimensions it is several times faster than with column ordering.
    """
    options = {"SymmetricMode": True}
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


def _contract(operator: FloatArray, stress: FloatArray) -> FloatArray:
    """Return the integral of B^T stress per element (element, unknown); B is `operator`."""
    elements, points, rows, width = operator.shape
    flat = operator.reshape(elements, points * rows, width)
    return np.asarray(np.matmul(stress.reshape(elements, 1, points * rows), flat)[:, 0])
