"""Displacement of both faces of an elastic layer under pressure, per wavenumber.

The layer is a slab, with or without a film. Frame: z along the press, from the touched face t
(z = 0) to the far face b (z = h). A pressure p cos(k x) on t deflects a face by
u = 2 Phi p / (E* k), with E* = E / (1 - nu^2) and Phi a function of q = k h. Phi is dimensionless
and independent of E. On the touched face Phi tends to 1, the value of a half-space, for short
waves.

Symbols: q wavenumber times thickness; kappa = 3 - 4 nu; U, W amplitudes of the displacement along
and across the layer (u_x = i U e^ikx, u_z = W e^ikx) at unit shear modulus and thickness; lam
Lame's first parameter; div divergence of the displacement.

Four solutions of Lame's equations, bounded for every q, with s = z - 1, a = exp(-q z) and
b = exp(q s):

    U:       a       -q z a             b    -q s b
    W:      -a       (kappa + q z) a    b    (kappa - q s) b
    lam div: 0       -4 nu q a          0    4 nu q b

lam div is computed from these expressions, which are finite at nu = 0.5.

With a film of another stiffness on the coated face, two bonded elastic layers are solved. The state
of one wavenumber at a depth is the vector of U, W, and shear and normal traction over k; the slab's
shear modulus is 1. A film is much thinner than a wavelength, and then the four bounded solutions
are nearly equal. There the state on one face follows from that on the other by the factor exp(M q),
with (M^2 - 1)^2 = 0.

For a whole grid of wavenumbers Phi is interpolated in a table over log q.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from reconstruction.arrays import FloatArray
from twin.mechanics.errors import PressError

Base = Literal["bonded", "free"]

# Below this the free layer's 4 x 4 system is ill-conditioned by rigid motions (condition ~ q^-4).
SMALLEST_Q = 0.01
LoadedBase = Literal["bonded", "free", "free_turned"]
# Below this, waves are long compared with the layer and its state is mapped by exp(M q).
_LONG_WAVE_Q = 0.5
Column = Literal["normal_t", "normal_b", "tangential_t", "tangential_b"]
_COLUMNS: tuple[Column, ...] = ("normal_t", "normal_b", "tangential_t", "tangential_b")
# Above this, both faces are half-spaces to 1e-15.
_LARGEST_Q = 45.0
_TABLE_SIZE = 2000


@dataclass(frozen=True)
class Transfer:
    """Dimensionless compliance Phi of both faces per wavenumber; arrays have the shape of q."""

    #: deflection of the touched face t and of the far face b
    normal_t: FloatArray
    normal_b: FloatArray
    #: displacement along the layer: (u_x, u_y) = grad(psi), psi = 2 Phi p / (E* k^2)
    tangential_t: FloatArray
    tangential_b: FloatArray


def solve_transfer(q: FloatArray, poisson_ratio: float, base: Base) -> Transfer:
    """Return Phi of a layer without film, for pressure on face t.

    Parameters
    ----------
    q : (n,) float; wavenumber times thickness, > 0
    poisson_ratio : 0 < nu <= 0.5
    base : {"bonded", "free"}; "bonded": no displacement of face b; "free": no traction on face b

    Returns
    -------
    Phi at each q
    """
    top, bottom = amplitudes(q, 0.0, poisson_ratio), amplitudes(q, 1.0, poisson_ratio)
    held = (bottom["U"], bottom["W"]) if base == "bonded" else (bottom["S_xz"], bottom["S_zz"])
    # Each row is divided by its largest entry: for extreme q rows differ by orders of magnitude.
    rows = np.stack((top["S_zz"], top["S_xz"], *held), axis=-2)
    scale = np.abs(rows).max(axis=-1, keepdims=True)
    load = np.zeros((q.size, 4, 1))
    load[:, 0] = -1.0
    weights = np.linalg.solve(rows / scale, load / scale)[..., 0]
    faces = (top["W"], bottom["W"], top["U"], bottom["U"])
    unit = q / (1 - poisson_ratio)
    return Transfer(*(unit * np.einsum("qi,qi->q", face, weights) for face in faces))


def amplitudes(q: FloatArray, z: float, nu: float) -> dict[str, FloatArray]:
    """Return the displacements U, W and stresses S_xz, S_zz of the four solutions, each (n, 4).

    `q` is (n,), `z` the depth over the thickness, 0 to 1.
    """
    kappa, s = 3 - 4 * nu, z - 1
    a, b = np.exp(-q * z), np.exp(q * s)
    shear = -2 * a, (kappa - 1 + 2 * q * z) * a, 2 * b, (kappa - 1 - 2 * q * s) * b
    down, up = (2 - 2 * kappa - 4 * nu - 2 * q * z) * a, (2 * kappa - 2 + 4 * nu - 2 * q * s) * b
    return {
        "U": np.stack((a, -q * z * a, b, -q * s * b), axis=-1),
        "W": np.stack((-a, (kappa + q * z) * a, b, (kappa - q * s) * b), axis=-1),
        "S_xz": q[:, None] * np.stack(shear, axis=-1),
        "S_zz": q[:, None] * np.stack((2 * a, down, 2 * b, up), axis=-1),
    }


def opposite_transfer(q: FloatArray) -> FloatArray:
    """Return the relief of the opposite face over that of the touched face of a free layer.

    T(q) = (sinh q + q cosh q) / (sinh q cosh q + q), for any nu and E. It is 1 for long waves, 0.5
    at a pitch of 2.40 thicknesses and 0.1 at 1.32.

    Parameters
    ----------
    q : (...) float; wavenumber times thickness, >= 0

    >>> float(opposite_transfer(np.array([2 * np.pi / 2.40]))[0].round(2))
    0.5
    """
    # Numerator and denominator times 4 exp(-2 q), to avoid overflow.
    fade = np.expm1(-2 * q)
    raised = 2 * np.exp(-q) * (-fade + q * (2 + fade))
    lowered = -fade * (2 + fade) + 4 * q * (1 + fade)
    return np.asarray(np.divide(raised, lowered, out=np.ones_like(q), where=q > 0))


@dataclass(frozen=True)
class CoatFilm:
    """A film on the coated face; its thickness is a part of the layer's thickness."""

    #: film thickness over the layer's whole thickness, 0 to 1
    share: float
    #: shear modulus of the film over that of the slab
    shear_ratio: float
    poisson_ratio: float


