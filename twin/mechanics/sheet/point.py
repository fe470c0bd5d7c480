"""Compiled potentials of the thin sheet at one Gauss point, and their first derivatives.

The sheet is described by v = (r, r_1, r_2, r_11, r_22, r_12). r is the position of the surface
midway between its deformed faces; the other elements are derivatives of r along the undeformed
sheet. The two fundamental forms are a = (a11, a22, a12) with a_ij = r_i . r_j, and b = (b11, b22,
b12) with b_ij = n . r_ij and the unit normal n. All potentials are functions of r, a and b. Their
derivatives by v follow from

    da11 = 2 r_1 . dr_1 (a22, a12 likewise),   db_m = n . dr_m - Gamma_m^e n . dr_e,

with Gamma_m^e = a^e . r_m and the dual vectors a^e. Units mm, kPa and so uJ (kPa mm^3) for
energies; second derivatives are in `tangent`.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.sheet.laws import Grip, Laws, Material, Touch, contact_law, inlined, material

#: Cell row, cell column and Gauss point.
At = tuple[int, int, int]
#: a11, a22, a12 and their determinant.
Metric = tuple[float, float, float, float]


class ContactState(NamedTuple):
    """Data of the contact potentials: constants, distances of bodies, and anchors where it sticks.

    The distances are those of the bodies near the sheet. At an anchor, the sheet sticks to a body.
    """

    laws: Laws
    touch: Touch
    grip: Grip


class EvaluationOptions(NamedTuple):
    """Options of an evaluation in addition to energy and forces."""

    #: fill the tangent
    tangent: bool
    #: omit terms of the tangent that can make it indefinite
    convex: bool


class Point(NamedTuple):
    """Work arrays for one Gauss point, which are overwritten for each point."""

    v: FloatArray
    #: derivatives of the energy by v (6, 3), and by a and b (6,)
    force: FloatArray
    stress: FloatArray
    #: second derivatives by a and b, by r and by (a, r)
    modulus: FloatArray
    at_r: FloatArray
    cross: FloatArray
    normal: FloatArray
    dual: FloatArray
    gamma: FloatArray
    #: second derivatives by (a or b, v) and by (v, v) as [t, s, 3 i + k] for v_s,i and v_t,k
    stress_by_v: FloatArray
    tangent: FloatArray
    material: Material


def point_scratch() -> Point:
    """Return new work arrays for a Gauss point; constant elements are set."""
    slopes = np.zeros((6, 5))
    slopes[0, 0] = slopes[1, 0] = slopes[3, 4] = slopes[4, 4] = 1.0
    return Point(
        np.zeros((6, 3)), np.zeros((6, 3)), np.zeros(6), np.zeros((6, 6)), np.zeros((3, 3)),
        np.zeros((3, 3)), np.zeros(3), np.zeros((2, 3)), np.zeros((3, 2)), np.zeros((6, 6, 3)),
        np.zeros((6, 6, 9)), Material(slopes, np.zeros((6, 5))),
    )  # fmt: skip


@inlined
def potentials(at: At, state: ContactState, options: EvaluationOptions, point: Point) -> float:
    """Return the energy per undeformed area, J/m^2; write its derivatives to `point`.

    `point.v` is the input. Outputs are `force`, `stress` and, if requested, the second derivatives.
    """
    v, n = point.v, point.normal
    laws, touch, grip = state.laws, state.touch, state.grip
    metric, bending = _geometry(point)
    forms = (metric[0], metric[1], metric[2], *bending)
    total = laws.shear_modulus_kpa * material(
        forms, laws.thickness_mm, point.material, point.stress, point.modulus, options.tangent
    )
    for i in range(6):
        point.stress[i] *= laws.shear_modulus_kpa
        for k in range(6):
            point.modulus[i, k] *= laws.shear_modulus_kpa
    point.force[:] = 0.0
    point.at_r[:] = 0.0
    point.cross[:] = 0.0
    for part in range(touch.distance_mm.shape[0]):
        total += _touch(part, at, metric, laws, touch, options.convex, point)
    if grip.held[at] > 0:
        total += _friction(at, grip, laws.stick_stiffness, point)
    total += laws.weight_kpa * v[0, 2]
    point.force[0, 2] += laws.weight_kpa
    if laws.pressure_kpa != 0.0:
        total += _pressure(laws.pressure_kpa * np.sqrt(metric[3]), laws.pressure_kpa, point)
    S, M, gamma = point.stress[:3], point.stress[3:], point.gamma
    turned_1 = M[0] * gamma[0, 0] + M[1] * gamma[1, 0] + M[2] * gamma[2, 0]
    turned_2 = M[0] * gamma[0, 1] + M[1] * gamma[1, 1] + M[2] * gamma[2, 1]
    for k in range(3):
        point.force[1, k] += 2 * S[0] * v[1, k] + S[2] * v[2, k] - turned_1 * n[k]
        point.force[2, k] += 2 * S[1] * v[2, k] + S[2] * v[1, k] - turned_2 * n[k]
        for m in range(3):
            point.force[3 + m, k] += M[m] * n[k]
    return float(total)


@inlined
def _geometry(point: Point) -> tuple[Metric, tuple[float, float, float]]:
    """Write normal, dual vectors and Gamma to `point`; return a with its determinant, and b."""
    v, n, dual, gamma = point.v, point.normal, point.dual, point.gamma
    r1, r2 = v[1], v[2]
    a11, a22, a12 = dot(r1, r1), dot(r2, r2), dot(r1, r2)
    d = a11 * a22 - a12 * a12
    over_area, over_d = 1 / np.sqrt(d), 1 / d
    n[0] = (r1[1] * r2[2] - r1[2] * r2[1]) * over_area
    n[1] = (r1[2] * r2[0] - r1[0] * r2[2]) * over_area
    n[2] = (r1[0] * r2[1] - r1[1] * r2[0]) * over_area
    for k in range(3):
        dual[0, k] = (a22 * r1[k] - a12 * r2[k]) * over_d
        dual[1, k] = (a11 * r2[k] - a12 * r1[k]) * over_d
    for m in range(3):
        for e in range(2):
            gamma[m, e] = dot(dual[e], v[3 + m])
    return (a11, a22, a12, d), (dot(n, v[3]), dot(n, v[4]), dot(n, v[5]))


@inlined
def dot(a: FloatArray, b: FloatArray) -> float:
    """Return the inner product of two vectors (3,)."""
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@inlined
def _touch(
    part: int, at: At, metric: Metric, laws: Laws, touch: Touch, convex: bool, point: Point
) -> float:
    """Return the potential of the contact with one body; add its derivatives to `point`."""
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
        point.force[0, k] += p1 * n[k]
        point.stress[k] += p1 * slope * dd[k]
        for m in range(3):
            point.modulus[k, m] += (p2 * slope * slope - 0.75 * bend / d) * dd[k] * dd[m]
            point.cross[k, m] += p2 * slope * dd[k] * n[m]
            point.at_r[k, m] += p2 * n[k] * n[m] + (0.0 if convex else p1 * H[k, m])
    point.modulus[0, 1] += 0.5 * bend
    point.modulus[1, 0] += 0.5 * bend
    point.modulus[2, 2] -= bend
    return psi


@inlined
def _friction(at: At, grip: Grip, stiffness: float, point: Point) -> float:
    """Return the energy of a point with an anchor; add its derivatives to `point`.

    Up to the limit of the friction it is that of a spring, and beyond it the limit's work.
    """
    if grip.limit_kpa[at] < np.inf:
        j_row, i_col, q = at
        away = along = 0.0
        for k in range(3):
            x = point.v[0, k] - grip.anchor_mm[j_row, i_col, q, k]
            away += x * x
            along += x * grip.normal[j_row, i_col, q, k]
        slip_mm = np.sqrt(max(away - along * along, 0.0))
        if stiffness * slip_mm > grip.limit_kpa[at]:
            return _slip(at, grip, slip_mm, along, stiffness, point)
    return _stick(at, grip, stiffness, point)


@inlined
def _slip(
    at: At, grip: Grip, slip_mm: float, along: float, stiffness: float, point: Point
) -> float:
    """Return the energy of a point that slips; add its derivatives to `point`.

    The force is the limit of the friction, along the tangent plane and towards the anchor.

    Parameters
    ----------
    slip_mm : distance from the anchor along the tangent plane
    along : distance from the anchor along the normal, mm
    """
    j_row, i_col, q = at
    normal, anchor = grip.normal[j_row, i_col, q], grip.anchor_mm[j_row, i_col, q]
    limit, hold = grip.limit_kpa[at], grip.limit_kpa[at] / slip_mm
    for k in range(3):
        x = point.v[0, k] - anchor[k] - along * normal[k]
        point.force[0, k] += hold * x
        point.at_r[k, k] += hold
        for m in range(3):
            y = point.v[0, m] - anchor[m] - along * normal[m]
            point.at_r[k, m] -= hold * (normal[k] * normal[m] + x * y / (slip_mm * slip_mm))
    return float(limit * (slip_mm - 0.5 * limit / stiffness))


@inlined
def _stick(at: At, grip: Grip, stiffness: float, point: Point) -> float:
    """Return the energy of the spring to the anchor; add its derivatives to `point`.

    The spring acts only along the tangent plane of the touched surface at the anchor.
    """
    j_row, i_col, q = at
    normal, total, along = grip.normal[j_row, i_col, q], 0.0, 0.0
    for k in range(3):
        along += (point.v[0, k] - grip.anchor_mm[j_row, i_col, q, k]) * normal[k]
    for k in range(3):
        x = point.v[0, k] - grip.anchor_mm[j_row, i_col, q, k] - along * normal[k]
        point.force[0, k] += stiffness * x
        total += 0.5 * stiffness * x * x
        point.at_r[k, k] += stiffness
        for m in range(3):
            point.at_r[k, m] -= stiffness * normal[k] * normal[m]
    return total


@inlined
def _pressure(p_area: float, p: float, point: Point) -> float:
    """Return the energy p z dA_z of the back pressure p; add its first derivatives to `point`.

    The variation of its integral is the pressure normal to the deformed sheet, if the rim is fixed.
    """
    v, force, up = point.v, point.force, p_area * point.normal[2]
    z = p * v[0, 2]
    force[0, 2] += up
    force[1, 0] += z * v[2, 1]
    force[1, 1] -= z * v[2, 0]
    force[2, 0] -= z * v[1, 1]
    force[2, 1] += z * v[1, 0]
    return float(up * v[0, 2])
