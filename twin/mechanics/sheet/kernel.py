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

from typing import NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray
from twin.mechanics.sheet.laws import (
    Grip,
    Laws,
    Material,
    Rest,
    Touch,
    contact_law,
    inlined,
    kernel,
    material,
)

#: Offsets (row, col) of the upper half of the tangent's stencil, in the order of its slots.
SLOTS = (
    *((0, col) for col in range(3)),
    *((row, col) for row in (1, 2) for col in range(-2, 3)),
)
#: Cell row, cell column and Gauss point.
At = tuple[int, int, int]
#: a11, a22, a12 and their determinant.
Metric = tuple[float, float, float, float]


class Point(NamedTuple):
    """Scratch of one Gauss point, reused."""

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


class Cell(NamedTuple):
    """Scratch of one cell, reused."""

    #: (9, 6) functions and derivatives at a point, and (5,) those of one along the grid
    functions: FloatArray
    plain: FloatArray
    #: (54,) and (6, 81) a point's tangent with its second side taken to the functions
    side: FloatArray
    half: FloatArray
    #: (9, 81) tangent between functions, [i, 9 j + 3 k + l] for j not below i
    blocks: FloatArray


def scratch() -> tuple[Point, Cell]:
    """Return what one call of `assemble_rows` works in."""
    slopes = np.zeros((6, 5))
    slopes[0, 0] = slopes[1, 0] = slopes[3, 4] = slopes[4, 4] = 1.0
    point = Point(
        np.zeros((6, 3)), np.zeros((6, 3)), np.zeros(6), np.zeros((6, 6)), np.zeros((3, 3)),
        np.zeros((3, 3)), np.zeros(3), np.zeros((2, 3)), np.zeros((3, 2)), np.zeros((6, 6, 3)),
        np.zeros((6, 6, 9)), Material(slopes, np.zeros((6, 5))),
    )  # fmt: skip
    cell = Cell(np.zeros((9, 6)), np.zeros(5), np.zeros(54), np.zeros((6, 81)), np.zeros((9, 81)))
    return point, cell


