"""Estimate the relative modulation of the single images of micro phase shifting.

Relative modulation is the modulation of an image over that of the first period's N steps.
Lens blur reduces the modulation of finer periods more: at a blur of 0.7 px the modulations for 15.5
and 20.7 px differ by 2 %. Neglecting this loss would cause errors of many times the noise. One
relative modulation is estimated for each image: variation of the blur over the field is neglected.
"""

import math
from typing import NamedTuple

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, Reason, Stack
from reconstruction.compact import Half, Turns
from reconstruction.compiling import run_over_rows
from reconstruction.decoding import DecodeOptions
from reconstruction.decoding._decode import Maps
from reconstruction.decoding._micro import MicroPeriods, decode_micro_rows
from reconstruction.decoding.plan import blank_maps, make_plan, units_of
from reconstruction.patterns import AXES, Axis, PatternSet
from reconstruction.rig.sensor import SensorNoise

# Approximate number of pixels from which relative modulations are estimated. If fewer than
# LEAST_PIXELS of them are valid, all relative modulations are 1.
PIXELS, LEAST_PIXELS = 20_000, 200


def micro_periods(
    stack: Stack, patterns: PatternSet, sensor: SensorNoise, scale: FloatImage | None
) -> tuple[MicroPeriods, MicroPeriods]:
    """Return the periods along column and row axis, with the relative modulation of single images.

    The modulation is estimated from a subset of the pixels, which are first decoded without a
    correction for blur.
    """
    even = _even_periods(patterns, AXES[0]), _even_periods(patterns, AXES[1])
    stride = max(1, round(math.sqrt(stack[0].size / PIXELS)))
    some = np.ascontiguousarray(stack[:, ::stride, ::stride])
    some_scale = None if scale is None else np.ascontiguousarray(scale[::stride, ::stride])
    maps = blank_maps(some.shape[1], some.shape[2])
    plan = make_plan(some, patterns, sensor, DecodeOptions(filter_taps=0), some_scale)
    run_over_rows(decode_micro_rows, some.shape[1], some, plan, even, maps)
    limit_dn = sensor.clipped_from_dn if some_scale is None else np.inf
    usable = np.equal(maps.reason, Reason.VALID) & (some.max(axis=0) < limit_dn)
    if np.count_nonzero(usable) < LEAST_PIXELS:
        return even
    unit_dn, frames = units_of(sensor, some_scale)[0], some[:, usable]
    columns, rows = (
        _with_shares(p, frames, _steps_of(maps, k, usable, unit_dn)) for k, p in enumerate(even)
    )
    return columns, rows


class _Steps(NamedTuple):
    """Result of the N steps of the first period for some pixels; every field is (pixel,).

    near_px is a decoded coordinate, exact to the fringe number only; turns is the phase in turns.
    """

    near_px: FloatArray
    turns: FloatArray
    mean_dn: FloatArray
    modulation_dn: FloatArray


def _steps_of(maps: Maps, axis: int, usable: BoolImage, unit_dn: float) -> _Steps:
    turns = Turns(maps.turns[axis]).expand() / (2.0 * np.pi)
    levels = (Half(image[axis], unit_dn).expand() for image in (maps.mean, maps.modulation))
    return _Steps(*(image[usable] for image in (maps.coordinate_px[axis], turns, *levels)))


def _with_shares(periods: MicroPeriods, frames: FloatArray, steps: _Steps) -> MicroPeriods:
    """Return the periods with the relative modulation of each single image.

    It is the regression coefficient of the image on the cosine that the N steps of the first
    period predict for the image.

    frames : (frame, pixel) DN
    """
    if not periods.first_image:
        return periods
    fringe = np.rint(steps.near_px / periods.first_px - steps.turns)
    x_px = periods.first_px * (fringe + steps.turns)
    images = slice(periods.first_image, periods.first_image + periods.further_px.size)
    light = frames[images] - steps.mean_dn
    phase = 2.0 * np.pi * x_px / periods.further_px[:, None] + periods.shifts_rad[:, None]
    model = steps.modulation_dn * np.cos(phase)
    return periods._replace(shares=(light * model).sum(axis=1) / np.square(model).sum(axis=1))


def _even_periods(patterns: PatternSet, axis: Axis) -> MicroPeriods:
    first_px, *further = patterns.periods_along(axis)
    shown = axis if axis in patterns.axes else patterns.axes[0]
    shifts = [patterns.shifts(shown, 1 + number)[0] for number in range(len(further))]
    further_px: FloatArray = np.array(further, float)
    turn = 2.0 * np.pi * first_px / further_px
    return MicroPeriods(
        first_px=float(first_px),
        further_px=further_px,
        shifts_rad=2.0 * np.pi * np.array(shifts, float),
        shares=np.ones(further_px.size),
        turn_cosines=np.cos(turn),
        turn_sines=np.sin(turn),
        first_image=patterns.step_sets(axis)[0].stop if axis in patterns.axes else 0,
        length_px=patterns.length_px(axis),
    )