def solve_coated(q: FloatArray, poisson_ratio: float, base: LoadedBase, film: CoatFilm) -> Transfer:
    """Return Phi of a slab with a film, for pressure on face t: eight equations per wavenumber.

    Parameters
    ----------
    q : (n,) float; wavenumber times the whole thickness, > 0
    poisson_ratio : Poisson's ratio of the slab, 0 < nu <= 0.5
    base : {"bonded", "free", "free_turned"}; "bonded": face b is bonded, the film is on face t;
        "free": face b is free and has the film; "free_turned": face b is free, the film is on
        face t, as if the slab of "free" were loaded on its coated face

    Returns
    -------
    Phi at each q, in units of the slab's E*
    """
    slab = _through(q * (1 - film.share), 1.0, poisson_ratio)
    coat = _through(q * film.share, film.shear_ratio, film.poisson_ratio)
    (top, upper), (lower, bottom) = (slab, coat) if base == "free" else (coat, slab)
    rows = np.zeros((q.size, 8, 8))
    rows[:, 0, :4], rows[:, 1, :4] = top[:, 3], top[:, 2]
    rows[:, 2:6, :4], rows[:, 2:6, 4:] = upper, -lower
    rows[:, 6:, 4:] = bottom[:, :2] if base == "bonded" else bottom[:, 2:]
    load = np.zeros((q.size, 8, 1))
    load[:, 0] = -1.0
    scale = np.abs(rows).max(axis=-1, keepdims=True)
    weights = np.linalg.solve(rows / scale, load / scale)
    at_t = (top @ weights[:, :4])[..., 0] / (1 - poisson_ratio)
    at_b = (bottom @ weights[:, 4:])[..., 0] / (1 - poisson_ratio)
    return Transfer(at_t[:, 1], at_b[:, 1], at_t[:, 0], at_b[:, 0])