@inlined
def _dot(a: FloatArray, b: FloatArray) -> float:
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@inlined
def _functions(at: At, rest: Rest, N: FloatArray, plain: FloatArray) -> None:
    """Fill N (9, m) with the cell's functions and their derivatives along the sheet."""
    row, col, q = at
    x, y = rest.along_x[col, q % 2], rest.along_y[row, q // 2]
    count = N.shape[1]
    for b in range(3):
        for a in range(3):
            n = N[3 * b + a]
            n[0] = x[0, a] * y[0, b]
            n[1] = x[1, a] * y[0, b]
            n[2] = x[0, a] * y[1, b]
            if count == 6:
                n[3] = x[2, a] * y[0, b]
                n[4] = x[0, a] * y[2, b]
                n[5] = x[1, a] * y[1, b]
    if rest.turned.shape[0] == 0:
        return
    turned = rest.turned[row, col, q]
    for j in range(9):
        for t in range(count - 1):
            plain[t] = N[j, 1 + t]
        for s in range(count - 1):
            total = 0.0
            for t in range(count - 1):
                total += turned[s, t] * plain[t]
            N[j, 1 + s] = total


@inlined
def _place(functions: FloatArray, c: FloatArray, row: int, col: int, v: FloatArray) -> None:
    """Fill v (m, 3), the first m derivatives of the surface at a Gauss point."""
    v[:] = 0.0
    for b in range(3):
        for a in range(3):
            for m in range(v.shape[0]):
                N = functions[3 * b + a, m]
                for k in range(3):
                    v[m, k] += N * c[row + b, col + a, k]


@inlined
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
def _stick(at: At, grip: Grip, stiffness: float, point: Point) -> float:
    """Add the spring to the anchor, along the surface that was touched there; return its energy."""
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
def _geometry(point: Point) -> tuple[Metric, tuple[float, float, float]]:
    """Fill normal, dual vectors and Christoffel symbols; return a with its determinant, and b."""
    v, n, dual, gamma = point.v, point.normal, point.dual, point.gamma
    r1, r2 = v[1], v[2]
    a11, a22, a12 = _dot(r1, r1), _dot(r2, r2), _dot(r1, r2)
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
            gamma[m, e] = _dot(dual[e], v[3 + m])
    return (a11, a22, a12, d), (_dot(n, v[3]), _dot(n, v[4]), _dot(n, v[5]))


@inlined
def _potentials(
    at: At, laws: Laws, touch: Touch, grip: Grip, want: bool, convex: bool, point: Point
) -> float:
    """Fill stress, forces and, if wanted, moduli; return the energy per area."""
    v, n = point.v, point.normal
    metric, bending = _geometry(point)
    forms = (metric[0], metric[1], metric[2], *bending)
    total = laws.shear_modulus_kpa * material(
        forms, laws.thickness_mm, point.material, point.stress, point.modulus, want
    )
    for i in range(6):
        point.stress[i] *= laws.shear_modulus_kpa
        for k in range(6):
            point.modulus[i, k] *= laws.shear_modulus_kpa
    point.force[:] = 0.0
    point.at_r[:] = 0.0
    point.cross[:] = 0.0
    for part in range(touch.distance_mm.shape[0]):
        total += _touch(part, at, metric, laws, touch, convex, point)
    if grip.held[at] > 0:
        total += _stick(at, grip, laws.stick_stiffness, point)
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
def _pressure(p_area: float, p: float, point: Point) -> float:
    """Add p int z dA_z: its variation is the follower pressure, while the rim does not move."""
    v, force, up = point.v, point.force, p_area * point.normal[2]
    z = p * v[0, 2]
    force[0, 2] += up
    force[1, 0] += z * v[2, 1]
    force[1, 1] -= z * v[2, 0]
    force[2, 0] -= z * v[1, 1]
    force[2, 1] += z * v[1, 0]
    return float(up * v[0, 2])


@inlined
def _stress_changes(point: Point) -> None:
    """Fill what v makes of the stresses: the moduli times the strains' first derivatives."""
    H, X, n, r1, r2 = point.modulus, point.stress_by_v, point.normal, point.v[1], point.v[2]
    gamma = point.gamma
    for m in range(6):
        g1 = H[m, 3] * gamma[0, 0] + H[m, 4] * gamma[1, 0] + H[m, 5] * gamma[2, 0]
        g2 = H[m, 3] * gamma[0, 1] + H[m, 4] * gamma[1, 1] + H[m, 5] * gamma[2, 1]
        for k in range(3):
            X[m, 1, k] = 2 * H[m, 0] * r1[k] + H[m, 2] * r2[k] - g1 * n[k]
            X[m, 2, k] = 2 * H[m, 1] * r2[k] + H[m, 2] * r1[k] - g2 * n[k]
            X[m, 3, k], X[m, 4, k], X[m, 5, k] = H[m, 3] * n[k], H[m, 4] * n[k], H[m, 5] * n[k]
    for m in range(3):  # the bodies' part: gaps change with place
        for k in range(3):
            X[m, 0, k] = point.cross[m, k]


@inlined
def _tangent(laws: Laws, convex: bool, point: Point) -> None:
    """Fill the second derivatives of the energy by v."""
    K, X, gamma, n, r1, r2 = (
        point.tangent, point.stress_by_v, point.gamma, point.normal, point.v[1], point.v[2],
    )  # fmt: skip
    _stress_changes(point)
    s1, s2, s12 = 2 * point.stress[0], 2 * point.stress[1], point.stress[2]
    if convex:
        s1, s2, s12 = _tension_only(s1, s2, s12)
    for t in range(6):
        for k in range(3):
            x0, x1, x2, x3, x4, x5 = (
                X[0, t, k], X[1, t, k], X[2, t, k], X[3, t, k], X[4, t, k], X[5, t, k],
            )  # fmt: skip
            g1 = gamma[0, 0] * x3 + gamma[1, 0] * x4 + gamma[2, 0] * x5
            g2 = gamma[0, 1] * x3 + gamma[1, 1] * x4 + gamma[2, 1] * x5
            for i in range(3):
                at = 3 * i + k
                K[t, 1, at] = 2 * x0 * r1[i] + x2 * r2[i] - g1 * n[i]
                K[t, 2, at] = 2 * x1 * r2[i] + x2 * r1[i] - g2 * n[i]
                K[t, 3, at], K[t, 4, at], K[t, 5, at] = x3 * n[i], x4 * n[i], x5 * n[i]
    for i in range(3):
        for k in range(3):
            K[0, 0, 3 * i + k] = point.at_r[i, k]
            for t in range(1, 3):  # the transpose of what is filled above
                K[t, 0, 3 * i + k] = K[0, t, 3 * k + i]
        K[1, 1, 4 * i] += s1
        K[2, 2, 4 * i] += s2
        K[1, 2, 4 * i] += s12
        K[2, 1, 4 * i] += s12
    if not convex:
        _curvature_terms(point)
        if laws.pressure_kpa != 0.0:
            _pressure_terms(laws.pressure_kpa, point)


@inlined
def _tension_only(s1: float, s2: float, s12: float) -> tuple[float, float, float]:
    """Return the membrane stress without its compressive principal parts."""
    mean, dev = 0.5 * (s1 + s2), 0.5 * (s1 - s2)
    rad = np.sqrt(dev * dev + s12 * s12)
    if mean - rad >= 0.0:
        return s1, s2, s12
    x = max(mean + rad, 0.0) / (2 * rad + 1e-300)
    return x * (rad + dev), x * (rad - dev), x * s12


@inlined
def _pressure_terms(p: float, point: Point) -> None:
    """Add the second derivatives of p z (r_1 x r_2)_z."""
    K, v, z = point.tangent, point.v, p * point.v[0, 2]
    # (z, x) and (z, y) lie at 6 and 7, their transposes at 2 and 5; (x, y) at 1, (y, x) at 3.
    for t, sign in ((1, 1.0), (2, -1.0)):
        along_x, along_y = sign * p * v[3 - t, 1], -sign * p * v[3 - t, 0]
        K[t, 0, 6] += along_x
        K[t, 0, 7] += along_y
        K[0, t, 2] += along_x
        K[0, t, 5] += along_y
        K[3 - t, t, 1] += sign * z
        K[3 - t, t, 3] -= sign * z


@inlined
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
        for i in range(3):
            for k in range(3):
                x = n[i] * dual[e, k]
                for s in range(5):
                    K[1 + s, 1 + e, 3 * i + k] -= x * share[s]
                    K[1 + e, 1 + s, 3 * k + i] -= x * share[s]
        for t in range(2):
            x = bent * _dot(dual[e], dual[t])
            for i in range(3):
                for k in range(3):
                    K[1 + t, 1 + e, 3 * i + k] -= x * n[i] * n[k]


@inlined
def _gather(N: FloatArray, weight: float, K: FloatArray, cell: Cell) -> None:
    """Add a point's tangent to its cell's blocks: long loops, for vector units."""
    half, side, blocks = cell.half, cell.side, cell.blocks
    for j in range(9):
        n0, n1, n2 = weight * N[j, 0], weight * N[j, 1], weight * N[j, 2]
        n3, n4, n5 = weight * N[j, 3], weight * N[j, 4], weight * N[j, 5]
        for k in range(54):
            side[k] = (
                n0 * K[0, k] + n1 * K[1, k] + n2 * K[2, k]
                + n3 * K[3, k] + n4 * K[4, k] + n5 * K[5, k]
            )  # fmt: skip
        for s in range(6):
            for k in range(9):
                half[s, 9 * j + k] = side[9 * s + k]
    for i in range(9):
        n0, n1, n2, n3, n4, n5 = N[i, 0], N[i, 1], N[i, 2], N[i, 3], N[i, 4], N[i, 5]
        for k in range(9 * i, 81):
            blocks[i, k] += (
                n0 * half[0, k] + n1 * half[1, k] + n2 * half[2, k]
                + n3 * half[3, k] + n4 * half[4, k] + n5 * half[5, k]
            )  # fmt: skip


@kernel
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
    point: Point,
    cell: Cell,
    energy: FloatArray,
    F: FloatArray,
    S: FloatArray,
) -> None:
    """Add the energy, forces and, if wanted, the tangent of cell rows first to end.

    Parameters
    ----------
    c : (row + 2, col + 2, 3) control points
    rest, laws, touch, grip : Rest, Laws, Touch, Grip
    point, cell : scratch
    want : fill the tangent
    convex : leave out of the tangent what can make it indefinite
    energy : (row,) of each row of cells
    F : (row + 2, col + 2, 3) forces, added to
    S : (row + 2, col + 2, 13 * 9) tangent by stencil slot, added to
    """
    N, plain = cell.functions, cell.plain
    for j_row in range(first, end):
        total = 0.0
        for i_col in range(rest.area_mm2.shape[1]):
            cell.blocks[:] = 0.0
            for q in range(4):
                weight = rest.area_mm2[j_row, i_col, q]
                _functions((j_row, i_col, q), rest, N, plain)
                _place(N, c, j_row, i_col, point.v)
                total += weight * _potentials(
                    (j_row, i_col, q), laws, touch, grip, want, convex, point
                )
                for j in range(9):
                    for k in range(3):
                        x = 0.0
                        for m in range(6):
                            x += N[j, m] * point.force[m, k]
                        F[j_row + j // 3, i_col + j % 3, k] += weight * x
                if want:
                    _tangent(laws, convex, point)
                    _gather(N, weight, point.tangent.reshape(6, 54), cell)
            if want:
                for i in range(9):
                    own = S[j_row + i // 3, i_col + i % 3]
                    for j in range(i, 9):
                        slot = 9 * ((j // 3 - i // 3) * 5 + j % 3 - i % 3)
                        for k in range(9):
                            own[slot + k] += cell.blocks[i, 9 * j + k]
        energy[j_row] = total


@kernel
def surface_rows(
    first: int,
    end: int,
    c: FloatArray,
    rest: Rest,
    N: FloatArray,
    plain: FloatArray,
    out: FloatArray,
) -> None:
    """Fill out (row, col, 4, 3, 3) with r, r_1 and r_2 at the Gauss points of some cell rows."""
    for j_row in range(first, end):
        for i_col in range(rest.area_mm2.shape[1]):
            for q in range(4):
                _functions((j_row, i_col, q), rest, N, plain)
                _place(N, c, j_row, i_col, out[j_row, i_col, q])
