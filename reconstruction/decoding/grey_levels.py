"""Read the brightness of frames with several grey levels, relative to white and black.

Without white and black frames, white is the mean of the fringes plus their modulation, and black is
the mean minus the modulation.
"""

import numpy as np

from reconstruction.arrays import FloatImage, Stack
from reconstruction.decoding._decode import Plan
from reconstruction.decoding._wrapped import WrappedMaps
from reconstruction.patterns import AXES, Axis, PatternSet


def read_levels(
    stack: Stack, patterns: PatternSet, plan: Plan, fitted: WrappedMaps, axis: Axis
) -> tuple[FloatImage, FloatImage]:
    """Return brightness, 0 for black and 1 for white, and its sigma; both (frame, row, col).

    They are empty if no code word along the axis has several grey levels.
    """
    if not patterns.kind.has_levels(patterns.fringes(axis)):
        return np.zeros((0, 0, 0), np.float32), np.zeros((0, 0, 0), np.float32)
    low_dn, high_dn, end_variance = _ends(stack, patterns, plan, fitted, axis)
    span_dn = np.maximum(high_dn - low_dn, np.float32(1e-6))
    gray, inverse = (stack[patterns.index(kind, axis)] for kind in ("gray", "inverse"))
    levels, sigmas = np.zeros((2, *gray.shape), np.float32)
    for number, frame in enumerate(gray.astype(np.float32)):
        variance = variance_dn2(frame, plan)
        if len(inverse):
            against = inverse[number].astype(np.float32)
            levels[number] = 0.5 + 0.5 * (frame - against) / span_dn
            variance = 0.25 * (variance + variance_dn2(against, plan))
        else:
            levels[number] = (frame - low_dn) / span_dn
        sigmas[number] = np.sqrt(variance + end_variance) / span_dn
    return levels, sigmas


def _ends(
    stack: Stack, patterns: PatternSet, plan: Plan, fitted: WrappedMaps, axis: Axis
) -> tuple[FloatImage, FloatImage, FloatImage]:
    """Return the levels of black and white, DN, and the variance of a level between them, DN^2."""
    if patterns.uniform:
        white, black = (
            stack[patterns.index(kind).start].astype(np.float32) for kind in ("white", "black")
        )
        return black, white, variance_dn2(white, plan)
    k = AXES.index(axis)
    mean, modulation = fitted.mean[k], fitted.modulation[k]
    variance = 3.0 / patterns.steps * np.square(fitted.noise[k])
    return mean - modulation, mean + modulation, variance.astype(np.float32)


def variance_dn2(level_dn: FloatImage, plan: Plan) -> FloatImage:
    """Return the noise variance of levels, (row, col) DN^2; see `_sum.noise_dn2`."""
    limits, scale = plan.limits, plan.scale if plan.scale.size else np.float32(1.0)
    above = np.maximum(level_dn - limits.black_level_dn, np.float32(0.0))
    read = limits.read_noise_dn**2 + np.float32(1.0 / 12.0)
    return np.asarray(scale * (scale * read + limits.gain_dn_per_e * above), np.float32)
