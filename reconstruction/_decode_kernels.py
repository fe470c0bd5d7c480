"""A band of image rows from camera frames to projector coordinates, in one pass over the stack.

The phasors of the last rows, as many as the filter is high, lie in a ring: nothing but the result
is ever as large as the image. Rows above and below the band are summed for the filter only.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any

import numpy as np

from reconstruction._band import Maps, Plan, Work, make_work, plane
from reconstruction._chain_kernels import climb_row
from reconstruction._filter_kernels import smooth_row
from reconstruction._jit import compiled, merged
from reconstruction._order_kernels import (
    NEAR_SIGMAS,
    PLAIN,
    blank_row,
    number_row,
    read_gray_row,
    settle_row,
    weigh_near_bits,
    weigh_wrap,
)
from reconstruction._phase_kernels import (
    blank_unusable,
    grow_sigma,
    mark_support,
    phase_row,
    phase_sigma,
    smooth_modulation,
)
from reconstruction._refit_kernels import refit_row
from reconstruction._sum_kernels import (
    IMAG,
    REAL,
    add_frames,
    find_damaged,
    find_noise,
    finish_sums,
    mark_dark,
    mark_low_modulation,
)


@compiled
def _fit_set(
    stack: Any, first: int, row: int, plan: Plan, scale: Any, work: Work,
    mean: Any, modulation: Any, reason: Any,
) -> Any:  # fmt: skip
    """Fit one fringe set over one row; return how many pixels have damaged frames."""
    layout, limits, sums = plan.layout, plan.limits, work.sums
    variance, noise, excess = work.fit[2], work.fit[3], work.fit[4]
    add_frames(stack, first, row, layout, sums)
    finish_sums(layout.steps, sums, mean, modulation, variance)
    count = find_damaged(sums, scale, limits, work.damaged)
    if count:
        _fill(excess, np.float32(0.0))
        refit_row(
            stack, first, row, layout, limits, scale, work.damaged,
            sums, mean, modulation, variance, excess, reason,
        )  # fmt: skip
    find_noise(mean, scale, limits, noise)
    if count:
        grow_sigma(excess, noise)
    mark_low_modulation(layout.steps, limits, modulation, noise, reason)
    return count


@compiled
def _fill(line: Any, value: Any) -> None:
    for i in range(line.size):
        line[i] = value


@compiled
def _copy(source: Any, target: Any) -> None:
    for i in range(target.size):
        target[i] = source[i]


@compiled
def _add_variance(is_first: bool, variance: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] = variance[col] if is_first else total[col] + variance[col]


@compiled
def _add_largest(value: Any, largest: Any) -> None:
    for col in range(value.size):
        largest[col] = max(largest[col], value[col])


@compiled
def _root_of_mean(sets: int, residual: Any) -> None:
    share = np.float32(1.0 / sets)
    for col in range(residual.size):
        residual[col] = np.sqrt(residual[col] * share)


@merged
def _sum_row(
    row: int, stack: Any, plan: Plan, scale: Any, work: Work, means: Any, modulations: Any,
    residuals: Any, reason: Any,
) -> None:  # fmt: skip
    """Put the phasors and the support of one image row into the ring, with the fit beside."""
    layout, gap = plan.layout, plan.smoothing.weights.size // 2
    slot, width, sets = row % work.ring.shape[0], reason.size, layout.sets
    line, excess_line = work.ring[slot], work.excess_ring[slot]
    if work.damaged_rows[slot]:
        _fill(excess_line, np.float32(0.0))
    work.damaged_rows[slot] = 0
    for axis in range(2):
        for j in range(sets):
            first = layout.phase_first[axis] + j * layout.steps
            mean = means[axis] if j == 0 else work.fit[0]
            modulation = modulations[axis] if j == 0 else work.fit[1]
            count = _fit_set(stack, first, row, plan, scale, work, mean, modulation, reason)
            if count:
                _add_largest(work.fit[4], plane(excess_line, axis, width, gap))
                work.damaged_rows[slot] += count
            _add_variance(j == 0, work.fit[2], residuals[axis])
            _copy(work.sums[REAL], plane(line, 2 * (axis * sets + j), width, gap))
            _copy(work.sums[IMAG], plane(line, 2 * (axis * sets + j) + 1, width, gap))
        _root_of_mean(sets, residuals[axis])
    mark_dark(stack[layout.white, row], stack[layout.black, row], scale, plan.limits, reason)
    _keep_usable(line, reason, width, gap, sets)


@merged
def _keep_usable(line: Any, reason: Any, width: int, gap: int, sets: int) -> None:
    """Write the support and zero the phasors without a phase: the filter must not mix them in."""
    usable = plane(line, 4 * sets, width, gap)
    count = 0
    for col in range(width):
        usable[col] = np.float32(reason[col] == 0)
        count += reason[col] == 0
    if count == width:
        return
    for index in range(4 * sets):
        values = plane(line, index, width, gap)
        for col in range(width):  # not a product: NaN times 0 is NaN
            values[col] = values[col] if reason[col] == 0 else np.float32(0.0)


@compiled
def _find_phases(
    axis: int, row: int, plan: Plan, scale: Any, work: Work, is_grown: bool, maps: Maps
) -> None:
    """Write phase, modulation and phase sigma of every set of one axis."""
    smoothing, steps, sets = plan.smoothing, plan.layout.steps, plan.layout.sets
    gap, width = smoothing.weights.size // 2, work.ones.size
    usable = plane(work.ring[row % work.ring.shape[0]], 4 * sets, width, gap)
    support = plane(work.smooth, 4 * sets, width, gap)
    for j in range(sets):
        real = plane(work.smooth, 2 * (axis * sets + j), width, gap)
        imag = plane(work.smooth, 2 * (axis * sets + j) + 1, width, gap)
        modulation = maps.modulation_dn[axis, row] if j == 0 else work.fit[1]
        blank_unusable(usable, real, imag)
        phase_row(real, imag, work.phases[j])
        smooth_modulation(steps, real, imag, support, usable, modulation)
        phase_sigma(
            steps, smoothing.noise_gain, plan.limits, scale, support, usable,
            maps.mean_dn[axis, row], modulation, work.sigmas[j],
        )  # fmt: skip
        if is_grown:
            grow_sigma(plane(work.excess, axis, width, gap), work.sigmas[j])
    _copy(work.phases[0], maps.phase_rad[axis, row])


@merged
def _read_order(
    axis: int, row: int, stack: Any, plan: Plan, scale: Any, work: Work, maps: Maps
) -> None:
    """Give one axis its fringe numbers by Gray words."""
    code, first, limits = plan.codes[axis], plan.layout.gray_first[axis], plan.limits
    mean, margin, phase = maps.mean_dn[axis, row], work.fit[3], maps.phase_rad[axis, row]
    order, error = maps.order[axis, row], maps.order_error[axis, row]
    word, near = work.word, work.near
    find_noise(mean, scale, limits, margin)
    # The threshold A carries the noise of N averaged frames.
    widening = np.float32(NEAR_SIGMAS * np.sqrt(1.0 + 1.0 / plan.layout.steps))
    for col in range(margin.size):
        margin[col] *= widening
    read_gray_row(stack, first, code.bits, row, mean, margin, word, near)
    number_row(code, word, phase, order, maps.coordinate_px[axis, row], error)
    weigh_near_bits(
        code, stack, first, row, limits.gray_sigmas, mean, margin, word, near, phase, order, error
    )
    if code.kind == PLAIN:
        weigh_wrap(code, phase, work.sigmas[0], error)
    sigma, per_rad = maps.sigma_px[axis, row], np.float32(code.period_px / (2.0 * np.pi))
    for col in range(sigma.size):
        sigma[col] = per_rad * work.sigmas[0, col]


@merged
def _finish_row(row: int, stack: Any, plan: Plan, scale: Any, work: Work, maps: Maps) -> None:
    """Filter, number the fringes and write the result of one row of the band."""
    smoothing, gap, width = plan.smoothing, plan.smoothing.weights.size // 2, work.ones.size
    reason, sets = maps.reason[row], plan.layout.sets
    is_grown = work.damaged_rows.sum() > 0
    smooth_row(work.ring, row, smoothing.weights, work.lane, work.smooth)
    if is_grown:
        weights = smoothing.square_weights
        smooth_row(work.excess_ring, row, weights, work.excess_lane, work.excess)
    mark_support(plane(work.smooth, 4 * sets, width, gap), smoothing.min_support, reason)
    usable = plane(work.ring[row % work.ring.shape[0]], 4 * sets, width, gap)
    for axis in range(2):
        coordinate, error = maps.coordinate_px[axis, row], maps.order_error[axis, row]
        _find_phases(axis, row, plan, scale, work, is_grown, maps)
        if plan.is_chain:
            climb_row(
                plan.ladders[axis], work.phases, work.sigmas, usable, maps.order[axis, row],
                coordinate, maps.sigma_px[axis, row], error,
            )  # fmt: skip
        else:
            _read_order(axis, row, stack, plan, scale, work, maps)
        length = plan.codes[axis].length_px
        settle_row(length, plan.limits.max_order_error, coordinate, error, usable, reason)
    for axis in range(2):  # only now are the reasons of both axes known
        order, sigma = maps.order[axis, row], maps.sigma_px[axis, row]
        blank_row(reason, order, maps.coordinate_px[axis, row], sigma)


@compiled
def decode_rows(first_row: int, end_row: int, stack: Any, plan: Plan, maps: Maps) -> None:
    """Fill `maps` for rows first_row to end_row - 1."""
    rows, width = maps.reason.shape
    taps = plan.smoothing.weights.size
    half = taps // 2
    work = make_work(width, taps, plan.layout.sets)
    for source in range(first_row - half, end_row + half):
        if 0 <= source < rows:
            scale = plan.scale[source] if plan.scale.size else work.ones
            if first_row <= source < end_row:
                means = (maps.mean_dn[0, source], maps.mean_dn[1, source])
                modulations = (maps.modulation_dn[0, source], maps.modulation_dn[1, source])
                residuals = (maps.residual_dn[0, source], maps.residual_dn[1, source])
                reason = maps.reason[source]
            else:
                means, modulations = (work.spare[0], work.spare[1]), (work.spare[2], work.spare[3])
                residuals, reason = (work.spare[4], work.spare[5]), work.spare_reason
                _fill(reason, np.uint8(0))
            _sum_row(source, stack, plan, scale, work, means, modulations, residuals, reason)
        else:
            _fill(work.ring[source % taps], np.float32(0.0))
            _fill(work.excess_ring[source % taps], np.float32(0.0))
            work.damaged_rows[source % taps] = 0
        row = source - half
        if row >= first_row:
            scale = plan.scale[row] if plan.scale.size else work.ones
            _finish_row(row, stack, plan, scale, work, maps)
