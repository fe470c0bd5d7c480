"""Second pass, row by row: smooth the phasor, take its phase, number the fringe, give the sigma.

Symbols: z phasor, phi its phase in [0, 2 pi), B modulation.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction._jit import compiled, inlined
from reconstruction._order_kernels import Code, number_row
from reconstruction._sum_kernels import Limits, Sums
from reconstruction.arrays import FloatImage, OrderImage
from reconstruction.mask import Reason
from reconstruction.sensor import noise_variance_dn2

FILTER_SUPPORT = int(Reason.FILTER_SUPPORT)
TURN = 2.0 * np.pi
# Weights are float32: full support sums to 1 within a few 1e-7.
SUPPORT_ROUNDING = 1e-5
# atan(t) = t P(t^2) on [0, 1], minimax fit of degree 8: 6e-9 rad, below single precision's 1e-7.
# The library's arctangent is a call per pixel; this polynomial runs on whole vectors.
ATAN = tuple(
    np.float32(coefficient)
    for coefficient in (
        0.999999886, -0.333325969, 0.199859053, -0.141612196, 0.104989132,
        -0.0723479412, 0.0397805317, -0.0144009572, 0.00245662921,
    )
)  # fmt: skip
HALF_PI, PI, TWO_PI = np.float32(0.5 * np.pi), np.float32(np.pi), np.float32(TURN)
TINY = np.float32(1e-30)

_variance = inlined(noise_variance_dn2)


class Smoothing(NamedTuple):
    """Symmetric filter kernel of odd length, its 2-D noise gain, the support demanded."""

    weights: FloatImage
    noise_gain: float
    min_support: float


class Phases(NamedTuple):
    """Result of the second pass, all (axis, row, col)."""

    coordinate_px: FloatImage
    phase_rad: FloatImage
    order: OrderImage
    sigma_px: FloatImage


@compiled
def _smooth_row(image: Any, row: int, weights: Any, lane: Any, out: Any) -> None:
    """Filter one row of `image` in both directions; pixels beyond the border count as zero."""
    half, width = weights.size // 2, out.size
    lane[:] = 0.0
    out[:] = 0.0
    for tap in range(weights.size):
        source = row + tap - half
        if 0 <= source < image.shape[0]:
            weight, line = weights[tap], image[source]
            for col in range(width):
                lane[half + col] += weight * line[col]
    for tap in range(weights.size):
        weight, line = weights[tap], lane[tap : tap + width]
        for col in range(width):
            out[col] += weight * line[col]


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


@compiled
def _phase_row(real: Any, imag: Any, phase: Any) -> None:
    """Write arg z in [0, 2 pi) without a branch; 0 for z = 0."""
    for col in range(phase.size):
        x, y = abs(real[col]), abs(imag[col])
        long, short = max(x, y), min(x, y)
        phi = _arctangent(short / max(long, TINY))
        phi = HALF_PI - phi if y > x else phi
        phi = PI - phi if real[col] < 0.0 else phi
        phi = TWO_PI - phi if imag[col] < 0.0 else phi
        phase[col] = phi if phi < TWO_PI else np.float32(0.0)


@compiled
def _modulation_row(real: Any, imag: Any, support: Any, steps: int, usable: Any, out: Any) -> None:
    """Replace the modulation of single pixels by that of the smoothed phasor."""
    scale = np.float32(2.0 / steps)
    for col in range(out.size):
        square = real[col] * real[col] + imag[col] * imag[col]
        smooth = scale * np.sqrt(square) / support[col]
        out[col] = smooth if usable[col] > 0.0 else out[col]


@compiled
def _finish_row(
    noise_gain: float, limits: Limits, code: Code, support: Any, reason: Any,
    mean: Any, modulation: Any, sigma: Any,
) -> None:  # fmt: skip
    """Write the predicted sigma of valid pixels, px.

    sigma_phi^2 = (2 / N) sigma_I^2 / B^2 (Surrel 1997); sigma_I at the mean holds for N >= 4,
    where the modulated part of the shot noise averages out.
    """
    scale = np.sqrt(2.0 / code.steps) * noise_gain * code.period_px / TURN
    gain, read, offset = limits.gain_dn_per_e, limits.read_noise_e, limits.black_level_dn
    for col in range(reason.size):
        noise = np.sqrt(_variance(mean[col], gain, read, offset) / support[col])
        sigma[col] = scale * noise / modulation[col] if reason[col] == 0 else 0.0


@compiled
def _blank_row(reason: Any, order: Any, coordinate: Any) -> None:
    for col in range(reason.size):
        order[col] = order[col] if reason[col] == 0 else 0
        coordinate[col] = coordinate[col] if reason[col] == 0 else 0.0


@compiled
def _mark_support(support: Any, min_support: float, reason: Any) -> None:
    for col in range(reason.size):
        is_weak = reason[col] == 0 and support[col] < min_support - SUPPORT_ROUNDING
        reason[col] = FILTER_SUPPORT if is_weak else reason[col]


@compiled
def phase_rows(
    first_row: int,
    end_row: int,
    code: Code,
    smoothing: Smoothing,
    limits: Limits,
    sums: Sums,
    phases: Phases,
) -> None:
    """Fill `phases`, zeroed by the caller, and update `sums.reason` and `sums.modulation_dn`."""
    weights, width = smoothing.weights, sums.reason.shape[1]
    lane = np.zeros(width + weights.size - 1, np.float32)
    real, imag = np.zeros(width, np.float32), np.zeros(width, np.float32)
    support = np.zeros(width, np.float32)
    for row in range(first_row, end_row):
        _smooth_row(sums.usable, row, weights, lane, support)
        _mark_support(support, smoothing.min_support, sums.reason[row])
        for axis in range(2):
            _smooth_row(sums.real[axis], row, weights, lane, real)
            _smooth_row(sums.imag[axis], row, weights, lane, imag)
            for col in range(width):  # outside the mask the filter leaves tails of its neighbours
                real[col] *= sums.usable[row, col]
                imag[col] *= sums.usable[row, col]
            _phase_row(real, imag, phases.phase_rad[axis, row])
            modulation = sums.modulation_dn[axis, row]
            _modulation_row(real, imag, support, code.steps, sums.usable[row], modulation)
            number_row(
                axis, code, sums.word[axis, row], sums.weak[axis, row], phases.phase_rad[axis, row],
                phases.order[axis, row], phases.coordinate_px[axis, row], sums.reason[row],
            )  # fmt: skip
        for axis in range(2):  # only now are the reasons of both axes known
            _blank_row(sums.reason[row], phases.order[axis, row], phases.coordinate_px[axis, row])
            _finish_row(
                smoothing.noise_gain, limits, code, support, sums.reason[row],
                sums.mean_dn[axis, row], sums.modulation_dn[axis, row], phases.sigma_px[axis, row],
            )  # fmt: skip
