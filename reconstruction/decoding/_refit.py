"""Least squares over the good frames of a pixel, where others are clipped, lost or not finite.

Symbols: g_n = (1, sqrt(2) cos t_n, -sqrt(2) sin t_n), t_n = 2 pi n / N; M = sum g g^T / n over the
n good frames, the identity when all are good. Condition number: |M| |M^-1| / 3 with the Frobenius
norm |.|, 1 when all frames are good, and never below a third of the spectral one.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any

import numpy as np

from reconstruction._jit import compiled, inlined
from reconstruction.decoding._sum import SATURATED, Layout, Limits, Sums

ROOT = np.sqrt(2.0)
LARGEST = 1e30


@inlined
def _is_good(level: Any, lowest: Any, limit: Any) -> Any:
    """Tell whether a frame counts; false for NaN."""
    return lowest < level < limit


@inlined
def _normal_sums(
    stack: Any, first: int, row: int, col: int, layout: Layout, lowest: Any, limit: Any
) -> Any:
    """Return n and the sums over good frames: g1, g2, g1 g1, g1 g2, g2 g2, I, g1 I, g2 I."""
    n, s1, s2, s11, s12, s22, y, y1, y2 = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for step in range(layout.steps):
        level = np.float64(stack[first + step, row, col])
        if _is_good(level, lowest, limit):
            g1, g2 = ROOT * layout.cosines[step], -ROOT * layout.sines[step]
            n += 1
            s1, s2, s11, s12, s22 = s1 + g1, s2 + g2, s11 + g1 * g1, s12 + g1 * g2, s22 + g2 * g2
            y, y1, y2 = y + level, y1 + g1 * level, y2 + g2 * level
    return n, s1, s2, s11, s12, s22, y, y1, y2


@inlined
def _inverse(a: float, b: float, c: float, d: float, e: float, f: float) -> Any:
    """Return the inverse of [[a b c] [b d e] [c e f]], row by row, and its condition number."""
    ia, ib, ic = d * f - e * e, c * e - b * f, b * e - c * d
    id_, ie, if_ = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * ia + b * ib + c * ic
    scale = 1.0 / determinant if determinant > 0.0 else LARGEST
    size = a * a + d * d + f * f + 2.0 * (b * b + c * c + e * e)
    inverse = ia * ia + id_ * id_ + if_ * if_ + 2.0 * (ib * ib + ic * ic + ie * ie)
    condition = np.sqrt(size * inverse) * scale / 3.0
    return (ia * scale, ib * scale, ic * scale, id_ * scale, ie * scale, if_ * scale), condition


@inlined
def _square_residuals(
    stack: Any, first: int, row: int, col: int, layout: Layout, lowest: Any, limit: Any,
    fit: Any,
) -> float:  # fmt: skip
    total = 0.0
    for step in range(layout.steps):
        level = np.float64(stack[first + step, row, col])
        if _is_good(level, lowest, limit):
            model = fit[0] + ROOT * (fit[1] * layout.cosines[step] - fit[2] * layout.sines[step])
            total += (level - model) ** 2
    return total


@compiled
def refit_row(
    stack: Any, first: int, row: int, layout: Layout, limits: Limits, scale: Any, damaged: Any,
    sums: Sums, mean: Any, modulation: Any, variance: Any, excess: Any, reason: Any,
) -> None:  # fmt: skip
    """Replace what the damaged frames spoiled, or mark the pixel SATURATED.

    `excess` is how much larger than with N good frames the phase variance is, as a share.
    """
    steps, lowest, black = layout.steps, limits.lowest_dn, limits.black_level_dn
    for col in range(damaged.size):
        if not damaged[col]:
            continue
        limit = black + (limits.clipped_from_dn - black) * scale[col]
        n, s1, s2, s11, s12, s22, y, y1, y2 = _normal_sums(
            stack, first, row, col, layout, lowest, limit
        )
        c, condition = _inverse(float(n), s1, s2, s11, s12, s22)
        if n < 3 or not condition <= limits.max_condition:
            reason[col] = SATURATED if reason[col] == 0 else reason[col]
            mean[col] = mean[col] if np.isfinite(mean[col]) else 0.0
            modulation[col] = modulation[col] if np.isfinite(modulation[col]) else 0.0
            variance[col] = 0.0
            continue
        level = c[0] * y + c[1] * y1 + c[2] * y2
        p, q = c[1] * y + c[3] * y1 + c[4] * y2, c[2] * y + c[4] * y1 + c[5] * y2
        fit = (level, p, q)
        rest = _square_residuals(stack, first, row, col, layout, lowest, limit, fit)
        length = max(np.sqrt(p * p + q * q), 1e-30)
        along_p, along_q = -q / length, p / length
        growth = steps * (
            c[3] * along_p * along_p + 2.0 * c[4] * along_p * along_q + c[5] * along_q * along_q
        )
        mean[col], modulation[col] = level, ROOT * length
        sums.real[col], sums.imag[col] = steps * p / ROOT, steps * q / ROOT
        variance[col] = rest / (n - 3) if n > 3 else 0.0
        excess[col] = growth - 1.0
