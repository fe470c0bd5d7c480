"""Compute the parameters of the compiled decoder from patterns, sensor and options; blank maps.

Every value that is equal for all pixels is computed here, before the kernels run.
"""

import math

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, FloatImage, Reason, Stack
from reconstruction.codes import Rule
from reconstruction.compact import TURN_STEPS
from reconstruction.decoding import DecodeOptions, FrameGains
from reconstruction.decoding._chain import Unwrapping
from reconstruction.decoding._decode import Maps, Plan, Units
from reconstruction.decoding._order import COMPLEMENTARY, PLAIN, SHIFTED, Code
from reconstruction.decoding._rows import BIAS
from reconstruction.decoding._sum import Layout, Limits
from reconstruction.decoding.ripple import Ripple, ripple_of, turned
from reconstruction.patterns import AXES, Axis, Kind, PatternSet
from reconstruction.rig.sensor import SensorNoise
from reconstruction.words import gray_word

# Bits of `Code.period_high_px`: its product with an order of up to 12 bits is exact in the 24 bits
# of single precision.
HIGH_BITS = 12
# Half precision spans 1e-9 to 1000 px, and 2e-12 to 1.
SIGMA_UNIT_PX = 2.0**-6
CHANCE_UNIT = 2.0**-15
KERNELS = {
    Rule.WORD_PER_PERIOD: PLAIN,
    Rule.WORD_PER_HALF_PERIOD: COMPLEMENTARY,
    Rule.TWO_WORDS: SHIFTED,
}


def make_plan(
    stack: Stack,
    patterns: PatternSet,
    sensor: SensorNoise,
    options: DecodeOptions,
    scale: FloatImage | None,
    *,
    ripple: Ripple | None = None,
    displacement: float = 0.0,
    gains: FrameGains | None = None,
    equal_steps: float | None = None,
) -> Plan:
    """Return the parameters of the kernels for decoding one stack of frames.

    Parameters
    ----------
    stack, patterns, sensor, options, scale : as in `decode`
    ripple : tables of the projector's response; None: the response is linear
    displacement : share of the period; the kernels decode x + displacement * period, see
        `place_displaced`
    gains : relative light of the phase frames, by which their levels are divided; None: 1
    equal_steps : number of equal frames of the camera's noise that give the same sigma of the
        phase; None: the number of steps, see `reduction.Equivalent`
    """
    tables = turned(ripple or ripple_of(patterns, None), displacement)
    column, row = AXES
    return Plan(
        layout=_layout(patterns, displacement, gains, equal_steps or float(patterns.steps)),
        limits=_limits(stack, patterns, sensor, options),
        codes=(_code(patterns, column, displacement), _code(patterns, row, displacement)),
        units=Units(*(np.float32(BIAS / unit) for unit in units_of(sensor, scale))),
        unwrappings=(_unwrapping(patterns, column), _unwrapping(patterns, row)),
        is_chain=patterns.kind.rule is Rule.CHAIN,
        threshold_noise=_threshold_noise(patterns),
        scale=np.ascontiguousarray(np.zeros((0, 0)) if scale is None else scale, np.float32),
        has_ripple=tables.error_rad.size > 0,
        ripple_rad=tables.error_rad,
        ripple_sigma_rad=tables.sigma_rad,
        shot_share=tables.shot_share,
        threshold_share=tables.threshold_share,
    )


def _threshold_noise(patterns: PatternSet) -> float:
    """Return the sigma of a bit's level minus its threshold, in sigmas of one frame.

    The threshold is the mean of N phase frames, or of white and black. With inverse frames, half
    the difference of frame and inverse frame takes the place of level minus threshold.
    """
    if patterns.inverse:
        return math.sqrt(0.5)
    return math.sqrt(1.0 + 1.0 / (patterns.steps or 2))


def _layout(
    patterns: PatternSet, displacement: float, gains: FrameGains | None, equal_steps: float
) -> Layout:
    column, row = AXES
    turns = _shifts(patterns) - 2.0 * np.pi * displacement
    factors = np.ones(turns.shape) if gains is None else 1.0 / gains.relative
    offsets = np.zeros(turns.shape) if gains is None else gains.dark_dn[..., None] * (1.0 - factors)
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
        equal_steps=float(equal_steps),
        sets=patterns.sets,
        cosines=np.cos(turns).astype(np.float32),
        sines=np.sin(turns).astype(np.float32),
        factors=factors.astype(np.float32),
        offsets=offsets.astype(np.float32),
    )


def _first(patterns: PatternSet, kind: Kind, axis: Axis) -> int:
    """Return the stack index of the first frame of a kind along an axis; -1: no such frame."""
    indices = [i for i, f in enumerate(patterns.frames) if f.kind == kind and f.axis == axis]
    return indices[0] if indices else -1


