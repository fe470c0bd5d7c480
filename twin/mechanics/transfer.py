"""How one wavenumber of pressure deflects both faces of an elastic layer.

Frame: z along the press, from the touched face t (z = 0) to the other face b (z = h); a pressure
p cos(k x) on t deflects by u = 2 Phi p / (E* k), E* = E / (1 - nu^2), at q = k h. Phi is
dimensionless and independent of E; on the touched face it tends to 1 for short waves, the
half-space.

Symbols: q wavenumber times thickness; kappa = 3 - 4 nu; U, W amplitudes of the displacement along
and across the layer (u_x = i U e^ikx, u_z = W e^ikx) at unit shear modulus and thickness.

Four solutions of Lame's equations, bounded for every q, with s = z - 1, a = exp(-q z) and
b = exp(q s):

    U:       a       -q z a             b    -q s b
    W:      -a       (kappa + q z) a    b    (kappa - q s) b
    lam div: 0       -4 nu q a          0    4 nu q b

The analytic lam div makes nu = 0.5 regular.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from reconstruction.arrays import FloatArray

Base = Literal["bonded", "free"]

# Below, the free layer's 4 x 4 system loses its digits to the rigid motions (condition ~ q^-4).
SMALLEST_Q = 0.01


@dataclass(frozen=True)
class Transfer:
    """Dimensionless compliance Phi per wavenumber; all arrays have the shape of q."""

    normal_t: FloatArray
    normal_b: FloatArray
    #: along the layer: (u_x, u_y) = grad(psi), psi = 2 Phi p / (E* k^2)
    tangential_t: FloatArray
    tangential_b: FloatArray


def solve_transfer(q: FloatArray, poisson_ratio: float, base: Base) -> Transfer:
    """Solve the layer's boundary values for unit pressure on face t.

    Parameters
    ----------
    q : (n,) float
        Wavenumber times thickness, > 0.
    poisson_ratio : float
        0 < nu <= 0.5.
    base : {"bonded", "free"}
        Face b: no displacement, or no traction.

    Returns
    -------
    Transfer
        Phi at each q.
    """
    top, bottom = amplitudes(q, 0.0, poisson_ratio), amplitudes(q, 1.0, poisson_ratio)
    held = (bottom["U"], bottom["W"]) if base == "bonded" else (bottom["S_xz"], bottom["S_zz"])
    # Rows divided by their largest entry: their sizes differ by orders of magnitude in q.
    rows = np.stack((top["S_zz"], top["S_xz"], *held), axis=-2)
    scale = np.abs(rows).max(axis=-1, keepdims=True)
    load = np.zeros((q.size, 4, 1))
    load[:, 0] = -1.0
    weights = np.linalg.solve(rows / scale, load / scale)[..., 0]
    faces = (top["W"], bottom["W"], top["U"], bottom["U"])
    unit = q / (1 - poisson_ratio)
    return Transfer(*(unit * np.einsum("qi,qi->q", face, weights) for face in faces))


def amplitudes(q: FloatArray, z: float, nu: float) -> dict[str, FloatArray]:
    """Return displacement and stress of the four solutions at depth z, 0 to 1, each (n, 4)."""
    kappa, s = 3 - 4 * nu, z - 1
    a, b = np.exp(-q * z), np.exp(q * s)
    return {
        "U": np.stack((a, -q * z * a, b, -q * s * b), axis=-1),
        "W": np.stack((-a, (kappa + q * z) * a, b, (kappa - q * s) * b), axis=-1),
        "S_xz": q[:, None]
        * np.stack(
            (-2 * a, (kappa - 1 + 2 * q * z) * a, 2 * b, (kappa - 1 - 2 * q * s) * b), axis=-1
        ),
        "S_zz": q[:, None]
        * np.stack(
            (
                2 * a,
                (2 - 2 * kappa - 4 * nu - 2 * q * z) * a,
                2 * b,
                (2 * kappa - 2 + 4 * nu - 2 * q * s) * b,
            ),
            axis=-1,
        ),
    }


def opposite_transfer(q: FloatArray) -> FloatArray:
    """Return what the opposite face of a free layer keeps of the touched face's relief.

    T(q) = (sinh q + q cosh q) / (sinh q cosh q + q), for any nu and E: 1 for long waves, a half
    at a pitch of 2.40 thicknesses, a tenth at 1.32.

    Parameters
    ----------
    q : (...) float
        Wavenumber times thickness, >= 0.

    >>> float(opposite_transfer(np.array([2 * np.pi / 2.40]))[0].round(2))
    0.5
    """
    # Both sides times 4 exp(-2 q), so that nothing overflows.
    fade = np.expm1(-2 * q)
    raised = 2 * np.exp(-q) * (-fade + q * (2 + fade))
    lowered = -fade * (2 + fade) + 4 * q * (1 + fade)
    kept: FloatArray = np.divide(raised, lowered, out=np.ones_like(q), where=q > 0)
    return kept
