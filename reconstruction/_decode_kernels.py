"""A band of image rows from camera frames to projector coordinates, in one pass over the stack.

The phasors of the last rows, as many as the filter is high, lie in a ring: nothing but the result
is ever as large as the image. Rows above and below the band are summed for the filter only.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any

import numpy as np

from reconstruction._band import (
    COORDINATE,
    MEAN,
    MODULATION,
    SIGMA,
    Maps,
    Plan,
    Work,
    make_work,
    plane,
)
from reconstruction._chain_kernels import climb_row
from reconstruction._filter_kernels import smooth_row
from reconstruction._half_kernels import pack_row
from reconstruction._jit import compiled, merged
from reconstruction._order_kernels import (
    NEAR_SIGMAS,
    PLAIN,
    number_row,
    read_gray_row,
    settle_row,
    weigh_near_bits,
    weigh_wrap,
    write_valid,
)
from reconstruction._phase_kernels import (
    blank_unusable,
    grow_sigma,
    mark_support,
    phase_row,
    phase_sigma,
    smooth_modulation,
    write_turns,
)
from reconstruction._refit_kernels import refit_row
from reconstruction._sum_kernels import (
    Sums,
    add_frames,
    find_damaged,
    find_noise,
    finish_sums,
    mark_dark,
    mark_low_modulation,
)

ALL_BITS, NO_BITS = np.uint32(0xFFFFFFFF), np.uint32(0)


@compiled
def _fit_set(
    stack: Any, first: int, row: int, plan: Plan, scale: Any, work: Work, sums: Sums,
    mean: Any, modulation: Any, variance: Any, reason: Any,
) -> Any:  # fmt: skip
    """Fit one fringe set over one row; return how many pixels have damaged frames."""
    layout, limits = plan.layout, plan.limits
    noise, excess = work.fit[3], work.fit[4]
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
def _add(values: Any, total: Any) -> None:
    for col in range(total.size):
        total[col] += values[col]


@compiled
def _add_largest(value: Any, largest: Any) -> None:
    for col in range(value.size):
        largest[col] = max(largest[col], value[col])


@compiled
def _root_of_mean(sets: int, variance: Any, out: Any) -> None:
    share = np.float32(1.0 / sets)
    for col in range(variance.size):
        out[col] = np.sqrt(variance[col] * share)


@merged
def _sum_row(
    row: int, is_inside: bool, stack: Any, plan: Plan, scale: Any, work: Work, maps: Maps,
    reason: Any,
) -> None:  # fmt: skip
    """Put the phasors, the support and the fit of one image row into the rings."""
    layout, gap = plan.layout, plan.smoothing.weights.size // 2
    slot, width, sets = row % work.ring.shape[0], reason.size, layout.sets
    line, excess_line = work.ring[slot], work.excess_ring[slot]
    fits = work.fits[row % work.fits.shape[0]]
    if work.damaged_rows[slot]:
        _fill(excess_line, np.float32(0.0))
    work.damaged_rows[slot] = 0
    for axis in range(2):
        for j in range(sets):
            index = 2 * (axis * sets + j)
            real, imag = plane(line, index, width, gap), plane(line, index + 1, width, gap)
            sums = Sums(work.sums[0], real, imag, work.sums[1], work.sums[2], work.sums[3])
            mean = fits[MEAN[axis]] if j == 0 else work.fit[0]
            modulation = fits[MODULATION[axis]] if j == 0 else work.fit[1]
            variance = work.fit[5] if j == 0 else work.fit[2]
            first = layout.phase_first[axis] + j * layout.steps
            count = _fit_set(
                stack, first, row, plan, scale, work, sums, mean, modulation, variance, reason
            )
            if count:
                _add_largest(work.fit[4], plane(excess_line, axis, width, gap))
                work.damaged_rows[slot] += count
            if j > 0:
                _add(variance, work.fit[5])
        if is_inside:
            # Never in place: loops whose input and output overlap do not become vector code.
            _root_of_mean(sets, work.fit[5], work.fit[6])
            pack_row(work.fit[6], plan.units.level, work.lines[2], maps.residual[axis, row])
    mark_dark(stack[layout.white, row], stack[layout.black, row], scale, plan.limits, reason)
    _keep_usable(line, reason, width, gap, sets, work.word)


@merged
def _keep_usable(line: Any, reason: Any, width: int, gap: int, sets: int, kept: Any) -> None:
    """Write the support and zero the phasors without a phase: the filter must not mix them in."""
    usable = plane(line, 4 * sets, width, gap)
    count = 0
    for col in range(width):
        usable[col] = np.float32(reason[col] == 0)
        count += reason[col] == 0
    if count == width:
        return
    for col in range(width):
        kept[col] = ALL_BITS if reason[col] == 0 else NO_BITS
    for index in range(4 * sets):
        bits = plane(line, index, width, gap).view(np.uint32)
        for col in range(width):  # not a product: NaN times 0 is NaN
            bits[col] &= kept[col]


@compiled
def _find_phases(axis: int, row: int, plan: Plan, scale: Any, work: Work, is_grown: bool) -> None:
    """Find phase, modulation and phase sigma of every set of one axis."""
    smoothing, steps, sets = plan.smoothing, plan.layout.steps, plan.layout.sets
    gap, width, slot = smoothing.weights.size // 2, work.ones.size, row % work.ring.shape[0]
    usable = plane(work.ring[slot], 4 * sets, width, gap)
    support = plane(work.smooth, 4 * sets, width, gap)
    fits = work.fits[row % work.fits.shape[0]]
    single = fits[MODULATION[axis]]
    for j in range(sets):
        real = plane(work.smooth, 2 * (axis * sets + j), width, gap)
        imag = plane(work.smooth, 2 * (axis * sets + j) + 1, width, gap)
        modulation = work.lines[0] if j == 0 else work.fit[1]
        blank_unusable(usable, real, imag)
        phase_row(real, imag, work.phases[j])
        smooth_modulation(steps, real, imag, support, usable, single, modulation)
        phase_sigma(
            steps, smoothing.noise_gain, plan.limits, scale, support, usable,
            fits[MEAN[axis]], modulation, work.sigmas[j],
        )  # fmt: skip
        if is_grown:
            grow_sigma(plane(work.excess, axis, width, gap), work.sigmas[j])


@merged
def _read_order(
    axis: int, row: int, stack: Any, plan: Plan, scale: Any, work: Work, coordinate: Any,
    sigma: Any, error: Any,
) -> None:  # fmt: skip
    """Give one axis its fringe numbers by Gray words."""
    code, first, limits = plan.codes[axis], plan.layout.gray_first[axis], plan.limits
    mean, margin = work.fits[row % work.fits.shape[0], MEAN[axis]], work.fit[3]
    phase, order, word, nearest = work.phases[0], work.order, work.word, work.nearest
    find_noise(mean, scale, limits, margin)
    # The threshold A carries the noise of N averaged frames.
    widening = np.float32(NEAR_SIGMAS * np.sqrt(1.0 + 1.0 / plan.layout.steps))
    for col in range(margin.size):
        margin[col] *= widening
    read_gray_row(stack, first, code.bits, row, mean, word, nearest)
    number_row(code, word, phase, order, coordinate, error)
    weigh_near_bits(
        code, stack, first, row, limits.gray_sigmas, mean, margin, word, nearest, phase, order,
        error,
    )  # fmt: skip
    if code.kind == PLAIN:
        weigh_wrap(code, phase, work.sigmas[0], error)
    per_rad = np.float32(code.period_px / (2.0 * np.pi))
    for col in range(sigma.size):
        sigma[col] = per_rad * work.sigmas[0, col]


@merged
def _inform(axis: int, row: int, plan: Plan, work: Work, error: Any, maps: Maps) -> None:
    """Write what does not depend on the other axis."""
    fits, spare, units = work.fits[row % work.fits.shape[0]], work.lines[2], plan.units
    write_turns(work.phases[0], maps.turns[axis, row])
    pack_row(fits[MEAN[axis]], units.level, spare, maps.mean[axis, row])
    pack_row(work.lines[0], units.level, spare, maps.modulation[axis, row])
    pack_row(error, units.chance, spare, maps.order_error[axis, row])


@merged
def _finish_row(row: int, stack: Any, plan: Plan, scale: Any, work: Work, maps: Maps) -> None:
    """Filter, number the fringes and write the result of one row of the band."""
    smoothing, gap, width = plan.smoothing, plan.smoothing.weights.size // 2, work.ones.size
    reason, sets, error = maps.reason[row], plan.layout.sets, work.lines[1]
    is_grown = work.damaged_rows.sum() > 0
    smooth_row(work.ring, row, smoothing.weights, work.lane, work.smooth)
    if is_grown:
        weights = smoothing.square_weights
        smooth_row(work.excess_ring, row, weights, work.excess_lane, work.excess)
    mark_support(plane(work.smooth, 4 * sets, width, gap), smoothing.min_support, reason)
    usable = plane(work.ring[row % work.ring.shape[0]], 4 * sets, width, gap)
    for axis in range(2):
        coordinate, sigma = work.answers[COORDINATE[axis]], work.answers[SIGMA[axis]]
        _find_phases(axis, row, plan, scale, work, is_grown)
        if plan.is_chain:
            ladder = plan.ladders[axis]
            climb_row(ladder, work.phases, work.sigmas, usable, coordinate, sigma, error)
        else:
            _read_order(axis, row, stack, plan, scale, work, coordinate, sigma, error)
        length = plan.codes[axis].length_px
        settle_row(length, plan.limits.max_order_error, coordinate, error, usable, reason)
        _inform(axis, row, plan, work, error, maps)
    for axis in range(2):  # only now are the reasons of both axes known
        write_valid(work.answers[COORDINATE[axis]], reason, maps.coordinate_px[axis, row])
        write_valid(work.answers[SIGMA[axis]], reason, work.lines[0])
        pack_row(work.lines[0], plan.units.sigma, work.lines[2], maps.sigma[axis, row])


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
            is_inside = first_row <= source < end_row
            reason = maps.reason[source] if is_inside else work.spare_reason
            if not is_inside:
                _fill(reason, np.uint8(0))
            _sum_row(source, is_inside, stack, plan, scale, work, maps, reason)
        else:
            _fill(work.ring[source % taps], np.float32(0.0))
            _fill(work.excess_ring[source % taps], np.float32(0.0))
            work.damaged_rows[source % taps] = 0
        row = source - half
        if row >= first_row:
            scale = plan.scale[row] if plan.scale.size else work.ones
            _finish_row(row, stack, plan, scale, work, maps)