def _shifts(patterns: PatternSet) -> FloatArray:
    """Return the phase shift of every phase frame, (axis, set, step), rad."""
    sets, periods = patterns.sets, len(patterns.periods_px)
    turns = 2.0 * np.pi * np.arange(patterns.steps) / max(patterns.steps, 1)
    if patterns.stepping != "equal":
        turns = 2.0 * np.pi * np.array(patterns.phase_shifts.shifts(patterns.steps))
    angles = np.broadcast_to(turns, (2, sets, patterns.steps)).copy()
    for number, shift_deg in enumerate(patterns.first_shifts_deg):
        if number % periods < sets:
            axis = AXES.index(patterns.axes[number // periods])
            angles[axis, number % periods] += math.radians(shift_deg)
    return angles


def _limits(
    stack: Stack, patterns: PatternSet, sensor: SensorNoise, options: DecodeOptions
) -> Limits:
    # A camera with a black level never records the level 0, so a frame with 0 was lost.
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
    """Return True if a phase frame is 0 everywhere; a sparse test first excludes most frames."""
    sparse = np.s_[::61, ::61]
    shown = sum(frame.kind == "phase" for frame in patterns.frames)
    return any(not stack[n][sparse].any() and not stack[n].any() for n in range(shown))


def units_of(sensor: SensorNoise, scale: FloatImage | None) -> tuple[float, float, float]:
    """Return the units of levels (DN), sigmas (px) and probabilities in half precision.

    The units are powers of two. Half precision covers 2^-24 to 2^16 units. The saturation level is
    at most 2^14 units, because the fit to clipped fringes may exceed it.
    """
    largest = sensor.saturation_dn * (1.0 if scale is None else float(scale.max()))
    return 2.0 ** (math.frexp(largest)[1] - 14), SIGMA_UNIT_PX, CHANCE_UNIT


def _code(patterns: PatternSet, axis: Axis, displacement: float) -> Code:
    period_px = float(patterns.period_along(axis))
    mantissa, exponent = math.frexp(period_px)
    words, length_px = patterns.words(axis), patterns.length_px(axis)
    high_px = math.ldexp(round(mantissa * 2**HIGH_BITS), exponent - HIGH_BITS)
    return Code(
        kind=KERNELS.get(patterns.kind.rule, PLAIN),
        period_px=period_px,
        period_high_px=np.float32(high_px),
        period_low_px=np.float32(period_px - high_px),
        half_px_turns=np.float32(0.5 / period_px),
        words=np.int32(words[0].count(length_px) if words else 1),
        bits=sum(word.bits for word in words),
        safety_bits=np.uint32(sum(word.bits for word in words[1:])),
        length_px=length_px + math.ceil(displacement * period_px),
        gray_of=_gray_words(patterns, axis),
        is_word=patterns.steps == 0,
        first_inverse=_first(patterns, "inverse", axis),
    )


def _gray_words(patterns: PatternSet, axis: Axis) -> NDArray[np.uint32]:
    """Return the Gray word of each number of bits as read; empty if the bits are Gray words.

    Only one word per axis has another encoding in the compiled decoder, see `general`.
    """
    words = patterns.words(axis)
    if len(words) != 1:
        return np.zeros(0, np.uint32)
    gray = gray_word(patterns.encoding.words_of(words[0].bits))
    is_gray = np.array_equal(gray, np.arange(gray.size))
    return np.zeros(0, np.uint32) if is_gray else gray.astype(np.uint32)


def place_displaced(maps: Maps, patterns: PatternSet) -> None:
    """Subtract the displacement of the patterns from decoded coordinates and phases, in place.

    The displacement is `patterns.kind.displacement`, a share of the period. If the number of
    periods is a power of two, the end of the projector image has the word of an earlier period. The
    two cannot be distinguished: pixels of both are masked with the reason `ORDER_UNCERTAIN`.
    """
    displacement = patterns.kind.displacement
    for k, axis in enumerate(AXES):
        if axis not in patterns.axes:
            continue
        period_px, length_px = patterns.period_along(axis), patterns.length_px(axis)
        shift_px = displacement * period_px
        x_px = maps.coordinate_px[k] - np.float32(shift_px)
        is_valid = maps.reason == Reason.VALID
        is_outside = is_valid & ((x_px < -0.5) | (x_px > length_px - 0.5))
        end_px = period_px * patterns.word_count(axis) - shift_px
        is_double = is_valid & (end_px < length_px)
        is_double &= x_px < end_px - (period_px - shift_px) - 0.5
        is_double &= x_px >= end_px - period_px - 0.5
        maps.reason[is_outside] = Reason.OUTSIDE_PROJECTOR
        maps.reason[is_double] = Reason.ORDER_UNCERTAIN
        maps.coordinate_px[k] = np.where(is_valid, x_px, 0.0)
        back = np.uint16(round(TURN_STEPS * (1.0 - displacement)) % TURN_STEPS)
        maps.turns[k] += np.where(maps.modulation[k] > 0, back, np.uint16(0))
    for lines in (maps.coordinate_px, maps.sigma):
        lines[:, maps.reason != Reason.VALID] = 0


def _unwrapping(patterns: PatternSet, axis: Axis) -> Unwrapping:
    kind = patterns.kind
    chain = kind.chain(patterns.fringes(axis)) if kind.rule is Rule.CHAIN else None
    sets = patterns.periods_along(axis)
    return Unwrapping(
        weights=np.array(chain.weights if chain else [[1.0] + [0.0] * (len(sets) - 1)], float),
        level_periods_px=np.array(chain.periods_px if chain else sets[:1], float),
        set_periods_px=np.array(sets, float),
        length_px=patterns.length_px(axis),
    )


def blank_maps(rows: int, cols: int) -> Maps:
    """Return packed maps for an image of the given size, filled with 0."""
    turns, mean, modulation, sigma, residual, error = (
        np.zeros((2, rows, cols), np.uint16) for _ in range(6)
    )
    return Maps(
        np.zeros((2, rows, cols), np.float32),
        turns, mean, modulation, sigma, residual, error,
        np.zeros((rows, cols), np.uint8),
    )  # fmt: skip
