"""Cyclic steps of a quarter period, and binomial self-compensation of the error by motion.

The phase of four steps of a surface in motion has a ripple of twice the fringe frequency. From one
frame to the next the ripple of a sliding set of four frames changes its sign, while the phase
changes little. Binomial weights over K + 1 sliding sets cancel the ripple up to the order K:
Zhang, Zhu, Liu, "Binomial self-compensation for motion error in dynamic 3D scanning", ECCV 2024
(arXiv 2404.06693). The weights act on the images, not on the phases, as in their image-sequential
form (arXiv 2507.10009): frames of equal shift are averaged, and only one phase is computed.

With 4 + K frames and a phase that changes by the constant rate e, rad per frame, the phase error in
the middle of the frames is arg(1 + r exp(-2 i psi)) with r = tan(e / 2)^(K + 1) and psi the phase
plus the mean shift. K = 0 are four steps, K = 1 is the formula of five steps by Schwider (1983) and
Hariharan (1987).

Binomial weights cancel a constant mean level, but not one that changes, as shading does that moves
through a pixel. In Surrel's description ("Design of algorithms for phase measurements by the use of
phase stepping", Appl. Opt. 35, 51, 1996) the weights are the coefficients of a polynomial, and each
disturbance is a root of it: that of the mean level and that of the second harmonic have to be
double for a linear change. The windowed weights are (1 + z^2)^2 (1 + z)^(N - 5) in place of
(1 + z^2) (1 + z)^(N - 3), with r = tan(e / 2)^(N - 5); those of 7 frames are his triangular window.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from reconstruction.arrays import FloatArray, FloatImage, Stack
from reconstruction.errors import InputError
from reconstruction.patterns import PatternSet
from reconstruction.reduction.equivalent import (
    Equivalent,
    fringe_sets,
    lost_pixels,
    with_equal_steps,
)
from reconstruction.rig.sensor import SensorNoise
from reconstruction.stepping import CYCLE


def binomial_weights(frames: int) -> FloatArray:
    """Return the weight (frame,) of each cyclic frame; those of frames of equal shift have sum 1.

    Parameters
    ----------
    frames : number of frames, 4 + K for the binomial order K >= 0

    Raises
    ------
    InputError : there are fewer than four frames
    """
    if frames < CYCLE:
        raise InputError(f"cyclic frames: found {frames}; needed are {CYCLE} or more")
    weights = np.ones(CYCLE)
    for _ in range(frames - CYCLE):
        weights = 0.5 * np.convolve(weights, [1.0, 1.0])
    return np.asarray(weights)


def windowed_weights(frames: int) -> FloatArray:
    """Return weights (frame,) as `binomial_weights`, which cancel light that changes linearly.

    Parameters
    ----------
    frames : number of frames, 6 or more

    Raises
    ------
    InputError : there are fewer than six frames
    """
    if frames < CYCLE + 2:
        raise InputError(f"windowed frames: found {frames}; needed are {CYCLE + 2} or more")
    pair = np.array([1.0, 0.0, 1.0])
    # The sum of the weights of each shift is 1, as for four frames.
    weights = np.convolve(pair, pair)
    for _ in range(frames - CYCLE - 1):
        weights = 0.5 * np.convolve(weights, [1.0, 1.0])
    return np.asarray(weights)


CYCLIC_WEIGHTS = {"cyclic": binomial_weights, "windowed": windowed_weights}
"""Functions that return the weights (frame,) of a number of frames, by stepping."""


def average_cyclic(
    stack: Stack, patterns: PatternSet, sensor: SensorNoise, scale: FloatImage | None = None
) -> Equivalent:
    """Return four equal steps, the weighted means of the cyclic frames of equal shift.

    Parameters
    ----------
    stack, patterns, sensor, scale : as in `decode`, with a stepping of `CYCLIC_WEIGHTS`
    """
    weights = CYCLIC_WEIGHTS[patterns.stepping](patterns.steps)
    averaged = []
    for frames in fringe_sets(stack, patterns):
        four: FloatImage = np.zeros((CYCLE, *frames.shape[1:]), np.float32)
        for first in range(CYCLE):
            of_shift = frames[first::CYCLE]
            for weight, frame in zip(weights[first::CYCLE], of_shift, strict=True):
                four[first] += np.float32(weight) * frame
            lost, marked_dn = lost_pixels(of_shift, sensor, scale)
            four[first] = np.where(lost, marked_dn, four[first])
        averaged.append(four)
    equal = replace(patterns, steps=CYCLE, stepping="equal")
    # Each frame contributes the share weight^2 of its noise. The mean over the phase is exact;
    # the variance at one phase differs from it by up to 14 % for K = 1, less for larger K.
    equal_steps = CYCLE**2 / float(np.square(weights).sum())
    return Equivalent(with_equal_steps(stack, patterns, averaged), equal, equal_steps)


def cyclic_windows(
    frames: Stack, others: Stack, patterns: PatternSet
) -> Iterator[tuple[Stack, PatternSet]]:
    """Return a stack and its patterns for each window of a longer recording of cyclic frames.

    There is a result for every frame from number `patterns.steps` - 1 on. It is that of the middle
    of its window.

    Parameters
    ----------
    frames : (frame, row, col) DN, frame n with the shift of n quarters of the period; one axis
    others : (frame, row, col) DN, frames of the code and uniform frames in the order of `patterns`
    patterns : sequence with a stepping of `CYCLIC_WEIGHTS`, one axis and one period; its number of
        steps is the width of the window

    Raises
    ------
    InputError : another stepping, several axes or periods, or less frames than steps
    """
    width = patterns.steps
    if patterns.stepping not in CYCLIC_WEIGHTS or len(patterns.axes) * patterns.sets != 1:
        raise InputError("cyclic windows need cyclic patterns, one axis and one period")
    if len(frames) < width or len(others) != len(patterns.frames) - width:
        raise InputError(
            f"cyclic windows: found {len(frames)} cyclic and {len(others)} other frames; needed are"
            f" {width} or more, and {len(patterns.frames) - width}"
        )
    start_deg = patterns.first_shifts_deg[0] if patterns.first_shifts_deg else 0.0
    for first in range(len(frames) - width + 1):
        shift_deg = (start_deg + first % CYCLE * 360.0 / CYCLE) % 360.0
        window = np.concatenate([frames[first : first + width], others])
        yield window, replace(patterns, first_shifts_deg=(shift_deg,))
