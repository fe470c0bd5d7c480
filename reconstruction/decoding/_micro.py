"""Number the fringes of one image row by single images of near periods: micro phase shifting.

Gupta and Nayar, Proc. CVPR 2012, 813. All periods are nearly equal, so that interreflection affects
mean A and modulation B of all images equally: I_k = A + B m_k cos(2 pi x / p_k + s_k) for image k
of period p_k and shift s_k. m_k is the modulation relative to that of the first period; it differs
from 1 because of lens blur, and is constant over the image.

N steps of the first period p_0 give A, B and the phase phi. They also give the candidates of the
coordinate, one for each fringe m: x_m = p_0 (phi / 2 pi + m). Symbols, for each candidate and
pixel: theta = (A, B, x); r_k the level of image k minus the model's level; J_k the derivative of
the model by theta; v the variance of the level; L the information matrix of the N steps for theta.
With H = L + sum J J^T / v and g = sum J r / v the cost of the candidate is least at
x_m + (H^-1 g)_x. The least cost is c_m = sum r^2 / v - g^T H^-1 g, a chi-square. The probability of
a candidate is proportional to exp(-c_m / 2) (equal prior probabilities). If even the least cost of
all candidates exceeds the limit for noise, the images deviate from the model, and the variance is
increased in proportion.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

import math
from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.compiling import compiled, inlined, nested
from reconstruction.decoding._decode import (
    Maps,
    Plan,
    answer_of,
    fit_row,
    make_work,
    settle_axis,
    write_valid_axes,
)
from reconstruction.decoding._order import TURN, Numbered
from reconstruction.decoding._phase import keep_usable
from reconstruction.decoding._sum import Limits, RowFrames, Shifts, noise_dn2, shifts_of

# Coordinate of the left edge of the projector's image.
FIRST_PX = -0.5
# Number of standard deviations above its mean up to which a chi-square is explained by noise.
MISFIT_SIGMAS = 3.0


class MicroPeriods(NamedTuple):
    """First period and single images of the further periods along one projector axis."""

    first_px: float
    further_px: FloatArray  # (image,), periods of the single images
    shifts_rad: FloatArray  # (image,), shifts of the single images
    shares: FloatArray  # (image,), modulation relative to that of the first period
    turn_cosines: FloatArray  # (image,), cosine of the phase change over one first period
    turn_sines: FloatArray
    first_image: int  # stack index of the first single image; 0: no pattern along this axis
    length_px: int


class PixelLight(NamedTuple):
    """Levels of a pixel by the N steps, DN, and the information matrix of A, B and x.

    The fields aa to xx are the six different elements of the symmetric information matrix L.
    """

    mean: float
    modulation: float
    aa: float
    ab: float
    ax: float
    bb: float
    bx: float
    xx: float


class MicroWork(NamedTuple):
    """Scratch arrays for one axis.

    values and weights are (image,), waves (2, image), costs (candidate,).
    """

    values: Any
    weights: Any
    waves: Any
    costs: Any


class FittedRow(NamedTuple):
    """Result of the N steps for one image row; every field is (col,) float32.

    mean and modulation are DN, phase is rad, excess is `Fit.excess`, usable is 1 or 0.
    """

    mean: Any
    modulation: Any
    phase: Any
    excess: Any
    usable: Any


@inlined
def _of_steps(
    mean: float, modulation: float, phase: float, excess: float, shifts: Shifts, period_px: float,
    scale: Any, limits: Limits,
) -> PixelLight:  # fmt: skip
    """Return levels and information matrix of the N steps of a pixel; `excess` as in `Fit`."""
    aa, ab, ax, bb, bx, xx = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    slope = -TURN / period_px * modulation
    c, s = math.cos(phase), math.sin(phase)
    for n in range(shifts.cosines.size):
        by_b = c * shifts.cosines[n] - s * shifts.sines[n]
        by_x = slope * (s * shifts.cosines[n] + c * shifts.sines[n])
        level = np.float32(mean + modulation * by_b)
        weight = 1.0 / (noise_dn2(level, scale, limits) * (1.0 + excess))
        aa, ab, ax = aa + weight, ab + weight * by_b, ax + weight * by_x
        bb += weight * by_b * by_b
        bx += weight * by_b * by_x
        xx += weight * by_x * by_x
    return PixelLight(mean, modulation, aa, ab, ax, bb, bx, xx)


@inlined
def _candidate(
    light: PixelLight, periods: MicroPeriods, values: Any, weights: Any, waves: Any
) -> Any:
    """Return the least cost near a candidate, its offset from the candidate, px, and the variance.

    The variance, px^2, is that of the coordinate at the least cost.

    values, weights : (image,), levels, DN, and 1 / variance, 1 / DN^2
    waves : (2, image), cosine and sine of every image's phase at the candidate
    """
    mean, modulation, aa, ab, ax, bb, bx, xx = light
    ga, gb, gx, cost = 0.0, 0.0, 0.0, 0.0
    for k in range(periods.further_px.size):
        weight, share = weights[k], periods.shares[k]
        by_b = share * waves[0, k]
        by_x = -modulation * share * TURN / periods.further_px[k] * waves[1, k]
        rest = values[k] - mean - modulation * by_b
        aa, ab, ax = aa + weight, ab + weight * by_b, ax + weight * by_x
        bb += weight * by_b * by_b
        bx += weight * by_b * by_x
        xx += weight * by_x * by_x
        ga, gb, gx = ga + weight * rest, gb + weight * rest * by_b, gx + weight * rest * by_x
        cost += weight * rest * rest
    # H = U^T D U, row by row.
    u_ab, u_ax = ab / aa, ax / aa
    d_b = bb - u_ab * ab
    u_bx = (bx - u_ab * ax) / d_b
    d_x = xx - u_ax * ax - u_bx * u_bx * d_b
    y_b = gb - u_ab * ga
    y_x = gx - u_ax * ga - u_bx * y_b
    return cost - ga * ga / aa - y_b * y_b / d_b - y_x * y_x / d_x, y_x / d_x, 1.0 / d_x


@inlined
def _next_fringe(periods: MicroPeriods, waves: Any) -> None:
    """Advance cosine and sine of every image's phase to the next candidate, one period further."""
    for k in range(periods.further_px.size):
        c, s = periods.turn_cosines[k], periods.turn_sines[k]
        waves[0, k], waves[1, k] = (
            c * waves[0, k] - s * waves[1, k],
            s * waves[0, k] + c * waves[1, k],
        )


