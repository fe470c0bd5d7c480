"""A layer with a film of its own stiffness on the coated face: two elastic layers, bonded.

State of one wavenumber k at a depth, with the symbols of `transfer`: displacement
amplitudes U, W and, over k, shear and normal traction; the slab's shear modulus is 1. A film is
much thinner than a wave, where the bounded exponentials of a thick layer coincide; there the
state is carried through by its exponential instead, exp(M q) with (M^2 - 1)^2 = 0.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.transfer import Transfer, amplitudes

LoadedBase = Literal["bonded", "free", "free_turned"]
# Below, waves are long against the layer and its state is carried through by exp(M q).
_LONG_WAVE_Q = 0.5


@dataclass(frozen=True)
class CoatFilm:
    """A film as part of a layer's thickness, on the coated face."""

    #: film thickness over the layer's whole thickness, 0 to 1
    share: float
    #: shear modulus over the slab's
    shear_ratio: float
    poisson_ratio: float


def solve_coated(q: FloatArray, poisson_ratio: float, base: LoadedBase, film: CoatFilm) -> Transfer:
    """Solve slab and film under unit pressure on face t: eight equations per wavenumber.

    Parameters
    ----------
    q : (n,) float
        Wavenumber times the whole thickness, > 0.
    poisson_ratio : float
        Of the slab, 0 < nu <= 0.5.
    base : {"bonded", "free", "free_turned"}
        "bonded": film on the touched face t; "free": film on the far face b; "free_turned": film
        on t of a layer whose far face is free, the same slab loaded from its other side.
    film : CoatFilm
        The film.

    Returns
    -------
    Transfer
        Phi at each q, in units of the slab's E*.
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
    """Return the states (n, 4, 4) of four solutions at a layer's upper and lower face."""
    upper, lower = (_bounded(q, z, nu) for z in (0.0, 1.0))
    long = q < _LONG_WAVE_Q
    upper[long], lower[long] = np.eye(4), _carried(q[long], nu)
    scale = np.array([1.0, 1.0, shear, shear])[:, None]
    return upper * scale, lower * scale


def _bounded(q: FloatArray, z: float, nu: float) -> FloatArray:
    found = amplitudes(q, z, nu)
    tractions = [found[name] / q[:, None] for name in ("S_xz", "S_zz")]
    return np.stack((found["U"], found["W"], *tractions), axis=-2)


def _carried(q: FloatArray, nu: float) -> FloatArray:
    """Return exp(M q), M the derivative of the state over k z at unit shear modulus."""
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
