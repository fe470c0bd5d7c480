"""Energy, forces and tangent of the thin sheet, compiled: one cell of splines at a time.

Per Gauss point the sheet is described by v = (r, r_1, r_2, r_11, r_22, r_12), the surface midway
between its deformed faces and its derivatives along the undeformed sheet, and by the two
fundamental forms a = (a11, a22, a12), a_ij = r_i . r_j, and b likewise, b_ij = n . r_ij. All
potentials are functions of r, a and b; their derivatives by v follow from

    da11 = 2 r_1 . dr_1 (a22, a12 likewise),   db_m = n . dr_m - Gamma_m^e n . dr_e,

with Gamma_m^e = a^e . r_m and the dual vectors a^e. Arrays are (row, col) of cells, then Gauss
point; units mm, kPa and so uJ (kPa mm^3) for energies.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numba
import numpy as np

from reconstruction.arrays import FloatArray

# Sums may be reordered for vector units: results are compared with tolerances that know of it.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "arcp", "nsz"},
}
Function = TypeVar("Function", bound=Callable[..., Any])


def _kernel(function: Function) -> Function:
    """Compile on first call and keep the result on disk."""
    return cast(Function, numba.njit(cache=True, **_OPTIONS)(function))


def _inlined(function: Function) -> Function:
    """Compile into the callers: for what runs once per Gauss point."""
    return cast(Function, numba.njit(cache=True, forceinline=True, **_OPTIONS)(function))


#: Offsets (row, col) of the upper half of the tangent's stencil, in the order of its slots.
SLOTS = (
    *((0, col) for col in range(3)),
    *((row, col) for row in (1, 2) for col in range(-2, 3)),
)
#: Cell row, cell column and Gauss point.
At = tuple[int, int, int]
#: a11, a22, a12 and their determinant.
Metric = tuple[float, float, float, float]


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


class Point(NamedTuple):
    """Scratch of one Gauss point, reused."""

    v: FloatArray
    force: FloatArray
    stress: FloatArray
    modulus: FloatArray
    at_r: FloatArray
    cross: FloatArray
    normal: FloatArray
    dual: FloatArray
    gamma: FloatArray
    strain: FloatArray
    tangent: FloatArray
    work: FloatArray


@_inlined
def _scratch() -> Point:
    return Point(
        np.zeros((6, 3)), np.zeros(18), np.zeros(6), np.zeros((6, 6)), np.zeros((3, 3)),
        np.zeros((3, 3)), np.zeros(3), np.zeros((2, 3)), np.zeros((3, 2)), np.zeros((6, 18)),
        np.zeros((18, 18)), np.zeros((6, 18)),
    )  # fmt: skip


@_inlined
def _dot(a: FloatArray, b: FloatArray) -> float:
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@_inlined
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


@_inlined
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


@_inlined
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


@_inlined
def _place(functions: FloatArray, c: FloatArray, row: int, col: int, point: Point) -> None:
    """Fill v of a Gauss point."""
    v = point.v
    v[:] = 0.0
    for b in range(3):
        for a in range(3):
            for m in range(6):
                N = functions[3 * b + a, m]
                for k in range(3):
                    v[m, k] += N * c[row + b, col + a, k]


@_inlined
def _touch(
    part: int, at: At, metric: Metric, laws: Laws, touch: Touch, convex: bool, point: Point
) -> float:
    """Add one body's potential to stress, forces and moduli; return it."""
    a11, a22, a12, d = metric
    j_row, i_col, q = at
    half = 0.5 * laws.thickness_mm / np.sqrt(d)
    psi, p1, p2 = contact_law(touch.distance_mm[part, j_row, i_col, q] - half, laws)
    if p1 == 0.0 and p2 == 0.0:
        return psi
    n, H = touch.gradient[part, j_row, i_col, q], touch.hessian[part, j_row, i_col, q]
    if convex and p2 < 0:
        p2 = 0.0
    dd = (a22, a11, -2 * a12)
    slope, bend = 0.5 * half / d, 0.0 if convex else p1 * half / d
    for k in range(3):
        point.force[k] += p1 * n[k]
        point.stress[k] += p1 * slope * dd[k]
        for m in range(3):
            point.modulus[k, m] += (p2 * slope * slope - 0.75 * bend / d) * dd[k] * dd[m]
            point.cross[k, m] += p2 * slope * dd[k] * n[m]
            point.at_r[k, m] += p2 * n[k] * n[m] + (0.0 if convex else p1 * H[k, m])
    point.modulus[0, 1] += 0.5 * bend
    point.modulus[1, 0] += 0.5 * bend
    point.modulus[2, 2] -= bend
    return psi