def _through(q: FloatArray, shear: float, nu: float) -> tuple[FloatArray, FloatArray]:
    """Return the states (n, state, solution) of four solutions at a layer's two faces.

    The first array is at the face nearer to t. `shear` is the layer's shear modulus.
    """
    upper, lower = (_bounded_states(q, z, nu) for z in (0.0, 1.0))
    long = q < _LONG_WAVE_Q
    upper[long], lower[long] = np.eye(4), _carried(q[long], nu)
    scale = np.array([1.0, 1.0, shear, shear])[:, None]
    return upper * scale, lower * scale


def _bounded_states(q: FloatArray, z: float, nu: float) -> FloatArray:
    states = amplitudes(q, z, nu)
    tractions = [states[name] / q[:, None] for name in ("S_xz", "S_zz")]
    return np.stack((states["U"], states["W"], *tractions), axis=-2)


def _carried(q: FloatArray, nu: float) -> FloatArray:
    """Return exp(M q) (n, 4, 4); M is the derivative of the state by k z at unit shear modulus."""
    side = nu / (1 - nu)
    M = np.array(
        [
            [0.0, -1.0, 1.0, 0.0],
            [side, 0.0, 0.0, (1 - 2 * nu) / (2 * (1 - nu))],
            [2 / (1 - nu), 0.0, 0.0, -side],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    second, third = q * np.sinh(q) / 2, (q * np.cosh(q) - np.sinh(q)) / 2
    factors = (np.cosh(q) - second, np.sinh(q) - third, second, third)
    powers = (np.eye(4), M, M @ M, M @ M @ M)
    carried: FloatArray = sum(
        (factor[:, None, None] * power for factor, power in zip(factors, powers, strict=True)),
        np.zeros((q.size, 4, 4)),
    )
    return carried


@dataclass(frozen=True, eq=False)
class TransferTable:
    """Table of Phi over log q from `lowest_q` up; above `highest_q` Phi is constant."""

    lowest_q: float
    highest_q: float
    splines: dict[Column, CubicSpline]

    def __call__(self, q: FloatArray, column: Column) -> FloatArray:
        """Return one column of `Transfer` at q (...), wavenumber times thickness, >= `lowest_q`."""
        inside = np.minimum(q, self.highest_q)
        phi: FloatArray = self.splines[column](np.log(inside))
        phi /= _damping(inside)
        return phi


def tabulate(
    lowest_q: float, poisson_ratio: float, base: LoadedBase, film: CoatFilm | None = None
) -> TransferTable:
    """Return a table of a layer's Phi, from `lowest_q` to where both faces are half-spaces.

    Raises
    ------
    PressError : `lowest_q` is too small: the layer is too thin for its span
    """
    if lowest_q < SMALLEST_Q:
        raise PressError(
            "elastomer.thickness_mm: the span is more than 300 times the thickness; "
            "a slab cannot be solved as a film: make it thicker or shorter"
        )
    highest_q = max(_LARGEST_Q, 2 * lowest_q)
    if film is not None and base != "free":
        highest_q /= film.share  # the loaded film is a half-space to much shorter waves only
    q = np.geomspace(lowest_q, highest_q, _TABLE_SIZE)
    if film is not None:
        solved = solve_coated(q, poisson_ratio, base, film)
    else:
        solved = solve_transfer(q, poisson_ratio, "bonded" if base == "bonded" else "free")
    splines = {
        column: CubicSpline(np.log(q), getattr(solved, column) * _damping(q)) for column in _COLUMNS
    }
    return TransferTable(lowest_q, highest_q, splines)


def _damping(q: FloatArray) -> FloatArray:
    """Return q^3 / (1 + q^3), by which Phi is multiplied before it is interpolated.

    For long waves Phi of a free layer increases as q^-3 (plate); the product is smooth.
    """
    cubed = q * q * q
    return np.asarray(cubed / (1 + cubed))
