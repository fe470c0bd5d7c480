"""Determine fringe orders by a function in numpy that takes whole images.

The compiled kernels compute phases, their noise and the masks. The function numbers the fringes of
one axis. The kernels then mask and store the result, as they do for compiled codes.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from reconstruction.arrays import BoolImage, FloatArray, FloatImage, IntArray, Stack
from reconstruction.codes import AxisFringes, Ordered, Unwrap, Wrapped
from reconstruction.compiling import run_over_rows
from reconstruction.decoding import Expect, IslandImages
from reconstruction.decoding._decode import Maps, Plan
from reconstruction.decoding._wrapped import OrderedMaps, WrappedMaps, place_rows, wrap_rows
from reconstruction.decoding.grey_levels import read_levels
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, Axis, PatternSet


class Numbering(NamedTuple):
    """Functions that number the fringes of one axis.

    unwrap : see `codes.Unwrap`; None: the function of the pattern code
    expect : see `codes.Expect`; None: no coordinate is known otherwise
    """

    unwrap: Unwrap | None
    expect: Expect | None


def unwrap_maps(
    stack: Stack,
    patterns: PatternSet,
    plan: Plan,
    maps: Maps,
    numbering: Numbering,
) -> IslandImages | None:
    """Write `maps` from coordinates that numpy functions return.

    numbering : functions that number the fringes

    Returns
    -------
    (axis, row, col) numbers of the islands; None if the function returns none

    Raises
    ------
    InputError : the patterns have no fringes, or the function returns a wrong shape
    """
    if not patterns.steps:
        raise InputError(
            "unwrap is given with patterns steps 0: there are no phases; show phase frames"
        )
    rows, cols = maps.reason.shape
    fitted = _blank(plan.layout.sets, rows, cols)
    run_over_rows(wrap_rows, rows, stack, plan, maps, fitted)
    ordered = OrderedMaps(*(np.zeros((2, rows, cols), np.float32) for _ in range(2)))
    islands = np.zeros((2, rows, cols), np.uint16)
    known: dict[Axis, FloatArray] = {}
    for axis in patterns.axes:
        k = AXES.index(axis)
        wrapped = _wrapped(stack, patterns, plan, fitted, axis)
        if numbering.expect is not None:
            wrapped = replace(wrapped, expected=numbering.expect(axis, known))
        result = _ordered(wrapped, patterns, numbering.unwrap)
        known[axis] = result.coordinate_px
        is_known = np.isfinite(result.coordinate_px)
        ordered.coordinate[k] = np.where(is_known, result.coordinate_px, 0.0)
        ordered.error[k] = np.where(is_known, result.error, 1.0)
        islands[k] = result.islands
    run_over_rows(place_rows, rows, plan, fitted, ordered, maps)
    return islands if islands.any() else None


def _blank(sets: int, rows: int, cols: int) -> WrappedMaps:
    zeros = partial(np.zeros, dtype=np.float32)
    mean, modulation, noise = (zeros((2, rows, cols)) for _ in range(3))
    phases, sigmas = (zeros((2, sets, rows, cols)) for _ in range(2))
    return WrappedMaps(phases, sigmas, mean, modulation, noise, zeros((rows, cols)))


def _ordered(wrapped: Wrapped, patterns: PatternSet, unwrap: Unwrap | None) -> Ordered:
    """Return the result of the function; the probability of a caller's coordinates is 0.

    Raises
    ------
    InputError : the coordinates have a wrong shape
    """
    result = (unwrap or patterns.kind.unwrap)(wrapped)
    if isinstance(result, Ordered):
        return result
    coordinate_px = np.asarray(result, np.float64)
    if coordinate_px.shape != wrapped.usable.shape:
        raise InputError(
            f"unwrap returned coordinates of shape {coordinate_px.shape}; "
            f"allowed {wrapped.usable.shape}, one for each pixel"
        )
    error = np.zeros(coordinate_px.shape)
    if unwrap is None:
        error = np.clip(patterns.kind.order_error(wrapped, coordinate_px), 0.0, 1.0)
    return Ordered(coordinate_px, error, np.zeros(coordinate_px.shape, np.uint16))


def _wrapped(
    stack: Stack, patterns: PatternSet, plan: Plan, fitted: WrappedMaps, axis: Axis
) -> Wrapped:
    k = AXES.index(axis)
    words, nearest_sigmas = _read_words(stack, patterns, plan, fitted, axis)
    levels, level_sigmas = read_levels(stack, patterns, plan, fitted, axis)
    return Wrapped(
        fringes=AxisFringes(patterns.length_px(axis), patterns.periods_along(axis)),
        phase_rad=fitted.phases[k],
        sigma_rad=fitted.sigmas[k],
        usable=fitted.usable > 0.0,
        words=words,
        nearest_sigmas=nearest_sigmas,
        levels=levels,
        level_sigmas=level_sigmas,
    )


def _read_words(
    stack: Stack, patterns: PatternSet, plan: Plan, fitted: WrappedMaps, axis: Axis
) -> tuple[tuple[IntArray, ...], FloatImage]:
    """Return the values of each word, (row, col), and a measure of their certainty, (row, col).

    The measure is the distance from its threshold, in sigmas, of the bit nearest to its threshold.
    """
    k = AXES.index(axis)
    threshold_dn = fitted.mean[k] + np.float32(plan.threshold_share[k]) * fitted.modulation[k]
    noise_dn = np.maximum(plan.threshold_noise * fitted.noise[k], 1e-12)
    bits = np.zeros((patterns.word_bits(axis), *fitted.usable.shape), np.bool_)
    nearest_dn = np.full(fitted.usable.shape, np.inf, np.float32)
    gray, inverse = (stack[patterns.index(kind, axis)] for kind in ("gray", "inverse"))
    for number in range(len(bits)):
        frame = gray[number].astype(np.float32)
        over_dn = 0.5 * (frame - inverse[number]) if len(inverse) else frame - threshold_dn
        bits[number] = over_dn > 0.0
        np.minimum(nearest_dn, np.abs(over_dn), out=nearest_dn)
    return _values(bits, patterns, axis), (nearest_dn / noise_dn).astype(np.float32)


def _values(bits: BoolImage, patterns: PatternSet, axis: Axis) -> tuple[IntArray, ...]:
    values, first = [], 0
    for word in patterns.words(axis):
        read = patterns.binary(bits[first : first + word.bits])
        weights = 2 ** np.arange(word.bits, dtype=np.int64)[::-1]
        values.append(np.tensordot(weights, read.astype(np.int64), axes=1))
        first += word.bits
    return tuple(values)
