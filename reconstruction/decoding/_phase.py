"""Compute the phase of one image row and its sigma, also for pixels with damaged frames.

Symbols: z phasor, phi its phase in [0, 2 pi), B modulation, N steps.

Damaged frames of a pixel (clipped, lost or not finite) are excluded from the pixel's least-squares
fit. The fit uses the vectors g_n = (1, sqrt(2) cos t_n, -sqrt(2) sin t_n) with t_n = 2 pi n / N.
M is the mean of g g^T over the good frames, the identity if all frames are good. The condition
number is |M| |M^-1| / 3 with the Frobenius norm |.|. It is 1 if all frames are good, and at least
1/3 of the spectral condition number.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any

import numpy as np

from reconstruction.compiling import inlined, nested
from reconstruction.decoding._sum import (
    SATURATED,
    Fit,
    Limits,
    RowFrames,
    Shifts,
    Sums,
    noise_dn2,
)

TURN = 2.0 * np.pi
# atan(t) = t P(t^2) on [0, 1], minimax fit of degree 8: 6e-9 rad, below single precision's 1e-7.
# The library's arctangent is a call per pixel; this polynomial is vectorised.
ATAN = tuple(
    np.float32(coefficient)
    for coefficient in (
        0.999999886, -0.333325969, 0.199859053, -0.141612196, 0.104989132,
        -0.0723479412, 0.0397805317, -0.0144009572, 0.00245662921,
    )
)  # fmt: skip
HALF_PI, PI, TWO_PI = np.float32(0.5 * np.pi), np.float32(np.pi), np.float32(TURN)
TINY = np.float32(1e-30)
HALF, QUARTER = np.float32(0.5), np.float32(0.25)
STEPS_PER_RAD, ROUNDING = np.float32(65536.0 / TURN), np.float32(0.5)
ROOT = np.sqrt(2.0)
# A slope of a table is taken over this many nodes on either side, because 8-bit levels make the
# difference of two neighbouring nodes irregular.
SPAN = 2
LARGEST = 1e30


@nested
def keep_usable(usable: Any, phase: Any) -> None:
    """Set the phases of pixels that are not usable to 0, also those that are NaN."""
    for col in range(usable.size):
        phase[col] = phase[col] if usable[col] > 0.0 else np.float32(0.0)


@inlined
def _arctangent(t: Any) -> Any:
    s = t * t
    value = ATAN[8]
    value = value * s + ATAN[7]
    value = value * s + ATAN[6]
    value = value * s + ATAN[5]
    value = value * s + ATAN[4]
    value = value * s + ATAN[3]
    value = value * s + ATAN[2]
    value = value * s + ATAN[1]
    return t * (value * s + ATAN[0])


@nested
def phase_row(real: Any, imag: Any, phase: Any) -> None:
    """Write the phase arg z, rad, in [0, 2 pi), from real and imaginary part of z; 0 for z = 0.

    The loop has no branches, so that the compiler vectorises it.
    """
    for col in range(phase.size):
        x, y = abs(real[col]), abs(imag[col])
        long, short = max(x, y), min(x, y)
        phi = _arctangent(short / max(long, TINY))
        phi = HALF_PI - phi if y > x else phi
        phi = PI - phi if real[col] < 0.0 else phi
        phi = TWO_PI - phi if imag[col] < 0.0 else phi
        phase[col] = phi if phi < TWO_PI else np.float32(0.0)


@nested
def write_turns(phase: Any, out: Any) -> None:
    """Write phases, rad, as uint16 in steps of 1 / 65536 turn.

    A phase that rounds up to a whole turn becomes 0.
    """
    for col in range(phase.size):
        out[col] = np.uint16(np.int32(phase[col] * STEPS_PER_RAD + ROUNDING))


@nested
def phase_sigma(
    steps: float, limits: Limits, scale: Any, usable: Any, mean: Any, modulation: Any, sigma: Any
) -> None:  # fmt: skip
    """Write the predicted sigma of the phase, rad; 0 for pixels that are not usable.

    sigma_phi^2 = (2 / N) sigma_I^2 / B^2 (Surrel 1997), where sigma_I is the sigma of a level. The
    value of sigma_I at the mean level is valid for N >= 4, for which the modulated part of the shot
    noise averages out; see `shot_sigma` for N = 3.
    """
    factor = np.float32(np.sqrt(2.0 / steps))
    for col in range(sigma.size):
        noise = np.sqrt(noise_dn2(mean[col], scale[col], limits))
        value = factor * noise / modulation[col]
        sigma[col] = value if usable[col] > 0.0 else np.float32(0.0)


@nested
def shot_sigma(
    table: Any, limits: Limits, scale: Any, phase: Any, mean: Any, modulation: Any, sigma: Any
) -> None:  # fmt: skip
    """Correct the phase sigma for shot noise, which depends on the light of each single step.

    `phase_sigma` uses the shot noise at the mean of the steps.

    table : (node,) over one turn of the measured phase, see `ripple.Ripple.shot_share`
    """
    per_rad = np.float32((table.size - 1) / TURN)
    for col in range(sigma.size):
        if not sigma[col] > 0.0:
            continue
        node = min(int(phase[col] * per_rad + HALF), table.size - 1)
        even = noise_dn2(mean[col], scale[col], limits)
        more = scale[col] * limits.gain_dn_per_e * modulation[col] * table[node]
        # At least 0.25 of the variance: the modulation of a fit to few electrons may be very wrong.
        sigma[col] *= np.sqrt(max(even + more, QUARTER * even) / even)


@nested
def straighten_row(table: Any, phase: Any, sigma: Any) -> None:
    """Subtract the phase error by the projector's response from the phase, and correct its sigma.

    table : (node,) phase error, rad, over one turn of the measured phase. With its slope d, the
        noise of the corrected phase is sigma (1 - d)
    """
    nodes = table.size - 1
    per_rad = np.float32(nodes / TURN)
    per_span = np.float32(nodes / TURN / (2 * SPAN + 1))
    for col in range(phase.size):
        place = phase[col] * per_rad
        node = min(int(place), nodes - 1)
        share = place - np.float32(node)
        phi = phase[col] - (table[node] + share * (table[node + 1] - table[node]))
        phi = phi + TWO_PI if phi < np.float32(0.0) else phi
        phase[col] = phi - TWO_PI if phi >= TWO_PI else phi
        rise = table[(node + SPAN + 1) % nodes] - table[(node - SPAN + nodes) % nodes]
        sigma[col] *= abs(np.float32(1.0) - per_span * rise)


@nested
def doubt_row(table: Any, phase: Any, sigma: Any, doubt: Any) -> None:
    """Write the phase sigma including the uncertainty of the subtracted phase error, rad.

    The result is 0 for pixels without a phase.

    table : (node,) standard uncertainty of the phase error, rad, over one turn of the phase
    """
    nodes = table.size - 1
    per_rad = np.float32(nodes / TURN)
    for col in range(phase.size):
        node = min(int(phase[col] * per_rad), nodes - 1)
        whole = np.sqrt(sigma[col] * sigma[col] + table[node] * table[node])
        doubt[col] = whole if sigma[col] > 0.0 else np.float32(0.0)


@nested
def grow_sigma(excess: Any, sigma: Any) -> None:
    """Increase sigma for fits with excluded frames; `excess`: relative increase of the variance."""
    for col in range(sigma.size):
        sigma[col] *= np.sqrt(np.float32(1.0) + excess[col])


@inlined
def _is_good(level: Any, lowest: Any, limit: Any) -> Any:
    """Return True if a level is neither lost nor clipped; False for NaN."""
    return lowest < level < limit


@inlined
def _normal_sums(frames: RowFrames, col: int, shifts: Shifts, lowest: Any, limit: Any) -> Any:
    """Return sums over the good frames of a pixel, with level I and g = (1, g1, g2).

    The nine sums are those of 1, g1, g2, g1 g1, g1 g2, g2 g2, I, g1 I and g2 I.
    """
    n, s1, s2, s11, s12, s22, y, y1, y2 = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for step in range(shifts.cosines.size):
        level = np.float64(frames.stack[frames.first + step, frames.row, col])
        if _is_good(level, lowest, limit):
            g1, g2 = ROOT * shifts.cosines[step], -ROOT * shifts.sines[step]
            level = level * shifts.factors[step] + shifts.offsets[step]
            n += 1
            s1, s2, s11, s12, s22 = s1 + g1, s2 + g2, s11 + g1 * g1, s12 + g1 * g2, s22 + g2 * g2
            y, y1, y2 = y + level, y1 + g1 * level, y2 + g2 * level
    return n, s1, s2, s11, s12, s22, y, y1, y2


@inlined
def _inverse(a: float, b: float, c: float, d: float, e: float, f: float) -> Any:
    """Return the inverse of [[a b c] [b d e] [c e f]], and the condition number of the matrix.

    The inverse is its six different elements in the order a to f. The module docstring defines the
    condition number.
    """
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
    frames: RowFrames, col: int, shifts: Shifts, lowest: Any, limit: Any, cosine: Any
) -> float:
    """Return the sum of squared residuals, DN^2, of a pixel's good frames from a fitted cosine.

    cosine : coefficients (A, p, q) of the vector g
    """
    total = 0.0
    for step in range(shifts.cosines.size):
        level = np.float64(frames.stack[frames.first + step, frames.row, col])
        if _is_good(level, lowest, limit):
            level = level * shifts.factors[step] + shifts.offsets[step]
            p, q = cosine[1] * shifts.cosines[step], cosine[2] * shifts.sines[step]
            model = cosine[0] + ROOT * (p - q)
            total += (level - model) ** 2
    return total


@nested
def refit_row(
    frames: RowFrames, shifts: Shifts, limits: Limits, scale: Any, share: Any, damaged: Any,
    sums: Sums, fit: Fit, reason: Any,
) -> None:  # fmt: skip
    """Fit pixels with damaged frames again without these frames, or mark them as `SATURATED`.

    A pixel is marked if fewer than three frames remain, if the condition number of the remaining
    frames is too large, or if the threshold of its Gray bits is clipped, so that no bit exceeds it.

    share : see `threshold_above_mean`
    """
    mean, modulation, variance, excess = fit
    steps, lowest, black = shifts.cosines.size, limits.lowest_dn, limits.black_level_dn
    for col in range(damaged.size):
        if not damaged[col]:
            continue
        limit = black + (limits.clipped_from_dn - black) * scale[col]
        n, s1, s2, s11, s12, s22, y, y1, y2 = _normal_sums(frames, col, shifts, lowest, limit)
        c, condition = _inverse(float(n), s1, s2, s11, s12, s22)
        if n < 3 or not condition <= limits.max_condition:
            reason[col] = SATURATED if reason[col] == 0 else reason[col]
            mean[col] = mean[col] if np.isfinite(mean[col]) else 0.0
            modulation[col] = modulation[col] if np.isfinite(modulation[col]) else 0.0
            variance[col] = 0.0
            continue
        level = c[0] * y + c[1] * y1 + c[2] * y2
        p, q = c[1] * y + c[3] * y1 + c[4] * y2, c[2] * y + c[4] * y1 + c[5] * y2
        rest = _square_residuals(frames, col, shifts, lowest, limit, (level, p, q))
        length = max(np.sqrt(p * p + q * q), 1e-30)
        along_p, along_q = -q / length, p / length
        growth = steps * (
            c[3] * along_p * along_p + 2.0 * c[4] * along_p * along_q + c[5] * along_q * along_q
        )
        mean[col], modulation[col] = level, ROOT * length
        if level + share * ROOT * length >= limit and reason[col] == 0:
            reason[col] = SATURATED
        sums.real[col], sums.imag[col] = steps * p / ROOT, steps * q / ROOT
        variance[col] = rest / (n - 3) if n > 3 else 0.0
        excess[col] = growth - 1.0