@_inlined
def _stick(at: At, grip: Grip, stiffness: float, point: Point) -> float:
    """Add the spring to the anchor, along the surface that was touched there; return its energy."""
    j_row, i_col, q = at
    normal, total, along = grip.normal[j_row, i_col, q], 0.0, 0.0
    for k in range(3):
        along += (point.v[0, k] - grip.anchor_mm[j_row, i_col, q, k]) * normal[k]
    for k in range(3):
        x = point.v[0, k] - grip.anchor_mm[j_row, i_col, q, k] - along * normal[k]
        point.force[k] += stiffness * x
        total += 0.5 * stiffness * x * x
        point.at_r[k, k] += stiffness
        for m in range(3):
            point.at_r[k, m] -= stiffness * normal[k] * normal[m]
    return total


@_inlined
def _potentials(at: At, laws: Laws, touch: Touch, grip: Grip, convex: bool, point: Point) -> float:
    """Fill stress, moduli, forces on r and the strain matrix; return the energy per area."""
    v, n, dual, gamma, B = point.v, point.normal, point.dual, point.gamma, point.strain
    r1, r2 = v[1], v[2]
    a11, a22, a12 = _dot(r1, r1), _dot(r2, r2), _dot(r1, r2)
    d = a11 * a22 - a12 * a12
    area = np.sqrt(d)
    n[0] = (r1[1] * r2[2] - r1[2] * r2[1]) / area
    n[1] = (r1[2] * r2[0] - r1[0] * r2[2]) / area
    n[2] = (r1[0] * r2[1] - r1[1] * r2[0]) / area
    for k in range(3):
        dual[0, k] = (a22 * r1[k] - a12 * r2[k]) / d
        dual[1, k] = (a11 * r2[k] - a12 * r1[k]) / d
    for m in range(3):
        for e in range(2):
            gamma[m, e] = _dot(dual[e], v[3 + m])
    b11, b22, b12 = _dot(n, v[3]), _dot(n, v[4]), _dot(n, v[5])
    mu = laws.shear_modulus_kpa
    total = mu * material(
        (a11, a22, a12, b11, b22, b12), laws.thickness_mm, point.stress, point.modulus
    )
    for i in range(6):
        point.stress[i] *= mu
        for k in range(6):
            point.modulus[i, k] *= mu
    point.force[:] = 0.0
    point.at_r[:] = 0.0
    point.cross[:] = 0.0
    for part in range(touch.distance_mm.shape[0]):
        total += _touch(part, at, (a11, a22, a12, d), laws, touch, convex, point)
    if grip.held[at] > 0:
        total += _stick(at, grip, laws.stick_stiffness, point)
    total += laws.weight_kpa * v[0, 2]
    point.force[2] += laws.weight_kpa
    if laws.pressure_kpa != 0.0:
        # p int z dA_z: its variation is the follower pressure, while the rim does not move.
        p, z = laws.pressure_kpa, laws.pressure_kpa * v[0, 2]
        total += z * n[2] * area
        point.force[2] += p * n[2] * area
        point.force[3] += z * r2[1]
        point.force[4] -= z * r2[0]
        point.force[6] -= z * r1[1]
        point.force[7] += z * r1[0]
    B[:] = 0.0
    for k in range(3):
        B[0, 3 + k] = 2 * r1[k]
        B[1, 6 + k] = 2 * r2[k]
        B[2, 3 + k] = r2[k]
        B[2, 6 + k] = r1[k]
        for m in range(3):
            B[3 + m, 9 + 3 * m + k] = n[k]
            B[3 + m, 3 + k] = -gamma[m, 0] * n[k]
            B[3 + m, 6 + k] = -gamma[m, 1] * n[k]
    for m in range(6):
        for i in range(3, 18):
            point.force[i] += point.stress[m] * B[m, i]
    return float(total)


