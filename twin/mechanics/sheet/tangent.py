"""Second derivatives of the sheet's energy at one Gauss point, compiled; symbols as in `point`."""

import numpy as np

from twin.mechanics.sheet.laws import Laws, inlined
from twin.mechanics.sheet.point import Point, dot


@inlined
def fill_tangent(laws: Laws, convex: bool, point: Point) -> None:
    """Write the second derivatives of the energy by v to `point.tangent`.

    `convex` True leaves out terms that can make the tangent indefinite.
    """
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
            for t in range(1, 3):  # the transpose of the part above
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
def _stress_changes(point: Point) -> None:
    """Write the derivatives of the stresses by v: moduli times derivatives of a and b by v."""
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
    # (z, x) and (z, y) are at 6 and 7, their transposes at 2 and 5; (x, y) at 1, (y, x) at 3.
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
    """Add the moments times the second derivatives of b, which depends on the normal."""
    K, n, dual = point.tangent, point.normal, point.dual
    c1 = c2 = bent = 0.0
    for m in range(3):
        M = point.stress[3 + m]
        c1 -= M * point.gamma[m, 0]
        c2 -= M * point.gamma[m, 1]
        bent += M * dot(n, point.v[3 + m])
    share = (c1, c2, point.stress[3], point.stress[4], point.stress[5])
    for e in range(2):
        for i in range(3):
            for k in range(3):
                x = n[i] * dual[e, k]
                for s in range(5):
                    K[1 + s, 1 + e, 3 * i + k] -= x * share[s]
                    K[1 + e, 1 + s, 3 * k + i] -= x * share[s]
        for t in range(2):
            x = bent * dot(dual[e], dual[t])
            for i in range(3):
                for k in range(3):
                    K[1 + t, 1 + e, 3 * i + k] -= x * n[i] * n[k]
