"""What the compiled decoder must know, in its own terms: frames, limits, codes."""

import math

import numpy as np

from reconstruction.arrays import FloatImage, Stack
from reconstruction.decoding._band import Plan, Units
from reconstruction.decoding._chain import Ladder
from reconstruction.decoding._half import BIAS
from reconstruction.decoding._order import COMPLEMENTARY, PLAIN, SHIFTED, Code
from reconstruction.decoding._sum import Layout, Limits
from reconstruction.decoding.options import DecodeOptions
from reconstruction.patterns import AXES, Axis, PatternSet
from reconstruction.rig.sensor import SensorNoise

# Times an order of up to 12 bits, exact in the 24 bits of single precision.
HIGH_BITS = 12
# Half precision reaches from 1e-9 to 1000 px, and from 2e-12 to 1.
SIGMA_UNIT_PX = 2.0**-6
CHANCE_UNIT = 2.0**-15
KINDS = {"gray": PLAIN, "complementary_gray": COMPLEMENTARY, "shifted_gray": SHIFTED}


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
        ladders=(_ladder(patterns, column), _ladder(patterns, row)),
        is_chain=patterns.chain is not None,
        scale=np.zeros((0, 0), np.float32)
        if scale is None
        else np.ascontiguousarray(scale, dtype=np.float32),
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


def _ladder(patterns: PatternSet, axis: Axis) -> Ladder:
    chain = patterns.chain
    sets = patterns.periods_px
    return Ladder(
        weights=np.array(chain.weights if chain else [[1.0] + [0.0] * (len(sets) - 1)], float),
        level_periods_px=np.array(chain.periods_px if chain else sets[:1], float),
        set_periods_px=np.array(sets, float),
        length_px=patterns.length_px(axis),
    )
