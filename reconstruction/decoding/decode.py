"""From a stack of camera frames to projector coordinates, with sigma and reason for every pixel.

Frames: camera pixels (row, col), row 0 at the top; projector coordinates in px, integer = centre of
a projector pixel. Formulas: see `patterns`; N-step least squares after Surrel, Appl. Opt. 36, 271
(1997); codes and edge-safe rules: see `PatternSet`, `_order`, `_chain`.
"""

import math
from typing import Any

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage, Reason, Stack
from reconstruction.compact import TURN_STEPS, Half, Orders, Share, Turns
from reconstruction.compiling import run_over_rows
from reconstruction.decoding import AxisDecode, Decoded, DecodeOptions
from reconstruction.decoding._chain import Unwrapping
from reconstruction.decoding._decode import Maps, Plan, Units, decode_rows
from reconstruction.decoding._filter import Smoothed, Unfiltered, smooth
from reconstruction.decoding._order import (
    BINARY,
    COMPLEMENTARY,
    EXCLUSIVE,
    PLAIN,
    REFLECTED,
    SHIFTED,
    Code,
)
from reconstruction.decoding._rows import BIAS
from reconstruction.decoding._sum import Layout, Limits
from reconstruction.decoding.ripple import NODES, Ripple, ripple_of
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, XOR_PLACES, Axis, Kind, PatternSet
from reconstruction.rig.projected_light import ProjectorResponse
from reconstruction.rig.sensor import SensorNoise

__all__ = ["AxisDecode", "DecodeOptions", "Decoded", "Reason", "decode"]

STACK_TYPES = ("uint8", "uint16", "float32")
BAND_ROWS = 96
# Times an order of up to 12 bits, exact in the 24 bits of single precision.
HIGH_BITS = 12
# Half precision reaches from 1e-9 to 1000 px, and from 2e-12 to 1.
SIGMA_UNIT_PX = 2.0**-6
CHANCE_UNIT = 2.0**-15
KINDS = {"gray": PLAIN, "complementary_gray": COMPLEMENTARY, "shifted_gray": SHIFTED}
SHOWN = {"reflected": REFLECTED, "binary": BINARY, "xor_02": EXCLUSIVE, "xor_04": EXCLUSIVE}


def decode(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    options: DecodeOptions | None = None,
    scale: FloatImage | None = None,
    *,
    response: ProjectorResponse | None = None,
) -> Decoded:
    """Decode a stack of frames.

    Parameters
    ----------
    stack : (frame, row, col) uint8, uint16 or float32, DN, in the order of `patterns.frames`
    sensor : noise model; gives the masks and the predicted sigma
    options : filter and masks; None: the defaults of `DecodeOptions`
    scale : (row, col) float32, by which each pixel's DN above the black level were multiplied, see
        `merge_exposures`; None: 1
    response : of the projector; its harmonics are taken off the phase, what is not known of them is
        part of sigma and of the chance of a wrong order; None: it is linear

    Raises
    ------
    InputError : wrong number of axes, frames or type of the stack, or shape of the scale
    """
    _check_stack(stack, patterns)
    if scale is not None and (scale.shape != stack.shape[1:] or not np.all(scale > 0.0)):
        raise InputError(
            f"scale has shape {scale.shape}; give positive numbers of shape {stack.shape[1:]}"
        )
    frames = np.ascontiguousarray(stack)
    options = options or DecodeOptions()
    ripple = ripple_of(patterns, response)
    plan = make_plan(frames, patterns, sensor, options, scale, ripple=ripple)
    maps = _blank_maps(stack.shape[1], stack.shape[2])
    run_over_rows(decode_rows, stack.shape[1], frames, plan, maps, band_rows=BAND_ROWS)
    smoothed = _smoothed(maps, options, patterns)
    units = units_of(sensor, scale)
    if plan.has_ripple:
        smoothed = _with_ripple(smoothed, maps, ripple, patterns)
    column, row = (
        _axis(maps, smoothed, k, units, patterns.period_along(axis)) for k, axis in enumerate(AXES)
    )
    return Decoded(column, row, smoothed.reason, patterns.axes)


def _check_stack(stack: Stack, patterns: PatternSet) -> None:
    if stack.dtype.name not in STACK_TYPES:
        raise InputError(f"stack is {stack.dtype}; allowed are {', '.join(STACK_TYPES)}")
    if stack.ndim != 3 or stack.shape[0] != len(patterns.frames) or stack.size == 0:
        raise InputError(
            f"stack has shape {stack.shape}; "
            f"this pattern set needs ({len(patterns.frames)} frames, rows, cols)"
        )


def _blank_maps(rows: int, cols: int) -> Maps:
    turns, mean, modulation, sigma, residual, error = (
        np.zeros((2, rows, cols), np.uint16) for _ in range(6)
    )
    return Maps(
        np.zeros((2, rows, cols), np.float32),
        turns, mean, modulation, sigma, residual, error,
        np.zeros((rows, cols), np.uint8),
    )  # fmt: skip


