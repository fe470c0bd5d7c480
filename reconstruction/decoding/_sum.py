"""Fit mean and modulation to the phase frames of one image row, and mask single pixels.

Symbols: A mean, B modulation, N steps, z = sum I_n exp(-2 pi i n / N) = (N B / 2) exp(i phi).
Every inner loop runs along one image row with few arrays, so that the compiler vectorises it.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import Reason
from reconstruction.compiling import compiled, inlined, nested
from reconstruction.decoding._rows import larger, smaller
from reconstruction.rig.sensor import QUANTISATION_DN2

# Of the type of the mask: with a Python int the compiler would use 64 bits in the whole loop.
DARK = np.uint8(Reason.DARK)
LOW_MODULATION = np.uint8(Reason.LOW_MODULATION)
SATURATED = np.uint8(Reason.SATURATED)
ZERO, ONE, INFINITE = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
QUANTISATION = np.float32(QUANTISATION_DN2)


class Layout(NamedTuple):
    """Stack indices of the frames, and their numbers; pairs are for the axes column and row."""

    first_axis: int  # patterns exist along the axes first_axis to end_axis - 1: 0 columns, 1 rows
    end_axis: int
    phase_first: tuple[int, int]  # index of the first phase frame
    gray_first: tuple[int, int]
    inverse_first: tuple[int, int]  # -1: there are no inverse frames
    gray_bits: tuple[int, int]  # number of Gray frames
    white: int  # index of the white frame, -1: there is none
    black: int
    steps: int  # phase frames per set, 0: Gray code without fringes
    equal_steps: float  # number of frames of the camera's noise that give the same phase sigma
    sets: int  # fringe sets per axis
    cosines: Any  # (axis, set, step) float32, cosines of the phase shifts
    sines: Any
    factors: Any  # (axis, set, step) float32, see `Shifts`
    offsets: Any


class Shifts(NamedTuple):
    """Phase shift and light of every step of one fringe set; every field is (step,) float32.

    `level * factor + offset` is the level, DN, under the mean light of the set, see `gains`.
    """

    cosines: Any
    sines: Any
    factors: Any
    offsets: Any


@inlined
def shifts_of(layout: Layout, axis: int, fringes: int) -> Shifts:
    """Return the steps of one fringe set."""
    cosines, sines = layout.cosines[axis, fringes], layout.sines[axis, fringes]
    return Shifts(cosines, sines, layout.factors[axis, fringes], layout.offsets[axis, fringes])


class RowFrames(NamedTuple):
    """Frames of one fringe set, or of the Gray code along one axis, in one image row."""

    stack: Any  # (frame, row, col), all frames
    first: int  # index of the first frame
    row: int  # image row


class Sums(NamedTuple):
    """Sums over the frames of one fringe set for one image row; every field is (col,) float32."""

    total: Any  # sum of the levels, DN
    real: Any  # real part of z
    imag: Any  # imaginary part of z
    square: Any  # sum of the squared levels
    high: Any  # largest level
    low: Any  # smallest level


class Fit(NamedTuple):
    """Fit of one fringe set for one image row; every field is (col,) float32."""

    mean: Any  # A, DN
    modulation: Any  # B, DN
    variance: Any  # variance of the residuals, DN^2
    excess: Any  # relative increase of the phase variance because of excluded frames


class Limits(NamedTuple):
    """Sensor model and thresholds of the masks, see `SensorNoise` and `DecodeOptions`.

    They have single precision, so that vector instructions process more pixels at a time.
    A level at or below lowest_dn is that of a lost frame; -inf: no frame is lost.
    """

    gain_dn_per_e: np.float32
    read_noise_dn: np.float32
    black_level_dn: np.float32
    clipped_from_dn: np.float32
    lowest_dn: np.float32
    dark_sigmas: np.float32
    gray_sigmas: np.float32
    min_modulation_dn: np.float32
    max_phase_sigma_rad: np.float32
    max_condition: np.float32
    max_order_error: np.float32


@inlined
def noise_dn2(mean: Any, scale: Any, limits: Limits) -> Any:
    """Return the noise variance, DN^2, of a pixel with the given mean level, DN.

    This is `SensorNoise.variance_dn2` in single precision; a test compares the two.

    scale : factor by which the pixel's level above the black level was multiplied
    """
    above = mean - limits.black_level_dn
    shot = limits.gain_dn_per_e * (above if above > ZERO else ZERO)
    read = limits.read_noise_dn * limits.read_noise_dn + QUANTISATION
    return scale * (scale * read + shot)


@inlined
def _steps(shifts: Shifts, first: int, end: int) -> Shifts:
    cosines, sines, factors, offsets = shifts
    return Shifts(cosines[first:end], sines[first:end], factors[first:end], offsets[first:end])


@nested
def _add_six(lines: Any, shifts: Shifts, sums: Sums) -> None:
    a, b, c, d, e, f = lines
    total, real, imag, square, high, low = sums
    cosines, sines, factors, offsets = shifts
    # Six frames in one loop, because access to the accumulators dominates the run time.
    g0, g1, g2, g3, g4, g5 = cosines[0], cosines[1], cosines[2], cosines[3], cosines[4], cosines[5]
    h0, h1, h2, h3, h4, h5 = sines[0], sines[1], sines[2], sines[3], sines[4], sines[5]
    f0, f1, f2, f3, f4, f5 = factors[0], factors[1], factors[2], factors[3], factors[4], factors[5]
    o0, o1, o2, o3, o4, o5 = offsets[0], offsets[1], offsets[2], offsets[3], offsets[4], offsets[5]
    for col in range(a.size):
        # Read before the first write: a store of `old if .. else new` right after reading `old`
        # is compiled to a masked store, which takes more time than all other instructions.
        top, bottom = high[col], low[col]
        u, v, w = np.float32(a[col]), np.float32(b[col]), np.float32(c[col])
        x, y, z = np.float32(d[col]), np.float32(e[col]), np.float32(f[col])
        largest = larger(larger(larger(u, v), larger(w, x)), larger(y, z))
        smallest = smaller(smaller(smaller(u, v), smaller(w, x)), smaller(y, z))
        u, v, w = u * f0 + o0, v * f1 + o1, w * f2 + o2
        x, y, z = x * f3 + o3, y * f4 + o4, z * f5 + o5
        total[col] += (u + v + w) + (x + y + z)
        real[col] += (g0 * u + g1 * v + g2 * w) + (g3 * x + g4 * y + g5 * z)
        imag[col] -= (h0 * u + h1 * v + h2 * w) + (h3 * x + h4 * y + h5 * z)
        square[col] += (u * u + v * v + w * w) + (x * x + y * y + z * z)
        high[col] = larger(largest, top)
        low[col] = smaller(smallest, bottom)


@nested
def _add_three(lines: Any, shifts: Shifts, sums: Sums) -> None:
    a, b, c = lines
    total, real, imag, square, high, low = sums
    cosines, sines, factors, offsets = shifts
    p, q, r = cosines[0], cosines[1], cosines[2]
    s, t, u = sines[0], sines[1], sines[2]
    f0, f1, f2 = factors[0], factors[1], factors[2]
    o0, o1, o2 = offsets[0], offsets[1], offsets[2]
    for col in range(a.size):
        top, bottom = high[col], low[col]
        x, y, z = np.float32(a[col]), np.float32(b[col]), np.float32(c[col])
        largest, smallest = larger(larger(x, y), z), smaller(smaller(x, y), z)
        x, y, z = x * f0 + o0, y * f1 + o1, z * f2 + o2
        total[col] += x + y + z
        real[col] += p * x + q * y + r * z
        imag[col] -= s * x + t * y + u * z
        square[col] += x * x + y * y + z * z
        high[col] = larger(largest, top)
        low[col] = smaller(smallest, bottom)


@nested
def _add_one(a: Any, shifts: Shifts, sums: Sums) -> None:
    total, real, imag, square, high, low = sums
    cosine, sine = shifts.cosines[0], shifts.sines[0]
    factor, offset = shifts.factors[0], shifts.offsets[0]
    for col in range(a.size):
        top, bottom = high[col], low[col]
        x = np.float32(a[col])
        largest, smallest = larger(x, top), smaller(x, bottom)
        x = x * factor + offset
        total[col] += x
        real[col] += cosine * x
        imag[col] -= sine * x
        square[col] += x * x
        high[col] = largest
        low[col] = smallest


@nested
def add_frames(frames: RowFrames, steps: int, shifts: Shifts, sums: Sums) -> None:
    """Write the sums over the frames of one fringe set for one image row."""
    stack, first, row = frames
    total, real, imag, square, high, low = sums
    for col in range(total.size):
        total[col], real[col], imag[col], square[col] = ZERO, ZERO, ZERO, ZERO
        high[col], low[col] = -INFINITE, INFINITE
    sixes, threes = steps // 6 * 6, steps // 3 * 3
    for n in range(0, sixes, 6):
        k = first + n
        lines = (
            stack[k, row], stack[k + 1, row], stack[k + 2, row],
            stack[k + 3, row], stack[k + 4, row], stack[k + 5, row],
        )  # fmt: skip
        _add_six(lines, _steps(shifts, n, n + 6), sums)
    for n in range(sixes, threes, 3):
        k = first + n
        three = (stack[k, row], stack[k + 1, row], stack[k + 2, row])
        _add_three(three, _steps(shifts, n, n + 3), sums)
    for n in range(threes, steps):
        _add_one(stack[first + n, row], _steps(shifts, n, n + 1), sums)


@nested
def find_damaged(sums: Sums, scale: Any, limits: Limits, damaged: Any) -> Any:
    """Mark pixels with a clipped, lost or non-finite frame; return the number of such pixels."""
    black, span = limits.black_level_dn, limits.clipped_from_dn - limits.black_level_dn
    total, high, low = sums.total, sums.high, sums.low
    count = 0
    for col in range(damaged.size):
        is_whole = (
            high[col] < black + span * scale[col]
            and low[col] > limits.lowest_dn
            and abs(total[col]) < INFINITE  # false for NaN, which no comparison above detects
        )
        damaged[col] = not is_whole
        count += not is_whole
    return count


@nested
def finish_sums(steps: int, sums: Sums, fit: Fit) -> None:
    """Write mean A, modulation B and the variance of the residuals from the sums.

    The residuals have sum r^2 = sum I^2 - N A^2 - N B^2 / 2 for equal steps, and N - 3 degrees of
    freedom. In single precision the rounding of the squares limits the resolution of the residuals'
    standard deviation to about 3e-4 of the level.
    """
    total, real, imag, square = sums.total, sums.real, sums.imag, sums.square
    mean, modulation, variance = fit.mean, fit.modulation, fit.variance
    per_step, freedom = np.float32(1.0 / steps), np.float32(1.0 / max(steps - 3, 1))
    half = np.float32(0.5 * steps)
    if steps == 3:  # three unknowns always fit
        freedom = ZERO
    for col in range(mean.size):
        level = total[col] * per_step
        contrast = (
            np.float32(2.0) * per_step * np.sqrt(real[col] * real[col] + imag[col] * imag[col])
        )
        rest = square[col] - total[col] * level - half * contrast * contrast
        mean[col], modulation[col] = level, contrast
        variance[col] = (rest if rest > ZERO else ZERO) * freedom


@compiled
def find_noise(mean: Any, scale: Any, limits: Limits, noise: Any) -> None:
    """Write the predicted sigma, DN, of the level of each pixel at its mean level."""
    for col in range(mean.size):
        noise[col] = np.sqrt(noise_dn2(mean[col], scale[col], limits))


@compiled
def mark_low_modulation(
    steps: float, limits: Limits, modulation: Any, noise: Any, reason: Any
) -> None:
    """Mark pixels as `LOW_MODULATION` if their phase sigma would exceed its limit.

    Pixels with less modulation than `limits.min_modulation_dn` are also marked. Pixels that are
    already marked as `SATURATED` are unchanged.

    steps : number N of frames that determine the noise of the phase
    noise : (col,) sigma of the level, DN
    """
    # sigma_phi = sqrt(2 / N) sigma_I / B (Surrel 1997), solved for B.
    per_noise = np.float32(np.sqrt(2.0 / steps) / limits.max_phase_sigma_rad)
    least = limits.min_modulation_dn
    for col in range(modulation.size):
        needed = per_noise * noise[col]
        needed = needed if needed > least else least
        # In this form a NaN has no modulation.
        is_kept = modulation[col] >= needed or reason[col] == SATURATED
        reason[col] = reason[col] if is_kept else LOW_MODULATION


@compiled
def mark_dark(white: Any, black: Any, scale: Any, limits: Limits, reason: Any) -> None:
    """Mark pixels as `DARK` if white does not exceed black by `limits.dark_sigmas` sigmas."""
    square = limits.dark_sigmas * limits.dark_sigmas
    for col in range(white.size):
        code, factor = reason[col], scale[col]
        bright, dim = np.float32(white[col]), np.float32(black[col])
        variance = noise_dn2(bright, factor, limits) + noise_dn2(dim, factor, limits)
        step = bright - dim
        # In this form a NaN counts as dark.
        is_lit = (step >= ZERO) & (step * step >= square * variance)
        reason[col] = code if is_lit else DARK


@nested
def level_row(
    frames: RowFrames, first_inverse: int, count: int, is_ordered: bool, mean: Any, modulation: Any
) -> None:
    """Write mean level and half difference, DN, of pairs of frames, averaged over `count` pairs.

    frames : first frames of the pairs, from `frames.first` on
    first_inverse : stack index of the second frame of the first pair
    is_ordered : True if the first frame of each pair is the brighter one, as for white and black;
        False: the absolute difference is used
    """
    stack, first, row = frames
    share = np.float32(0.5 / count)
    for col in range(mean.size):
        mean[col], modulation[col] = ZERO, ZERO
    for k in range(count):
        a, b = stack[first + k, row], stack[first_inverse + k, row]
        for col in range(mean.size):
            level, opposite = np.float32(a[col]), np.float32(b[col])
            mean[col] += share * (level + opposite)
            step = level - opposite
            modulation[col] += share * (step if is_ordered else abs(step))


@nested
def mark_faint(modulation: Any, limits: Limits, reason: Any) -> None:
    """Mark pixels as `LOW_MODULATION` if their modulation is below `min_modulation_dn`.

    Pixels that are marked already, with any other reason, are not changed.
    """
    for col in range(modulation.size):
        is_kept = modulation[col] >= limits.min_modulation_dn or reason[col] != 0
        reason[col] = reason[col] if is_kept else LOW_MODULATION
