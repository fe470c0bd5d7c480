"""Rubber in mixed form, displacement and pressure: neo-Hookean, and its small-strain limit.

At unit Young's modulus. Symbols: F deformation gradient, J = det F, mu shear modulus, K bulk
modulus, p pressure-like unknown (the hydrostatic part; tension is positive), P first
Piola-Kirchhoff stress, cof = J F^-T = dJ/dF.

    neo-Hookean: P = mu J^(-2/3) (F - tr(F^T F) / 3 F^-T) + p cof,   J - 1 - p / K = 0
    linear:      P = 2 mu dev eps + p I,                             tr eps - p / K = 0

The mixed form has no locking as nu -> 0.5. Arrays are (..., 3, 3); in axisymmetry the axes are
r, z, hoop.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray


@dataclass(frozen=True)
class Response:
    """What a material point answers, at unit Young's modulus."""

    #: (..., 3, 3) first Piola-Kirchhoff stress
    stress: FloatArray
    #: (..., 3, 3, 3, 3) its derivative by F at constant p
    tangent: FloatArray
    #: (...) the volume equation's residual
    volume: FloatArray
    #: (..., 3, 3) its derivative by F, and the stress's derivative by p
    coupling: FloatArray


@dataclass(frozen=True)
class Moduli:
    """Shear and bulk modulus over Young's modulus."""

    shear: float
    bulk: float


Material = Callable[[FloatArray, FloatArray, Moduli], Response]


def moduli(poisson_ratio: float) -> Moduli:
    """Return shear and bulk modulus over Young's modulus, 0 < nu < 0.5."""
    return Moduli(1 / (2 * (1 + poisson_ratio)), 1 / (3 * (1 - 2 * poisson_ratio)))


def neo_hookean(gradient: FloatArray, pressure: FloatArray, material: Moduli) -> Response:
    """Return the response of a neo-Hookean rubber.

    Parameters
    ----------
    gradient : (..., 3, 3) float
        Deformation gradient F with det F > 0.
    pressure : (...) float
        p over Young's modulus.
    material : Moduli
        Over Young's modulus.
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
    """Return the response at small strain; arguments as for `neo_hookean`."""
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
    """Return dP/dF; `inverse` is F^-T."""
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