def _smoothed(maps: Maps, options: DecodeOptions, patterns: PatternSet) -> Smoothed:
    source = Unfiltered(maps.coordinate_px, maps.sigma, maps.reason)
    # The steps of words alone are no noise from pixel to pixel: no mean takes them away.
    if options.filter_taps == 0 or patterns.steps == 0:
        no_bias = np.zeros(source.sigma.shape, np.uint8)
        return Smoothed(source.coordinate_px, source.sigma, no_bias, source.reason)
    taps, sigma_px = options.filter_taps, options.filter_sigma_px
    if patterns.axes == AXES and not patterns.row_periods_px:
        return smooth(source, taps, sigma_px, 0.5 * float(patterns.period_px), SIGMA_UNIT_PX)
    no_bias = np.zeros(maps.sigma.shape, np.uint8)
    result = Smoothed(
        np.zeros_like(maps.coordinate_px), np.zeros_like(maps.sigma), no_bias, maps.reason
    )
    for axis in patterns.axes:
        at = slice(AXES.index(axis), AXES.index(axis) + 1)
        limit_px = 0.5 * float(patterns.period_along(axis))
        one = Unfiltered(maps.coordinate_px[at], maps.sigma[at], maps.reason)
        found = smooth(one, taps, sigma_px, limit_px, SIGMA_UNIT_PX)
        for target, part in zip(result[:3], found[:3], strict=True):
            target[at] = part
        result = result._replace(reason=found.reason)
    return result


def _with_ripple(smoothed: Smoothed, maps: Maps, ripple: Ripple, patterns: PatternSet) -> Smoothed:
    """Add to sigma what is not known of the ripple: waves of many pixels, which no filter takes.

    That of the measuring period stands for all periods of a weighted mean: an upper bound, as their
    ripples are not in step.
    """
    sigma, share = smoothed.sigma.copy(), smoothed.bias_share.copy()
    for k, axis in enumerate(AXES):
        if axis not in patterns.axes:
            continue
        per_rad = np.float32(patterns.period_along(axis) / (2.0 * np.pi))
        node = maps.turns[k] // (TURN_STEPS // NODES)
        doubt_px = per_rad * ripple.sigma_rad[k, 0][node]
        noise_px = Half(smoothed.sigma[k], SIGMA_UNIT_PX).expand()
        whole_px = np.where(noise_px > 0.0, np.hypot(noise_px, doubt_px), np.float32(0.0))
        sigma[k] = Half.of(whole_px, SIGMA_UNIT_PX).bits
        kept = np.divide(noise_px, whole_px, out=np.ones_like(noise_px), where=whole_px > 0.0)
        share[k] = np.rint(share[k] * np.square(kept)).astype(np.uint8)
    return smoothed._replace(sigma=sigma, bias_share=share)


def _axis(
    maps: Maps, smoothed: Smoothed, axis: int, units: tuple[float, float, float], period_px: float
) -> AxisDecode:
    level_dn, sigma_px, chance = units
    coordinate_px, turns = smoothed.coordinate_px[axis], Turns(maps.turns[axis])
    compact: dict[str, Any] = {
        "phase_rad": turns,
        "order": Orders(coordinate_px, turns, float(period_px)),
        "mean_dn": Half(maps.mean[axis], level_dn),
        "modulation_dn": Half(maps.modulation[axis], level_dn),
        "sigma_px": Half(smoothed.sigma[axis], sigma_px),
        "bias_share": Share(smoothed.bias_share[axis]),
        "residual_dn": Half(maps.residual[axis], level_dn),
        "order_error": Half(maps.order_error[axis], chance),
    }
    return AxisDecode(coordinate_px, **compact)


def make_plan(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    options: DecodeOptions,
    scale: FloatImage | None,
    *,
    ripple: Ripple | None = None,
) -> Plan:
    """Return the plan of one decoding."""
    known = ripple or ripple_of(patterns, None)
    column, row = AXES
    return Plan(
        layout=_layout(patterns),
        limits=_limits(stack, patterns, sensor, options),
        codes=(_code(patterns, column), _code(patterns, row)),
        units=Units(*(np.float32(BIAS / unit) for unit in units_of(sensor, scale))),
        unwrappings=(_unwrapping(patterns, column), _unwrapping(patterns, row)),
        is_chain=patterns.is_multi_frequency,
        threshold_noise=_threshold_noise(patterns),
        scale=np.ascontiguousarray(np.zeros((0, 0)) if scale is None else scale, np.float32),
        has_ripple=known.error_rad.size > 0,
        ripple_rad=known.error_rad,
        ripple_sigma_rad=known.sigma_rad,
        shot_share=known.shot_share,
        threshold_share=known.threshold_share,
    )


def _threshold_noise(patterns: PatternSet) -> float:
    """Return the noise of a bit less its threshold, in sigmas of one frame.

    The threshold is the mean of N phase frames, or of white and black; of a pair half the
    difference is read.
    """
    if patterns.inverse:
        return math.sqrt(0.5)
    return math.sqrt(1.0 + 1.0 / (patterns.steps or 2))


