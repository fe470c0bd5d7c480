"""Response curves: estimate a projector's gamma from its own fringes, and make frames linear.

Symbols: g gamma, I = ((1 + cos phi) / 2)^g = cos(phi / 2)^(2 g) the light of a full-range fringe,
B_m its harmonics, proportional to 1 / (Gamma(g + m + 1) Gamma(g - m + 1)), so that B_(m+1) / B_m =
(g - m) / (g + m + 1) and B_2 / B_1 = (g - 1) / (g + 2); used for this purpose by Liu et al., J.
Opt. Soc. Am. A 27, 553 (2010). Lens blur weakens B_2 more than B_1: the estimate is then too close
to 1.
"""

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolImage, FloatArray, Stack
from reconstruction.errors import InputError, require_number
from reconstruction.patterns import AXES, PatternSet
from reconstruction.rig.sensor import SensorNoise

MIN_STEPS = 5
"""With four steps the second harmonic is seen in one quadrature only, with three not at all."""


def estimate_gamma(stack: Stack, patterns: PatternSet, sensor: SensorNoise) -> float:
    """Return the gamma of the projector, from the first two harmonics of all lit pixels.

    Parameters
    ----------
    stack : (frame, row, col), DN of a linear camera, in the order of `patterns.frames`
    patterns : what was projected; black at low_level 0
    sensor : tells which pixels saturate

    Raises
    ------
    InputError : fewer than five steps, or no pixel with fringes
    """
    if patterns.steps < MIN_STEPS:
        raise InputError(
            f"patterns steps is {patterns.steps}; the second harmonic needs at least {MIN_STEPS}"
        )
    sums = np.zeros(2)
    for axis in AXES:
        first = patterns.index("phase", axis).start
        sums += _harmonics(stack[first : first + patterns.steps], sensor)
    if not sums[0] > 0.0:
        raise InputError("no unsaturated pixel shows fringes; expose and aim the camera anew")
    ratio = sums[1] / sums[0]
    return float((1.0 + 2.0 * ratio) / (1.0 - ratio))


def _harmonics(frames: Stack, sensor: SensorNoise) -> FloatArray:
    """Return the sums of B_1 and of the part of B_2 in phase with it over all good pixels.

    The second one is linear in the noise, so that noise does not look like a harmonic.
    """
    turns = np.arange(len(frames)) / len(frames)
    first, second = (np.zeros(frames.shape[1:], complex) for _ in range(2))
    for frame, turn in zip(frames, turns, strict=True):
        first += frame * np.exp(-2j * np.pi * turn)
        second += frame * np.exp(-4j * np.pi * turn)
    size = np.abs(first)
    is_whole = frames.max(axis=0) < sensor.clipped_from_dn
    variance = sensor.variance_dn2(frames.mean(axis=0, dtype=np.float64))
    is_good = is_whole & (size > 10.0 * np.sqrt(len(frames) / 2.0 * variance))
    unit = first[is_good] / size[is_good]
    return np.array([size[is_good].sum(), (second[is_good] / unit**2).real.sum()])


def correct_gamma(stack: Stack, patterns: PatternSet, gamma: float) -> Stack:
    """Return float32 frames as a projector with gamma 1 would have given them.

    Each frame is placed between the black and the white frame of its pixel: u = (I - K) / (W - K)
    becomes u^(1 / gamma). Pixels without light keep their values.
    """
    require_number("gamma", gamma, 0.0, open_low=True)
    black = stack[patterns.index("black").start].astype(np.float32)
    span = stack[patterns.index("white").start] - black
    is_lit: BoolImage = span > 0.0
    result = stack.astype(np.float32)
    for frame in result:
        share = np.divide(frame - black, span, out=np.zeros_like(span), where=is_lit)
        linear = black + span * np.sign(share) * np.abs(share) ** np.float32(1.0 / gamma)
        frame[...] = np.where(is_lit, linear, frame)
    return result


def apply_response(stack: Stack, table_dn: ArrayLike) -> Stack:
    """Return float32 frames made linear by a table of the camera's response.

    Parameters
    ----------
    stack : (frame, row, col) uint8 or uint16, or float32 that is interpolated
    table_dn : (level,) linear DN of each recorded DN 0, 1, 2 ...; strictly rising

    Raises
    ------
    InputError : a table that does not rise or is shorter than the levels of the stack
    """
    table: FloatArray = np.asarray(table_dn, dtype=np.float64)
    if table.ndim != 1 or table.size < 2 or not np.all(np.diff(table) > 0.0):
        raise InputError(
            f"response table has shape {table.shape}; give strictly rising DN, (level,)"
        )
    if not stack.max() <= table.size - 1:
        raise InputError(
            f"stack holds the value {stack.max()}; the response table ends at {table.size - 1}"
        )
    if stack.dtype.kind == "u":
        return np.asarray(table.astype(np.float32)[stack])
    levels = np.arange(table.size)
    return np.stack([np.interp(frame, levels, table).astype(np.float32) for frame in stack])
