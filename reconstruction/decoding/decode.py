"""From a stack of camera frames to projector coordinates, with sigma and reason for every pixel.

Frames: camera pixels (row, col), row 0 at the top; projector coordinates in px, integer = centre of
a projector pixel. Formulas: see `patterns`; N-step least squares after Surrel, Appl. Opt. 36, 271
(1997); codes and edge-safe rules: see `PatternSet`, `_order`.
"""

import math
from typing import Any

import numpy as np

from reconstruction.arrays import FloatImage, Reason, Stack
from reconstruction.compact import Half, Orders, Share, Turns
from reconstruction.compiling import run_over_rows
from reconstruction.decoding import AxisDecode, Decoded, DecodeOptions
from reconstruction.decoding._decode import Maps, Plan, Units, decode_rows
from reconstruction.decoding._filter import Smoothed, Unfiltered, smooth
from reconstruction.decoding._order import COMPLEMENTARY, PLAIN, SHIFTED, Code, Unwrapping
from reconstruction.decoding._rows import BIAS
from reconstruction.decoding._sum import Layout, Limits
from reconstruction.errors import InputError
from reconstruction.patterns import AXES, Axis, PatternSet
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


def decode(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    options: DecodeOptions | None = None,
    scale: FloatImage | None = None,
) -> Decoded:
    """Decode a stack of frames.

    Parameters
    ----------
    stack : (frame, row, col) uint8, uint16 or float32, DN, in the order of `patterns.frames`
    sensor : noise model; gives the masks and the predicted sigma
    options : filter and masks; None: the defaults of `DecodeOptions`
    scale : (row, col) float32, by which each pixel's DN above the black level were multiplied, see
        `merge_exposures`; None: 1

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
    plan = make_plan(frames, patterns, sensor, options, scale)
    maps = _blank_maps(stack.shape[1], stack.shape[2])
    run_over_rows(decode_rows, stack.shape[1], frames, plan, maps, band_rows=BAND_ROWS)
    smoothed = _smoothed(maps, options, patterns.period_px)
    units = units_of(sensor, scale)
    column, row = (_axis(maps, smoothed, axis, units, patterns.period_px) for axis in range(2))
    return Decoded(column, row, smoothed.reason)


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


def _smoothed(maps: Maps, options: DecodeOptions, period_px: float) -> Smoothed:
    source = Unfiltered(maps.coordinate_px, maps.sigma, maps.reason)
    if options.filter_taps == 0:
        no_bias = np.zeros(source.sigma.shape, np.uint8)
        return Smoothed(source.coordinate_px, source.sigma, no_bias, source.reason)
    limit_px = 0.5 * float(period_px)
    return smooth(source, options.filter_taps, options.filter_sigma_px, limit_px, SIGMA_UNIT_PX)


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
) -> Plan:
    """Return the plan of one decoding."""
    column, row = AXES
    return Plan(
        layout=_layout(patterns),
        limits=_limits(stack, patterns, sensor, options),
        codes=(_code(patterns, column), _code(patterns, row)),
        units=Units(*(np.float32(BIAS / unit) for unit in units_of(sensor, scale))),
        unwrappings=(_unwrapping(patterns, column), _unwrapping(patterns, row)),
        is_chain=patterns.chain is not None,
        scale=np.ascontiguousarray(np.zeros((0, 0)) if scale is None else scale, np.float32),
    )


def _layout(patterns: PatternSet) -> Layout:
    column, row = AXES
    turns = 2.0 * np.pi * np.arange(patterns.steps) / patterns.steps
    return Layout(
        phase_first=(patterns.index("phase", column).start, patterns.index("phase", row).start),
        gray_first=(patterns.index("gray", column).start, patterns.index("gray", row).start),
        gray_bits=(patterns.word_bits(column), patterns.word_bits(row)),
        white=patterns.index("white").start,
        black=patterns.index("black").start,
        steps=int(patterns.steps),
        sets=len(patterns.periods_px),
        cosines=np.cos(turns).astype(np.float32),
        sines=np.sin(turns).astype(np.float32),
    )


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
    for n in range(patterns.index("phase", "row").stop):
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
    period_px = float(patterns.period_px)
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
    )


def _unwrapping(patterns: PatternSet, axis: Axis) -> Unwrapping:
    chain = patterns.chain
    sets = patterns.periods_px
    return Unwrapping(
        weights=np.array(chain.weights if chain else [[1.0] + [0.0] * (len(sets) - 1)], float),
        level_periods_px=np.array(chain.periods_px if chain else sets[:1], float),
        set_periods_px=np.array(sets, float),
        length_px=patterns.length_px(axis),
    )
