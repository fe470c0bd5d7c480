"""The thin sheet's laws, compiled: membrane and bending, contact and cohesion; and their data.

Energies are per undeformed area, kPa mm = J/m^2; lengths mm. Kirchhoff-Love sheet of incompressible
neo-Hookean solid (Kiendl et al. 2015), in closed form.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

import numba

from reconstruction.arrays import FloatArray

# Sums may be reordered for vector units: results are compared with tolerances that know of it.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "arcp", "nsz"},
}
Function = TypeVar("Function", bound=Callable[..., Any])


def _digest_of_sources() -> str:
    files = (Path(__file__).with_name(name) for name in ("laws.py", "kernel.py"))
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


_SOURCE_DIGEST = _digest_of_sources()


def kernel(function: Function) -> Function:
    """Compile on first call and keep the result on disk."""
    return _compiled(function, _OPTIONS)


def inlined(function: Function) -> Function:
    """Compile into the callers: for what runs once per Gauss point."""
    return _compiled(function, _OPTIONS | {"forceinline": True})


def _compiled(function: Function, options: dict[str, Any]) -> Function:
    compiled = numba.njit(cache=True, **options)(function)
    # The cache notices a change in a function's own file only, not of what is inlined from here.
    compiled._cache._cache_file._source_stamp = _SOURCE_DIGEST
    return cast(Function, compiled)


class Rest(NamedTuple):
    """The undeformed sheet at its Gauss points."""

    #: (row, col, 4, 9, 6) functions of the cell: value, d/dX, d/dY, d2/dX2, d2/dY2, d2/dXdY
    functions: FloatArray
    #: (row, col, 4) area of each Gauss point, mm^2
    area_mm2: FloatArray


class Touch(NamedTuple):
    """Signed distances of the bodies near the sheet, at the Gauss points."""

    #: (body, row, col, 4)
    distance_mm: FloatArray
    #: (body, row, col, 4, 3)
    gradient: FloatArray
    #: (body, row, col, 4, 3, 3) 1/mm
    hessian: FloatArray


class Grip(NamedTuple):
    """Where the sheet sticks: anchors in the world, normals of the surface at the anchor."""

    #: (row, col, 4) 1 where it sticks
    held: FloatArray
    #: (row, col, 4, 3)
    anchor_mm: FloatArray
    #: (row, col, 4, 3)
    normal: FloatArray


class Laws(NamedTuple):
    """Constants of the potentials."""

    thickness_mm: float
    shear_modulus_kpa: float
    #: pressure per penetration, kPa/mm
    contact_stiffness: float
    #: the same along the surface, where the sheet sticks
    stick_stiffness: float
    #: adhesion energy, kPa mm = J/m^2
    tack: float
    #: range of the cohesive law
    tack_range_mm: float
    #: follows the sheet, towards its touched side
    pressure_kpa: float
    #: weight per area along -z, kPa
    weight_kpa: float


@inlined
def material(
    forms: tuple[float, float, float, float, float, float], h: float, g: FloatArray, H: FloatArray
) -> float:
    """Return energy per undeformed area over shear modulus; fill gradient and Hessian by (a, b).

    W = h/2 (A + 1/d - 3) + h^3/24 (3 T^2/d^4 - 2 k/d^3 + (B T - k A)/d^2) with A = tr a, d = det a,
    T = a22 b11 + a11 b22 - 2 a12 b12, k = det b, B = tr b: an incompressible neo-Hookean sheet.
    """
    a11, a22, a12, b11, b22, b12 = forms
    A, d, B = a11 + a22, a11 * a22 - a12 * a12, b11 + b22
    T = a22 * b11 + a11 * b22 - 2 * a12 * b12
    k = b11 * b22 - b12 * b12
    i = 1 / d
    i2, c = i * i, h * h * h / 24
    i3, i4 = i2 * i, i2 * i2
    bent = B * T - k * A
    by_A = h / 2 - c * k * i2
    by_d = -h / 2 * i2 + c * (-12 * T * T * i4 * i + 6 * k * i4 - 2 * bent * i3)
    by_T = c * (6 * T * i4 + B * i2)
    by_k = -c * (2 * i3 + A * i2)
    by_B = c * T * i2
    Ad, Ak = 2 * c * k * i3, -c * i2
    dd = h * i3 + c * (60 * T * T * i3 * i3 - 24 * k * i4 * i + 6 * bent * i4)
    dT, dk, dB = -c * (24 * T * i4 * i + 2 * B * i3), c * (6 * i4 + 2 * A * i3), -2 * c * T * i3
    TT, TB = 6 * c * i4, c * i2
    for n in range(6):
        # Row n of the Jacobian of (A, d, T, k, B), and what it becomes under their Hessian.
        jA, jd, jT, jk, jB = _invariants(n, forms)
        g[n] = by_A * jA + by_d * jd + by_T * jT + by_k * jk + by_B * jB
        mA, md = Ad * jd + Ak * jk, Ad * jA + dd * jd + dT * jT + dk * jk + dB * jB
        mT, mk, mB = dT * jd + TT * jT + TB * jB, Ak * jA + dk * jd, dB * jd + TB * jT
        for m in range(6):
            lA, ld, lT, lk, lB = _invariants(m, forms)
            H[n, m] = mA * lA + md * ld + mT * lT + mk * lk + mB * lB
    H[0, 1] += by_d
    H[1, 0] += by_d
    H[2, 2] -= 2 * by_d
    H[0, 4] += by_T
    H[4, 0] += by_T
    H[1, 3] += by_T
    H[3, 1] += by_T
    H[2, 5] -= 2 * by_T
    H[5, 2] -= 2 * by_T
    H[3, 4] += by_k
    H[4, 3] += by_k
    H[5, 5] -= 2 * by_k
    return h / 2 * (A + i - 3) + c * (3 * T * T * i4 - 2 * k * i3 + bent * i2)


@inlined
def _invariants(
    n: int, forms: tuple[float, float, float, float, float, float]
) -> tuple[float, float, float, float, float]:
    """Return the derivatives of (A, d, T, k, B) by the n-th of (a11, a22, a12, b11, b22, b12)."""
    a11, a22, a12, b11, b22, b12 = forms
    if n == 0:
        return 1.0, a22, b22, 0.0, 0.0
    if n == 1:
        return 1.0, a11, b11, 0.0, 0.0
    if n == 2:
        return 0.0, -2 * a12, -2 * b12, 0.0, 0.0
    if n == 3:
        return 0.0, 0.0, a22, b22, 1.0
    if n == 4:
        return 0.0, 0.0, a11, b11, 1.0
    return 0.0, 0.0, -2 * a12, -2 * b12, 0.0


@inlined
def contact_law(gap_mm: float, laws: Laws) -> tuple[float, float, float]:
    """Return potential, slope and curvature: repulsion below 0, cohesion up to the range."""
    if gap_mm < 0:
        eps = laws.contact_stiffness
        return 0.5 * eps * gap_mm * gap_mm - laws.tack, eps * gap_mm, eps
    if laws.tack > 0 and gap_mm < laws.tack_range_mm:
        x, G, D = gap_mm / laws.tack_range_mm, laws.tack, laws.tack_range_mm
        return (
            -G * (1 - x) ** 2 * (1 + 2 * x),
            6 * G * x * (1 - x) / D,
            6 * G * (1 - 2 * x) / D**2,
        )
    return 0.0, 0.0, 0.0
