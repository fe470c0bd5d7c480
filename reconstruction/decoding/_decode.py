"""Decode a band of image rows from camera frames to projector coordinates, pixel by pixel.

Buffers are for one row, so that only the result is as large as the image.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction.arrays import FloatImage
from reconstruction.compiling import compiled, inlined, merged, nested
from reconstruction.decoding._chain import Unwrapping, unwrap_row
from reconstruction.decoding._order import (
    NEAR_SIGMAS,
    PLAIN,
    Code,
    FringeRow,
    Numbered,
    Word,
    number_row,
    place_words,
    read_word_row,
    reflect_row,
    settle_borders,
    settle_row,
    weigh_near_bits,
    weigh_wrap,
    write_valid,
)
from reconstruction.decoding._phase import (
    doubt_row,
    grow_sigma,
    keep_usable,
    phase_row,
    phase_sigma,
    refit_row,
    shot_sigma,
    straighten_row,
    write_turns,
)
from reconstruction.decoding._rows import add, copy_row, fill, move_row, pack_row
from reconstruction.decoding._sum import (
    Fit,
    Layout,
    Limits,
    RowFrames,
    Shifts,
    Sums,
    add_frames,
    find_damaged,
    find_noise,
    finish_sums,
    level_row,
    mark_dark,
    mark_faint,
    mark_low_modulation,
    shifts_of,
)

# Lines of `Work.answers` for the axes column and row.
COORDINATE, SIGMA = (0, 1), (2, 3)
NO_THRESHOLD = np.float32(-np.inf)


class Units(NamedTuple):
    """Factors with which `pack_row` packs each kind of map: BIAS over the unit of the kind."""

    level: np.float32
    sigma: np.float32
    chance: np.float32


class Plan(NamedTuple):
    """Parameters of decoding that are equal for all image rows; pairs are (column, row)."""

    layout: Layout
    limits: Limits
    codes: tuple[Code, Code]
    units: Units
    unwrappings: tuple[Unwrapping, Unwrapping]
    is_chain: bool
    threshold_noise: float  # sigma of a bit minus its threshold, in sigmas of one frame
    scale: FloatImage  # (row, col), flat-field factor of each pixel; shape (0, 0): 1 everywhere
    has_ripple: bool
    ripple_rad: FloatImage  # (axis, set, node) phase error by the phase, see `ripple`
    ripple_sigma_rad: FloatImage
    shot_share: FloatImage  # (axis, set, node), see `ripple`; shape (2, 0, 0): no correction
    threshold_share: tuple[float, float]  # threshold of Gray bits above the mean, in modulations


class Maps(NamedTuple):
    """Resulting maps, (axis, row, col) unless stated, packed as in `compact`.

    The caller allocates them with zeros.
    """

    coordinate_px: Any  # float32
    turns: Any  # phases; uint16 as all following maps unless stated
    mean: Any
    modulation: Any
    sigma: Any
    residual: Any
    order_error: Any
    reason: Any  # (row, col) uint8


class Work(NamedTuple):
    """Buffers for the row that is being decoded; compiled code allocates no arrays."""

    sums: Any  # (6, col): total, real, imag, square, high, low
    fit: Any  # (line, col): mean, variance, noise, excess of one set; total variance, residual
    mean: Any  # (axis, col), mean of the measuring period, DN
    excess: Any  # (axis, col), largest `Fit.excess` of all sets
    modulations: Any  # (axis, set, col), DN
    phases: Any  # (axis, set, col), rad
    sigmas: Any  # (set, col), phase sigma by noise, rad
    doubts: Any  # (set, col), the sigma including the uncertainty of the projector's response
    answers: Any  # (line, col): coordinates of both axes, then their sigmas
    lines: Any  # (line, col): probability of a wrong order, and two scratch lines for packing
    order: Any
    damaged: Any
    ones: Any
    usable: Any
    word: Any
    reflected: Any
    nearest: Any


def make_work(width: int, sets: int) -> Work:
    return Work(
        np.zeros((6, width), np.float32),
        np.zeros((6, width), np.float32),
        np.zeros((2, width), np.float32),
        np.zeros((2, width), np.float32),
        np.zeros((2, sets, width), np.float32),
        np.zeros((2, sets, width), np.float32),
        np.zeros((sets, width), np.float32),
        np.zeros((sets, width), np.float32),
        np.zeros((4, width), np.float32),
        np.zeros((3, width), np.float32),
        np.zeros(width, np.int32),
        np.zeros(width, np.bool_),
        np.ones(width, np.float32),
        np.zeros(width, np.float32),
        np.zeros(width, np.uint32),
        np.zeros(width, np.uint32),
        np.zeros(width, np.float32),
    )


@nested
def _fit_set(
    frames: RowFrames, shifts: Shifts, plan: Plan, scale: Any, share: Any, work: Work, sums: Sums,
    fit: Fit, reason: Any,
) -> Any:  # fmt: skip
    """Fit one fringe set over one row; return the number of pixels with damaged frames.

    share : see `threshold_above_mean`
    """
    steps, limits = plan.layout.steps, plan.limits
    noise = work.fit[2]
    add_frames(frames, steps, shifts, sums)
    finish_sums(steps, sums, fit)
    count = find_damaged(sums, scale, limits, work.damaged)
    if count:
        fill(fit.excess, np.float32(0.0))
        refit_row(frames, shifts, limits, scale, share, work.damaged, sums, fit, reason)
    find_noise(fit.mean, scale, limits, noise)
    if count:
        grow_sigma(fit.excess, noise)
    mark_low_modulation(plan.layout.equal_steps, limits, fit.modulation, noise, reason)
    return count


@nested
def _add_largest(value: Any, largest: Any) -> None:
    for col in range(value.size):
        largest[col] = max(largest[col], value[col])


@nested
def _root_of_mean(sets: int, variance: Any, out: Any) -> None:
    share = np.float32(1.0 / sets)
    for col in range(variance.size):
        out[col] = np.sqrt(variance[col] * share)


@inlined
def threshold_above_mean(axis: int, plan: Plan) -> Any:
    """Return the threshold of the Gray bits minus the mean of the fringe, in modulations.

    -inf without Gray bits, and if each bit is compared with its inverse frame.
    """
    layout = plan.layout
    has_threshold = layout.gray_bits[axis] > 0 and layout.inverse_first[axis] < 0
    return np.float32(plan.threshold_share[axis]) if has_threshold else NO_THRESHOLD


@merged
def fit_row(
    row: int, stack: Any, plan: Plan, scale: Any, work: Work, maps: Maps, reason: Any
) -> None:  # fmt: skip
    """Fit all fringe sets of one image row, and set `work.usable` to 1 for pixels with a phase."""
    layout, sets, total = plan.layout, plan.layout.sets, work.sums
    sums = Sums(total[0], total[1], total[2], total[3], total[4], total[5])
    for axis in range(layout.first_axis, layout.end_axis):
        fill(work.excess[axis], np.float32(0.0))
        for j in range(sets):
            mean = work.mean[axis] if j == 0 else work.fit[0]
            variance = work.fit[4] if j == 0 else work.fit[1]
            first = layout.phase_first[axis] + j * layout.steps
            fit = Fit(mean, work.modulations[axis, j], variance, work.fit[3])
            frames = RowFrames(stack, first, row)
            shifts = shifts_of(layout, axis, j)
            share = threshold_above_mean(axis, plan) if j == 0 else NO_THRESHOLD
            if _fit_set(frames, shifts, plan, scale, share, work, sums, fit, reason):
                _add_largest(work.fit[3], work.excess[axis])
            if j > 0:
                add(variance, work.fit[4])
            phase_row(sums.real, sums.imag, work.phases[axis, j])
        # Never in place: loops whose input and output overlap do not become vector code.
        _root_of_mean(sets, work.fit[4], work.fit[5])
        pack_row(work.fit[5], plan.units.level, work.lines[2], maps.residual[axis, row])
    _mask_row(row, stack, plan, scale, work, reason)


@merged
def _level_words(row: int, stack: Any, plan: Plan, scale: Any, work: Work, reason: Any) -> None:
    """Write mean level and contrast of one row for a Gray code without fringes.

    `work.usable` becomes 1 for pixels that are lit, 0 for all others.
    """
    layout = plan.layout
    for axis in range(layout.first_axis, layout.end_axis):
        bright, dim = work.lines[1], work.lines[2]
        mean, modulation = work.mean[axis], work.modulations[axis, 0]
        if layout.white >= 0:
            level_row(RowFrames(stack, layout.white, row), layout.black, 1, True, mean, modulation)
        else:
            first, count = layout.inverse_first[axis], layout.gray_bits[axis]
            frames = RowFrames(stack, layout.gray_first[axis], row)
            level_row(frames, first, count, False, mean, modulation)
        for col in range(mean.size):
            bright[col], dim[col] = mean[col] + modulation[col], mean[col] - modulation[col]
        mark_dark(bright, dim, scale, plan.limits, reason)
        mark_faint(modulation, plan.limits, reason)
    _mark_usable(reason, work.usable)


@merged
def _mask_row(row: int, stack: Any, plan: Plan, scale: Any, work: Work, reason: Any) -> None:
    layout = plan.layout
    if layout.white >= 0:
        mark_dark(stack[layout.white, row], stack[layout.black, row], scale, plan.limits, reason)
    _mark_usable(reason, work.usable)


@nested
def _mark_usable(reason: Any, usable: Any) -> None:
    for col in range(reason.size):
        usable[col] = np.float32(reason[col] == 0)


@merged
def find_sigmas(axis: int, plan: Plan, scale: Any, work: Work) -> None:
    """Write the phase sigma of every set of one axis, and set the phases of unusable pixels to 0.

    A ripple of the projector's response, if known, is subtracted from the phases.
    """
    for j in range(plan.layout.sets):
        keep_usable(work.usable, work.phases[axis, j])
        phase_sigma(
            plan.layout.equal_steps, plan.limits, scale, work.usable, work.mean[axis],
            work.modulations[axis, j], work.sigmas[j],
        )  # fmt: skip
        if plan.shot_share.size:
            shot_sigma(
                plan.shot_share[axis, j], plan.limits, scale, work.phases[axis, j],
                work.mean[axis], work.modulations[axis, j], work.sigmas[j],
            )  # fmt: skip
        grow_sigma(work.excess[axis], work.sigmas[j])
        if plan.has_ripple:
            # The table is over the measured phase; its sigma varies little within one ripple.
            straighten_row(plan.ripple_rad[axis, j], work.phases[axis, j], work.sigmas[j])
            keep_usable(work.usable, work.phases[axis, j])
            table = plan.ripple_sigma_rad[axis, j]
            doubt_row(table, work.phases[axis, j], work.sigmas[j], work.doubts[j])
        else:
            copy_row(work.sigmas[j], work.doubts[j])


@merged
def _read_order(
    axis: int, row: int, stack: Any, plan: Plan, scale: Any, work: Work, answer: Numbered
) -> None:
    """Read the Gray words of one axis, and write coordinate, sigma and error probability.

    The fringe numbers are written to `work.order`.
    """
    code, limits, margin = plan.codes[axis], plan.limits, work.fit[2]
    frames = RowFrames(stack, plan.layout.gray_first[axis], row)
    threshold = work.mean[axis]
    if plan.has_ripple:
        share, threshold = np.float32(plan.threshold_share[axis]), work.lines[1]
        move_row(work.mean[axis], share, work.modulations[axis, 0], threshold)
    read = Word(work.word, work.nearest, threshold, margin)
    phase, order = work.phases[axis, 0], work.order
    find_noise(read.mean, scale, limits, margin)
    widening = np.float32(NEAR_SIGMAS * plan.threshold_noise)
    for col in range(margin.size):
        margin[col] *= widening
    read_word_row(frames, code, read)
    if code.gray_of.size == 0:
        number_row(code, read.gray, phase, order, answer)
    else:
        reflect_row(code, read.gray, work.reflected)
        number_row(code, work.reflected, phase, order, answer)
    if code.kind == PLAIN and code.gray_of.size == 0 and not code.is_word:
        fringe = FringeRow(phase, work.doubts[0], work.modulations[axis, 0])
        settle_borders(code, frames, read, fringe, order, answer)
    elif code.kind == PLAIN and not code.is_word:
        weigh_wrap(code, phase, work.doubts[0], answer.error)
    weigh_near_bits(code, frames, limits.gray_sigmas, read, phase, order, answer.error)
    per_rad = np.float32(code.period_px / (2.0 * np.pi))
    for col in range(margin.size):
        answer.sigma[col] = per_rad * work.sigmas[0, col]
    if code.is_word:
        place_words(code, answer)


@inlined
def answer_of(axis: int, work: Work) -> Numbered:
    """Return the buffers for coordinate, sigma and error probability of one axis."""
    return Numbered(work.answers[COORDINATE[axis]], work.answers[SIGMA[axis]], work.lines[0])


@merged
def settle_axis(axis: int, row: int, plan: Plan, work: Work, maps: Maps) -> None:
    """Write the reasons of pixels masked along one axis, and the maps that depend on it only."""
    spare, units, error = work.lines[2], plan.units, work.lines[0]
    length, most = plan.codes[axis].length_px, plan.limits.max_order_error
    settle_row(length, most, answer_of(axis, work), work.usable, maps.reason[row])
    write_turns(work.phases[axis, 0], maps.turns[axis, row])
    pack_row(work.mean[axis], units.level, spare, maps.mean[axis, row])
    pack_row(work.modulations[axis, 0], units.level, spare, maps.modulation[axis, row])
    pack_row(error, units.chance, spare, maps.order_error[axis, row])


@merged
def _finish_row(row: int, stack: Any, plan: Plan, scale: Any, work: Work, maps: Maps) -> None:
    """Determine the fringe numbers of one image row along both axes, and write the maps."""
    for axis in range(plan.layout.first_axis, plan.layout.end_axis):
        answer = answer_of(axis, work)
        if plan.layout.steps:
            find_sigmas(axis, plan, scale, work)
        if plan.is_chain:
            unwrap_row(
                plan.unwrappings[axis], work.phases[axis], work.sigmas, work.doubts, work.usable,
                answer,
            )  # fmt: skip
        else:
            _read_order(axis, row, stack, plan, scale, work, answer)
        settle_axis(axis, row, plan, work, maps)
    write_valid_axes(row, plan, work, maps)


@merged
def write_valid_axes(row: int, plan: Plan, work: Work, maps: Maps) -> None:
    """Write coordinates and sigmas of one row; they are 0 for pixels masked along either axis."""
    reason = maps.reason[row]
    for axis in range(plan.layout.first_axis, plan.layout.end_axis):
        write_valid(work.answers[COORDINATE[axis]], reason, maps.coordinate_px[axis, row])
        write_valid(work.answers[SIGMA[axis]], reason, work.lines[1])
        pack_row(work.lines[1], plan.units.sigma, work.lines[2], maps.sigma[axis, row])


def decode_rows(first_row: int, end_row: int, stack: Any, plan: Plan, maps: Maps) -> None:
    """Decode image rows first_row to end_row - 1, and write them to `maps`."""
    work = make_work(maps.reason.shape[1], plan.layout.sets)
    decode_band(first_row, end_row, stack, plan, work, maps)


@compiled
def decode_band(
    first_row: int, end_row: int, stack: Any, plan: Plan, work: Work, maps: Maps
) -> None:
    for row in range(first_row, end_row):
        scale = plan.scale[row] if plan.scale.size else work.ones
        if plan.layout.steps:
            fit_row(row, stack, plan, scale, work, maps, maps.reason[row])
        else:
            _level_words(row, stack, plan, scale, work, maps.reason[row])
        _finish_row(row, stack, plan, scale, work, maps)