@_inlined
def _moduli_terms(point: Point) -> None:
    """Fill the tangent with what the strains' first derivatives make of the moduli."""
    B, K, HB = point.strain, point.tangent, point.work
    HB[:] = 0.0
    K[:] = 0.0
    for m in range(6):
        for k in range(6):
            x = point.modulus[m, k]
            for i in range(3, 18):
                HB[m, i] += x * B[k, i]
    for m in range(6):
        for i in range(3, 18):
            x = B[m, i]
            if x != 0.0:
                for k in range(3, 18):
                    K[i, k] += x * HB[m, k]


@_inlined
def _tangent(laws: Laws, convex: bool, point: Point) -> None:
    """Fill the second derivatives of the energy by v, (18, 18), upper half of the blocks."""
    B, K = point.strain, point.tangent
    _moduli_terms(point)
    for k in range(3):
        for m in range(3):
            K[k, m] += point.at_r[k, m]
        for i in range(3, 9):
            for m in range(3):
                K[k, i] += point.cross[m, k] * B[m, i]
    s1, s2, s12 = 2 * point.stress[0], 2 * point.stress[1], point.stress[2]
    if convex:
        s1, s2, s12 = _tension_only(s1, s2, s12)
    for k in range(3):
        K[3 + k, 3 + k] += s1
        K[6 + k, 6 + k] += s2
        K[3 + k, 6 + k] += s12
        K[6 + k, 3 + k] += s12
    if not convex:
        _curvature_terms(point)
        if laws.pressure_kpa != 0.0:
            _pressure_terms(laws.pressure_kpa, point)


@_inlined
def _tension_only(s1: float, s2: float, s12: float) -> tuple[float, float, float]:
    """Return the membrane stress without its compressive principal parts."""
    mean, dev = 0.5 * (s1 + s2), 0.5 * (s1 - s2)
    rad = np.sqrt(dev * dev + s12 * s12)
    if mean - rad >= 0.0:
        return s1, s2, s12
    x = max(mean + rad, 0.0) / (2 * rad + 1e-300)
    return x * (rad + dev), x * (rad - dev), x * s12


@_inlined
def _pressure_terms(p: float, point: Point) -> None:
    """Add the second derivatives of p z (r_1 x r_2)_z."""
    K, v, z = point.tangent, point.v, p * point.v[0, 2]
    K[2, 3] += p * v[2, 1]
    K[2, 4] -= p * v[2, 0]
    K[2, 6] -= p * v[1, 1]
    K[2, 7] += p * v[1, 0]
    K[3, 7] += z
    K[7, 3] += z
    K[4, 6] -= z
    K[6, 4] -= z


@_inlined
def _curvature_terms(point: Point) -> None:
    """Add the second variation of b times its moments: the normal turns as r_1 and r_2 change."""
    K, n, dual = point.tangent, point.normal, point.dual
    c1 = c2 = bent = 0.0
    for m in range(3):
        M = point.stress[3 + m]
        c1 -= M * point.gamma[m, 0]
        c2 -= M * point.gamma[m, 1]
        bent += M * _dot(n, point.v[3 + m])
    share = (c1, c2, point.stress[3], point.stress[4], point.stress[5])
    for e in range(2):
        for s in range(5):
            for i in range(3):
                for k in range(3):
                    x = n[i] * dual[e, k] * share[s]
                    K[3 + 3 * e + i, 3 + 3 * s + k] -= x
                    K[3 + 3 * s + k, 3 + 3 * e + i] -= x
        for t in range(2):
            x = bent * _dot(dual[e], dual[t])
            for i in range(3):
                for k in range(3):
                    K[3 + 3 * e + i, 3 + 3 * t + k] -= x * n[i] * n[k]


