"""Compute wrapped phases of a whole image, and maps from coordinates that numpy code determined.

Only pattern codes and user functions in numpy use this module: compiled codes never store whole
images of phases.
"""

# ruff: noqa: PLR0917 - compiled functions cannot take keyword-only arguments

from typing import Any, NamedTuple

import numpy as np

from reconstruction.compiling import compiled
from reconstruction.decoding._decode import (
    Maps,
    Plan,
    Work,
    answer_of,
    find_sigmas,
    fit_row,
    make_work,
    settle_axis,
    write_valid_axes,
)
from reconstruction.decoding._order import TURN
from reconstruction.decoding._rows import copy_row
from reconstruction.decoding._sum import find_noise


class WrappedMaps(NamedTuple):
    """Wrapped phases and levels of a whole image, float32; (axis, row, col) unless stated."""

    phases: Any  # (axis, set, row, col), rad
    sigmas: Any  # (axis, set, row, col), rad
    mean: Any  # DN
    modulation: Any  # modulation of the measuring period, DN
    noise: Any  # sigma of one frame at the mean level, DN
    usable: Any  # (row, col), 1 or 0


class OrderedMaps(NamedTuple):
    """Coordinates along both axes, px, and the probability of a wrong order; (axis, row, col)."""

    coordinate: Any
    error: Any


def wrap_rows(
    first_row: int, end_row: int, stack: Any, plan: Plan, maps: Maps, wrapped: WrappedMaps
) -> None:
    """Fit image rows first_row to end_row - 1, and write `wrapped`, and reasons and residuals."""
    work = make_work(maps.reason.shape[1], plan.layout.sets)
    _wrap_band(first_row, end_row, stack, plan, work, maps, wrapped)


@compiled
def _wrap_band(
    first_row: int, end_row: int, stack: Any, plan: Plan, work: Work, maps: Maps, wrapped: Any
) -> None:
    layout = plan.layout
    for row in range(first_row, end_row):
        scale = plan.scale[row] if plan.scale.size else work.ones
        fit_row(row, stack, plan, scale, work, maps, maps.reason[row])
        copy_row(work.usable, wrapped.usable[row])
        for axis in range(layout.first_axis, layout.end_axis):
            find_sigmas(axis, plan, scale, work)
            for j in range(layout.sets):
                copy_row(work.phases[axis, j], wrapped.phases[axis, j, row])
                copy_row(work.sigmas[j], wrapped.sigmas[axis, j, row])
            copy_row(work.mean[axis], wrapped.mean[axis, row])
            copy_row(work.modulations[axis, 0], wrapped.modulation[axis, row])
            find_noise(work.mean[axis], scale, plan.limits, wrapped.noise[axis, row])


def place_rows(
    first_row: int, end_row: int, plan: Plan, wrapped: WrappedMaps, ordered: OrderedMaps, maps: Maps
) -> None:
    """Write the maps of image rows first_row to end_row - 1 from coordinates in `ordered`.

    Pixels with an uncertain order or outside the projector are masked.
    """
    work = make_work(maps.reason.shape[1], plan.layout.sets)
    _place_band(first_row, end_row, plan, work, wrapped, ordered, maps)


@compiled
def _place_band(
    first_row: int, end_row: int, plan: Plan, work: Work, wrapped: Any, ordered: Any, maps: Maps
) -> None:
    layout = plan.layout
    for row in range(first_row, end_row):
        copy_row(wrapped.usable[row], work.usable)
        for axis in range(layout.first_axis, layout.end_axis):
            answer = answer_of(axis, work)
            copy_row(ordered.coordinate[axis, row], answer.coordinate)
            copy_row(ordered.error[axis, row], answer.error)
            copy_row(wrapped.phases[axis, 0, row], work.phases[axis, 0])
            copy_row(wrapped.mean[axis, row], work.mean[axis])
            copy_row(wrapped.modulation[axis, row], work.modulations[axis, 0])
            per_rad = np.float32(plan.codes[axis].period_px / TURN)
            for col in range(answer.sigma.size):
                answer.sigma[col] = per_rad * wrapped.sigmas[axis, 0, row, col]
            settle_axis(axis, row, plan, work, maps)
        write_valid_axes(row, plan, work, maps)