def _layout(patterns: PatternSet) -> Layout:
    column, row = AXES
    turns = _shifts(patterns)
    uniform = len(patterns.frames) - 2 if patterns.uniform else -1
    return Layout(
        first_axis=AXES.index(patterns.axes[0]),
        end_axis=AXES.index(patterns.axes[-1]) + 1,
        phase_first=(_first(patterns, "phase", column), _first(patterns, "phase", row)),
        gray_first=(_first(patterns, "gray", column), _first(patterns, "gray", row)),
        inverse_first=(_first(patterns, "inverse", column), _first(patterns, "inverse", row)),
        gray_bits=(patterns.word_bits(column), patterns.word_bits(row)),
        white=uniform,
        black=uniform + 1 if patterns.uniform else -1,
        steps=int(patterns.steps),
        sets=len(patterns.periods_px),
        cosines=np.cos(turns).astype(np.float32),
        sines=np.sin(turns).astype(np.float32),
    )


def _first(patterns: PatternSet, kind: Kind, axis: Axis) -> int:
    """Return where a kind of frames begins in the stack, -1 where there are none."""
    found = [i for i, f in enumerate(patterns.frames) if f.kind == kind and f.axis == axis]
    return found[0] if found else -1


def _shifts(patterns: PatternSet) -> FloatArray:
    """Return the shift of every phase step, (axis, set, step), rad."""
    sets = len(patterns.periods_px)
    turns = 2.0 * np.pi * np.arange(patterns.steps) / max(patterns.steps, 1)
    angles = np.broadcast_to(turns, (2, sets, patterns.steps)).copy()
    for number, shift_deg in enumerate(patterns.first_shifts_deg):
        axis = AXES.index(patterns.axes[number // sets])
        angles[axis, number % sets] += math.radians(shift_deg)
    return angles


def _limits(
    stack: Stack, patterns: PatternSet, sensor: SensorNoise, options: DecodeOptions
) -> Limits:
    # A camera with a black level never delivers 0: that frame was lost.
    has_lost = sensor.black_level_dn > 0.0 or _has_lost_frame(stack, patterns)
    return Limits(
        gain_dn_per_e=np.float32(sensor.gain_dn_per_e),
        read_noise_dn=np.float32(sensor.gain_dn_per_e * sensor.read_noise_e),
        black_level_dn=np.float32(sensor.black_level_dn),
        clipped_from_dn=np.float32(sensor.clipped_from_dn),
        lowest_dn=np.float32(0.0 if has_lost else -np.inf),
        dark_sigmas=np.float32(options.dark_sigmas),
        gray_sigmas=np.float32(options.gray_sigmas),
        min_modulation_dn=np.float32(options.min_modulation_dn or 0.0),
        max_phase_sigma_rad=np.float32(options.max_phase_sigma_rad),
        max_condition=np.float32(options.max_condition),
        max_order_error=np.float32(options.max_order_error),
    )


def _has_lost_frame(stack: Stack, patterns: PatternSet) -> bool:
    """Tell whether a phase frame is 0 everywhere; a look at few pixels settles nearly all."""
    sparse = np.s_[::61, ::61]
    for n in range(len(patterns.axes) * patterns.steps * len(patterns.periods_px)):
        if not stack[n][sparse].any() and not stack[n].any():
            return True
    return False


def units_of(sensor: SensorNoise, scale: FloatImage | None) -> tuple[float, float, float]:
    """Return the units in which levels (DN), sigmas (px) and chances are kept in half precision.

    Powers of two: half precision spans 2^-24 to 2^16 units. Saturation is at most 2^14 of them, as
    the fit of clipped fringes goes beyond.
    """
    largest = sensor.saturation_dn * (1.0 if scale is None else float(scale.max()))
    return 2.0 ** (math.frexp(largest)[1] - 14), SIGMA_UNIT_PX, CHANCE_UNIT


def _code(patterns: PatternSet, axis: Axis) -> Code:
    period_px = float(patterns.period_along(axis))
    mantissa, exponent = math.frexp(period_px)
    high_px = math.ldexp(round(mantissa * 2**HIGH_BITS), exponent - HIGH_BITS)
    return Code(
        kind=KINDS.get(str(patterns.code), PLAIN),
        period_px=period_px,
        period_high_px=np.float32(high_px),
        period_low_px=np.float32(period_px - high_px),
        half_px_turns=np.float32(0.5 / period_px),
        words=np.int32(patterns.words(axis)),
        bits=patterns.word_bits(axis),
        safety_bits=np.uint32(patterns.safety_bits(axis)),
        length_px=patterns.length_px(axis),
        shown=SHOWN[patterns.word],
        place=np.uint32(XOR_PLACES.get(patterns.word, 0)),
        is_word=patterns.steps == 0,
        first_inverse=_first(patterns, "inverse", axis),
    )


def _unwrapping(patterns: PatternSet, axis: Axis) -> Unwrapping:
    chain = patterns.chain(axis)
    sets = patterns.periods_along(axis)
    return Unwrapping(
        weights=np.array(chain.weights if chain else [[1.0] + [0.0] * (len(sets) - 1)], float),
        level_periods_px=np.array(chain.periods_px if chain else sets[:1], float),
        set_periods_px=np.array(sets, float),
        length_px=patterns.length_px(axis),
    )