@inlined
def _decide(
    phase: float, light: PixelLight, periods: MicroPeriods, values: Any, weights: Any,
    waves: Any, costs: Any,
) -> Any:  # fmt: skip
    """Return the coordinate, px, its variance, px^2, and the probability of a wrong fringe.

    phase : of the first period, rad
    values, weights, waves, costs : see `MicroWork`
    """
    place = phase / TURN * periods.first_px
    place -= periods.first_px if place - periods.first_px >= FIRST_PX else 0.0
    for k in range(periods.further_px.size):
        angle = TURN / periods.further_px[k] * place + periods.shifts_rad[k]
        waves[0, k], waves[1, k] = math.cos(angle), math.sin(angle)
    count, best, x_px, variance = 0, np.inf, 0.0, 1.0
    while place <= periods.length_px - 1.0 - FIRST_PX:
        cost, off_px, spread = _candidate(light, periods, values, weights, waves)
        costs[count] = cost
        count += 1
        if cost < best:
            best, x_px, variance = cost, place + off_px, spread
        place += periods.first_px
        _next_fringe(periods, waves)
    freedom, chances = -1.0, 0.0
    for k in range(weights.size):
        freedom += 1.0 if weights[k] > 0.0 else 0.0
    freedom = max(freedom, 1.0)
    softer = max(1.0, best / (freedom + MISFIT_SIGMAS * math.sqrt(2.0 * freedom)))
    for m in range(count):
        chances += math.exp(-0.5 * (costs[m] - best) / softer)
    return x_px, variance, 1.0 - 1.0 / chances if chances > 0.0 else 1.0


@nested
def number_micro_row(
    frames: RowFrames, periods: MicroPeriods, shifts: Shifts, limits: Limits, scale: Any,
    fitted: FittedRow, spare: MicroWork, answer: Numbered,
) -> None:  # fmt: skip
    """Write the coordinate, its sigma and the probability of a wrong fringe for one image row.

    All three are 0 for a pixel without a phase. Single images in which the pixel is clipped or lost
    are excluded.
    """
    count = periods.further_px.size
    values, weights, waves, costs = spare
    coordinate, sigma_px, error = answer
    span = limits.clipped_from_dn - limits.black_level_dn
    for col in range(error.size):
        coordinate[col], sigma_px[col], error[col] = 0.0, 0.0, 0.0
        if not fitted.usable[col] > 0.0:
            continue
        for k in range(count):
            value = np.float32(frames.stack[frames.first + k, frames.row, col])
            whole = value > limits.lowest_dn and value < limits.black_level_dn + span * scale[col]
            values[k] = value if whole else 0.0
            weights[k] = 1.0 / noise_dn2(value, scale[col], limits) if whole else 0.0
        light = _of_steps(
            fitted.mean[col], fitted.modulation[col], fitted.phase[col], fitted.excess[col],
            shifts, periods.first_px, scale[col], limits,
        )  # fmt: skip
        x_px, variance, wrong = _decide(
            fitted.phase[col], light, periods, values, weights, waves, costs
        )
        coordinate[col], sigma_px[col], error[col] = x_px, math.sqrt(variance), wrong


def decode_micro_rows(
    first_row: int, end_row: int, stack: Any, plan: Plan, periods: Any, maps: Maps
) -> None:
    """Decode image rows first_row to end_row - 1, and write them to `maps`.

    periods : pair of `MicroPeriods` for the axes column and row
    """
    work, spare = make_work(maps.reason.shape[1], 1), tuple(map(_make_spare, periods))
    _decode_band(first_row, end_row, stack, plan, periods, (work, spare), maps)


def _make_spare(periods: MicroPeriods) -> MicroWork:
    count, fringes = periods.further_px.size, int(periods.length_px / periods.first_px)
    return MicroWork(np.zeros(count), np.zeros(count), np.zeros((2, count)), np.zeros(fringes + 3))


@compiled
def _decode_band(
    first_row: int, end_row: int, stack: Any, plan: Plan, periods: Any, lines: Any, maps: Maps
) -> None:
    (work, spare), layout = lines, plan.layout
    for row in range(first_row, end_row):
        scale = plan.scale[row] if plan.scale.size else work.ones
        fit_row(row, stack, plan, scale, work, maps, maps.reason[row])
        for axis in range(layout.first_axis, layout.end_axis):
            phase = work.phases[axis, 0]
            keep_usable(work.usable, phase)
            single = RowFrames(stack, periods[axis].first_image, row)
            shifts = shifts_of(layout, axis, 0)
            fitted = FittedRow(
                work.mean[axis], work.modulations[axis, 0], phase, work.excess[axis], work.usable
            )
            answer = answer_of(axis, work)
            number_micro_row(
                single, periods[axis], shifts, plan.limits, scale, fitted, spare[axis], answer
            )
            settle_axis(axis, row, plan, work, maps)
        write_valid_axes(row, plan, work, maps)
