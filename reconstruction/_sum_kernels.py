"""First pass over the stack, row by row: phase sums, Gray words and the masks of single pixels.

Symbols: A mean, B modulation, N steps, z = sum I_n exp(-2 pi i n / N) = (N B / 2) exp(i phi).
Every inner loop runs along one image row with few arrays, so that the compiler vectorises it.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction._jit import compiled, inlined
from reconstruction.arrays import FloatImage
from reconstruction.mask import Reason
from reconstruction.sensor import noise_variance_dn2

DARK = int(Reason.DARK)
LOW_MODULATION = int(Reason.LOW_MODULATION)
SATURATED = int(Reason.SATURATED)

_variance = inlined(noise_variance_dn2)


class Layout(NamedTuple):
    """Where frames lie in the stack; pairs are (column, row)."""

    phase_first: tuple[int, int]
    gray_first: tuple[int, int]
    gray_bits: tuple[int, int]
    white: int
    black: int


class Limits(NamedTuple):
    """Sensor model and thresholds of the masks."""

    gain_dn_per_e: float
    read_noise_e: float
    black_level_dn: float
    saturation_dn: float
    dark_sigmas: float
    gray_sigmas: float
    min_modulation_dn: float
    max_phase_sigma_rad: float


class Sums(NamedTuple):
    """Result of the first pass; (axis, row, col) unless stated."""

    mean_dn: FloatImage
    real: FloatImage
    imag: FloatImage
    modulation_dn: FloatImage
    word: Any
    weak: Any
    reason: Any  # (row, col)
    usable: FloatImage  # (row, col), 1 where the pixel has a phase, else 0


@compiled
def _add_phase_frames(
    stack: Any, first: int, row: int, cosines: Any, sines: Any,
    total: Any, peak: Any, real: Any, imag: Any,
) -> None:  # fmt: skip
    peak[:] = 0.0
    for n in range(cosines.size):
        frame = stack[first + n, row]
        c, s = cosines[n], sines[n]
        for col in range(frame.size):
            level = np.float32(frame[col])
            total[col] += level
            peak[col] = level if level > peak[col] else peak[col]
        for col in range(frame.size):
            real[col] += c * np.float32(frame[col])
            imag[col] -= s * np.float32(frame[col])


@compiled
def _mark_saturated(peak: Any, limit: float, reason: Any) -> None:
    for col in range(peak.size):
        reason[col] = SATURATED if peak[col] >= limit else reason[col]


@compiled
def _finish_phase_row(
    steps: int, limits: Limits, mean: Any, real: Any, imag: Any, modulation: Any, noise: Any
) -> None:
    for col in range(mean.size):
        mean[col] /= np.float32(steps)
        square = real[col] * real[col] + imag[col] * imag[col]
        # A NaN in a damaged float stack becomes "no modulation" here; it must not spread.
        modulation[col] = np.float32(2.0 / steps) * np.sqrt(square) if square >= 0 else 0.0
        mean[col] = mean[col] if square >= 0 else 0.0
    for col in range(mean.size):
        variance = _variance(
            mean[col], limits.gain_dn_per_e, limits.read_noise_e, limits.black_level_dn
        )
        noise[col] = np.sqrt(variance)


@compiled
def _mark_low_modulation(
    steps: int, limits: Limits, modulation: Any, noise: Any, reason: Any
) -> None:
    # sigma_phi = sqrt(2 / N) sigma_I / B (Surrel 1997), solved for B.
    per_noise = np.sqrt(2.0 / steps) / limits.max_phase_sigma_rad
    for col in range(modulation.size):
        needed = max(limits.min_modulation_dn, per_noise * noise[col])
        reason[col] = LOW_MODULATION if modulation[col] < needed else reason[col]


@compiled
def _mark_dark(white: Any, black: Any, limits: Limits, reason: Any) -> None:
    gain, read, offset = limits.gain_dn_per_e, limits.read_noise_e, limits.black_level_dn
    for col in range(white.size):
        bright, dim = np.float32(white[col]), np.float32(black[col])
        variance = _variance(bright, gain, read, offset) + _variance(dim, gain, read, offset)
        # This way round a NaN counts as dark.
        is_lit = bright - dim >= limits.dark_sigmas * np.sqrt(variance)
        reason[col] = reason[col] if is_lit else DARK


@compiled
def _read_gray_row(
    stack: Any, first: int, bits: int, row: int, mean: Any, margin: Any, word: Any, weak: Any
) -> None:
    for bit in range(bits):
        frame = stack[first + bit, row]
        for col in range(frame.size):
            word[col] = (word[col] << 1) | (np.float32(frame[col]) > mean[col])
        for col in range(frame.size):
            doubt = abs(np.float32(frame[col]) - mean[col]) < margin[col]
            weak[col] = (weak[col] << 1) | doubt


@compiled
def _keep_usable(reason: Any, usable: Any, real: Any, imag: Any) -> None:
    """Zero the phasors without a phase: the filter must not mix them in."""
    for col in range(reason.size):
        usable[col] = np.float32(reason[col] == 0)
    for axis in range(2):
        for col in range(reason.size):
            real[axis, col] = real[axis, col] if reason[col] == 0 else np.float32(0.0)
            imag[axis, col] = imag[axis, col] if reason[col] == 0 else np.float32(0.0)


@compiled
def sum_rows(
    first_row: int,
    end_row: int,
    stack: Any,
    layout: Layout,
    limits: Limits,
    cosines: Any,
    sines: Any,
    sums: Sums,
) -> None:
    """Fill `sums`, zeroed by the caller, for rows first_row to end_row - 1.

    A lower reason code overwrites a higher one: the marks are made in falling order.
    """
    steps = cosines.size
    noise = np.zeros((2, stack.shape[2]), np.float32)
    peak = np.zeros(stack.shape[2], np.float32)
    for row in range(first_row, end_row):
        reason = sums.reason[row]
        for axis in range(2):
            first = layout.phase_first[axis]
            mean, real, imag = sums.mean_dn[axis, row], sums.real[axis, row], sums.imag[axis, row]
            _add_phase_frames(stack, first, row, cosines, sines, mean, peak, real, imag)
            _mark_saturated(peak, limits.saturation_dn, reason)
            modulation = sums.modulation_dn[axis, row]
            _finish_phase_row(steps, limits, mean, real, imag, modulation, noise[axis])
        for axis in range(2):
            _mark_low_modulation(steps, limits, sums.modulation_dn[axis, row], noise[axis], reason)
            # The threshold A carries the noise of N averaged frames.
            for col in range(reason.size):
                noise[axis, col] *= limits.gray_sigmas * np.sqrt(1.0 + 1.0 / steps)
            gray, bits = layout.gray_first[axis], layout.gray_bits[axis]
            word, weak = sums.word[axis, row], sums.weak[axis, row]
            _read_gray_row(stack, gray, bits, row, sums.mean_dn[axis, row], noise[axis], word, weak)
        _mark_dark(stack[layout.white, row], stack[layout.black, row], limits, reason)
        _keep_usable(reason, sums.usable[row], sums.real[:, row], sums.imag[:, row])
