"""A band of image rows from camera frames to projector coordinates, pixel by pixel.

Nothing but the result is ever as large as the image.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any

import numpy as np

from reconstruction._jit import compiled, merged
from reconstruction.decoding._band import COORDINATE, SIGMA, Maps, Plan, Work, make_work
from reconstruction.decoding._chain import climb_row
from reconstruction.decoding._half import pack_row
from reconstruction.decoding._order import (
    NEAR_SIGMAS,
    PLAIN,
    number_row,
    read_gray_row,
    settle_row,
    weigh_near_bits,
    weigh_wrap,
    write_valid,
)
from reconstruction.decoding._phase import (
    grow_sigma,
    keep_usable,
    phase_row,
    phase_sigma,
    write_turns,
)
from reconstruction.decoding._refit import refit_row
from reconstruction.decoding._sum import (
    Sums,
    add_frames,
    find_damaged,
    find_noise,
    finish_sums,
    mark_dark,
    mark_low_modulation,
)


@compiled
def _fit_set(
    stack: Any, first: int, row: int, plan: Plan, scale: Any, work: Work, sums: Sums,
    mean: Any, modulation: Any, variance: Any, reason: Any,
) -> Any:  # fmt: skip
    """Fit one fringe set over one row; return how many pixels have damaged frames."""
    layout, limits = plan.layout, plan.limits
    noise, excess = work.fit[2], work.fit[3]
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
def _fit_row(
    row: int, stack: Any, plan: Plan, scale: Any, work: Work, maps: Maps, reason: Any
) -> None:  # fmt: skip
    """Fit all fringe sets of one image row and tell which pixels have a phase."""
    layout, sets, total = plan.layout, plan.layout.sets, work.sums
    sums = Sums(total[0], total[1], total[2], total[3], total[4], total[5])
    for axis in range(2):
        _fill(work.excess[axis], np.float32(0.0))
        for j in range(sets):
            mean = work.mean[axis] if j == 0 else work.fit[0]
            variance = work.fit[4] if j == 0 else work.fit[1]
            first = layout.phase_first[axis] + j * layout.steps
            count = _fit_set(
                stack, first, row, plan, scale, work, sums, mean, work.modulations[axis, j],
                variance, reason,
            )  # fmt: skip
            if count:
                _add_largest(work.fit[3], work.excess[axis])
            if j > 0:
                _add(variance, work.fit[4])
            phase_row(sums.real, sums.imag, work.phases[axis, j])
        # Never in place: loops whose input and output overlap do not become vector code.
        _root_of_mean(sets, work.fit[4], work.fit[5])
        pack_row(work.fit[5], plan.units.level, work.lines[2], maps.residual[axis, row])
    mark_dark(stack[layout.white, row], stack[layout.black, row], scale, plan.limits, reason)
    _mark_usable(reason, work.usable)


@compiled
def _mark_usable(reason: Any, usable: Any) -> None:
    for col in range(reason.size):
        usable[col] = np.float32(reason[col] == 0)


@merged
def _find_sigmas(axis: int, plan: Plan, scale: Any, work: Work) -> None:
    """Blank phases where there are none, and write the phase sigma of every set of one axis."""
    for j in range(plan.layout.sets):
        keep_usable(work.usable, work.phases[axis, j])
        phase_sigma(
            plan.layout.steps, plan.limits, scale, work.usable, work.mean[axis],
            work.modulations[axis, j], work.sigmas[j],
        )  # fmt: skip
        grow_sigma(work.excess[axis], work.sigmas[j])


@merged
def _read_order(
    axis: int, row: int, stack: Any, plan: Plan, scale: Any, work: Work, coordinate: Any,
    sigma: Any, error: Any,
) -> None:  # fmt: skip
    """Give one axis its fringe numbers by Gray words."""
    code, first, limits = plan.codes[axis], plan.layout.gray_first[axis], plan.limits
    mean, margin = work.mean[axis], work.fit[2]
    phase, order, word, nearest = work.phases[axis, 0], work.order, work.word, work.nearest
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
    spare, units = work.lines[2], plan.units
    write_turns(work.phases[axis, 0], maps.turns[axis, row])
    pack_row(work.mean[axis], units.level, spare, maps.mean[axis, row])
    pack_row(work.modulations[axis, 0], units.level, spare, maps.modulation[axis, row])
    pack_row(error, units.chance, spare, maps.order_error[axis, row])


@merged
def _finish_row(row: int, stack: Any, plan: Plan, scale: Any, work: Work, maps: Maps) -> None:
    """Give one row of the band its fringe numbers, and write the result."""
    reason, error, usable = maps.reason[row], work.lines[0], work.usable
    for axis in range(2):
        coordinate, sigma = work.answers[COORDINATE[axis]], work.answers[SIGMA[axis]]
        _find_sigmas(axis, plan, scale, work)
        if plan.is_chain:
            ladder = plan.ladders[axis]
            climb_row(ladder, work.phases[axis], work.sigmas, usable, coordinate, sigma, error)
        else:
            _read_order(axis, row, stack, plan, scale, work, coordinate, sigma, error)
        length = plan.codes[axis].length_px
        settle_row(length, plan.limits.max_order_error, coordinate, error, usable, reason)
        _inform(axis, row, plan, work, error, maps)
    for axis in range(2):  # only now are the reasons of both axes known
        write_valid(work.answers[COORDINATE[axis]], reason, maps.coordinate_px[axis, row])
        write_valid(work.answers[SIGMA[axis]], reason, work.lines[1])
        pack_row(work.lines[1], plan.units.sigma, work.lines[2], maps.sigma[axis, row])


@compiled
def decode_rows(first_row: int, end_row: int, stack: Any, plan: Plan, maps: Maps) -> None:
    """Fill `maps` for rows first_row to end_row - 1."""
    work = make_work(maps.reason.shape[1], plan.layout.sets)
    for row in range(first_row, end_row):
        scale = plan.scale[row] if plan.scale.size else work.ones
        _fit_row(row, stack, plan, scale, work, maps, maps.reason[row])
        _finish_row(row, stack, plan, scale, work, maps)
