"""Does an N-step set start at step 0? The phase must agree with the half-periods of the Gray code.

A set that starts k steps late is a perfect set with all coordinates moved by k period / N. Only the
Gray code tells: all bits of an edge-safe code together are even in the first half of every period,
so that the mean of +-exp(i phi) has the argument pi / 2, less the half pixel by which stripes begin
earlier. A set recorded backwards has the phase 2 pi / N - phi.
"""

import numpy as np

from reconstruction.arrays import Doubles
from reconstruction.errors import CaptureError
from reconstruction.patterns import AXES, Axis, PatternSet

# In steps; and in radians, which blur, noise and a few fringes may move the mean by.
LEAST_STEPS_OFF, LEAST_ANGLE_OFF = 0.7, 0.2
# More steps than this are rather a set recorded backwards, where that explains them.
MOST_STEPS_OFF = 2.0
# Phase and Gray code go together above, and have nothing to do with each other below these shares
# of the mean that ideal frames give.
AGREES, DISAGREES = 0.6, 0.3
# Points per projector pixel at which the pattern itself is looked up.
FINE = 16


def check_first_step(pixels: Doubles, patterns: PatternSet) -> None:
    """Compare phase and Gray code along both axes; other codes cannot be checked.

    Parameters
    ----------
    pixels : (frame, pixel), DN, unsaturated and lit

    Raises
    ------
    CaptureError : the phase frames along an axis start at another step, run backwards, or are
        those of the other axis
    """
    if patterns.code not in ("complementary_gray", "shifted_gray"):
        return
    found = {axis: _found(pixels, patterns, axis, axis) for axis in AXES}
    expected = {axis: _expected(patterns, axis) for axis in AXES}
    if all(abs(found[axis]) < DISAGREES * abs(expected[axis]) for axis in AXES):
        _check_exchange(pixels, patterns)
    for axis in AXES:
        if abs(found[axis]) > AGREES * abs(expected[axis]):
            _check_axis(found[axis], expected[axis], patterns, axis)


def _check_exchange(pixels: Doubles, patterns: PatternSet) -> None:
    crossed = [_found(pixels, patterns, axis, other) for axis, other in (AXES, AXES[::-1])]
    if min(abs(mean) for mean in crossed) > AGREES * abs(_expected(patterns, "column")):
        raise CaptureError(
            "the phase frames of columns and rows look exchanged: each goes with the Gray frames "
            "of the other axis"
        )


def _check_axis(found: complex, expected: complex, patterns: PatternSet, axis: Axis) -> None:
    per_step = 2.0 * np.pi / patterns.steps
    turns = float(np.angle(found / expected))
    backwards = float(np.angle(np.conj(found) * np.exp(1j * per_step) / expected))
    steps = turns / per_step
    if abs(steps) <= LEAST_STEPS_OFF or abs(turns) <= LEAST_ANGLE_OFF:
        return
    first = patterns.index("phase", axis).start
    subject = f"the {patterns.steps} phase frames along {axis} (from frame {first}) look"
    if abs(steps) > MOST_STEPS_OFF and abs(backwards) < LEAST_STEPS_OFF * per_step:
        raise CaptureError(f"{subject} recorded backwards: against the Gray frames the phase falls")
    late = "late" if steps > 0 else "early"
    raise CaptureError(
        f"{subject} shifted by {abs(round(steps)) or 1}: against the Gray frames they start that "
        f"many steps {late}; start the recording with step 00"
    )


def _found(pixels: Doubles, patterns: PatternSet, axis: Axis, coded: Axis) -> complex:
    """Return the mean of the phase along `axis`, with the sign of the Gray word along `coded`."""
    phase = pixels[patterns.index("phase", axis)][: patterns.steps]
    turns = np.arange(patterns.steps) / patterns.steps
    phasor = np.exp(-2j * np.pi * turns) @ phase
    bits = pixels[patterns.index("gray", coded)] > phase.mean(axis=0)
    sign = 1.0 - 2.0 * (bits.sum(axis=0) % 2)
    return complex(np.mean(sign * phasor / np.maximum(np.abs(phasor), 1e-12)))


def _expected(patterns: PatternSet, axis: Axis) -> complex:
    length = patterns.length_px(axis)
    x_px = (np.arange(length * FINE) + 0.5) / FINE - 0.5
    half = np.floor(2.0 * np.arange(length) / patterns.period_px)
    sign = 1.0 - 2.0 * (np.repeat(half, FINE) % 2)
    return complex(np.mean(sign * np.exp(2j * np.pi * x_px / patterns.period_px)))