@_inlined
def _gather(
    N: FloatArray,
    weight: float,
    point: Point,
    blocks: FloatArray,
    packed: FloatArray,
    T: FloatArray,
) -> None:
    """Add a point's tangent to its cell's blocks (9, 9, 9), lower pairs of functions only."""
    K = point.tangent
    for t in range(6):
        for s in range(6):
            for i in range(3):
                for k in range(3):
                    row, col = 3 * s + i, 3 * t + k
                    packed[t, 9 * s + 3 * i + k] = K[row, col] if s <= t else K[col, row]
    for j in range(9):
        T[:] = 0.0
        for t in range(6):
            x = weight * N[j, t]
            for i in range(54):
                T[i] += x * packed[t, i]
        for i in range(j + 1):
            for s in range(6):
                x = N[i, s]
                for k in range(9):
                    blocks[i, j, k] += x * T[9 * s + k]


@_kernel
def assemble_rows(
    first: int,
    end: int,
    c: FloatArray,
    rest: Rest,
    laws: Laws,
    touch: Touch,
    grip: Grip,
    want: bool,
    convex: bool,
    energy: FloatArray,
    F: FloatArray,
    S: FloatArray,
) -> None:
    """Add the energy, forces and, if wanted, the tangent of cell rows first to end.

    Parameters
    ----------
    c : (row + 2, col + 2, 3) control points
    rest, laws, touch, grip : Rest, Laws, Touch, Grip
    want : fill the tangent
    convex : leave out of the tangent what can make it indefinite
    energy : (row,) of each row of cells
    F : (row + 2, col + 2, 3) forces, added to
    S : (row + 2, col + 2, 13, 3, 3) tangent by stencil slot, added to
    """
    point = _scratch()
    blocks, packed, T = np.zeros((9, 9, 9)), np.zeros((6, 54)), np.zeros(54)
    for j_row in range(first, end):
        total = 0.0
        for i_col in range(rest.area_mm2.shape[1]):
            blocks[:] = 0.0
            for q in range(4):
                N, weight = rest.functions[j_row, i_col, q], rest.area_mm2[j_row, i_col, q]
                _place(N, c, j_row, i_col, point)
                total += weight * _potentials((j_row, i_col, q), laws, touch, grip, convex, point)
                for j in range(9):
                    for k in range(3):
                        x = 0.0
                        for m in range(6):
                            x += N[j, m] * point.force[3 * m + k]
                        F[j_row + j // 3, i_col + j % 3, k] += weight * x
                if want:
                    _tangent(laws, convex, point)
                    _gather(N, weight, point, blocks, packed, T)
            if want:
                for j in range(9):
                    for i in range(j + 1):
                        slot = (j // 3 - i // 3) * 5 + j % 3 - i % 3
                        for k in range(9):
                            S[j_row + i // 3, i_col + i % 3, slot, k // 3, k % 3] += blocks[i, j, k]
        energy[j_row] = total


@_kernel
def surface_rows(
    first: int, end: int, c: FloatArray, functions: FloatArray, out: FloatArray
) -> None:
    """Fill out (row, col, 4, 3, 3) with r, r_1 and r_2 at the Gauss points of some cell rows."""
    for j_row in range(first, end):
        for i_col in range(functions.shape[1]):
            for q in range(4):
                o = out[j_row, i_col, q]
                o[:] = 0.0
                for j in range(9):
                    for m in range(3):
                        N = functions[j_row, i_col, q, j, m]
                        for k in range(3):
                            o[m, k] += N * c[j_row + j // 3, i_col + j % 3, k]
